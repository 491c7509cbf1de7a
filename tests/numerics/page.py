"""Runs `meson test --suite numerics` on a build and writes its cases as a page: page.py BUILD [PAGE].

The page (RESULTS.md beside this file when not named) has a table for each case of the suite: what
was measured, on which code, over which range, the bound, the worst error seen and where. Tests that
are skipped are listed as such. The exit code is 0 only when every bound held.
"""

import json
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path

TITLES = {
    1: "Frustum moments", 2: "Projected footprint and level", 3: "Ripmap, and planes that grow",
    4: "Planes from solids", 5: "Density, compositing, networks", 6: "Rays and the march",
    7: "Cameras", 8: "Optimiser", 9: "Training that would diverge", 10: "Long runs",
    11: "Reproducibility", 12: "Metrics", 13: "Images",
}
SETS = ("float64", "float32", "reference", "generic", "avx2", "avx512", "avx512bf16", "amx", "cuda")
HEAD = """# Numerics: bounds and worst errors

How far each piece of the field's arithmetic is from the truth, against a bound that is stated
beforehand. The truth is 256-bit arithmetic (MPFR), or long double or float64 where that provably
suffices. Inputs are a list of corners and fresh random numbers from the seeds at the end
(`RN_NUMERICS_SEED` repeats a run). **ULP** are units in the last place of the number type: 2^-23
for fp32, 2^-52 for float64, relative. **On** names the code: `float64` and `float32` are the
reference's formulas in that type, `reference` the float64 field, `cuda` the functions of the GPU's
kernels, run by an emulator in which the machine's approximate logarithm, root and quotient are as far
off as they may be; the others are the CPU's kernel sets that this machine can run.

{storage}
Written by `meson compile -C BUILD numerics-page`, which runs `meson test --suite numerics`; a test
fails when a bound does not hold. `tests/numerics/mutations.sh` puts each naive formula back and shows
that a test then fails. `ripnerf doctor [SCENE]` measures the quick ones on your machine and scene.

{date}, {machine}. {summary}
"""


STORAGE = (
    ("float64, reference", "float64", "float64", "float64", "float64"),
    ("generic, avx2, avx512", "fp32", "fp32", "fp32", "fp32"),
    ("avx512bf16, amx", "fp32", "bf16", "bf16 within the networks, fp32 of texels and weights", "fp32"),
    ("cuda", "fp16, made anew from fp32 texels after every step", "fp16",
     "fp16 with a power of two, sums of texels fp16 (fixed point of 2^-30 in the deterministic mode)", "fp32"),
)


def storage():
    return ("What is stored in which type; all sums of products are fp32 or wider:\n\n"
            + table(["on", "planes' maps", "features and activations", "their gradients",
                     "parameters, moments, optical depths"], STORAGE))


def run_suite(build):
    command = ["meson", "test", "-C", build, "--suite", "numerics", "--logbase", "numerics"]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    lines = (Path(build) / "meson-logs/numerics.json").read_text(encoding="utf-8").splitlines()
    return sorted((json.loads(line) for line in lines), key=lambda test: test["name"])


def machine():
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        model = "unknown processor"
    return f"{platform.machine()}, {model}"


def table(header, rows):
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


class Row:
    """One measurement, of all the code that shares its range and bound."""

    def __init__(self, what, span, bound, unit):
        self.what, self.span, self.bound, self.unit = what, span, bound, unit
        self.sets, self.worst, self.worst_set, self.where = [], -1.0, "", ""

    def see(self, kind, worst, where):
        self.sets.append(kind)
        if float(worst) > self.worst:
            self.worst, self.worst_set, self.where = float(worst), kind, where

    def cells(self):
        sets = [kind for kind in SETS if kind in self.sets]
        worst = f"{self.worst:.3g}" + (f" ({self.worst_set})" if len(sets) > 1 else "")
        return [self.what, ", ".join(sets), self.span, self.bound, worst, self.unit, self.where]


def split_name(name):
    """`5 density, avx2` -> (5, "density", "avx2")."""
    number, what = name.split(" ", 1)
    head, _, kind = what.rpartition(", ")
    return (int(number), head, kind) if kind in SETS else (int(number), what, "")


class Suite:
    """What the tests printed."""

    def __init__(self, tests):
        self.rows, self.shown, self.skipped, self.checks, self.seeds = {}, [], [], [], []
        self.failed = not tests
        for test in tests:
            self.take(test)

    def take(self, test):
        output = test.get("stdout", "")
        name = test["name"].rpartition(" / ")[2].removeprefix("numerics ")
        if test["result"] == "SKIP":
            lines = output.strip().splitlines()
            self.skipped.append((name, lines[-1].removeprefix("skipped: ") if lines else ""))
            return
        self.failed |= test["result"] != "OK"
        measured = [self.line(name, line.split("\t")) for line in output.splitlines()]
        if not any(measured):
            self.checks.append((name, "holds" if test["result"] == "OK" else test["result"]))

    def line(self, name, cells):
        if cells[0].startswith("seed "):
            self.seeds.append(f"{name} {cells[0][5:]}")
        elif len(cells) == 3 and cells[1] == "skipped":
            self.skipped.append((cells[0], cells[2]))
        elif len(cells) == 5:
            if cells[2] == "none, shown":
                self.shown.append(cells)
                return True
            number, what, kind = split_name(cells[0])
            bound, unit = cells[2].split(" ", 1)
            key = (number, what, cells[1], bound, unit)
            row = self.rows.setdefault(key, Row(what, cells[1], bound, unit))
            row.see(kind, cells[3].split(" ", 1)[0], cells[4])
            return True
        return False


def losses(rows):
    """The comparison of forms: one line a quantity, number type and range, one column a form."""
    forms, cells = [], {}
    for case, span, _, worst, _ in rows:
        quantity, form, kind = case.removeprefix("1 ").split(", ")
        cells.setdefault((quantity, kind, span), {})[form] = worst.replace(" relative", "")
        if form not in forms:
            forms.append(form)
    lines = [key + tuple(row.get(form, "") for form in forms) for key, row in cells.items()]
    return table(["quantity", "type", "range"] + forms, lines)


def page_of(suite):
    count = sum(len(row.sets) for row in suite.rows.values())
    summary = (f"{count} bounds, {len(suite.checks)} proofs and checks"
               + (", NOT ALL OF WHICH HOLD" if suite.failed else "; all hold") + ".")
    text = HEAD.format(date=date.today().isoformat(), machine=machine(), summary=summary,
                       storage=storage())
    for number in sorted({key[0] for key in suite.rows}):
        rows = [row.cells() for key, row in suite.rows.items() if key[0] == number]
        text += f"\n## {number}. {TITLES.get(number, '')}\n\n"
        text += table(["what", "on", "range", "bound", "worst seen", "unit", "where"], rows)
        if number == 1 and suite.shown:
            text += ("\nWhat other forms of the same moments lose on the same inputs (worst relative"
                     " error):\n\n" + losses(suite.shown))
    text += "\n## Proofs and checks\n\n" + table(["what", "result"], suite.checks)
    text += "\n## Skipped\n\nNeither passed nor failed.\n\n"
    text += table(["what", "why"], suite.skipped)
    return text + "\nSeeds: " + ", ".join(suite.seeds) + ".\n"


def main(build, page=None):
    suite = Suite(run_suite(build))
    path = Path(page) if page else Path(__file__).with_name("RESULTS.md")
    path.write_text(page_of(suite), encoding="utf-8")
    print(f"{path}: {len(suite.rows)} rows" + (", a bound does not hold" if suite.failed else ""))
    return 1 if suite.failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
