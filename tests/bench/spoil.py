#!/usr/bin/python3
"""Captures that were spoilt by a known amount, and what of it is found again.

    spoil.py exposures CAPTURE OUT [--stops 0.5] [--tint 0.1] [--veil 0] [--seed 1]
    spoil.py gains OUT DATASET BEFORE
    spoil.py colours DATASET
    spoil.py even DATASET OUT [--offsets 0]
    spoil.py poses DATASET OUT [--turn 0.5] [--shift 0.005] [--seed 1]
    spoil.py moves OUT CHECKPOINT

`exposures` copies a capture (images/ and what lies beside it) with each photograph lightened or darkened in linear
light by up to that many stops either way and each channel tinted by up to that share, and stray light of
up to `veil` of white added to each; `gains` compares what an import of it measured, beside what one of the
capture as it was (BEFORE) did. `colours` fits a gain a channel, and a gain and an offset, to half of what
an imported dataset's photographs show of sparse points, and scores both on the other half; `even` copies
the dataset with its training photographs brought to one exposure by either. `poses` copies an imported dataset with each camera, test cameras too, turned by
so many degrees about a random axis and shifted by that share of the bounds' radius; `moves` compares what
a training (quality ... save=CHECKPOINT) made of its training cameras, after the rigid motion and scale
that all share.
"""

import argparse
import json
import shutil
import struct
import sys
from pathlib import Path

import numpy as np
from PIL import Image


def linear(stored):
    x = stored.astype(np.float64) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def stored(light):
    x = np.clip(light, 0, 1)
    return np.round(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


def exposures(options):
    random = np.random.default_rng(options.seed)
    shutil.copytree(options.capture, options.out, ignore=shutil.ignore_patterns("images*"))
    (options.out / "images").mkdir()
    truth = {}
    for path in sorted((options.capture / "images").iterdir()):
        factor = 2.0 ** random.uniform(-options.stops, options.stops) * (
            1 + random.uniform(-options.tint, options.tint, 3))
        veil = random.uniform(0, options.veil) if options.veil else 0.0
        image = np.asarray(Image.open(path).convert("RGB"))
        Image.fromarray(stored(linear(image) * factor + veil)).save(options.out / "images" / path.name, quality=97)
        truth[path.stem] = factor.tolist()
    (options.out / "truth.json").write_text(json.dumps(truth))


def gains(options):
    truth = json.loads((options.out / "truth.json").read_text())
    imported = [{Path(f["name"]).stem: f["gain"] for f in
                 json.loads((folder / "dataset.json").read_text())["frames"] if "gain" in f}
                for folder in (options.dataset, options.before)]
    names = sorted(set(imported[0]) & set(imported[1]))
    known = np.log2([truth[name] for name in names]) / 2.2  # of stored values, nearly
    found = np.log2([imported[0][name] for name in names]) - np.log2([imported[1][name] for name in names])
    off = (found - found.mean(0)) - (known - known.mean(0))
    print(f"{len(names)} of {len(truth)} photographs measured: known gains of stored values spread by "
          f"{100 * (2 ** known.std() - 1):.1f} % (standard deviation), found ones are off by "
          f"{100 * (2 ** off.std() - 1):.1f} %, {100 * (2 ** np.abs(off).max() - 1):.1f} % at most")


DARK, BRIGHT = 16, 240  # as common/dataset/exposure.c
NEAR = 2 / 255  # differences below it weigh as if they were it


class Sightings:
    """What photographs show of sparse points: stored values in [0, 1], means of 3 x 3 pixels."""

    def __init__(self, folder):
        self.document = json.loads((folder / "dataset.json").read_text())
        data = (folder / "points.bin").read_bytes()
        points, count = struct.unpack("<QQ", data[8:24])
        seen = np.frombuffer(data, [("point", "<u4"), ("photo", "<u4"), ("at", "<f4", 2)], count,
                             24 + 32 * points)
        value = np.full((count, 3), np.nan)
        for frame in self.document["frames"]:
            image = np.asarray(Image.open(folder / frame["file"]).convert("RGB")).astype(float)
            of = np.flatnonzero(seen["photo"] == frame["photo"])
            for i, (x, y) in zip(of, np.floor(seen["at"][of] * image.shape[1::-1]).astype(int)):
                part = image[y - 1:y + 2, x - 1:x + 2]
                if part.shape == (3, 3, 3) and part.min() >= DARK and part.max() <= BRIGHT:
                    value[i] = part.mean((0, 1)) / 255
        usable = ~np.isnan(value[:, 0])
        self.point, self.photo = seen["point"][usable].astype(int), seen["photo"][usable].astype(int)
        self.value, self.points = value[usable], points
        self.photos = 1 + max(frame["photo"] for frame in self.document["frames"])

    def fit(self, used, offsets):
        """Gains and offsets (photographs, 3), and colours of points, by least absolute differences."""
        point, photo, value = self.point[used], self.photo[used], self.value[used]
        gain, offset = np.ones((self.photos, 3)), np.zeros((self.photos, 3))
        colour, weight = None, np.ones_like(value)
        for _ in range(80):
            sums = [np.stack([np.bincount(point, w * x, self.points) for w, x in zip(weight.T, part.T)], -1)
                    for part in ((value - offset[photo]) / gain[photo], np.ones_like(value))]
            colour = sums[0] / np.maximum(sums[1], 1e-9)
            c = colour[point]
            total = lambda part: np.stack(  # noqa: E731
                [np.bincount(photo, w * x, self.photos) for w, x in zip(weight.T, part.T)], -1)
            cc, cv, one, c1, v1 = (total(p) for p in (c * c, c * value, np.ones_like(c), c, value))
            cc, cv, one = cc + 0.8 / NEAR, cv + 0.8 / NEAR, one + 3 / NEAR  # as three sightings of (1, 0)
            if offsets:
                gain, offset = (one * cv - c1 * v1) / (one * cc - c1 * c1), (cc * v1 - c1 * cv) / (one * cc - c1 * c1)
                offset -= offset.mean(0)
            else:
                gain = cv / cc
            gain /= np.exp(np.log(gain).mean(0))
            weight = 1 / np.maximum(np.abs(value - gain[photo] * c - offset[photo]), NEAR)
        return gain, offset, colour


def colours(options):
    seen = Sightings(options.dataset)
    draw = np.random.default_rng(1).random(len(seen.point)) < 0.5
    known = np.bincount(seen.point[draw], minlength=seen.points) > 1
    scored = ~draw & known[seen.point]
    print(f"{len(seen.point)} usable sightings, {scored.sum()} of them scored:")
    for name, fitted, offsets in (("as they are", False, False), ("gains", True, False),
                                  ("gains and offsets", True, True)):
        gain, offset, colour = seen.fit(draw, offsets)
        if not fitted:
            gain, sums = np.ones_like(gain), np.stack(
                [np.bincount(seen.point[draw], v, seen.points) for v in seen.value[draw].T], -1)
            colour = sums / np.maximum(np.bincount(seen.point[draw], minlength=seen.points), 1)[:, None]
        off = seen.value - gain[seen.photo] * colour[seen.point] - offset[seen.photo]
        print(f"  {name}: mean absolute difference {255 * np.abs(off[scored]).mean():.2f}, median "
              f"{255 * np.median(np.abs(off[scored])):.2f} of 255; gains spread by "
              f"{100 * np.log(gain).std():.1f} %, offsets by {255 * offset.std():.1f} of 255")


def even(options):
    seen = Sightings(options.dataset)
    gain, offset, _ = seen.fit(slice(None), options.offsets)
    shutil.copytree(options.dataset, options.out)
    for frame in seen.document["frames"]:
        frame.pop("gain", None)
        if frame["split"] == "train":
            image = np.asarray(Image.open(options.dataset / frame["file"]).convert("RGB")) / 255
            image = (image - offset[frame["photo"]]) / gain[frame["photo"]]
            Image.fromarray(np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)).save(
                options.out / frame["file"])
    (options.out / "dataset.json").write_text(json.dumps(seen.document))


def turn_of(vector):
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-12)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def poses(options):
    random = np.random.default_rng(options.seed)
    document = json.loads((options.dataset / "dataset.json").read_text())
    radius = document["bounds"]["radius"]
    options.out.mkdir()
    shutil.copytree(options.dataset / "images", options.out / "images")
    shutil.copyfile(options.dataset / "dataset.json", options.out / "truth.json")
    for frame in document["frames"]:
        pose = np.array(frame["camera"]["world_from_camera"])
        axis, aside = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
        pose[:, :3] = pose[:, :3] @ turn_of(axis * np.radians(options.turn))
        pose[:, 3] += aside * options.shift * radius
        frame["camera"]["world_from_camera"] = pose.tolist()
    if "points" in document:
        del document["points"]  # they would say that the poses are wrong
    (options.out / "dataset.json").write_text(json.dumps(document))


def moves_of(checkpoint):
    with open(checkpoint, "rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
        begin = file.tell()
        if "poses" not in header:
            return None
        first, end = header["poses"]["data_offsets"]
        file.seek(begin + first)
        return np.frombuffer(file.read(end - first), np.float32).reshape(header["poses"]["shape"]).astype(float)


def apart(cameras, truth):
    """Degrees and shares of the mean distance, after the similarity that fits best."""
    a, b = cameras[:, :, 3], truth[:, :, 3]
    turns = np.einsum("nij,nkj->ik", truth[:, :, :3], cameras[:, :, :3])
    u, _, v = np.linalg.svd(turns)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    x, y = (a - a.mean(0)) @ turn.T, b - b.mean(0)
    scale = (x * y).sum() / (x * x).sum()
    rest = np.linalg.norm(scale * x - y, axis=1) / np.linalg.norm(y, axis=1).mean()
    angles = [np.degrees(np.arccos(np.clip((np.trace((turn @ p).T @ q) - 1) / 2, -1, 1)))
              for p, q in zip(cameras[:, :, :3], truth[:, :, :3])]
    return np.mean(angles), np.mean(rest)


def moves(options):
    given = json.loads((options.out / "dataset.json").read_text())
    truth = json.loads((options.out / "truth.json").read_text())
    held = lambda f: f["split"] == "train" and f["index"] % 8 == 7  # noqa: E731
    chosen = [(f, g) for f, g in zip(given["frames"], truth["frames"]) if f["split"] == "train" and not held(f)]
    start = np.array([f["camera"]["world_from_camera"] for f, _ in chosen])
    goal = np.array([g["camera"]["world_from_camera"] for _, g in chosen])
    found, by = start.copy(), moves_of(options.checkpoint)
    print("given: off by {:.3f} degrees, {:.4f} of the distance".format(*apart(start, goal)))
    if by is None:
        print("poses were not refined")
        return
    for pose, move in zip(found, by):
        pose[:, 3] += pose[:, :3] @ move[3:6] * given["bounds"]["radius"]
        pose[:, :3] = pose[:, :3] @ turn_of(move[:3])
    print("found: off by {:.3f} degrees, {:.4f} of the distance; focal length times {:.5f}".format(
        *apart(found, goal), np.exp(by[:, 6].mean())))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    shapes = {exposures: (("capture", "out"), ("stops", 0.5), ("tint", 0.1), ("veil", 0.0), ("seed", 1)),
              gains: (("out", "dataset", "before"),), colours: (("dataset",),),
              even: (("dataset", "out"), ("offsets", 0)), moves: (("out", "checkpoint"),),
              poses: (("dataset", "out"), ("turn", 0.5), ("shift", 0.005), ("seed", 1))}
    for verb, (paths, *numbers) in shapes.items():
        words = verbs.add_parser(verb.__name__)
        words.set_defaults(run=verb)
        for name in paths:
            words.add_argument(name, type=Path)
        for name, default in numbers:
            words.add_argument(f"--{name}", type=type(default), default=default)
    options = parser.parse_args()
    options.run(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
