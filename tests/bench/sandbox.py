#!/usr/bin/python3
"""sandbox.py BUILD [--rounds 5] [--steps 400]: what the sandbox costs.

The same training and the same pictures by two daemons, one with `--sandbox 1` and one with
`--sandbox 0`, in turn; each round's CPU seconds of daemon and runners (which what else runs on the
machine disturbs less than a clock), and that parameters and pictures are the same bytes.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.checked import Daemon  # noqa: E402

VIEWS, REPEATS = 6, 6


def cpu_s(daemon):
    """CPU seconds that a daemon and its runners have used, those that are gone included."""
    ticks = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = stat.read_text(encoding="utf-8").rsplit(")", 1)[1].split()
        except OSError:  # it ended
            continue
        if int(stat.parent.name) == daemon.process.pid:
            ticks += sum(int(word) for word in words[11:15])
        elif int(words[1]) == daemon.process.pid:
            ticks += int(words[11]) + int(words[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def measured(daemon, work, *given):
    """CPU seconds, and what `work` returned."""
    begin = cpu_s(daemon)
    result = work(daemon, *given)
    return cpu_s(daemon) - begin, result


def train(daemon, scene, steps):
    return daemon.train(scene, preset="draft", max_steps=steps)[1]["parameters_sha256"]


def take_pictures(daemon, scene):
    views = [f"test:{i % VIEWS}" for i in range(VIEWS * REPEATS)]
    replies = [daemon.post(f"/v1/scenes/{scene}/render", {"view": view}) for view in views]
    assert {reply.status for reply in replies} == {200}
    return [reply.body for reply in replies]


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("build", type=Path)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--steps", type=int, default=400)
    given = options.parse_args()
    build = given.build.resolve()
    ratios = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = "synth sphere photos --size 200 --views 24"
        subprocess.run([build / "client/ripnerf", *command.split()], cwd=folder, check=True, stderr=subprocess.DEVNULL)
        programs = build / "server/ripnerfd", build / "server/ripnerf-runner"
        with Daemon(*programs, folder / "on", sandbox=1) as confined, \
                Daemon(*programs, folder / "off", sandbox=0) as free:
            for daemon in (confined, free):
                assert daemon.wait(daemon.upload("data", folder / "photos"))["state"] == "succeeded"
            print(f"load {os.getloadavg()[0]:.1f}\n\n| round | training, CPU s: on | off | "
                  f"{VIEWS * REPEATS} pictures, CPU s: on | off |\n|---|---|---|---|---|")
            for i in range(given.rounds):
                order = (confined, free) if i % 2 == 0 else (free, confined)
                trained = {daemon: measured(daemon, train, f"s{i}", given.steps) for daemon in order}
                taken = {daemon: measured(daemon, take_pictures, f"s{i}") for daemon in order}
                on, off = ((*trained[daemon], *taken[daemon]) for daemon in (confined, free))
                assert on[1::2] == off[1::2], "other bytes"
                ratios.append((on[0] / off[0], on[2] / off[2]))
                print(f"| {i + 1} | {on[0]:.2f} | {off[0]:.2f} | {on[2]:.2f} | {off[2]:.2f} |", flush=True)
    for what, values in zip(("training", "pictures"), zip(*ratios)):
        print(f"\n{what}: on/off {statistics.median(values):.3f} (median), "
              f"{min(values):.3f} to {max(values):.3f}; the same bytes")


if __name__ == "__main__":
    main()
