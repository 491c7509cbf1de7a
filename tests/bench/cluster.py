#!/usr/bin/python3
"""cluster.py BUILD overhead|peace|storm --folder F [--nodes N]: runners on a Slurm cluster of this machine.

`overhead`: from a training's submission to its first step, and what a frame of a path costs, on this
machine and on a node of it, in turns. `peace`: eight trainings of procedural scenes and a path of 300
frames at once; what comes of each is kept in F/peace.json. `storm`: the same, each again as soon as it
is over, for --seconds, while every 20 seconds the slurmd of another node is killed, with all that runs on
the node where --whole says so, and started again --down seconds later (at most 60, so that one of four
is up); every result is compared with the one of the peace. It may be run as often as one likes on the same folder. Needs Slurm's packages
(tests/slurm).
"""

import argparse
import hashlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.checked import TERMINAL, Daemon, make_tar  # noqa: E402
from support.cluster import Cluster  # noqa: E402

POSES = [[[1, 0, 0, 0.0], [0, 0, -1, -3.2], [0, 1, 0, 0.4]],
         [[1, 0, 0, 0.4], [0, 0, -1, -3.2], [0, 1, 0, 0.4]]]
SCENES = ("sphere", "nested")
PHOTOS = 64  # pixels a side
INTERVAL_S = 20
PATIENCE_S = 280  # for what is still under way in the end


def camera_path(frames, size):
    return {"axes": "opengl", "fps": 10, "interpolation": "linear", "loop": False, "width": size,
            "height": size,
            "keys": [{"time": time_s, "world_from_camera": pose, "fov_y_deg": 40}
                     for time_s, pose in zip((0, (frames - 1) / 10), POSES)]}


def daemon_on(build, folder, cluster=None, **options):
    programs = build / "server" / "ripnerfd", build / "server" / "ripnerf-runner"
    if cluster:
        options |= {"executor": "slurm", "shared": folder.parent, "slurm-listen": "127.0.0.1:0"}
    environment = cluster.environment if cluster else {}
    return Daemon(*programs, folder, environment, **{"log-level": "info", **options})


def succeed(daemon, job, timeout=300):
    record = daemon.wait(job, timeout=timeout)
    assert record["state"] == "succeeded", record
    return record


def import_scene(daemon, build, photos, name):
    if not photos.exists():
        subprocess.run([build / "client" / "ripnerf", "synth", name, photos, "--size", str(PHOTOS),
                        "--views", "24"], check=True, capture_output=True)
    reply = daemon.post("/v1/datasets", body=make_tar(photos), query={"name": name},
                        headers={"Content-Type": "application/x-tar"})
    assert reply.status == 202, reply.body
    succeed(daemon, reply.json["id"])


def train(daemon, dataset, scene, **options):
    return daemon.submit(type="train", dataset=dataset, scene=scene,
                         options={"preset": "draft", "threads": 1, **options})


# ---- overhead -----------------------------------------------------------------------------------


def seconds_to_first_step(daemon, dataset, scene):
    begin = time.monotonic()
    job = train(daemon, dataset, scene, max_steps=60)
    while not (daemon.job(job)["progress"] or {}).get("step"):
        time.sleep(0.01)
    took = time.monotonic() - begin
    succeed(daemon, job)
    return took


def ms_a_frame(daemon, scene, frames, size):
    begin = time.monotonic()
    job = daemon.submit(type="path", scene=scene, camera_path=camera_path(frames, size))
    record = succeed(daemon, job)
    return 1000 * (time.monotonic() - begin) / frames, record["result"]["render_ms_median"]


def ms_a_picture(daemon, scene):
    """Of a runner that is warm, from request to answer."""
    took = []
    for i in range(8):
        begin = time.monotonic()
        reply = daemon.post(f"/v1/scenes/{scene}/render", {"view": f"test:{i % 2}"})
        took.append(1000 * (time.monotonic() - begin))
        assert reply.status == 200, reply.body
    return statistics.median(took)


def overhead(build, folder, options):
    with Cluster(folder / "cluster", options.nodes) as cluster, \
            daemon_on(build, folder / "local", threads=1) as local, \
            daemon_on(build, folder / "shared" / "far", cluster, threads=1) as far:
        figures = {}
        for daemon in (local, far):
            import_scene(daemon, build, folder / "photos-sphere", "sphere")
            succeed(daemon, train(daemon, "sphere", "s", max_steps=100))
        for i in range(options.rounds):
            for where, daemon in (("here", local), ("Slurm", far)):
                def note(what, value, where=where):
                    figures.setdefault((what, where), []).append(value)
                note("s from submission to the first step",
                     seconds_to_first_step(daemon, "sphere", f"s{i}"))
                whole, median = ms_a_frame(daemon, f"s{i}", 60, options.size)
                note("ms a frame of a path of 60, all told", whole)
                note("ms a frame, its rendering alone", median)
                note("ms a picture by a warm runner", ms_a_picture(daemon, f"s{i}"))
        for (what, where), values in sorted(figures.items()):
            print(f"| {what} | {where} | {statistics.median(values):.2f} | "
                  f"{min(values):.2f} to {max(values):.2f} |", flush=True)


# ---- peace and storm ----------------------------------------------------------------------------


def digest_of_frames(daemon, job):
    folder = Path(daemon.data) / "jobs" / job / "frames"
    frames = sorted(folder.glob("*.png"))
    return hashlib.sha256(b"".join(frame.read_bytes() for frame in frames)).hexdigest()


class Work:
    """Eight trainings and a path, each of which can be asked for again and again."""

    def __init__(self, daemon, options):
        self.daemon, self.options = daemon, options
        self.jobs = {}  # name -> the job that is under way
        self.asked = []  # all of them
        self.rounds = 0

    def names(self):
        return ["path"] + [f"t{i}" for i in range(self.options.trainings)]

    def begin(self, name):
        self.rounds += 1
        if name == "path":
            job = self.daemon.submit(type="path", scene="base", camera_path=camera_path(
                self.options.frames, self.options.size))
        else:
            number = int(name[1:])
            job = train(self.daemon, SCENES[number % 2], f"{name}-{self.rounds}", seed=1 + number,
                        max_steps=self.options.steps, checkpoint_interval_s=2)
        self.jobs[name] = job
        self.asked.append(job)

    def take(self, name):
        """(digest, attempts) of one that is over; None while it is not."""
        record = self.daemon.job(self.jobs[name])
        if record["state"] not in TERMINAL:
            return None
        assert record["state"] == "succeeded", record
        job = self.jobs.pop(name)
        if name == "path":
            assert record["result"]["frames"] == self.options.frames, record
            return digest_of_frames(self.daemon, job), record["attempt"]
        return record["result"]["parameters_sha256"], record["attempt"]

    def states(self):
        return {name: (record["state"], record.get("runner"), record["progress"])
                for name, record in ((name, self.daemon.job(job)) for name, job in self.jobs.items())}

    def check_nothing_is_lost(self):
        for job in self.asked:
            assert self.daemon.job(job)["state"] == "succeeded", self.daemon.job(job)


def kill_all_on(node, folder):
    """What runs in jobs of this node: each one's script, what watches it, and its runner."""
    doomed = set()
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment = (process / "environ").read_bytes().split(b"\0")
            if f"SLURMD_NODENAME={node}".encode() not in environment or \
                    str(folder).encode() not in (process / "cmdline").read_bytes():
                continue
            parent = int((process / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if "slurmstepd" in Path(f"/proc/{parent}/comm").read_text():
                doomed.add(parent)
            doomed.add(int(process.name))
        except OSError:
            continue
    for pid in doomed:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue


class Weather(threading.Thread):
    """Hits a node every INTERVAL_S, in turns, which comes back `down_s` later: until then others may be
    hit too. With `folder`, that jobs are of, all of a node is lost and not its slurmd alone."""

    def __init__(self, cluster, down_s, folder):
        super().__init__()
        self.cluster, self.down_s, self.folder = cluster, down_s, folder
        self.over, self.killed, self.wrong = threading.Event(), 0, None
        self.back = []  # (when, node) of those that are down, first to come back first

    def hit(self):
        name = f"n{1 + self.killed % self.cluster.nodes}"
        self.cluster.node(name, "down")
        if self.folder:
            kill_all_on(name, self.folder)
        self.killed += 1
        self.back.append((time.monotonic() + self.down_s, name))

    def run(self):
        try:
            next_hit = time.monotonic() + 1
            while not self.over.wait(0.1):
                now = time.monotonic()
                if now >= next_hit:
                    self.hit()
                    next_hit += INTERVAL_S
                if self.back and now >= self.back[0][0]:
                    self.cluster.node(self.back.pop(0)[1], "up")
            for _, name in self.back:
                self.cluster.node(name, "up")
        except AssertionError as error:
            self.wrong = error

    def end(self):
        self.over.set()
        self.join()
        assert self.wrong is None, self.wrong


def prepare(build, folder, daemon):
    for scene in SCENES:
        import_scene(daemon, build, folder / f"photos-{scene}", scene)
    succeed(daemon, train(daemon, SCENES[0], "base", max_steps=100))


def work_until(work, seconds, found):
    """Asks for each again while there is time, and waits for the last ones."""
    begin = time.monotonic()
    for name in work.names():
        work.begin(name)
    while work.jobs:
        for name in list(work.jobs):
            result = work.take(name)
            if result is None:
                continue
            found(name, *result)
            if time.monotonic() - begin < seconds:
                work.begin(name)
        assert time.monotonic() - begin < seconds + PATIENCE_S, work.states()
        time.sleep(0.2)
    work.check_nothing_is_lost()


def peace(build, folder, options):
    results = {}
    with Cluster(folder / "cluster", options.nodes) as cluster, \
            daemon_on(build, folder / "shared" / "peace", cluster, threads=1) as daemon:
        prepare(build, folder, daemon)
        begin = time.monotonic()
        work_until(Work(daemon, options), 0,
                   lambda name, digest, attempts: results.update({name: digest}))
        print(f"| peace | {time.monotonic() - begin:.0f} s | {len(results)} results |", flush=True)
    (folder / "peace.json").write_text(json.dumps({"options": vars_of(options), "results": results}))


def vars_of(options):
    return {name: getattr(options, name) for name in ("trainings", "steps", "frames", "size")}


def storm(build, folder, options):
    kept = json.loads((folder / "peace.json").read_text())
    assert kept["options"] == vars_of(options), f"the peace was of {kept['options']}"
    counts = {"results": 0, "paths": 0, "again": 0, "attempts": 0}

    def compare(name, digest, attempts):
        assert digest == kept["results"][name], f"{name} differs"
        counts["results"] += 1
        counts["paths"] += name == "path"
        counts["again"] += attempts > 1
        counts["attempts"] += attempts - 1
        print(f"{time.monotonic() - begin:6.1f} s  {name}: the same, attempt {attempts}",
              file=sys.stderr, flush=True)

    number = len(list((folder / "shared").glob("storm*[0-9]")))
    with Cluster(folder / "cluster", options.nodes) as cluster, \
            daemon_on(build, folder / "shared" / f"storm{number}", cluster, threads=1) as daemon:
        prepare(build, folder, daemon)
        begin = time.monotonic()
        weather = Weather(cluster, options.down, folder if options.whole else None)
        weather.start()
        try:
            work_until(Work(daemon, options), options.seconds, compare)
        finally:
            weather.end()
        what = "whole nodes" if options.whole else "slurmd"
        print(f"| storm | {time.monotonic() - begin:.0f} s | {weather.killed} {what} killed | "
              f"{counts['results']} results, {counts['paths']} of them paths, all equal | "
              f"{counts['again']} of them lost their runner, {counts['attempts']} times |",
              flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("build", type=Path)
    parser.add_argument("what", choices=("overhead", "peace", "storm"))
    parser.add_argument("--folder", type=Path, help="that keeps what peace found, for storm")
    parser.add_argument("--nodes", type=int, default=4)
    parser.add_argument("--trainings", type=int, default=8)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--seconds", type=float, default=300)
    parser.add_argument("--down", type=float, default=15, help="storm: s until a node comes back")
    parser.add_argument("--whole", action="store_true", help="storm: all of a node is lost")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    do = {"overhead": overhead, "peace": peace, "storm": storm}[options.what]
    with tempfile.TemporaryDirectory() as own:
        folder = (options.folder or Path(own)).resolve()
        (folder / "shared").mkdir(parents=True, exist_ok=True)
        do(options.build.resolve(), folder, options)


if __name__ == "__main__":
    main()
