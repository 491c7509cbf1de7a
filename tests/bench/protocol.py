#!/usr/bin/env python3
"""The paper's protocol on its multi-scale benchmark: its rows beside ours, as Markdown.

    protocol.py BUILD SCENE_FOLDER WORK_FOLDER [--times 600] [--seeds 1] [--test 50] [OPTION=VALUE ...]

SCENE_FOLDER is a scene of NeRF-synthetic (its name is the folder's); it is imported into WORK_FOLDER once:
full size and three halvings, colour and opacity averaged apart as the published converter does. Trains on
the train and validation splits for each time and evaluates the test views, with as many cones a pixel as
the engine takes by itself, and with one. Further options are tests/bench/quality's (clock=cpu threads=1).
A finished row is kept in WORK_FOLDER, by build, time, seed and options, and not measured again.
"""
import argparse
import hashlib
import json
import re
import statistics
import subprocess
from pathlib import Path

# Published PSNR of Rip-NeRF on the multi-scale benchmark after 25,000 and 120,000 steps (32 minutes and
# 2.6 hours of an A100), means over four scales.
PUBLISHED = {
    "chair": (39.36, 40.08), "drums": (29.40, 29.88), "ficus": (35.89, 36.61),
    "hotdog": (40.82, 41.98), "lego": (36.94, 38.36), "materials": (32.66, 33.79),
    "mic": (40.07, 40.94), "ship": (34.13, 36.18)}
SCALE = re.compile(r"^test( one cone a pixel,)? scale \d+: psnr ([\d.]+) ssim ([\d.]+) views (\d+)", re.M)


def imported(build, scene, work):
    """The scene's photographs at four scales."""
    target = work / f"{scene.name}-straight"
    if not (target / "dataset.json").exists():
        subprocess.run([build / "tests/bench/import", scene, target, "scales=4", "alpha=straight"], check=True)
    return target


def measured(build, dataset, work, options):
    """What quality printed: now, or before with this build and these options."""
    quality = build / "tests/bench/quality"
    name = hashlib.sha256(quality.read_bytes() + json.dumps([str(dataset), options]).encode()).hexdigest()
    kept = work / f"{name[:16]}.txt"
    if not kept.exists():
        said = subprocess.run([quality, dataset, "train_val=trainval", *options], check=True,
                              capture_output=True, text=True).stdout
        kept.write_text(said, encoding="utf-8")
    return kept.read_text(encoding="utf-8")


def row(label, runs, cones, one):
    """A line of the table out of what a run a seed printed."""
    found = [[(float(p), float(s), int(v)) for single, p, s, v in SCALE.findall(run) if bool(single) == one]
             for run in runs]
    scales = [statistics.mean(run[i][0] for run in found) for i in range(len(found[0]))]
    ssim = statistics.mean(s for run in found for _, s, _ in run)
    print(f"| {label} | {cones} | {statistics.mean(scales):.2f} | {', '.join(f'{p:.2f}' for p in scales)} "
          f"| {ssim:.4f} | {found[0][0][2]} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--times", default="600")
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--test", type=int, default=50, help="test views a scale")
    parser.add_argument("options", nargs="*", metavar="OPTION=VALUE")
    given = parser.parse_intermixed_args()
    dataset = imported(given.build, given.scene, given.work)
    print(f"{given.scene.name}: trained on train and validation views, seeds {given.seeds}; "
          f"{' '.join(given.options) or 'standard'}\n")
    print("| training | cones a pixel | PSNR, dB | scales, dB | SSIM | views |\n|---|---|---|---|---|---|")
    for label, psnr in zip(("the paper, 25,000 steps (32 min of an A100)",
                            "the paper, 120,000 steps (2.6 h of an A100)"),
                           PUBLISHED.get(given.scene.name, ())):
        print(f"| {label} | one | {psnr:.2f} | | | 200 |")
    for seconds in given.times.split(","):
        runs = [measured(given.build, dataset, given.work,
                         [f"time={seconds}", f"seed={seed}", f"test={given.test}", *given.options])
                for seed in given.seeds.split(",")]
        row(f"{seconds} s", runs, "as many as make them as narrow as the finest", False)
        row(f"{seconds} s", runs, "one", True)


main()
