#!/usr/bin/python3
"""Every capture of a folder by every layout that it bears: what is said of it, as two tables.

    captures.py BUILD DATA > captures.table

DATA has captures in folders, such as `real/cup_colmap`; a folder is one when a layout recognises it.
The first table is what validate says: photographs that are usable, the reprojection error of its sparse
points through our cameras and as its model says, how it was photographed, and the seconds of CPU and on
the wall that it took with every picture decoded. The second is what an import (longest side 400 pixels,
every 8th photograph to test) and two steps of training with `standard` make of it: bounds, which
effects are on and which off, each with its number and threshold, and the seconds of the import. Then,
for captures that have several layouts, how far their poses and focal lengths are apart; a binary COLMAP
model of pinholes also beside the transforms.json that nerfstudio writes of it.

    captures.py BUILD DATA layouts

prints that last part alone.
"""

import json
import re
import resource
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support.client import Client  # noqa: E402
from support.daemon import Daemon  # noqa: E402

LAYOUTS = ("blender", "instant-ngp", "nerfstudio", "colmap", "opensfm", "bundler", "llff")


def validate(program, folder, layout):
    """The report and the CPU and wall seconds that it took; None where the layout does not read it."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    result = subprocess.run([program, "--json", "validate", folder, "--format", layout],
                            capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    report = json.loads(result.stdout) if result.stdout.startswith("{") else {}
    if "layout" not in report:
        return None
    return report, seconds, time.monotonic() - began


def text_of(report, words):
    return next((item["text"] for item in report["problems"] if words in item["text"]), "")


def row(name, layout, found):
    report, cpu, wall = found
    survey = report.get("survey", {})
    said = re.search(r"cameras are read, ([0-9.]+) px as the model says", text_of(report, "sparse points"))
    kind = text_of(report, "view directions").split(":")[0]
    pixels = (f"{survey['reprojection_px']:.4f}, {said.group(1)} as said, p95 "
              f"{survey['reprojection_p95_px']:.2f}, worst photograph {survey['reprojection_worst_px']:.2f}"
              if said else "-")
    exposure = f"{100 * survey['exposure_spread']:.0f} %" if "exposure_spread" in survey else "-"
    size = f"{report['width']['max']:.0f}x{report['height']['max']:.0f}"
    usable = sum(report["usable"].values())
    left = sum(report["unusable"].values())
    return (f"| {name} | {layout} | {usable} ({left} left out), {size} | {pixels} | {kind or 'its layout says'} | "
            f"{report['camera_distance']['min']:.3g} to {report['camera_distance']['max']:.3g} | {exposure} | "
            f"{cpu:.1f} ({wall:.1f}) |")


def effects_of(scene, wanted):
    """The effects that are on (or off), with what was measured and from which number on they are."""
    found = []
    for effect in scene["effects"]:
        if effect["on"] == wanted:
            number, threshold = effect.get("number"), effect.get("threshold")
            known = number is not None and threshold is not None
            found.append(effect["name"] + (f" {number:.3g} ({threshold:.3g})" if known else ""))
    return ", ".join(found) or "none"


def effects_row(client, number, name, folder, layout):
    """What training makes of it; None where it cannot be imported."""
    began = time.monotonic()
    client.run("import", folder, "--name", f"c{number}", "--format", layout, "--max-size", 400,
               "--split", "every:8", "--skip-bad")
    seconds = time.monotonic() - began
    dataset = client.json("show", f"c{number}")
    client.run("train", f"c{number}", "--name", f"s{number}", "--max-steps", 2, "--wait")
    scene = client.json("show", f"s{number}")
    centre = ", ".join(f"{x:.2f}" for x in dataset["bounds"]["centre"])
    return (f"| {name} | {layout} | ({centre}), {dataset['bounds']['radius']:.2f}, by "
            f"{dataset['bounds']['source']} | {effects_of(scene, True)} | {effects_of(scene, False)} | "
            f"{seconds:.1f} |")


def colmap_cameras(model):
    """Focal lengths and principal points by identifier, of pinholes."""
    data = (model / "cameras.bin").read_bytes()
    at, cameras = 8, {}
    while at < len(data):
        number, kind, width, height = struct.unpack_from("<IiQQ", data, at)
        if kind > 1:
            return None
        values = struct.unpack_from(f"<{3 + kind}d", data, at + 24)
        cameras[number] = (width, height, values[0], values[kind], *values[-2:])
        at += 24 + 8 * len(values)
    return cameras


def colmap_images(model):
    """Name, number of the camera, rotation's quaternion and translation of each photograph."""
    data = (model / "images.bin").read_bytes()
    at = 8
    while at < len(data):
        pose = struct.unpack_from("<7d", data, at + 4)
        (camera,) = struct.unpack_from("<I", data, at + 60)
        end = data.index(b"\0", at + 64)
        yield data[at + 64:end].decode(), camera, pose[:4], pose[4:]
        (points,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + 24 * points


def nerfstudio_pose(quaternion, translation):
    """As ns-process-data writes it: OpenGL axes, then y and z of the world exchanged and one turned."""
    w, x, y, z = quaternion
    down = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    rows = [[down[0][i], -down[1][i], -down[2][i], -sum(down[k][i] * translation[k] for k in range(3))]
            for i in range(3)]
    return [rows[0], rows[2], [-value for value in rows[1]], [0, 0, 0, 1]]


def said_of_layouts(program, folder):
    said = subprocess.run([program, "--json", "validate", folder], capture_output=True, text=True,
                          check=False).stdout
    return text_of(json.loads(said), "photographs in common") if said.startswith("{") else ""


def with_nerfstudio(program, folder, work):
    """What is told of a COLMAP capture that nerfstudio's file was put beside."""
    model = folder / "sparse" / "0"
    cameras = colmap_cameras(model) if (model / "images.bin").exists() else None
    if not cameras:
        return ""
    beside = Path(work) / folder.name
    beside.mkdir()
    for name in ("images", "sparse"):
        (beside / name).symlink_to(folder / name)
    frames = [{"file_path": f"images/{name}", "transform_matrix": nerfstudio_pose(rotation, translation)}
              | dict(zip(("w", "h", "fl_x", "fl_y", "cx", "cy"), cameras[number]))
              for name, number, rotation, translation in colmap_images(model)]
    (beside / "transforms.json").write_text(json.dumps(
        {"camera_model": "OPENCV", "frames": frames,
         "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]}))
    return said_of_layouts(program, beside)


def layouts_apart(program, data, folders):
    """What is told of captures that have several layouts."""
    with tempfile.TemporaryDirectory() as work:
        for folder in folders:
            for told in (said_of_layouts(program, folder), with_nerfstudio(program, folder, work)):
                if told:
                    print(f"- {folder.relative_to(data)}: {told}", flush=True)


def what_is_said(program, data, folders):
    """The first table; which layouts each folder has."""
    layouts = []
    print("| capture | layout | photographs | reprojection, px | photographed | cameras from the "
          "bounds' centre | exposures differ | validate, CPU s (wall) |")
    print("|---|---|---|---|---|---|---|---|")
    for folder in folders:
        for layout in LAYOUTS:
            found = validate(program, folder, layout)
            if found:
                layouts.append((folder, layout))
                print(row(str(folder.relative_to(data)), layout, found), flush=True)
    return layouts


def main():
    build, data = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    program = build / "client" / "ripnerf"
    folders = sorted(path for path in data.glob("*/*") if path.is_dir())
    if sys.argv[3:] == ["layouts"]:
        layouts_apart(program, data, folders)
        return
    layouts = what_is_said(program, data, folders)
    print("\n| capture | layout | bounds: centre, radius | effects on: number (threshold) | effects off | "
          "import, s |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as work, Daemon(build, Path(work) / "data") as daemon:
        client = Client(program, work, daemon.url)
        for number, (folder, layout) in enumerate(layouts):
            print(effects_row(client, number, str(folder.relative_to(data)), folder, layout), flush=True)
    print()
    layouts_apart(program, data, folders)


if __name__ == "__main__":
    main()
