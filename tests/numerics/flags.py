"""Holds every compile command of a build to the stated floating point: flags.py BUILD.

No flag may change values, and each command states -ffp-contract: `fast` for the kernel sets, whose
bounds are proved with and without contraction, `off` for all other code. Instructions that not every
machine has stay in the files that run only after CPUID was asked. The CUDA compiler states the same
of its own: contraction, denormals, division and square root as IEEE has them.
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
CONTRACT = (
    "server/engine/cpu/kernel_set.c",
    "server/engine/bench/peak.c",  # counts operations, computes nothing
    "tests/numerics/subject_kernels.c",  # the cases' own instances of the kernel sets
)
MAY_CHOOSE_INSTRUCTIONS = CONTRACT + (
    "server/engine/bench/peak_bf16.c",
    "server/engine/bench/peak_amx.c",
    "tests/numerics/flags.c",  # asks for FMA itself
    "tests/bench/libraries_xsmm.c",
)
CUDA = {"-fmad=true", "-ftz=false", "-prec-div=true", "-prec-sqrt=true"}
CUDA_FORBIDDEN = {"-use_fast_math", "--use_fast_math", "-ftz=true", "-prec-div=false",
                  "-prec-sqrt=false"}
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
    wanted = "fast" if any(place in file for place in CONTRACT) else "off"
    if contract != wanted:
        yield f"{file}: -ffp-contract={contract}, not {wanted}"


def cuda_complaints(build):
    """The device compiler's command, which only Meson's own list of targets has."""
    targets = json.loads((Path(build) / "meson-info/intro-targets.json").read_text("utf-8"))
    for source in (source for target in targets for source in target["target_sources"]):
        flags = source["compiler"]
        if not flags or not flags[0].endswith("nvcc"):
            continue
        for flag in sorted(CUDA - set(flags)):
            yield f"{source['sources'][0]}: {flag} is not stated"
        for flag in sorted(CUDA_FORBIDDEN & set(flags)):
            yield f"{source['sources'][0]}: {flag}"


def main(build):
    commands = json.loads((Path(build) / "compile_commands.json").read_text(encoding="utf-8"))
    commands = [command for command in commands if command["file"].endswith((".c", ".cpp"))]
    findings = [line for command in commands for line in complaints(command)]
    findings += cuda_complaints(build)
    good = f"{len(commands)} compile commands: no flag changes values or asks for what CPUs may lack"
    print("\n".join(findings) or good)
    return 1 if findings or not commands else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
