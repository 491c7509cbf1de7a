"""Holds every compile command of a build to the stated floating point: flags.py BUILD.

No flag may change values, and each command states -ffp-contract: `off`, or `fast` for the kernel
sets, whose bounds are proved with contraction. Instructions that not every machine has stay in the
files that run only after CPUID was asked.
"""

import json
import shlex
import sys
from pathlib import Path

FORBIDDEN = {
    "-ffast-math", "-Ofast", "-funsafe-math-optimizations", "-fassociative-math",
    "-freciprocal-math", "-ffinite-math-only", "-fno-signed-zeros",
    "-fsingle-precision-constant", "-mfpmath=387", "-mrecip", "-mdaz-ftz", "-fcx-limited-range",
}
MAY_CONTRACT = (
    "server/engine/cpu/",
    "server/engine/bench/peak.c",  # counts operations, computes nothing
    "tests/numerics/subject_kernels.c",  # the cases' own instances of the kernel sets
)
MAY_CHOOSE_INSTRUCTIONS = MAY_CONTRACT + (
    "server/engine/bench/peak_bf16.c",
    "server/engine/bench/peak_amx.c",
    "tests/numerics/flags.c",  # asks for FMA itself
)
INSTRUCTIONS = ("-mavx", "-mfma", "-mf16c", "-mamx", "-march=", "-mcpu=", "-msse", "-mbmi")


def last(flags, prefix):
    values = [flag[len(prefix):] for flag in flags if flag.startswith(prefix)]
    return values[-1] if values else None


def complaints(command):
    flags = shlex.split(command["command"])
    file = command["file"]
    for flag in flags:
        if flag in FORBIDDEN or flag.startswith("-mrecip="):
            yield f"{file}: {flag}"
        if flag.startswith(INSTRUCTIONS) and not any(
                place in file for place in MAY_CHOOSE_INSTRUCTIONS):
            yield f"{file}: {flag}"
    contract = last(flags, "-ffp-contract=")
    free = any(place in file for place in MAY_CONTRACT)
    if contract not in (("off", "fast") if free else ("off",)):
        yield f"{file}: -ffp-contract={contract}"


def main(build):
    commands = json.loads((Path(build) / "compile_commands.json").read_text(encoding="utf-8"))
    commands = [command for command in commands if command["file"].endswith(".c")]
    findings = [line for command in commands for line in complaints(command)]
    good = f"{len(commands)} compile commands: no flag changes values or asks for what CPUs may lack"
    print("\n".join(findings) or good)
    return 1 if findings or not commands else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
