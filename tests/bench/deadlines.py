#!/usr/bin/python3
"""Pictures by a deadline, measured socket to socket against a running daemon.

    tests/bench/deadlines.py HOST SCENE [--deadlines 10,20,50,100,200,500] [--cameras 100]
                             [--size 400x400] [--format jpeg] [--train DATASET] [--fixed FILE]

Every camera is a held-out view (test, then val) of the scene's dataset, asked for as JPEG 90. A line
a deadline: the share of answers whose last byte was here in time, the median and 95th percentile of
that, PSNR against the full picture, beside it that of the best fixed setting of the scene's curve
and what is lost to it, and the PSNR expected against that of the photograph: the mean of the
differences, and the share within 0.5 dB. The best fixed setting of a time is the one with the best
mean PSNR of those that, asked for here likewise, are in time as often as is aimed at: 99 of 100
times, 95 with `--train`, which trains DATASET meanwhile; FILE keeps what they were, for another call with
other deadlines. Measure the curve first, and say what else the machine did.
"""

import argparse
import http.client
import io
import json
import os
import time

import numpy
from PIL import Image


class Daemon:
    def __init__(self, host):
        self.connection = http.client.HTTPConnection(host, timeout=120)
        self.connection.connect()

    def ask(self, method, path, body=None):
        """(milliseconds from the first byte out to the last byte in, headers, body)."""
        data = json.dumps(body).encode() if body is not None else None
        headers = {"Content-Type": "application/json"} if data else {}
        begin = time.perf_counter()
        self.connection.request(method, path, data, headers)
        reply = self.connection.getresponse()
        content = reply.read()
        spent = 1e3 * (time.perf_counter() - begin)
        if reply.status >= 300:
            raise SystemExit(f"{method} {path}: {reply.status} {content[:300]!r}")
        return spent, reply.headers, content

    def json(self, path):
        return json.loads(self.ask("GET", path)[2])


def pixels(content, background=None):
    image = Image.open(io.BytesIO(content))
    if image.mode == "RGBA" and background is not None:
        under = Image.new("RGBA", image.size, tuple(round(255 * c) for c in background) + (255,))
        image = Image.alpha_composite(under, image)
    return numpy.asarray(image.convert("RGB"), dtype=numpy.float64) / 255


def psnr(a, b):
    error = numpy.mean((a - b) ** 2)
    return -10 * numpy.log10(error) if error > 0 else 99.0


class Views:
    """Held-out views, what is true of them, and what a setting makes of them."""

    def __init__(self, daemon, scene, count, size, form):
        self.daemon, self.path = daemon, f"/v1/scenes/{scene}/render"
        self.format = form
        self.size = dict(zip(("width", "height"), size))
        about = daemon.json(f"/v1/scenes/{scene}")
        self.names, self.full, self.photographs = [], [], []
        for split in ("test", "val"):
            index = 0
            while len(self.names) < count:
                daemon.connection.request("GET",
                                          f"/v1/datasets/{about['dataset']}/images/{split}/{index}")
                reply = daemon.connection.getresponse()
                content = reply.read()
                if reply.status != 200:
                    break
                name = f"{split}:{index}"
                self.names.append(name)
                self.photographs.append(pixels(content, about["config"]["background"]))
                self.full.append(pixels(self.picture(name, format="png")[2]))
                index += 1

    def picture(self, view, **options):
        return self.daemon.ask("POST", self.path, {
            "view": view, "size": self.size, "format": self.format, "jpeg_quality": 90, **options})

    def fixed(self, setting):
        """Milliseconds and PSNR against the full picture, of every view."""
        asked = [self.picture(name, **setting) for name in self.names]
        return ([ms for ms, _, _ in asked],
                [psnr(pixels(content), full) for (_, _, content), full in zip(asked, self.full)])


class Training:
    """Of a scene of its own, on the same cores."""

    def __init__(self, daemon, dataset):
        self.daemon, self.scene = daemon, f"beside-{int(time.time())}"
        self.job = json.loads(daemon.ask("POST", "/v1/jobs", {
            "type": "train", "dataset": dataset, "scene": self.scene,
            "options": {"max_time_s": 3600}})[2])["id"]
        while self.steps() < 100:
            time.sleep(0.2)

    def steps(self):
        return self.daemon.json(f"/v1/scenes/{self.scene}")["steps"]

    def end(self):
        self.daemon.ask("POST", f"/v1/jobs/{self.job}/cancel")


def all_fixed(views, curve, kept):
    if kept and os.path.exists(kept):
        with open(kept, encoding="utf-8") as file:
            return json.load(file)
    fixed = [views.fixed(point["setting"]) for point in curve["points"]]
    if kept:
        with open(kept, "w", encoding="utf-8") as file:
            json.dump(fixed, file)
    return fixed


def best_fixed(fixed, deadline, aim):
    fitting = [numpy.mean(values) for spent, values in fixed
               if numpy.mean(numpy.array(spent) <= deadline) >= aim]
    return max(fitting, default=float("nan"))


def measure(views, fixed, deadline, aim):
    spent, full, difference, late = [], [], [], 0
    for name, whole, photograph in zip(views.names, views.full, views.photographs):
        ms, headers, content = views.picture(name, within_ms=deadline)
        picture = pixels(content)
        spent.append(ms)
        late += ms > deadline
        full.append(psnr(picture, whole))
        if picture.shape == photograph.shape:
            difference.append(float(headers["X-Ripnerf-Expected-Psnr"]) - psnr(picture, photograph))
    best = best_fixed(fixed, deadline, aim)
    within = numpy.mean(numpy.abs(difference) <= 0.5) if difference else float("nan")
    print(f"{deadline:8g}{100 * (1 - late / len(spent)):8.1f}%{numpy.median(spent):9.1f}"
          f"{numpy.percentile(spent, 95):9.1f}{numpy.mean(full):9.2f}{best:9.2f}"
          f"{best - numpy.mean(full):9.2f}{numpy.mean(difference):9.2f}{100 * within:8.0f}%",
          flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("host")
    parser.add_argument("scene")
    parser.add_argument("--deadlines", default="10,20,50,100,200,500")
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--size", default="400x400")
    parser.add_argument("--format", default="jpeg", choices=("jpeg", "png"))
    parser.add_argument("--train", metavar="DATASET")
    parser.add_argument("--fixed", metavar="FILE")
    options = parser.parse_args()
    daemon = Daemon(options.host)
    curve = daemon.json(f"/v1/scenes/{options.scene}/curve")
    views = Views(daemon, options.scene, options.cameras, map(int, options.size.split("x")),
                  options.format)
    training = Training(daemon, options.train) if options.train else None
    began, steps = time.monotonic(), training.steps() if training else 0
    fixed = all_fixed(views, curve, options.fixed)
    print(f"{len(views.names)} views, full picture {curve['points'][-1]['ms_median']:.1f} ms"
          f"{', the curve is stale' if curve['stale'] else ''}")
    print(f"{'deadline':>8}{'kept':>9}{'median':>9}{'p95':>9}{'to full':>9}{'fixed':>9}{'lost':>9}"
          f"{'expected':>9}{'0.5 dB':>9}")
    for deadline in options.deadlines.split(","):
        measure(views, fixed, float(deadline), 0.95 if training else 0.99)
    if training:
        print(f"the training made {(training.steps() - steps) / (time.monotonic() - began):.1f} "
              "steps a second meanwhile")
        training.end()


if __name__ == "__main__":
    main()
