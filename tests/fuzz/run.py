#!/usr/bin/python3
"""Runs the fuzzer over every parser, one after the other, and keeps the ledger of executions.

  run.py --seconds 1                 as the check does: the corpus, then a second for each parser
  run.py --seconds 600 --ledger tests/fuzz/ledger.tsv     the same for longer, counted
  run.py --seconds 600 --keep        and what reaches new edges is kept in corpus/

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
    head = "parser\texecutions\tseconds\tfindings\tedges\tlast"
    ledger.write_text("\n".join([head] + ["\t".join(row) for _, row in sorted(rows.items())]) + "\n")


def note(ledger, parser, executions, seconds, failed, edges):
    """Adds to the parser's row; another process may have written since."""
    rows = read_ledger(ledger)
    row = rows.get(parser, [parser, "0", "0", "0", "0", ""])
    rows[parser] = [parser, str(int(row[1]) + executions), str(round(float(row[2]) + seconds)),
                    str(int(row[3]) + failed), str(max(int(row[4]), edges)),
                    date.today().isoformat()]
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


def fuzz(program, parser, options):
    with tempfile.TemporaryDirectory() as fresh:
        command = [program, parser, "--corpus", CORPUS, "--seconds", str(options.seconds),
                   "--seed", str(options.seed), "--found", options.found]
        if options.keep:
            command += ["--keep", fresh]
        result = subprocess.run([str(word) for word in command], capture_output=True, text=True,
                                errors="replace", check=False)
        said = SAID.search(result.stdout)
        print(result.stdout.strip() or f"{parser}: ended with {result.returncode}", flush=True)
        if result.returncode:
            print(result.stderr[-3000:], flush=True)
        if options.keep:
            keep(parser, Path(fresh))
    if options.ledger and said:
        executions, seconds, _, edges = said.groups()
        note(Path(options.ledger), parser, int(executions), float(seconds),
             int(result.returncode != 0), int(edges))
    return result.returncode == 0


def main():
    arguments = argparse.ArgumentParser(description=__doc__,
                                        formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--program", default="build/tests/fuzz/fuzz")
    arguments.add_argument("--seconds", type=float, default=60, help="for each parser")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--ledger", help="the file that counts executions, ledger.tsv")
    arguments.add_argument("--keep", action="store_true")
    arguments.add_argument("--found", default=".", help="where findings are written")
    arguments.add_argument("parsers", nargs="*", help="all when none is named")
    options = arguments.parse_args()
    names = subprocess.run([options.program, "--list"], capture_output=True, text=True,
                           check=True).stdout.split()
    chosen = options.parsers or names
    good = [fuzz(options.program, parser, options) for parser in chosen]
    print(f"{good.count(True)} passed, {good.count(False)} failed")
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
