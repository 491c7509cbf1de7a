"""The shape of the source: shape.py [ROOT ...] prints, for each tree, how long its functions are,
which folder includes which, and whether folders include each other in a circle.

A function is what stands from a line of text that begins in column 0 and opens a brace at a line's
end to the brace in column 0 that closes it; its lines are those between the two.
"""

import os
import re
import sys
from pathlib import Path

FOLDERS = ("client", "common", "proto", "server")
OPENS = re.compile(r"^[A-Za-z_].*\)\s*\{$|^ .*\)\s*\{$")
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"')
NOT_ONE = ("struct ", "union ", "enum ", "extern ", "typedef ")


def sources(root, *suffixes):
    for folder in FOLDERS:
        yield from sorted(path for path in (root / folder).rglob("*") if path.suffix in suffixes)


def functions(path):
    """(lines, name) of each function of a file."""
    head, begin = "", None
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if begin is None:
            if line and not line[0].isspace() and line[0] not in "}#/":
                head = line
            if OPENS.match(line) and "(" in head and "=" not in head:
                begin = number
        elif line.startswith("}"):
            yield number - begin - 1, head.split("(")[0].split()[-1].lstrip("*")
            begin = None


def graph(root):
    """Folder -> the other folders that it includes from."""
    edges = {}
    for path in sources(root, ".c", ".h", ".cu", ".cuh"):
        folder = str(path.parent.relative_to(root))
        own = edges.setdefault(folder, set())
        for line in path.read_text(encoding="utf-8").splitlines():
            match = INCLUDE.match(line)
            if match and os.path.dirname(match[1]) not in (folder, ""):
                own.add(os.path.dirname(match[1]))
    return edges


def circles(edges):
    """What is left when folders that include nothing that is left are taken away."""
    left = {folder: set(others) & set(edges) for folder, others in edges.items()}
    while any(not others & set(left) for others in left.values()):
        left = {folder: others for folder, others in left.items() if others & set(left)}
    while any(not any(folder in others for others in left.values()) for folder in left):
        left = {folder: others for folder, others in left.items()
                if any(folder in some for some in left.values())}
    return sorted(left)


def main(*roots):
    for root in map(Path, roots or ["."]):
        found = [(lines, name, path.relative_to(root)) for path in sources(root, ".c", ".h")
                 for lines, name in functions(path)]
        lines, name, path = max(found)
        edges = graph(root)
        print(f"{root}: {len(found)} functions of C, {sum(f[0] for f in found) / len(found):.1f} lines "
              f"in the mean, longest {lines} ({name}, {path})")
        over = sum(f[0] > 60 for f in found)
        print(f"  {over} over 60 lines; {len(edges)} folders, "
              f"{sum(map(len, edges.values()))} inclusions between them, "
              f"in a circle: {', '.join(circles(edges)) or 'none'}")
        if len(roots) < 2:
            for folder in sorted(edges):
                print(f"  {folder} -> {', '.join(sorted(edges[folder])) or '-'}")


main(*sys.argv[1:])
