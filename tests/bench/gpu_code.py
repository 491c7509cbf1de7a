#!/usr/bin/env python3
"""The machine code of the CUDA kernels, counted: what a change did to loads, waits, frames, registers.

    gpu_code.py MODULE [--arch 90] [--before FILE] [--json FILE] [--report]

Prints a table of Markdown, a row a kernel of the paper's shape (160 features, width 128): registers and bytes
of local frame a thread, KB of code, and of its instructions the loads and stores by memory, products on tensor
cores, atomics, fp64, barriers, and waits (instructions that wait for a scoreboard). A generic load (LD) has to
find out where it goes; what is known to lie in shared memory reads LDS. --before takes what --json wrote and
prints what changed; fails where a kernel's frame or registers grew, or where there are others than were
counted then, unless --report. It reads the module's ELF images itself and needs none of CUDA's tools; exit code 77 where
there is no module.

Instructions are 16 bytes (compute capability 7.0 and later): bits 0-8 the operation, 9-11 the form of its
operands, 116-121 the scoreboards that it waits for.
"""
import argparse
import json
import re
import struct
import subprocess
import sys
from pathlib import Path

FATBIN, ELF = 0xBA55ED50, 2
# Operations by their lowest 9 bits, and 12 where two share them.
KINDS = {"LD": {0x180}, "ST": {0x185}, "LDS": {0x184}, "STS": {0x188}, "LDG": {0x181}, "STG": {0x186},
         "LDL": {0x183}, "STL": {0x187}, "to shared": {0x1AE}, "MMA": {0x3C}, "movmatrix": {0x3A},
         "atomics": {0x18E, 0x1A3, 0x1A6, 0x1A8, 0x18A, 0x18B, 0x18C}, "shuffles": {0x189},
         "MUFU": {0x108}, "fp64": {0x28, 0x29, 0x2A, 0x2B}, "barriers": {0x11D}}
NOP = 0x118
COLUMNS = ("registers", "frame", "KB", "instructions", *KINDS, "waits")
PAPERS = re.compile(r"<10, 8|<8[,>]|^[^<]*$|<false(, 8)?(, \d)?>$|<\d>$")


def images(module, arch):
    """The ELF images of one architecture in a module's fat binaries."""
    at = module.find(struct.pack("<I", FATBIN))
    while at >= 0:
        header, size = struct.unpack_from("<HQ", module, at + 6)
        entry, end = at + header, at + header + size
        while entry < end:
            kind, _, skip, payload = struct.unpack_from("<HHIQ", module, entry)
            if kind == ELF and struct.unpack_from("<I", module, entry + 28)[0] == arch:
                yield module[entry + skip:entry + skip + payload]
            entry += skip + payload
        at = module.find(struct.pack("<I", FATBIN), at + 4)


def sections(elf):
    """(name, bytes) of every section."""
    table, = struct.unpack_from("<Q", elf, 40)
    width, count, names = struct.unpack_from("<HHH", elf, 58)
    rows = [struct.unpack_from("<IIQQQQIIQQ", elf, table + i * width) for i in range(count)]
    strings = rows[names][4]
    for name, _, _, _, offset, size, *_ in rows:
        end = elf.index(b"\0", strings + name)
        yield elf[strings + name:end].decode(), elf[offset:offset + size]


REGISTERS, FRAME = 0x2F, 0x11  # attributes of .nv.info: of a function's symbol


def attribute_of_all(elf, wanted):
    """An attribute of every function, by its name."""
    parts = dict(sections(elf))
    found, info, at = {}, parts.get(".nv.info", b""), 0
    while at + 4 <= len(info):
        form, attribute, size = struct.unpack_from("<BBH", info, at)
        if form == 4 and attribute == wanted:
            symbol, value = struct.unpack_from("<II", info, at + 4)
            start, = struct.unpack_from("<I", parts[".symtab"], 24 * symbol)
            found[parts[".strtab"][start:parts[".strtab"].index(b"\0", start)].decode()] = value
        at += 4 + (size if form == 4 else 0)
    return found


def counted(code):
    """How many instructions there are of each kind."""
    words = list(struct.iter_unpack("<QQ", code))
    used = [(low & 0x1FF, high) for low, high in words if low & 0x1FF != NOP]
    kinds = {kind: sum(operation in codes for operation, _ in used) for kind, codes in KINDS.items()}
    return {"KB": round(len(code) / 1024, 1), "instructions": len(used)} | kinds | {
        "waits": sum((high >> 52) & 0x3F != 0 for _, high in used)}


def readable(name):
    """rn_forward_kernel<10, 8, true> of its mangled name."""
    plain = subprocess.run(["c++filt", name], check=True, capture_output=True, text=True).stdout.strip()
    plain = plain.replace("(bool)1", "true").replace("(bool)0", "false")
    return re.sub(r"^void |\(int\)|(?<=[\w>])\((?:rn_|int|unsigned|float|_).*", "", plain)


def measure(module, arch):
    kernels = {}
    for elf in images(module, arch):
        registers, frames = attribute_of_all(elf, REGISTERS), attribute_of_all(elf, FRAME)
        for section, data in sections(elf):
            if not section.startswith(".text."):
                continue
            name = readable(section[6:])
            if PAPERS.search(name):
                kernels[name] = {"registers": registers.get(section[6:]), "frame": frames.get(section[6:])} | counted(data)
    return dict(sorted(kernels.items()))


def cell(now, before):
    return str(now) if before in (None, now) else f"{before} to **{now}**"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("module", type=Path)
    parser.add_argument("--arch", type=int, default=90)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", action="store_true", help="what grew is no failure")
    given = parser.parse_args()
    if not given.module.exists():
        print(f"gpu_code.py: there is no {given.module}; it is built where nvcc is", file=sys.stderr)
        sys.exit(77)
    kernels = measure(given.module.read_bytes(), given.arch)
    if not any(row["MMA"] for row in kernels.values()):
        sys.exit(f"gpu_code.py: no kernel of {given.module} for sm_{given.arch} has a product: is it read rightly?")
    before = json.loads(given.before.read_text(encoding="utf-8")) if given.before else {}
    if given.json:
        given.json.write_text(json.dumps(kernels, indent=1), encoding="utf-8")
    print(f"| kernel, sm_{given.arch} | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 1)}")
    for name, row in kernels.items():
        old = before.get(name, {})
        print(f"| {name} | {' | '.join(cell(row[column], old.get(column)) for column in COLUMNS)} |")
    grew = [name for name, row in kernels.items() if name in before and
            any(row[column] > before[name][column] for column in ("registers", "frame", "LD"))]
    anew = f"where that is meant, write them anew with --json {given.before} --report"
    if grew and not given.report:
        sys.exit(f"gpu_code.py: registers, frames or generic loads grew: {', '.join(grew)}; {anew}")
    others = sorted(before.keys() ^ kernels.keys()) if before else []
    if others and not given.report:
        sys.exit(f"gpu_code.py: only one of both has {', '.join(others)}; {anew}")


main()
