"""The house rules that a machine can check: lint.py fences|headers|text|shell|format [ROOT].

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
    r"sqlite3\.h": ("server/store/", "tests/unit/server/store"),
    r"jansson\.h": (
        "proto/",
        "common/dataset/",
        "common/path/",
        "server/engine/checkpoint",
        "tests/",
    ),
    r"cuda\w*(\.h|/.*)": ("server/engine/cuda/",),
    r"curl/.*": ("client/", "tests/"),
}
# The folders that may be included from a folder; what is not listed is free.
LAYERS = {
    "common/": ("common/",),
    "proto/": ("common/", "proto/"),
    "client/": ("client/", "common/", "proto/"),
    "server/engine/": ("server/engine/", "common/"),
    "server/engine/field/": ("server/engine/field/", "common/"),
}
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


def check_fences(root):
    for name in tracked(root, ".c", ".h", ".cu", ".cuh"):
        layer = max((key for key in LAYERS if name.startswith(key)), key=len, default=None)
        for number, system, own in included(root, name):
            header = system or own
            for pattern, allowed in FENCES.items():
                if re.fullmatch(pattern, header) and not name.startswith(allowed):
                    yield f"{name}:{number}: {header} belongs to {', '.join(allowed)}"
            if own and layer and not own.startswith(LAYERS[layer]):
                yield f"{name}:{number}: {layer} may not include {own}"


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
    scripts = tracked(root, ".sh") + tracked(root, ".ci/deps", ".ci/run")
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


CHECKS = {"fences": check_fences, "headers": check_headers, "text": check_text,
          "shell": check_shell, "format": check_format}


def main(check, root=None):
    root = Path(root) if root else Path(__file__).resolve().parents[2]
    findings = list(CHECKS[check](root))
    print("\n".join(findings) or f"{check}: clean")
    return 1 if findings and check != "format" else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
