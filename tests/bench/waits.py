#!/usr/bin/python3
"""How long a render waits for a training, against a running daemon.

    tests/bench/waits.py HOST DATASET [--presets draft,standard,paper] [--pictures 300] [--warm 20]

Each preset trains DATASET (two scenes of it may not train at once), and after `--warm` seconds small
pictures are asked for at random moments. A line a preset: the steps that were made meanwhile, the
median, the 95th percentile and the longest of the milliseconds that a picture waited in its runner
(the `queue` of its Server-Timing), and whether all pictures of one step were the same bytes.
"""

import argparse
import http.client
import json
import random
import time

import numpy


def ask(host, method, path, body=None):
    connection = http.client.HTTPConnection(host, timeout=120)
    data = json.dumps(body).encode() if body is not None else None
    connection.request(method, path, data, {"Content-Type": "application/json"} if data else {})
    reply = connection.getresponse()
    content = reply.read()
    connection.close()
    return reply.status, reply.headers, content


def wait_until_trained(host, scene, seconds):
    while True:
        record = json.loads(ask(host, "GET", f"/v1/scenes/{scene}")[2])
        if record["steps"] > 0 and record["train_seconds"] >= seconds:
            return
        time.sleep(0.2)


def measure(host, dataset, preset, pictures, warm):
    scene = f"waits-{preset}-{int(time.time())}"
    body = {"type": "train", "dataset": dataset, "scene": scene,
            "options": {"preset": preset, "max_time_s": 3600}}
    status, _, content = ask(host, "POST", "/v1/jobs", body)
    if status != 202:
        raise SystemExit(content)
    job = json.loads(content)["id"]
    wait_until_trained(host, scene, warm)
    waited, of_step, same = [], {}, True
    for _ in range(pictures):
        time.sleep(random.uniform(0.02, 0.12))
        status, headers, content = ask(host, "POST", f"/v1/scenes/{scene}/render",
                                       {"view": "test:0", "size": {"width": 32, "height": 32}})
        if status != 200:
            raise SystemExit(content)
        waited.append(float(headers["Server-Timing"].split("queue;dur=")[1].split(",")[0]))
        step = int(headers["X-Ripnerf-Step"])
        same = same and of_step.setdefault(step, content) == content
    steps = sorted(of_step)
    ask(host, "POST", f"/v1/jobs/{job}/cancel")
    print(f"{preset:10}{steps[0]:8}{steps[-1]:8}{numpy.median(waited):9.1f}"
          f"{numpy.percentile(waited, 95):9.1f}{max(waited):9.1f}   {'yes' if same else 'NO'}",
          flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("host")
    parser.add_argument("dataset")
    parser.add_argument("--presets", default="draft,standard,paper")
    parser.add_argument("--pictures", type=int, default=300)
    parser.add_argument("--warm", type=float, default=20)
    options = parser.parse_args()
    print(f"{'preset':10}{'from':>8}{'to step':>8}{'median':>9}{'p95':>9}{'longest':>9}   one step, one picture")
    for preset in options.presets.split(","):
        measure(options.host, options.dataset, preset, options.pictures, options.warm)


if __name__ == "__main__":
    main()
