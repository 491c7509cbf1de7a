"""Every allocation and system call that can fail, made to fail once for each way that leads to it.

A script of import, training, picture, path and deletion is gone through step by step; while a step
runs, one call whose stack was not met before fails, until a step meets none. After some failures the
next life of a daemon begins, with nothing stored, for a step takes the longer the more jobs there were.
The check takes a sample for some seconds; `RIPNERF_FAULT_SECONDS=3600 pytest
tests/api/test_fault_stacks.py -s` goes on until no new stack is found. `RIPNERF_FAULT_TRIED=FOLDER`
leaves out those tried before of the same programs, also by others that run beside it.
Nothing may crash, hang, leak descriptors or memory or lose what it acknowledged, and what fails says why.
"""

import contextlib
import http.client
import io
import itertools
import math
import os
import random
import re
import sqlite3
import subprocess
import tarfile
import time
from collections import Counter
from pathlib import Path

import pytest

from support.checked import Daemon, make_tar
from support.faults import Faults
from support.photographs import pose, write_dataset
from support.waiting import PATIENCE_S, wait_for

SECONDS = float(os.environ.get("RIPNERF_FAULT_SECONDS", "0"))
SAMPLE_S = 12
TRIED = os.environ.get("RIPNERF_FAULT_TRIED")
LIFE = 150  # calls that fail in a daemon's life
MADE = {"import": "datasets", "train": "scenes"}  # by a step, which is refused where it is there
CONTENT = ("datasets", "scenes", "jobs", "camera-paths")
PATH = {"axes": "opengl", "width": 8, "height": 8, "fps": 2,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1)]}
TAR = {"Content-Type": "application/x-tar"}
# Crashes by itself where memory ends (libarchive 3.6): an import is tried again then.
FRAIL = ("libarchive.so",)
LEAKY = FRAIL  # also ends the process by exit(), with all that it has, or keeps a block by itself


class Script:
    """The steps; each is tried again until it succeeds, as a person would."""

    def __init__(self, daemon, faults, held, photographs, options):
        self.daemon, self.faults, self.held, self.options = daemon, faults, held, options
        self.tar = make_tar(photographs)
        self.failures, self.told, self.round = 0, set(), 0
        self.end = math.inf
        self.read = 0  # of the log

    def ask(self, method, path, **keys):
        try:
            return self.daemon.request(method, path, check=False, **keys)
        except (http.client.HTTPException, ConnectionError):
            return None  # the connection is all that was lost

    def follow(self, job):
        """Its events to their end, or until the connection ends: asking again and again would cost more."""
        connection = self.daemon.connect()
        end = time.monotonic() + PATIENCE_S
        with contextlib.closing(connection), contextlib.suppress(http.client.HTTPException, ConnectionError):
            connection.request("GET", f"/v1/jobs/{job}/events")
            for _ in connection.getresponse():
                assert time.monotonic() < end, f"the events of a job do not end; failed: {self.faults.last()}"

    def job_of(self, reply):
        """How the job of a reply ended; None: there is none."""
        if reply is None or reply.status != 202:
            return None

        def ended():
            seen = self.ask("GET", f"/v1/jobs/{reply.json['id']}")
            assert seen is None or seen.status != 404, "an acknowledged job is lost"
            return seen is not None and seen.status == 200 and seen.json["finished_at"] and seen.json
        self.follow(reply.json["id"])
        return wait_for(ended, said=lambda: f"a job does not end; failed: {self.faults.last()}")

    def tell(self, problem):
        assert problem["detail"], (problem, self.faults.last())
        self.told.add(problem["detail"])

    def is_done(self, reply, kind):
        job = self.job_of(reply)
        if job is not None and job["state"] != "succeeded":
            assert job["state"] == "failed", job
            self.tell(job["problem"])
        elif job is None and reply is not None and reply.status != 409:
            assert reply.status >= 400, reply.body
            self.tell(reply.json)
        return (job is not None and job["state"] == "succeeded") or self.is_there(kind)

    def is_there(self, kind):
        seen = self.ask("GET", f"/v1/{kind}/n{self.round}")
        return seen is not None and seen.status == 200 and seen.json.get("state") in (None, "ready")

    def step_import(self):
        return self.is_done(self.ask("POST", "/v1/datasets", body=self.tar, headers=TAR,
                                     query={"name": f"n{self.round}"}), "datasets")

    def step_train(self):
        done = self.is_done(self.ask("POST", "/v1/jobs", json_body={
            "type": "train", "dataset": f"n{self.round}", "scene": f"n{self.round}",
            "options": self.options}), "scenes")
        if not done:
            self.ask("DELETE", f"/v1/scenes/n{self.round}")
        return done

    def step_render(self):
        reply = self.ask("POST", f"/v1/scenes/n{self.round}/render",
                         json_body={"view": "test:0"})
        if reply is not None and reply.status != 200:
            self.tell(reply.json)
        return reply is not None and reply.status == 200

    def rests(self):
        seen = self.ask("GET", f"/v1/scenes/n{self.round}")
        return seen is not None and seen.status == 200 and not seen.json["loaded"]

    def step_path(self):
        wait_for(self.rests)  # its job starts a runner, or meets the last picture's: 208 stacks that came by chance
        job = self.job_of(self.ask("POST", "/v1/jobs", json_body={
            "type": "path", "scene": f"n{self.round}", "camera_path": PATH}))
        if job is None or job["state"] != "succeeded":
            return False
        frames = self.ask("GET", f"/v1/jobs/{job['id']}/frames.tar")
        return frames is not None and frames.status == 200

    def step_list(self):
        replies = [self.ask("GET", path) for path in
                   ("/v1/jobs", "/v1/scenes", "/metrics", "/v1/info",
                    f"/v1/datasets/n{self.round}/cameras",
                    f"/v1/datasets/n{self.round}/images/train/0")]
        return all(reply is not None and reply.status == 200 for reply in replies)

    def files(self):
        """What is stored for good and has a record, by its name below the data folder."""
        root = Path(self.daemon.data)
        with contextlib.closing(sqlite3.connect(f"file:{root}/ripnerf.db?mode=ro", uri=True)) as records:
            known = {(kind, row[0]) for kind in CONTENT
                     for row in records.execute(f"SELECT id FROM {kind.replace('-', '_')}")}
        return {str(path.relative_to(root)) for kind, name in known for path in root.glob(f"{kind}/{name}/**/*")
                if path.is_file() and path.name != "lock" and not path.name.startswith(".")}

    def step_backup(self):
        return self.backup({})

    def step_backup_of_scene(self):
        return self.backup({"scene": f"n{self.round}"})

    def backup(self, query):
        """All or nothing."""
        reply = self.ask("GET", "/v1/backup", query=query)
        if reply is None or reply.status != 200:
            if reply is not None:
                self.tell(reply.json)
            return False
        with tarfile.open(fileobj=io.BytesIO(reply.body)) as archive:
            missing = self.files() - set(archive.getnames())
        assert not [name for name in missing if name.startswith(("scenes", "datasets")) or not query], \
            (missing, self.faults.last())
        self.copy = reply.body
        return True

    def step_adopt(self):
        """What was deleted comes back as it was, or not at all."""
        reply = self.ask("POST", "/v1/backup", body=self.copy, headers=TAR)
        if reply is None or reply.status // 100 != 2:
            if reply is not None:
                self.tell(reply.json)
            return False
        self.faults.disarm()
        for kind in ("datasets", "scenes"):
            assert self.daemon.get(f"/v1/{kind}/n{self.round}").status == 200, self.faults.last()
        return True

    def step_token(self):
        made = self.ask("POST", "/v1/tokens", json_body={"name": "anna", "scope": "read"})
        if made is None or made.status != 201:
            self.ask("DELETE", "/v1/tokens/anna")  # its answer may be all that was lost
            return False
        gone = self.ask("DELETE", f"/v1/tokens/{made.json['id']}")
        return gone is not None and gone.status == 204

    def step_camera_path(self):
        made = self.ask("POST", "/v1/camera-paths", json_body={"name": f"n{self.round}", "path": PATH})
        return made is not None and made.status in (201, 409)

    def step_delete_camera_path(self):
        return self.gone("camera-paths")

    def gone(self, kind):
        self.ask("DELETE", f"/v1/{kind}/n{self.round}")
        seen = self.ask("GET", f"/v1/{kind}/n{self.round}")
        return seen is not None and seen.status == 404

    def step_delete_scene(self):
        return self.gone("scenes")

    def step_delete_dataset(self):
        return self.gone("datasets")

    RESTORE = ["delete_scene", "delete_dataset", "adopt"]
    STEPS = ["import", "train", "render", "path", "camera_path", "token", "list", "backup", *RESTORE,
             "backup_of_scene", *RESTORE, "delete_camera_path", "delete_scene", "delete_dataset"]

    def run(self, chance):
        """Once through, with as many failures as there are new stacks; how many there were. With chance
        None nothing fails, and the stacks are noted."""
        before = self.failures
        self.round += 1
        for name in self.STEPS:
            step = getattr(self, "step_" + name)
            quiet = 0
            while True:
                late = (time.monotonic() > self.end and self.failures > 1) or self.failures >= LIFE
                if chance is None:
                    self.faults.survey()
                else:
                    self.faults.arm_stacks(0 if late else chance, random.randrange(1 << 30))
                done = step()
                hit = self.faults.disarm()
                self.failures += hit
                self.check()
                if done and not hit:
                    break
                if done and name in MADE:
                    self.ask("DELETE", f"/v1/{MADE[name]}/n{self.round}")
                quiet = 0 if hit else quiet + 1
                if not hit:
                    assert quiet < 100, (name, self.told, self.faults.last())
                    time.sleep(0.05)
        return self.failures - before

    def damaged(self):
        return Path(self.daemon.data).glob("scenes/*/checkpoints/*.damaged")

    def check(self):
        assert self.daemon.process.poll() is None, \
            f"it ended after {self.faults.last()}\n{self.daemon.log_text()[-2000:]}"
        assert not list(self.damaged()), f"a sound checkpoint is set aside after {self.faults.last()}"
        with open(self.daemon.log, "rb") as log:
            log.seek(self.read)
            fresh = log.read().decode(errors="replace")
            self.read = log.tell()
        crashed = re.search(r"killed by signal (?!9 |15 )\d+[^\n]*", fresh)
        assert not crashed or self.faults.is_within(FRAIL), f"{crashed[0]} after {self.faults.last()}"
        assert self.daemon.get("/healthz", check=False).status == 200
        self.held.check()


def descriptors(daemon):
    return len(os.listdir(f"/proc/{daemon.process.pid}/fd"))


class Held:
    """What processes of a program have not given back when they end: the places that asked for it, counted."""

    def __init__(self, build, faults, program, folder):
        library = build / "tests" / "support" / "ripnerf-held.so"
        self.folder, self.faults, self.usual, self.learns = folder, faults, Counter(), True
        if library.is_file():  # no sanitizer counts
            faults.environment |= {"LD_PRELOAD": f"{library}:{faults.environment['LD_PRELOAD']}",
                                   "RIPNERF_HELD": str(folder / "held"), "RIPNERF_HELD_OF": program}
        self.waits = program == "ripnerf-runner"  # each ends with its job, the daemon with its life

    def is_running(self, file):
        return self.waits and Path(f"/proc/{file.suffix[1:]}").exists()

    def check(self):
        """Not more than one of those of a life without failures, the first: what libraries keep for good."""
        for file in list(self.folder.glob("held.*")):
            wait_for(lambda: not self.is_running(file))  # pylint: disable=cell-var-from-loop
            *places, last = file.read_text().splitlines() or [""]
            if self.waits or last == "whole":
                file.unlink()  # another process may have its number later
            if last != "whole":
                continue  # it was killed, or goes on
            more = Counter(places) - self.usual
            if self.learns:
                self.usual += more
            assert self.learns or not more or self.faults.is_within(LEAKY), f"{dict(more)} after {self.faults.last()}"


def tried(program):
    return TRIED and Path(TRIED) / program


@pytest.mark.parametrize("program", ["ripnerfd", "ripnerf-runner"])
def test_each_way_to_fail(build, tmp_path, program):
    faults = Faults(build, tmp_path / "plan", program, tried(program))
    options = {"preset": "draft", "max_steps": 3, "threads": 1}
    runner = build / "server" / "ripnerf-runner"
    if program == "ripnerfd":
        runner = build / "tests" / "support" / "ripnerf-runner-fake"
    held = Held(build, faults, program, tmp_path)
    photographs = write_dataset(tmp_path / "photographs", train=3, val=1, test=1)
    failures, told, before, end = 0, set(), 0, None

    def live(life):
        """How many calls failed in one life of a daemon."""
        nonlocal before, end
        with Daemon(build / "server" / "ripnerfd", runner, tmp_path / f"data{life}", faults.environment,
                    keep_alive=0, log_level="info") as daemon:
            script = Script(daemon, faults, held, photographs, options)
            if life == 0:  # in later ones calls fail from their first step on
                assert script.run(None) == 0  # all that is opened once is open now
                before = descriptors(daemon)
                assert daemon.stop() == 0, daemon.log_text()[-2000:]
                held.check()
                held.learns = False
                return 0
            script.end = end = end or time.monotonic() + (SECONDS or SAMPLE_S)
            while script.run(256 if SECONDS else 128) > 0 and script.failures < LIFE and time.monotonic() < end:
                pass
            assert script.run(0) == 0
            wait_for(lambda: descriptors(daemon) <= before, said=lambda: f"{descriptors(daemon)} of {before}")
            assert daemon.stop() == 0, daemon.log_text()[-2000:]
            held.check()
        told.update(script.told)
        return script.failures

    for life in itertools.count():
        failures += (fresh := live(life))
        print(f"\n{program}: {failures} calls failed, {len(faults.tried())} stacks tried, "
              f"{len(faults.met() & faults.tried())} of the {len(faults.met())} that are met where nothing fails, "
              f"{life + 1} lives, {len(told)} reasons told", flush=True)
        if life > 0 and (fresh == 0 or time.monotonic() > end):
            break
    assert failures > 1 or TRIED


def test_each_way_to_fail_at_the_start(build, tmp_path):
    """A start ends with a reason, or serves."""
    faults = Faults(build, tmp_path / "plan", "ripnerfd", tried("start"))
    runner = build / "tests" / "support" / "ripnerf-runner-fake"
    end = time.monotonic() + (SECONDS or 6)
    count = 0
    while time.monotonic() < end or (count <= 5 and time.monotonic() < end + PATIENCE_S):
        faults.arm_stacks(256 if SECONDS else 48, random.randrange(1 << 30))
        process = subprocess.Popen(
            [build / "server" / "ripnerfd", "--data", tmp_path / "data", "--runner", runner,
             "--listen", "127.0.0.1:0", "--drain", "1"], stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True, env={**os.environ, **faults.environment})
        line = process.stdout.readline()
        hit = faults.disarm()
        if line:
            assert "listening" in line
            process.terminate()
        _, why = process.communicate(timeout=PATIENCE_S)
        assert process.returncode in ((0, 143) if line else (1, 2)), (faults.last(), why)
        assert line or why.startswith("ripnerfd: ") or "\nripnerfd: " in why, (faults.last(), why)
        count += hit
        if not hit and SECONDS:
            break
    print(f"\n{count} calls failed at the start")
    assert count > 5 or TRIED


def under_way(daemon, job):
    """The training, once it runs, or another one in place of one that has failed and says why."""
    record = daemon.wait(job, ("running", "failed"))
    if record["state"] == "running":
        return job
    assert record["problem"]["detail"], record
    return under_way(daemon, daemon.submit(type="train", dataset="data", scene=f"of-{job}",
                                           options={"max_steps": 10**9}))


def test_each_way_to_fail_at_the_end(build, tmp_path, programs):
    """An end comes, and the next life has what was acknowledged and goes on with what was under way."""
    faults = Faults(build, tmp_path / "plan", "ripnerfd", tried("end"))
    photographs = write_dataset(tmp_path / "photographs", train=3, val=1, test=1)
    end = time.monotonic() + (SECONDS or 6)
    hits = []
    with Daemon(*programs, tmp_path / "data", faults.environment, keep_alive=0) as daemon:
        daemon.wait(daemon.upload("data", photographs))
        job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 10**9})
        while len(hits) < 3 or (hits[-1] or not SECONDS) and time.monotonic() < end:
            job = under_way(daemon, job)
            assert daemon.post("/v1/camera-paths", {"name": f"n{len(hits)}", "path": PATH}).status == 201
            faults.arm_stacks(256 if SECONDS else 48, random.randrange(1 << 30))
            assert daemon.stop() == 0, f"{faults.last()}\n{daemon.log_text()[-2000:]}"
            hits.append(faults.disarm())
            daemon.start()
            assert daemon.get(f"/v1/camera-paths/n{len(hits) - 1}").status == 200, faults.last()
            assert not list(Path(daemon.data).glob("scenes/*/checkpoints/*.damaged")), faults.last()
    print(f"\n{sum(hits)} calls failed at the end")
    assert sum(hits) > 1 or TRIED
