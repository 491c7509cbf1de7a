#!/usr/bin/python3
"""Runs the fuzzer over every parser, one after the other, and keeps the ledger of executions.

  run.py --seconds 1                 as the check does: the corpus, then a second for each parser
  run.py --seconds 600 --ledger tests/fuzz/ledger.tsv     the same for longer, counted
  run.py --seconds 600 --keep        and what reaches new edges is kept in corpus/
  run.py --seconds 600 --lean        without sanitizers, for many more executions; what reaches new
                                     edges is run with them then
  run.py --until 10000000            only parsers with fewer executions than that in the ledger, and
                                     not beyond it

What crashes, hangs or leaks is written to --found; `fuzz PARSER --input FILE` shows it again.
"""

import argparse
import random
import re
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
SAID = re.compile(r"(\d+) executions in ([\d.]+) s, (\d+) inputs, (\d+) edges")
MOST_KEPT, MOST_BYTES = 60, 4096  # of a parser


def read_ledger(ledger):
    lines = ledger.read_text().splitlines() if ledger.exists() else []
    return {line.split("\t")[0]: line.split("\t") for line in lines[1:]}


def write_ledger(ledger, rows):
    head = "parser\texecutions\tsanitized\tseconds\tfindings\tedges\tlast"
    ledger.write_text("\n".join([head] + ["\t".join(row) for _, row in sorted(rows.items())]) + "\n")


def note(ledger, parser, executions, sanitized, seconds, failed, edges):
    """Adds to the parser's row; another process may have written since."""
    rows = read_ledger(ledger)
    row = rows.get(parser, [parser, "0", "0", "0", "0", "0", ""])
    rows[parser] = [parser, str(int(row[1]) + executions), str(int(row[2]) + sanitized),
                    str(round(float(row[3]) + seconds)), str(int(row[4]) + failed),
                    str(max(int(row[5]), edges)), date.today().isoformat()]
    write_ledger(ledger, rows)


def keep(parser, folder):
    """The smallest of what was new, as many as there is room for."""
    target = CORPUS / parser
    target.mkdir(parents=True, exist_ok=True)
    room = MOST_KEPT - len(list(target.iterdir()))
    fresh = sorted((path for path in folder.iterdir() if path.stat().st_size <= MOST_BYTES),
                   key=lambda path: path.stat().st_size)
    for path in random.sample(fresh, min(len(fresh), max(room, 0))):
        (target / path.name).write_bytes(path.read_bytes())


def run(program, parser, options, *more):
    """One process; (executions, seconds, edges, whether it found something)."""
    command = [program, parser, "--found", options.found, *more]
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True,
                            errors="replace", check=False)
    said = SAID.search(result.stdout)
    print(result.stdout.strip() or f"{parser}: ended with {result.returncode}", flush=True)
    if result.returncode:
        print(result.stderr[-3000:], flush=True)
    executions, seconds, _, edges = said.groups() if said else (0, 0, 0, 0)
    return int(executions), float(seconds), int(edges), result.returncode != 0


def fuzz(parser, options, done, most):
    limits = ["--seconds", options.seconds, "--runs", most, "--seed", options.seed or 1 + done]
    with tempfile.TemporaryDirectory() as folder:
        fresh = Path(folder) / parser
        fresh.mkdir()
        limits += ["--keep", fresh] if options.keep or options.lean else []
        program = f"{options.program}-lean" if options.lean else options.program
        executions, seconds, edges, failed = run(program, parser, options, "--corpus", CORPUS, *limits)
        sanitized = 0 if options.lean else executions
        if options.lean:
            sanitized, more_s, edges, bad = run(options.program, parser, options, "--corpus", folder,
                                                "--runs", 0)
            executions, seconds, failed = executions + sanitized, seconds + more_s, failed or bad
        if options.keep:
            keep(parser, fresh)
    if options.ledger and (executions or failed):
        note(Path(options.ledger), parser, executions, sanitized, seconds, int(failed), edges)
    return not failed


def choose(names, options):
    """Parsers, executions of each so far, and how many more; those with the most come first."""
    rows = read_ledger(Path(options.ledger)) if options.ledger else {}
    done = {parser: int(rows[parser][1]) if parser in rows else 0 for parser in names}
    if not options.until:
        return [(parser, done[parser], 2**63) for parser in names]
    return [(parser, done[parser], options.until - done[parser])
            for parser in sorted(names, key=done.get, reverse=True) if done[parser] < options.until]


def main():
    arguments = argparse.ArgumentParser(description=__doc__,
                                        formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", default="build/tests/fuzz/fuzz")
    arguments.add_argument("--seconds", type=float, default=60, help="for each parser")
    arguments.add_argument("--seed", type=int, help="another one for each state of the ledger")
    arguments.add_argument("--ledger", help="the file that counts executions, ledger.tsv")
    arguments.add_argument("--lean", action="store_true")
    arguments.add_argument("--until", type=int, help="executions by the ledger")
    arguments.add_argument("--keep", action="store_true")
    arguments.add_argument("--found", default=".", help="where findings are written")
    arguments.add_argument("parsers", nargs="*", help="all when none is named")
    options = arguments.parse_args()
    names = subprocess.run([options.program, "--list"], capture_output=True, text=True,
                           check=True).stdout.split()
    if options.until and not options.ledger:
        arguments.error("--until takes --ledger")
    good = [fuzz(parser, options, done, most)
            for parser, done, most in choose(options.parsers or names, options)]
    print(f"{good.count(True)} passed, {good.count(False)} failed")
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
