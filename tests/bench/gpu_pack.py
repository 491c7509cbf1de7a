#!/usr/bin/env python3
"""Lays out what a machine with a GPU needs for tests/bench/gpu.sh: programs, libraries, photographs.

    gpu_pack.py BUILD SCENE KIT [--module FILE] [--test 25] [--val 8] [--most 55] [--beside FIRST]

SCENE is a scene of NeRF-synthetic. Into KIT go gpu.sh with its parts, the programs with the libraries that
they link to (but for the C library, which is the machine's) as one archive, and photos/: all training views,
--test and --val of the others evenly spaced, as lossless WebP, which is a quarter smaller. `KIT/gpu.sh
KIT/photos OUT` is the command there. Fails where KIT is larger than --most MiB. --beside lays out photos/
alone, of those views that the kit FIRST has not: what a second call carries, `FIRST/gpu.sh FIRST/photos OUT
--more KIT/photos`.
"""
import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
PROGRAMS = ("tests/bench/quality", "tests/bench/cuda", "tests/bench/import", "tests/ops/cuda_device_test",
            "tests/ops/device_test", "client/ripnerf", "server/ripnerfd", "server/ripnerf-runner")
MODULE = "server/engine/cuda/ripnerf-cuda.so"
# Only formats that are not carried need these, and they need much themselves: empty ones take their place.
UNUSED = ("libheif.so.1", "libxml2.so.2")
OF_THE_MACHINE = re.compile(r"(ld-linux.*|lib(c|m|dl|rt|pthread|resolv|util)|libcuda|libnvidia.*)\.so")


def empty_library(path):
    """A library that has all functions of the one of this name: programs start with it, and none is called."""
    said = subprocess.run(["cc", f"-print-file-name={path.name}"], check=True, capture_output=True, text=True).stdout
    names = subprocess.run(["nm", "-D", "--defined-only", said.strip()], check=True, capture_output=True,
                           text=True).stdout
    versions, text = {}, ""
    for name, version in re.findall(r"^\w+ [TW] (\w+)(?:@@(\S+))?$", names, re.MULTILINE):
        versions.setdefault(version, []).append(name)
        text += f"void {name}(void) {{ __builtin_trap(); }}\n"
    script = path.with_suffix(".versions")
    script.write_text("".join(f"{version} {{ global: {'; '.join(of)}; }};\n" for version, of in versions.items() if version))
    subprocess.run(["cc", "-shared", "-fPIC", "-w", "-fno-builtin", f"-Wl,-soname,{path.name}", "-o", path,
                    *([f"-Wl,--version-script={script}"] if any(versions) else []), "-x", "c", "-"],
                   input=text, text=True, check=True)
    script.unlink()


def libraries(program, lib):
    """What the loader finds for a program, but for what is the machine's own, or lies in `lib`."""
    said = subprocess.run(["ldd", program], check=True, capture_output=True, text=True,
                          env=os.environ | {"LD_LIBRARY_PATH": str(lib)}).stdout
    missing = re.findall(r"^\s*(\S+) => not found", said, re.MULTILINE)
    if missing:
        sys.exit(f"gpu_pack.py: {program} does not find {', '.join(missing)}")
    found = (Path(path) for path in re.findall(r"=> (/\S+)", said))
    return {path for path in found if not OF_THE_MACHINE.match(path.name) and path.parent != lib}


def pack_programs(build, module, kit):
    (kit / "bin").mkdir(parents=True, exist_ok=True)
    lib, needed = kit / "lib", set()
    lib.mkdir(exist_ok=True)
    for name in UNUSED:
        empty_library(lib / name)
    for name in PROGRAMS:
        program = kit / "bin" / Path(name).name
        subprocess.run(["strip", "-o", program, build / name], check=True)
        needed |= libraries(program, lib)
    shutil.copyfile(module, kit / "bin" / "ripnerf-cuda.so")
    needed |= libraries(module, lib)
    for library in needed:
        shutil.copy2(library.resolve(), lib / library.name)
    with tarfile.open(kit / "programs.tar.xz", "w:xz") as archive:
        for part in ("bin", "lib"):
            archive.add(kit / part, part)
            shutil.rmtree(kit / part)
    for script in ("gpu.sh", "gpu.py", "gpu_scenes.py"):
        shutil.copy2(HERE / script, kit)


def carried(kit, split):
    """The names of a kit's views."""
    document = json.loads((kit / "photos" / f"transforms_{split}.json").read_text(encoding="utf-8"))
    return {Path(frame["file_path"]).stem for frame in document["frames"]}


def pack_photographs(scene, kit, most, first):
    """The splits, of each at most so many views, but for those of the kit `first`; poses and camera as they are."""
    for split, count in most.items():
        with open(scene / f"transforms_{split}.json", encoding="utf-8") as file:
            document = json.load(file)
        frames, root = document["frames"], kit / "photos"
        kept = frames if count is None or len(frames) <= count else \
            [frames[i * len(frames) // count] for i in range(count)]
        there = carried(first, split) if first else set()
        kept = [frame for frame in kept if Path(frame["file_path"]).stem not in there]
        for frame in kept:
            source = scene / frame["file_path"]
            name = source.name if source.suffix else source.name + ".png"
            target = (root / split / name).with_suffix(".webp")
            target.parent.mkdir(parents=True, exist_ok=True)
            with Image.open(source.with_name(name)) as picture:
                picture.save(target, lossless=True, exact=True, quality=60, method=4)
            frame["file_path"] = f"./{split}/{target.name}"
        root.mkdir(parents=True, exist_ok=True)
        (root / f"transforms_{split}.json").write_text(json.dumps(document | {"frames": kept}), encoding="utf-8")
        print(f"{split}: {len(kept)} of {len(frames)} views")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("kit", type=Path)
    parser.add_argument("--module", type=Path, help="instead of the build's")
    parser.add_argument("--test", type=int, default=25)
    parser.add_argument("--val", type=int, default=8)
    parser.add_argument("--most", type=float, default=55, help="MiB")
    parser.add_argument("--beside", type=Path, metavar="FIRST")
    given = parser.parse_args()
    given.kit = given.kit.resolve()
    if not given.beside:
        pack_programs(given.build, given.module or given.build / MODULE, given.kit)
    pack_photographs(given.scene, given.kit, {"train": None, "val": given.val, "test": given.test}, given.beside)
    size = sum(path.stat().st_size for path in given.kit.rglob("*") if path.is_file()) / 2**20
    print(f"{given.kit}: {size:.1f} MiB")
    if size > given.most:
        sys.exit(f"gpu_pack.py: more than {given.most:g} MiB; take fewer --test views")


main()
