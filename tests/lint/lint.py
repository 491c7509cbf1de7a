"""The house rules that a machine can check: lint.py fences|headers|text|shell|promises|format [ROOT].

Each check prints one line per finding, `file:line: what is wrong`, and exits with 1 when there
is any. `format` only reports.
"""

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Header -> the folders (or file prefixes) that may include it.
FENCES = {
    r"microhttpd\.h": ("server/http/",),
    # pairs.c and cameras.c work on the database of another program, COLMAP.
    r"sqlite3\.h": (
        "server/store/",
        "server/runner/ingest/pairs.c",
        "server/runner/ingest/cameras.c",
        "tests/sim/vfs.c",
        "tests/unit/server/store",
    ),
    r"jansson\.h": (
        "proto/",
        "common/image/lpips.c",
        "common/dataset/",
        "common/path/",
        "server/engine/checkpoint",
        "tests/",
    ),
    r"cuda\w*(\.h|/.*)": ("server/engine/cuda/",),
    r"mpi\.h": ("server/engine/mpi/",),
    r"curl/.*": ("client/", "tests/"),
    r"lib(av|sw)\w+/.*": ("server/film/", "tests/"),
}
# Who may look at the wall clock, which may be set: nobody else, so that nothing waits for it. Nor is
# it a condition's own in a folder where one is waited for until some time.
WALL_CLOCK = re.compile(r"\bCLOCK_REALTIME\b|\bgettimeofday\s*\(|\btime\s*\(\s*(NULL|0|&)")
WALL_CLOCK_FILE = "common/base/clock.c"
UNTIMED = re.compile(r"\bpthread_cond_init\s*\([^,]+,\s*NULL\)")
# Every folder with code, and the folders that it may include from besides itself; what ends with a
# slash is all folders beneath. The table has no circle, so the folders have none.
ENGINE = "server/engine"
LAYERS = {
    "common/base": (),
    "common/math": ("common/base",),
    "common/settings": ("common/base", "common/math"),
    "common/image": ("common/base", "common/math"),
    "common/dataset": ("common/base", "common/math", "common/settings", "common/image"),
    "common/path": ("common/base", "common/math", "common/settings", "common/dataset"),
    "common/path/formats": ("common/base", "common/math", "common/settings", "common/dataset",
                            "common/path"),
    "proto": ("common/",),
    "client": ("common/", "proto"),
    "client/commands": ("common/", "proto", "client"),
    "server/http": ("common/", "proto"),
    "server/store": ("common/", "proto"),
    "server/jobs": ("common/", "proto", "server/http", "server/store"),
    "server/report": ("common/", "proto"),
    "server/api": ("common/", "proto", "server/http", "server/store", "server/jobs", "server/report"),
    "server/slurm": ("common/", "proto", "server/jobs"),
    "server": ("common/", "proto", "server/http", "server/store", "server/jobs", "server/slurm",
               "server/api"),
    f"{ENGINE}/field": ("common/",),
}
# The engine's folders from the mathematics up: each may include from those before it.
FLOORS = [("field",), ("kernels",), ("cpu", "cuda", "mpi", "reference"), ("scene",),
          ("checkpoint", "effects"), ("render",), ("train",), ("",), ("doctor", "bench")]
below = ["common/", f"{ENGINE}/field"]
for floor in FLOORS[1:]:
    own = [f"{ENGINE}/{room}".rstrip("/") for room in floor]
    LAYERS |= {room: tuple(below) for room in own}
    below += [room for room in own if not room.endswith(("/cuda", "/mpi"))]  # modules of their own
LAYERS["server/film"] = ("common/",)
# The runner's likewise: what a process may do, its way to the daemon, what a scene's folder holds, then
# the modes.
below = ["common/", "proto"]
for room, others in {"sandbox": (), "link": (), "scene": (ENGINE,), "tools": (f"{ENGINE}/doctor", f"{ENGINE}/bench"),
                     "ingest": (), "field": ("server/film",), "": ()}.items():
    own = f"server/runner/{room}".rstrip("/")
    LAYERS[own] = (*below, *others)
    below += [own, *others]
HOUSE = ("common/", "proto/", "client/", "server/")
INCLUDE = re.compile(r'^\s*#\s*include\s+(?:<([^>]+)>|"([^"]+)")')
UNFINISHED = ("TO" + "DO", "FIX" + "ME", "XX" + "X", "un" + "implemented",
              "not " + "implemented", "for " + "now")
FORBIDDEN = re.compile(r"\b(" + "|".join(UNFINISHED) + r")\b", re.IGNORECASE)
MAX_LINES = 700


def tracked(root, *suffixes):
    """Files of the source tree, relative to it; without git, what lies in the known folders."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=root, capture_output=True, text=True, check=False)
    if listing.returncode == 0:
        names = listing.stdout.splitlines()
    else:
        names = [str(path.relative_to(root)) for path in root.rglob("*")
                 if path.is_file() and not path.relative_to(root).parts[0].startswith("build")]
    return sorted(name for name in names
                  if name.endswith(suffixes or ("",)) and (root / name).is_file())


def lines_of(root, name):
    text = (root / name).read_text(encoding="utf-8", errors="replace")
    return list(enumerate(text.splitlines(), 1))


def included(root, name):
    for number, line in lines_of(root, name):
        match = INCLUDE.match(line)
        if match:
            yield number, match.group(1), match.group(2)


def may_include(folder, other, layers):
    return other == folder or any(
        other.startswith(allowed) if allowed.endswith("/") else other == allowed
        for allowed in layers[folder])


def circle(layers):
    """Folders of the table that may include each other in a circle, or None."""
    left = dict.fromkeys(layers)
    while left:
        free = [folder for folder in left if not any(
            other != folder and may_include(folder, other, layers) for other in left)]
        if not free:
            return list(left)
        for folder in free:
            del left[folder]
    return None


def check_waits(root):
    """No wait is on the wall clock."""
    sources = {name: lines_of(root, name) for name in tracked(root, ".c", ".h") if name.startswith(HOUSE)}
    timed = {os.path.dirname(name) for name, lines in sources.items()
             if any("pthread_cond_timedwait(" in line for _, line in lines)}
    for name, lines in sources.items():
        for number, line in lines:
            if WALL_CLOCK.search(line) and name != WALL_CLOCK_FILE:
                yield f"{name}:{number}: the wall clock belongs to {WALL_CLOCK_FILE}"
            if UNTIMED.search(line) and os.path.dirname(name) in timed:
                yield f"{name}:{number}: a condition that is waited for until a time needs CLOCK_MONOTONIC"


def check_fences(root):
    yield from check_waits(root)
    if circle(LAYERS):
        yield f"tests/lint/lint.py:1: a circle of folders: {', '.join(circle(LAYERS))}"
    for name in tracked(root, ".c", ".h", ".cu", ".cuh"):
        folder = os.path.dirname(name)
        if name.startswith(HOUSE) and folder not in LAYERS:
            yield f"{name}:1: {folder} has no layer in tests/lint/lint.py"
        for number, system, own in included(root, name):
            header = system or own
            for pattern, allowed in FENCES.items():
                if re.fullmatch(pattern, header) and not name.startswith(allowed):
                    yield f"{name}:{number}: {header} belongs to {', '.join(allowed)}"
            if own and folder in LAYERS and not may_include(folder, os.path.dirname(own), LAYERS):
                yield f"{name}:{number}: {folder} may not include {own}"


def compile_alone(root, name, language, standard):
    """The compiler's complaint about a header that is included first, or None."""
    compiler = os.environ.get("CC" if language == "c" else "CXX",
                              "cc" if language == "c" else "c++")
    result = subprocess.run(
        [*compiler.split(), "-fsyntax-only", f"-std={standard}", "-D_GNU_SOURCE", "-Wall",
         "-Wextra", "-Werror", "-Wno-unused-parameter", "-Wno-unused-function", "-Wno-psabi",
         "-I", ".",
         "-x", language, "-"],
        cwd=root, input=f'#include "{name}"\n', capture_output=True, text=True, check=False)
    return f"{name}:1: does not compile alone as {standard}:\n{result.stderr}" \
        if result.returncode else None


def check_headers(root):
    jobs = [(name, "c", "c17") for name in tracked(root, ".h")
            if not name.startswith("server/engine/cuda/")]
    jobs += [(name, "c++", "c++17") for name in tracked(root, ".h")
             if name.startswith(("server/engine/field/", "common/math/"))]
    with ThreadPoolExecutor(2) as pool:
        yield from filter(None, pool.map(lambda job: compile_alone(root, *job), jobs))


def check_text(root):
    for name in tracked(root, ".c", ".h", ".cu", ".cuh", ".js", ".css", ".html", ".py", ".sh",
                        ".md", ".yaml", "meson.build"):
        lines = lines_of(root, name)
        for number, line in lines:
            match = FORBIDDEN.search(line)
            if match:
                yield f"{name}:{number}: '{match.group(0)}': finish it or leave it out"
        if name.endswith((".c", ".h", ".cu", ".cuh", ".js", ".py")) and len(lines) > MAX_LINES:
            yield f"{name}:{MAX_LINES}: {len(lines)} lines; split the file"


def check_shell(root):
    scripts = tracked(root, ".sh") + tracked(root, "tests/slurm", ".ci/deps", ".ci/run", ".ci/debian/build",
                                           ".ci/debian/postinst", ".ci/debian/prerm",
                                           ".ci/debian/reproduce", ".ci/debian/root")
    result = subprocess.run(["shellcheck", *scripts], cwd=root, capture_output=True, text=True,
                            check=False)
    if result.returncode:
        yield result.stdout + result.stderr


def check_format(root):
    for name in tracked(root, ".c", ".h"):
        result = subprocess.run(["clang-format", "--dry-run", "-Werror", name], cwd=root,
                                capture_output=True, check=False)
        if result.returncode:
            yield f"{name}:1: clang-format would change it"


PROMISES = "server/README.md"


def rows_of_tests(root):
    """Lines of the tables whose last column is `test`: number, and what stands in that column."""
    inside = False
    for number, line in lines_of(root, PROMISES):
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if not cells:
            inside = False
        elif cells[-1] == "test":
            inside = True
        elif inside and not re.fullmatch("-+", cells[-1]):
            yield number, cells[-1]


TEST_FUNCTION = re.compile(r"^(?:def |START_TEST\()(test_\w+)", re.MULTILINE)


def check_promises(root):
    """Every promise names tests, all of which are there."""
    names = tracked(root)
    sources = [name for name in names if name.startswith("tests/") and name.endswith((".py", ".c"))]
    there = {Path(name).name for name in sources}
    for name in sources:
        there.update(TEST_FUNCTION.findall((root / name).read_text(encoding="utf-8")))
    for number, cell in rows_of_tests(root):
        tests = re.findall(r"`([^`]+)`", cell)
        if not tests:
            yield f"{PROMISES}:{number}: a promise without a test"
        for test in tests:
            if test not in there and not any(name.startswith(test) for name in names):
                yield f"{PROMISES}:{number}: there is no {test}"


CHECKS = {"fences": check_fences, "headers": check_headers, "text": check_text,
          "shell": check_shell, "promises": check_promises, "format": check_format}


def main(check, root=None):
    root = Path(root) if root else Path(__file__).resolve().parents[2]
    findings = list(CHECKS[check](root))
    print("\n".join(findings) or f"{check}: clean")
    return 1 if findings and check != "format" else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
