#!/usr/bin/python3
"""Stands in for COLMAP: its commands and files, with cameras on a circle instead of found ones.

RIPNERF_FAKE_COLMAP says how it fails: `crash` in the matcher, `kill` it there, `fail` in the
mapper, `none` finds nothing, `two` finds two models, `some` leaves the last photograph out, `bad`
writes a model that ends early, `damaged` a database that does not agree with itself, `slow` takes its
time.
"""

import math
import os
import random
import re
import signal
import sqlite3
import struct
import sys
import time

from PIL import Image

mood = os.environ.get("RIPNERF_FAKE_COLMAP", "")
command, words = sys.argv[1], sys.argv[2:]
options = dict(zip(words[::2], words[1::2]))
print("==================")
print(command, sorted(options), flush=True)


def names():
    root = options["--image_path"]
    return sorted(os.path.relpath(os.path.join(folder, file), root)
                  for folder, _, files in os.walk(root) for file in files)


def names_in_database():
    database = sqlite3.connect(options["--database_path"])
    found = sorted(name for name, in database.execute("SELECT name FROM images"))
    database.close()
    return found


def tell_cameras(path):
    """Each camera's kind, parameters and size, and the photographs that it took."""
    database = sqlite3.connect(path)
    for camera, kind, width, height, params in database.execute(
            "SELECT camera_id, model, width, height, params FROM cameras").fetchall():
        took = database.execute("SELECT name FROM images WHERE camera_id = ? ORDER BY name", (camera,))
        numbers = struct.unpack(f"<{len(params) // 8}d", params)
        print("camera", kind, width, height, *map(int, numbers), *(name for name, in took), flush=True)
    database.close()


def write_model(folder, photographs):
    os.makedirs(folder)
    sizes = [Image.open(os.path.join(options["--image_path"], name)).size for name in photographs]
    kinds = list(dict.fromkeys(sizes))  # a camera for each size
    with open(f"{folder}/cameras.bin", "wb") as file:
        file.write(struct.pack("<Q", len(kinds)))
        for i, (width, height) in enumerate(kinds):
            file.write(struct.pack("<IiQQ8d", i + 1, 4, width, height, 20, 20, width / 2,
                                   height / 2, 0, 0, 0, 0))
    with open(f"{folder}/images.bin", "wb") as file:
        file.write(struct.pack("<Q", len(photographs)))
        for i, name in enumerate(photographs):
            angle = 2 * math.pi * i / len(photographs)
            half = angle / 2
            file.write(struct.pack("<I7dI", i + 1, math.cos(half), 0, math.sin(half), 0, 0, 0, 4,
                                   1 + kinds.index(sizes[i])))
            file.write(name.encode() + b"\0")
            file.write(struct.pack("<QddQ", 1, 8, 8, 1))
    with open(f"{folder}/points3D.bin", "wb") as file:
        file.write(struct.pack("<QQdddBBBdQ", 1, 1, 0, 0, 0, 200, 100, 50, 0.25, len(photographs)))
        for i in range(len(photographs)):
            file.write(struct.pack("<II", i + 1, 0))
    if mood == "bad":
        os.truncate(f"{folder}/images.bin", 40)


def write_database(path, photographs):
    """Tables as COLMAP's; a feature a photograph shares with those up to 10 before and after it."""
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER, "
                     "height INTEGER, params BLOB, prior_focal_length INTEGER)")
    database.execute("CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
                     "camera_id INTEGER)")
    database.execute("CREATE TABLE descriptors (image_id INTEGER PRIMARY KEY, rows INTEGER, "
                     "cols INTEGER, data BLOB)")
    for i, name in enumerate(photographs):
        number = int(re.sub(r"\D", "", name) or 0)
        rows = [random.Random(number + k).choices(range(79), k=128) for k in range(11)]
        rows = 1 if mood == "damaged" else len(rows), b"".join(map(bytes, rows))
        camera = 1 if options["--ImageReader.single_camera"] == "1" else i + 1
        width, height = Image.open(os.path.join(options["--image_path"], name)).size
        database.execute("INSERT OR IGNORE INTO cameras VALUES (?, 2, ?, ?, ?, 0)",
                         (camera, width, height, struct.pack("<4d", 20, width / 2, height / 2, 0)))
        database.execute("INSERT INTO images VALUES (?, ?, ?)", (i + 1, name, camera))
        database.execute("INSERT INTO descriptors VALUES (?, ?, 128, ?)", (i + 1, *rows))
    database.commit()
    database.close()


if command == "feature_extractor":
    assert options["--SiftExtraction.use_gpu"] == "0"
    for i, name in enumerate(names()):
        print(f"Processed file [{i + 1}/{len(names())}]", flush=True)
        time.sleep(0.5 if mood == "slow" else 0)
    write_database(options["--database_path"], names())
elif command in ("exhaustive_matcher", "matches_importer"):
    if mood == "crash":
        print("about to fail", flush=True)
        os.abort()
    if mood == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if command == "matches_importer":
        with open(options["--match_list_path"], encoding="utf-8") as file:
            pairs = [line.rstrip("\n").split(" ") for line in file]
        assert all(len(pair) == 2 and pair[0] != pair[1] for pair in pairs)
        assert len({frozenset(pair) for pair in pairs}) == len(pairs)
        assert {name for pair in pairs for name in pair} <= set(names_in_database())
        for pair in pairs:
            print("pair", *pair, flush=True)
    print("Matching block [1/1, 1/1] in 0.1s", flush=True)
elif command == "mapper":
    if mood == "fail":
        print("ERROR: the database is locked", file=sys.stderr)
        sys.exit(3)
    found = names()
    assert found == names_in_database()
    tell_cameras(options["--database_path"])
    if mood == "none":
        print("  => No good initial image pair found.", flush=True)
    elif mood == "two":
        write_model(options["--output_path"] + "/0", found[:2])
        write_model(options["--output_path"] + "/1", found[2:])
    else:
        write_model(options["--output_path"] + "/0", found[:-1] if mood == "some" else found)
    print(f"Registering image #{len(found)} ({len(found)})", flush=True)
