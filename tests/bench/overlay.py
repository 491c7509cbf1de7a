#!/usr/bin/python3
"""Pictures of known cameras laid over their photographs: how far edges are apart, in pixels.

    overlay.py PHOTOGRAPHS PICTURES [--blocks 6] [--save overlay.png]
    overlay.py --check PHOTOGRAPHS

Files of the same name in two folders, of one size. Both are cut into blocks; in each the shift by which
the gradients of grey correlate best is found to a fraction of a pixel, by a parabola through the
correlation's peak. Blocks without edges, or whose best correlation is below 0.5, say
nothing. A block's mean over all photographs is what a camera model that is wrong leaves; what a pose
or a blurred edge leaves varies from photograph to photograph.

Printed: the median length of the shifts, the mean shift of the whole picture, and of the block whose
mean over photographs is the longest, and the means of the blocks in the corners. --check shifts each
photograph by known fractions of a pixel and prints how well they are found again.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image

REACH = 6  # pixels, the largest shift that is looked for
ALIKE = 0.5  # correlation from which on a block counts
FEWEST = 4  # photographs that say something of a block


def grey(path):
    return np.asarray(Image.open(path).convert("L"), dtype=np.float64)


def smooth(image, sigma=1.5):
    radius = int(3 * sigma) + 1
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        image = np.apply_along_axis(lambda row: np.convolve(row, kernel, mode="same"), axis, image)
    return image


def edges(image):
    return np.stack(np.gradient(smooth(image)))


def parabola(before, peak, after):
    bend = before - 2 * peak + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


def shift_of(still, moved):
    """By how much `moved` lies right of and below `still`, and how well they agree then."""
    scores = np.full((2 * REACH + 1, 2 * REACH + 1), -1.0)
    a = still[:, REACH:-REACH, REACH:-REACH]
    if np.sqrt((a * a).mean()) < 1.0:
        return None
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            b = moved[:, REACH + dy:moved.shape[1] - REACH + dy, REACH + dx:moved.shape[2] - REACH + dx]
            scores[dy + REACH, dx + REACH] = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum() + 1e-12)
    y, x = np.unravel_index(scores.argmax(), scores.shape)
    if scores[y, x] < ALIKE or 0 in (y, x) or 2 * REACH in (y, x):
        return None
    best = scores[y, x]
    return (x - REACH + parabola(scores[y, x - 1], best, scores[y, x + 1]),
            y - REACH + parabola(scores[y - 1, x], best, scores[y + 1, x]))


def shifts_of(photograph, picture, blocks):
    """An array (blocks, blocks, 2) of shifts of the picture's edges against the photograph's."""
    still, moved = edges(photograph), edges(picture)
    found = np.full((blocks, blocks, 2), np.nan)
    height, width = photograph.shape
    for i in range(blocks):
        for j in range(blocks):
            part = np.s_[:, i * height // blocks:(i + 1) * height // blocks,
                         j * width // blocks:(j + 1) * width // blocks]
            shift = shift_of(still[part], moved[part])
            if shift:
                found[i, j] = shift
    return found


def subpixel(image, dx, dy):
    """The image moved right and down, by Fourier's theorem."""
    fy = np.fft.fftfreq(image.shape[0])[:, None]
    fx = np.fft.fftfreq(image.shape[1])[None, :]
    return np.real(np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * (fx * dx + fy * dy))))


def check(folder, blocks):
    worst = 0.0
    for path in sorted(folder.iterdir())[:4]:
        image = grey(path)
        for dx, dy in ((0.0, 0.0), (0.25, -0.5), (1.7, 0.4), (-3.3, 2.1)):
            found = shifts_of(image, subpixel(image, dx, dy), blocks)
            off = np.nanmedian(np.abs(found - (dx, dy)))
            worst = max(worst, off)
            print(f"{path.name}: moved by ({dx}, {dy}), found to {off:.3f} px")
    return worst


def save(path, photograph, picture):
    """Red: the photograph's edges; green: the picture's; where they meet, yellow."""
    layers = [np.clip(4 * np.hypot(*edges(image)), 0, 255) for image in (photograph, picture)]
    Image.fromarray(np.stack([*layers, np.zeros_like(layers[0])], -1).astype(np.uint8)).save(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("pictures", type=Path, nargs="?")
    parser.add_argument("--blocks", type=int, default=6)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--save")
    options = parser.parse_args()
    if options.check:
        return 0 if check(options.photographs, options.blocks) < 0.1 else 1
    found = []
    for path in sorted(options.pictures.iterdir()):
        photograph, picture = grey(options.photographs / path.name), grey(path)
        found.append(shifts_of(photograph, picture, options.blocks))
        if options.save and len(found) == 1:
            save(options.save, photograph, picture)
    found = np.array(found)
    count = (~np.isnan(found[..., 0])).sum(0)
    middle = np.where(count[..., None] >= FEWEST, np.nanmedian(found, 0), np.nan)
    length = np.hypot(middle[..., 0], middle[..., 1])
    corner = [float(length[i, j]) for i in (0, -1) for j in (0, -1)]
    whole = np.nanmean(found, (0, 1, 2))
    print(f"{len(found)} photographs, {int(count.sum())} of {found[..., 0].size} blocks have edges: "
          f"shifts {np.nanmedian(np.hypot(found[..., 0], found[..., 1])):.2f} px (median), mean "
          f"({whole[0]:+.2f}, {whole[1]:+.2f}); a block's median over photographs at most "
          f"{np.nanmax(length):.2f}, {np.nanmedian(length):.2f} (median), in the corners "
          + ", ".join("-" if np.isnan(c) else f"{c:.2f}" for c in corner))
    return 0


if __name__ == "__main__":
    sys.exit(main())
