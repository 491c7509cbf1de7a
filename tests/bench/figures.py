#!/usr/bin/env python3
"""The table of quality after a given time, as Markdown, with the machine that made it.

    figures.py QUALITY DATASET [--times 15,60] [--seeds 1,2,3] [--test 50] [OPTION=VALUE ...]

QUALITY is the built program tests/bench/quality; further options are its own (preset=draft, clock=cpu,
threads=1). A row a time: mean PSNR of the test views over the scales, range over the seeds, PSNR of each
scale, SSIM and milliseconds a picture.
"""
import argparse
import re
import statistics
import subprocess
from pathlib import Path

SCALE = re.compile(r"^test scale (\d+): psnr ([\d.]+) ssim ([\d.]+) views \d+ render_ms ([\d.]+)", re.M)


def measure(quality, dataset, seconds, seed, test, options):
    """(PSNR, SSIM, ms) of each scale."""
    command = [quality, dataset, f"time={seconds}", f"seed={seed}", f"test={test}", *options]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = [tuple(float(v) for v in m.groups()[1:]) for m in SCALE.finditer(said)]
    if not found:
        raise SystemExit(f"{' '.join(command)} printed no test scale:\n{said}")
    return found


def row(seconds, runs):
    """A line of the table out of one run a seed."""
    means = [statistics.mean(psnr for psnr, _, _ in run) for run in runs]
    scales = ", ".join(f"{statistics.mean(run[i][0] for run in runs):.1f}"
                       for i in range(len(runs[0])))
    ssim = statistics.mean(ssim for run in runs for _, ssim, _ in run)
    full = statistics.mean(run[0][2] for run in runs)
    return (f"| {seconds:g} s | {statistics.mean(means):.2f} | {min(means):.2f} to {max(means):.2f} "
            f"| {scales} | {ssim:.3f} | {full:.0f} |")


def machine():
    """The processor, by its own account."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    name = re.search(r"model name\s*: (.*)", text)
    return f"{name[1] if name else 'unknown processor'}, {text.count('processor')} threads"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("quality")
    parser.add_argument("dataset")
    parser.add_argument("--times", default="15,60")
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--test", type=int, default=50, help="test views a scale")
    parser.add_argument("options", nargs="*", metavar="OPTION=VALUE")
    given = parser.parse_intermixed_args()
    print(f"{machine()}; {given.dataset}; {' '.join(given.options) or 'standard'}\n")
    print("| training | PSNR, dB | seeds | scales, dB | SSIM | a picture, ms |\n|---|---|---|---|---|---|")
    for seconds in map(float, given.times.split(",")):
        runs = [measure(given.quality, given.dataset, seconds, seed, given.test, given.options)
                for seed in given.seeds.split(",")]
        print(row(seconds, runs), flush=True)


main()
