"""Runs the numerics programs of a build and writes their cases as a page: page.py BUILD [PAGE].

The page (RESULTS.md beside this file when not named) has one line a case: its range, its bound,
the worst error seen and where. Programs that are skipped are listed as such. The exit code is 0
only when every bound held.
"""

import os
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path

SKIPPED = 77
HEAD = """# Numerics: bounds and worst errors

Written by `tests/numerics/page.py BUILD`. The truth is 256-bit arithmetic (MPFR), long double or
float64 where that provably suffices; ULP are units in the last place of the number type named
with the case. Inputs are a list of corners and fresh random numbers; `RN_NUMERICS_SEED` repeats a
run. `meson test --suite numerics` fails when a bound does not hold; `mutations.sh` shows that each
test can fail.

{date}, {machine}.
"""


def run(program, seed):
    environment = dict(os.environ, RN_NUMERICS_SEED=str(seed)) if seed else None
    return subprocess.run([program], capture_output=True, text=True, check=False, env=environment)


def machine():
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        model = "unknown processor"
    return f"{platform.machine()}, {model}"


def table(rows):
    lines = ["| case | range | bound | worst seen | where |", "|---|---|---|---|---|"]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def losses(rows):
    """The comparison of forms: one line a quantity, number type and range, one column a form."""
    forms, cells = [], {}
    for case, span, _, worst, _ in rows:
        quantity, form, kind = case.split(", ")
        cells.setdefault((quantity, kind, span), {})[form] = worst.replace(" relative", "")
        if form not in forms:
            forms.append(form)
    lines = ["| quantity | type | range | " + " | ".join(forms) + " |",
             "|---|---|---|" + "---|" * len(forms)]
    for key, row in cells.items():
        lines.append("| " + " | ".join(key + tuple(row.get(form, "") for form in forms)) + " |")
    return "\n".join(lines) + "\n"


def main(build, page=None):
    programs = sorted(path for path in (Path(build) / "tests/numerics").glob("numerics_*")
                      if path.is_file() and os.access(path, os.X_OK)
                      and not path.name.startswith("numerics_flags"))
    rows, shown, skipped, absent, seeds, failed = [], [], [], [], [], not programs
    for program in programs:
        result = run(program, os.environ.get("RN_NUMERICS_SEED"))
        name = program.name.removeprefix("numerics_")
        if result.returncode == SKIPPED:
            skipped.append(name)
            continue
        failed |= result.returncode != 0
        for line in result.stdout.splitlines():
            cells = line.split("\t")
            if line.startswith("seed "):
                seeds.append(f"{name} {line[5:]}")
            elif len(cells) == 3 and cells[1] == "skipped":
                absent.append((cells[0], cells[2]))
            elif len(cells) == 5:
                (shown if cells[2] == "none, shown" else rows).append(cells)
    rows.sort(key=lambda row: int(row[0].split()[0]))
    text = HEAD.format(date=date.today().isoformat(), machine=machine())
    text += "\n## Cases\n\n" + table(rows)
    if shown:
        text += "\n## What other forms lose\n\nThe worst relative error over the same range.\n\n"
        text += losses(shown)
    if absent:
        text += "\n## Skipped\n\nNeither passed nor failed: this build has none of it.\n\n"
        text += "| case | why |\n|---|---|\n"
        text += "".join(f"| {case} | {why} |\n" for case, why in sorted(absent))
    if skipped:
        text += "\nSkipped on this machine: " + ", ".join(skipped) + ".\n"
    text += "\nSeeds: " + ", ".join(seeds) + ".\n"
    path = Path(page) if page else Path(__file__).with_name("RESULTS.md")
    path.write_text(text, encoding="utf-8")
    print(f"{path}: {len(rows)} cases" + (", a bound does not hold" if failed else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
