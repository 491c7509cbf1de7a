#!/usr/bin/python3
"""Pictures by a deadline, measured socket to socket against a running daemon.

    tests/bench/deadlines.py HOST SCENE [--deadlines 10,20,50,100,200,500] [--cameras 100]
                             [--size 400x400] [--format jpeg]

Every camera is a held-out view (test, then val) of the scene's dataset, asked for as JPEG 90. A line
a deadline: the share of answers whose last byte was here in time, the median and 95th percentile of
that, PSNR against the full picture beside that of the best fixed setting of the scene's curve (its
median and the encoder's within the deadline), and the PSNR expected against that of the photograph:
the mean of the differences, and the share within 0.5 dB. Measure the curve first, and say what else
the machine did.
"""

import argparse
import http.client
import io
import json
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
        if reply.status != 200:
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
        return numpy.mean([psnr(pixels(self.picture(name, **setting)[2]), full)
                           for name, full in zip(self.names, self.full)])


def best_fixed(curve, deadline, encode_ms):
    fitting = [point for point in curve["points"] if point["ms_median"] + encode_ms <= deadline]
    return fitting[-1]["setting"] if fitting else None


def measure(views, curve, deadline, encode_ms):
    spent, full, difference, late = [], [], [], 0
    for name, whole, photograph in zip(views.names, views.full, views.photographs):
        ms, headers, content = views.picture(name, within_ms=deadline)
        picture = pixels(content)
        spent.append(ms)
        late += ms > deadline
        full.append(psnr(picture, whole))
        if picture.shape == photograph.shape:
            difference.append(float(headers["X-Ripnerf-Expected-Psnr"]) - psnr(picture, photograph))
    setting = best_fixed(curve, deadline, encode_ms)
    fixed = views.fixed(setting) if setting is not None else float("nan")
    within = numpy.mean(numpy.abs(difference) <= 0.5) if difference else float("nan")
    print(f"{deadline:8g}{100 * (1 - late / len(spent)):8.1f}%{numpy.median(spent):9.1f}"
          f"{numpy.percentile(spent, 95):9.1f}{numpy.mean(full):9.2f}{fixed:9.2f}"
          f"{numpy.mean(difference):9.2f}{100 * within:8.0f}%", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("host")
    parser.add_argument("scene")
    parser.add_argument("--deadlines", default="10,20,50,100,200,500")
    parser.add_argument("--cameras", type=int, default=100)
    parser.add_argument("--size", default="400x400")
    parser.add_argument("--format", default="jpeg", choices=("jpeg", "png"))
    options = parser.parse_args()
    daemon = Daemon(options.host)
    curve = daemon.json(f"/v1/scenes/{options.scene}/curve")
    views = Views(daemon, options.scene, options.cameras, map(int, options.size.split("x")),
                  options.format)
    timing = views.picture(views.names[0])[1]["Server-Timing"]
    encode_ms = float(timing.split("encode;dur=")[1])
    print(f"{len(views.names)} views, full picture {curve['points'][-1]['ms_median']:.1f} ms, "
          f"encoding {encode_ms:.1f} ms{', the curve is stale' if curve['stale'] else ''}")
    print(f"{'deadline':>8}{'kept':>9}{'median':>9}{'p95':>9}{'to full':>9}{'fixed':>9}"
          f"{'expected':>9}{'0.5 dB':>9}")
    for deadline in options.deadlines.split(","):
        measure(views, curve, float(deadline), encode_ms)


if __name__ == "__main__":
    main()
