#!/usr/bin/env python3
"""PSNR over seconds of several configurations, as a table and a plot.

    curves.py QUALITY DATASET OUT [--time 60] [--jobs 1] [--title TEXT] LABEL=OPTIONS ...

QUALITY is the built program tests/bench/quality; OPTIONS are its name=value pairs, separated by
commas: `3 planes, mip=planes=3,footprint=mip`. Each configuration trains on one thread for --time
seconds of CPU time, so that a machine that is not idle does not bend the curves, and is evaluated
on the held-out views as it goes. Writes OUT.csv (label, seconds, PSNR) and OUT.svg.
"""
import argparse
import concurrent.futures
import csv
import html
import math
import re
import subprocess
from pathlib import Path

LINE = re.compile(r"^step\s+\d+\s+([\d.]+) s\s+psnr ([\d.]+)")
COLOURS = ["#0b6e99", "#c2410c", "#3f7d20", "#7c3aed", "#b91c6b", "#57534e", "#a16207", "#0f766e",
           "#1d4ed8", "#dc2626", "#65a30d", "#9333ea"]
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 900, 520, 60, 250, 44, 48


def train(quality, dataset, seconds, options):
    """Points (seconds, PSNR) of one configuration."""
    command = [quality, dataset, "clock=cpu", "threads=1", f"time={seconds}",
               f"every={seconds / 8}", *options.split(",")]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [(float(m[1]), float(m[2])) for m in map(LINE.match, text.splitlines()) if m]


def scale(low, high, begin, end):
    """Maps [low, high] to [begin, end]."""
    return lambda value: begin + (value - low) / (high - low) * (end - begin)


def ticks(low, high):
    """Round numbers from low to high, about eight."""
    step = next(s for s in (0.5, 1, 2, 5, 10, 20) if (high - low) / s <= 9)
    first = math.ceil(low / step)
    return [step * i for i in range(first, math.floor(high / step) + 1)]


def plot(curves, title):
    """SVG of the curves; seconds on a logarithmic axis."""
    points = [point for _, curve in curves for point in curve]
    seconds = sorted({s for s, _ in points})
    low = math.floor(max(min(p for _, p in points), max(p for _, p in points) - 14))
    high = math.ceil(max(p for _, p in points))
    x = scale(math.log(seconds[0]), math.log(seconds[-1]), LEFT, WIDTH - RIGHT)
    y = scale(low, high, HEIGHT - BOTTOM, TOP)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
           'font-family="sans-serif" font-size="13">',
           f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
           f'<text x="{LEFT}" y="24" font-size="16">{html.escape(title)}</text>']
    for value in ticks(low, high):
        out.append(f'<path d="M{LEFT} {y(value):.1f}H{WIDTH - RIGHT}" stroke="#ddd"/>'
                   f'<text x="{LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{value:g}</text>')
    for value in (s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500)
                  if seconds[0] <= s <= seconds[-1]):
        at = x(math.log(value))
        out.append(f'<path d="M{at:.1f} {TOP}V{HEIGHT - BOTTOM}" stroke="#ddd"/>'
                   f'<text x="{at:.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{value}</text>')
    out.append(f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 8}" text-anchor="middle">'
               'seconds of one thread</text>'
               f'<text x="{LEFT}" y="{TOP - 6}" text-anchor="end">dB</text>')
    # Labels at the curves' ends, moved apart.
    at = HEIGHT
    for i, (label, curve) in sorted(enumerate(curves), key=lambda e: e[1][1][-1][1]):
        colour, dash = COLOURS[i % len(COLOURS)], ' stroke-dasharray="6 4"' if i % 2 else ""
        path = "L".join(f"{x(math.log(s)):.1f} {y(max(p, low)):.1f}" for s, p in curve)
        at = min(at - 17, y(curve[-1][1]) + 4)
        out.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="2"{dash}/>'
                   f'<path d="M{WIDTH - RIGHT} {y(curve[-1][1]):.1f}L{WIDTH - RIGHT + 12} '
                   f'{at - 4:.1f}" fill="none" stroke="{colour}"/>'
                   f'<text x="{WIDTH - RIGHT + 16}" y="{at:.1f}" fill="{colour}">'
                   f'{html.escape(label)}: {curve[-1][1]:.1f} dB</text>')
    return "\n".join([*out, "</svg>", ""])


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("quality")
    parser.add_argument("dataset")
    parser.add_argument("out", type=Path)
    parser.add_argument("curves", nargs="+", metavar="LABEL=OPTIONS")
    parser.add_argument("--time", type=float, default=60)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--title", default="PSNR of held-out views")
    args = parser.parse_args()
    labels, options = zip(*(curve.split("=", 1) for curve in args.curves))
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        found = list(pool.map(lambda o: train(args.quality, args.dataset, args.time, o), options))
    with args.out.with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["label", "seconds", "psnr"])
        writer.writerows((label, *point) for label, curve in zip(labels, found) for point in curve)
    args.out.with_suffix(".svg").write_text(plot(list(zip(labels, found)), args.title),
                                            encoding="utf-8")


if __name__ == "__main__":
    main()
