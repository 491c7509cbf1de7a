#!/usr/bin/env python3
"""Studies of the paper's own mathematics: arms trained on paired seeds and compared, as Markdown.

    ablation.py BUILD DATASET WORK_FOLDER --study planes|sizes|ripmap|back|area|orientations
                [--steps 1000] [--seeds 1,2,3] [--samples 65536] [--test 10] [--minutes 0] [--only "ARM;ARM"]
                [--quick] [OPTION=VALUE ...]

DATASET is an imported one, of several scales where footprints are to matter. Every arm is preset `paper`
for --steps steps of --samples samples, one cone a pixel; further options are tests/bench/quality's. With
--quick it is `standard`'s networks and optimiser with steps of one width, one cone a pixel, rays drawn evenly
and 10 planes of 512: what matters to footprints is as in the paper, in a tenth of the time.

One command, called again until its exit code is not 75: what is finished is kept in WORK_FOLDER by
program, dataset and options, and a training that --minutes ended goes on where it was. What is there so
far is printed each time.
"""
import argparse
import hashlib
import json
import os
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

UNFINISHED = 75
SCALE = re.compile(r"^test(?: one cone a pixel,)? scale (\d+): psnr ([\d.]+) ssim ([\d.]+) views (\d+)", re.M)
# Published PSNR of the ablation's lego after 25,000 steps, four scales from 800 px. Its fewer planes have larger
# grids, as many parameters as 10 of 512: rows of `sizes`, not of `planes`.
PUBLISHED = {"10 planes, rip": 36.94, "10 planes, mip": 35.87, "10 planes of 512": 36.94, "6 planes of 661": 36.27,
             "4 planes of 810": 34.50, "3 planes of 935": 35.98}
# Not an option of quality's: every pixel weighs the same, however wide it is.
UNWEIGHTED = "weights=1"
# Half a level is a factor of the square root of two in the texels that footprints are measured in.
UP, DOWN = "fbase={up}", "fbase={down}"
STUDIES = {
    "planes": {"10 planes, rip": [], "10 planes, mip": ["footprint=mip"], "6 planes, rip": ["planes=6"],
               "4 planes, rip": ["planes=4"], "3 planes, rip": ["planes=3"]},
    "sizes": {"10 planes of 512": [], "6 planes of 661": ["planes=6", "base={of_661}"],
              "4 planes of 810": ["planes=4", "base={of_810}"], "3 planes of 935": ["planes=3", "base={of_935}"]},
    "ripmap": {"rip": [], "mip": ["footprint=mip"], "mip, mean level": ["footprint=mip", "mean_level=true"],
               "rip, half a level up": [UP], "rip, half a level down": [DOWN],
               "mip, half a level up": ["footprint=mip", UP], "mip, half a level down": ["footprint=mip", DOWN], "point": ["footprint=point"]},
    "back": {f"{footprint}, {name}": [f"footprint={footprint}", *options]
             for name, options in (("as the paper", []), ("steps as wide as cones", ["cone=true"]),
                                   ("several cones", ["supersample=true"]),
                                   ("most rays from the finest scale", ["finest=true"]))
             for footprint in ("rip", "mip")},
    "area": {"with the area loss": [], "without": [UNWEIGHTED]},
    "orientations": {"10 planes of the icosahedron": [], "10 of a golden spiral": ["orientation=golden"],
                     "10 of blue noise": ["orientation=blue"], "10 of white noise": ["orientation=white"]}}

PAPER = ["preset=paper"]
QUICK = ["preset=standard", "cone=false", "supersample=false", "finest=false", "by_error=false", "auto=false",
         "planes=10", "footprint=rip", "base=512", "grow=0"]


def of_base(arm, options):
    """An arm's options, where footprints and grids go by the base grid that the further options ask for."""
    base = next((int(option[5:]) for option in options if option.startswith("base=")), 512)
    sizes = {f"of_{size}": round(size * base / 512) for size in (661, 810, 935)}
    return [option.format(up=round(base * 2 ** 0.5), down=round(base / 2 ** 0.5), **sizes) for option in arm]


def build_name(quality):
    return hashlib.sha256(quality.read_bytes()).hexdigest()[:12]


def unweighted(dataset, work):
    """The same photographs, where coarse pixels weigh no more than fine ones."""
    target = work / f"{dataset.name}-unweighted"
    if not (target / "dataset.json").exists():
        target.mkdir(exist_ok=True)
        (target / "images").unlink(missing_ok=True)
        (target / "images").symlink_to((dataset / "images").resolve())
        record = json.loads((dataset / "dataset.json").read_text(encoding="utf-8"))
        for frame in record["frames"]:
            frame["loss_weight"] = 1
        (target / "dataset.json").write_text(json.dumps(record), encoding="utf-8")
    return target


def train(given, arm, seed, deadline):
    """What quality printed of an arm with a seed: now, or before. None: not finished by the deadline."""
    quality = given.build / "tests/bench/quality"
    options = [*(QUICK if given.quick else PAPER), f"steps={given.steps}", f"samples={given.samples}", f"test={given.test}",
               "cones=own", "every=0", *given.options, *arm, f"seed={seed}"]
    name = hashlib.sha256(json.dumps([build_name(quality), str(given.dataset), options]).encode())
    kept = given.work / f"{name.hexdigest()[:16]}.txt"
    dataset = unweighted(given.dataset, given.work) if UNWEIGHTED in options else given.dataset
    if kept.exists():
        return kept.read_text(encoding="utf-8")
    left = deadline - time.monotonic()
    if left < 20:
        return None
    state = kept.with_suffix(".safetensors")
    run = subprocess.run(
        [quality, dataset, *(option for option in options if option != UNWEIGHTED), f"save={state}",
         *([f"resume={state}"] if state.exists() else []), *([f"wall={left:.0f}"] if left < 1e9 else [])],
        capture_output=True, text=True, check=False)
    if run.returncode == UNFINISHED:
        return None
    if run.returncode != 0:
        sys.exit(f"{' '.join(options)}: {run.stderr}")
    kept.with_suffix(".tmp").write_text(run.stdout, encoding="utf-8")
    os.replace(kept.with_suffix(".tmp"), kept)
    state.unlink(missing_ok=True)
    return run.stdout


def scores(said):
    """PSNR of each scale, SSIM, views."""
    found = SCALE.findall(said)
    return [float(psnr) for _, psnr, _, _ in found], statistics.mean(float(s) for _, _, s, _ in found), \
        int(found[0][3])


def margin(of, first):
    """Mean over the seeds that both have, and the range."""
    pairs = [statistics.mean(of[seed][0]) - statistics.mean(first[seed][0]) for seed in of if seed in first]
    if not pairs:
        return ""
    spread = f" ({min(pairs):+.2f} to {max(pairs):+.2f})" if len(pairs) > 1 else ""
    return f"{statistics.mean(pairs):+.2f}{spread}"


def table(given, arms, found):
    published = any(arm in PUBLISHED for arm in arms)
    views = next((run[2] for runs in found.values() for run in runs.values()), 0)
    preset = "standard with steps of one width, one cone, even rays and 10 planes" if given.quick else "paper"
    print(f"{given.dataset.name}: preset {preset}, {given.steps} steps of {given.samples} samples, "
          f"{views} test views a scale, one cone a pixel{' ' + ' '.join(given.options) if given.options else ''}\n")
    print("| arm | seeds | PSNR, dB | over the first | by scale | over the first by scale | SSIM |"
          + (" the paper, 25,000 steps | over its first |" if published else ""))
    print("|---|---|---|---|---|---|---|" + ("---|---|" if published else ""))
    first = found[next(iter(arms))]
    for arm, runs in ((arm, found[arm]) for arm in arms if found[arm]):
        scales = [statistics.mean(run[0][i] for run in runs.values()) for i in range(len(next(iter(runs.values()))[0]))]
        both = [seed for seed in runs if seed in first]
        apart = [statistics.mean(runs[seed][0][i] - first[seed][0][i] for seed in both)
                 for i in range(len(scales))] if both else []
        paper = " | |" if published else ""
        if arm in PUBLISHED:
            paper = f" {PUBLISHED[arm]:.2f} | {PUBLISHED[arm] - PUBLISHED['10 planes, rip']:+.2f} |"
        print(f"| {arm} | {', '.join(map(str, runs))} | {statistics.mean(scales):.2f} | {margin(runs, first)} | "
              f"{', '.join(f'{p:.2f}' for p in scales)} | {', '.join(f'{p:+.2f}' for p in apart)} | "
              f"{statistics.mean(run[1] for run in runs.values()):.4f} |{paper}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--study", choices=STUDIES, default="planes")
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--samples", type=int, default=65536)
    parser.add_argument("--test", type=int, default=10, help="test views a scale")
    parser.add_argument("--minutes", type=float, default=0, help="end after so many, with exit code 75; 0: never")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", help="these arms")
    parser.add_argument("options", nargs="*", metavar="OPTION=VALUE")
    given = parser.parse_intermixed_args()
    given.work.mkdir(parents=True, exist_ok=True)
    arms = STUDIES[given.study]
    if given.only:
        arms = {arm: arms[arm] for arm in given.only.split(";")}
    deadline = time.monotonic() + 60 * given.minutes if given.minutes else float("inf")
    found = {arm: {} for arm in arms}
    whole = True
    for seed in map(int, given.seeds.split(",")):  # every arm with one seed before the next one
        for arm, options in arms.items():
            said = train(given, of_base(options, given.options), seed, deadline)
            whole = whole and said is not None
            if said is not None:
                found[arm][seed] = scores(said)
    table(given, arms, found)
    sys.exit(0 if whole else UNFINISHED)


if __name__ == "__main__":
    main()
