#!/usr/bin/python3
"""Stands in for COLMAP: its commands and files, with cameras on a circle instead of found ones.

RIPNERF_FAKE_COLMAP says how it fails: `crash` in the matcher, `kill` it there, `fail` in the
mapper, `none` finds nothing, `two` finds two models, `some` leaves the last photograph out, `bad`
writes a model that ends early, `slow` takes its time.
"""

import math
import os
import signal
import struct
import sys
import time

mood = os.environ.get("RIPNERF_FAKE_COLMAP", "")
command, words = sys.argv[1], sys.argv[2:]
options = dict(zip(words[::2], words[1::2]))
print("==================")
print(command, sorted(options), flush=True)


def names():
    root = options["--image_path"]
    return sorted(os.path.relpath(os.path.join(folder, file), root)
                  for folder, _, files in os.walk(root) for file in files)


def write_model(folder, photographs):
    os.makedirs(folder)
    with open(f"{folder}/cameras.bin", "wb") as file:
        file.write(struct.pack("<QIiQQ8d", 1, 1, 4, 16, 16, 20, 20, 8, 8, 0, 0, 0, 0))
    with open(f"{folder}/images.bin", "wb") as file:
        file.write(struct.pack("<Q", len(photographs)))
        for i, name in enumerate(photographs):
            angle = 2 * math.pi * i / len(photographs)
            half = angle / 2
            file.write(struct.pack("<I7dI", i + 1, math.cos(half), 0, math.sin(half), 0, 0, 0, 4, 1))
            file.write(name.encode() + b"\0")
            file.write(struct.pack("<QddQ", 1, 8, 8, 1))
    with open(f"{folder}/points3D.bin", "wb") as file:
        file.write(struct.pack("<QQdddBBBdQ", 1, 1, 0, 0, 0, 200, 100, 50, 0.25, len(photographs)))
        for i in range(len(photographs)):
            file.write(struct.pack("<II", i + 1, 0))
    if mood == "bad":
        os.truncate(f"{folder}/images.bin", 40)


if command == "feature_extractor":
    assert options["--SiftExtraction.use_gpu"] == "0"
    for i, name in enumerate(names()):
        print(f"Processed file [{i + 1}/{len(names())}]", flush=True)
        time.sleep(0.5 if mood == "slow" else 0)
    open(options["--database_path"], "w", encoding="utf-8").close()
elif command in ("exhaustive_matcher", "sequential_matcher"):
    if mood == "crash":
        print("about to fail", flush=True)
        os.abort()
    if mood == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    print("Matching block [1/1, 1/1] in 0.1s", flush=True)
elif command == "mapper":
    if mood == "fail":
        print("ERROR: the database is locked", file=sys.stderr)
        sys.exit(3)
    found = names()
    if mood == "none":
        print("  => No good initial image pair found.", flush=True)
    elif mood == "two":
        write_model(options["--output_path"] + "/0", found[:2])
        write_model(options["--output_path"] + "/1", found[2:])
    else:
        write_model(options["--output_path"] + "/0", found[:-1] if mood == "some" else found)
    print(f"Registering image #{len(found)} ({len(found)})", flush=True)
