"""The plug is pulled: what was not flushed is dropped, torn or in another order. Nothing that was
acknowledged is lost, whatever of the rest the disk has kept.

RIPNERF_LOSSES is how many losses are simulated (6); RIPNERF_SEED repeats those of another run.
"""

import os
import random
import shutil
import signal
import subprocess
import threading
import time

import pytest

from support.checked import Daemon
from support.photographs import pose

PAGE = 4096
KEY = "user.ripnerf.id"
PATH = {"axes": "opengl", "width": 8, "height": 8, "fps": 2,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1)]}
RENDER = {"view": "test:0", "size": {"width": 8, "height": 8}}


def id_of(path):
    try:
        return os.getxattr(path, KEY).decode()
    except OSError:
        return None


def index(live):
    """Live files by their ids."""
    return {id_of(path): path for path in live.rglob("*") if path.is_file()}


def torn(rng, old, new):
    """Of each page the flushed bytes or the newer ones; the size of either."""
    size = rng.choice([len(old), len(new)])
    pages = range(0, size, PAGE)
    mixed = b"".join((rng.choice([old, new]) or b"")[at:at + PAGE].ljust(PAGE, b"\0") for at in pages)
    return mixed[:size]


def file_bytes(rng, mode, old, new):
    if mode == "dropped" or new is None:
        return old
    return torn(rng, old, new) if mode == "torn" else rng.choice([old, new])


def build_dropped(rng, mode, shadow, files, key, target):
    """A folder as it was last flushed; of its files what the disk has kept."""
    listing = shadow / key if key else None
    if listing is None or not listing.is_file():
        return
    for line in listing.read_text().splitlines():
        inner, kind, name = line.split(" ", 2)
        if kind == "d":
            (target / name).mkdir()
            build_dropped(rng, mode, shadow, files, inner, target / name)
        else:
            old = (shadow / inner).read_bytes() if (shadow / inner).is_file() else b""
            new = files[inner].read_bytes() if inner in files else None
            (target / name).write_bytes(file_bytes(rng, mode, old, new))


def build_ordered(rng, mode, shadow, live, target):
    """All names have reached the disk, not all of the bytes."""
    for path in sorted(live.rglob("*")):
        to = target / path.relative_to(live)
        if path.is_dir():
            to.mkdir()
        elif path.is_file():
            key = id_of(path)
            flushed = key is not None and (shadow / key).is_file()
            old = (shadow / key).read_bytes() if flushed else b""
            to.write_bytes(file_bytes(rng, mode, old, path.read_bytes()))


@pytest.fixture(scope="module")
def shim(build):
    return build / "tests" / "support" / "ripnerf-powerloss.so"


class Disk:
    def __init__(self, shim, folder):
        self.live, self.shadow, self.kept = folder / "live", folder / "shadow", folder / "kept"
        self.shadow.mkdir()
        self.live.mkdir()
        self.environment = {"LD_PRELOAD": str(shim), "RIPNERF_SHADOW": str(self.shadow),
                            "RIPNERF_SHADOW_OF": str(self.live), "RIPNERF_FAKE_STEP_US": "300",
                            "ASAN_OPTIONS": "verify_asan_link_order=0:detect_leaks=0"}

    def lose(self, rng, daemon, acknowledged):
        """Stops everything, looks at what was acknowledged, and takes what the disk would have."""
        pids = [daemon.process.pid, *daemon.runners()]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(0.02)
        oracle = {kind: dict(items) for kind, items in acknowledged.items()}
        self.kept.mkdir()
        mode = rng.choice(["dropped", "torn", "reordered"])
        if rng.random() < 0.5:
            build_dropped(rng, mode, self.shadow, index(self.live), id_of(self.live), self.kept)
        else:
            mode += ", names kept"
            build_ordered(rng, mode.split(",")[0], self.shadow, self.live, self.kept)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
            os.kill(pid, signal.SIGCONT)
        daemon.stop()
        return mode, oracle


def work(daemon, rng, acknowledged, stopped):
    """What users do, until the plug is pulled; each answer is written down when it is there."""
    def note(kind, reply, code, key, value):
        if reply.status == code:
            acknowledged[kind][key(reply)] = value(reply)
        return reply
    number = 0
    try:
        while not stopped.is_set():
            number += 1
            choice = rng.randrange(5)
            if choice == 0:
                name = f"p{number}"
                note("paths", daemon.post("/v1/camera-paths", {"name": name, "path": PATH}), 201,
                     lambda r: name, lambda r: r.json["id"])
            elif choice == 1 and acknowledged["paths"]:
                name = rng.choice(sorted(acknowledged["paths"]))
                doomed = acknowledged["paths"].pop(name)  # in doubt from now on
                note("gone", daemon.delete(f"/v1/camera-paths/{name}"), 204, lambda r: name,
                     lambda r: doomed)
            elif choice == 2:
                scene = f"s{number}"
                reply = note("jobs", daemon.post("/v1/jobs", {
                    "type": "train", "dataset": "data", "scene": scene, "options": {
                        "max_steps": 300, "checkpoint_interval_s": 1}}), 202,
                    lambda r: r.json["id"], lambda r: "queued")
                if reply.status == 202 and rng.random() < 0.7:
                    note("trained", Outcome(daemon.wait(reply.json["id"])), 200,
                         lambda r: scene, lambda r: r.json["result"]["parameters_sha256"])
            elif choice == 3:
                reply = note("jobs", daemon.post("/v1/jobs", {
                    "type": "path", "scene": "ready", "camera_path": PATH}), 202,
                    lambda r: r.json["id"], lambda r: "queued")
                if reply.status == 202 and rng.random() < 0.7:
                    note("filmed", Outcome(daemon.wait(reply.json["id"])), 200,
                         lambda r: r.json["id"], lambda r: r.json["result"]["frames"])
            else:
                note("tokens", daemon.post("/v1/tokens", {"name": f"t{number}"}), 201,
                     lambda r: f"t{number}", lambda r: r.json["token"])
    except (OSError, AssertionError, ValueError, KeyError, EOFError):
        pass  # the daemon is gone
    except Exception as error:  # noqa: BLE001 - http.client's
        if "http" not in type(error).__module__:
            raise


class Outcome:
    """A job's end as an answer."""
    def __init__(self, record):
        self.json = record
        self.status = 200 if record["state"] == "succeeded" else 0


def check(daemon, oracle):
    for name, identity in oracle["paths"].items():
        assert daemon.get(f"/v1/camera-paths/{name}").json["id"] == identity
    for name, identity in oracle["gone"].items():
        reply = daemon.get(f"/v1/camera-paths/{name}")
        assert reply.status == 404 or reply.json["id"] != identity
    for job in oracle["jobs"]:
        assert daemon.get(f"/v1/jobs/{job}").status == 200
    for scene, sha256 in oracle["trained"].items():
        assert daemon.get(f"/v1/scenes/{scene}").json["parameters_sha256"] == sha256
        assert daemon.post(f"/v1/scenes/{scene}/render", RENDER).status == 200
    for job, frames in oracle["filmed"].items():
        for i in range(frames):
            assert daemon.get(f"/v1/jobs/{job}/frames/{i}").status == 200, (job, i)
    for token in oracle["tokens"].values():
        reply = daemon.get("/v1/scenes", headers={"Authorization": f"Bearer {token}"})
        assert reply.status == 200
    for split, count in (("train", 6), ("val", 8), ("test", 4)):
        for i in range(count):
            assert daemon.get(f"/v1/datasets/data/images/{split}/{i}").status == 200
    assert daemon.post("/v1/scenes/ready/render", RENDER).status == 200


SEED = int(os.environ.get("RIPNERF_SEED", 0)) or random.SystemRandom().randrange(1, 2**31)
COUNT = int(os.environ.get("RIPNERF_LOSSES", "6"))


def simulate(programs, photographs, shim, folder, seed, forgets=None):
    rng = random.Random(seed)
    folder.mkdir()
    disk = Disk(shim, folder)
    forgotten = {"RIPNERF_FORGETS": forgets} if forgets else {}
    daemon = Daemon(*programs, disk.live, {**disk.environment, **forgotten}, sandbox=0,
                    max_rate=0).start()
    acknowledged = {kind: {} for kind in ("paths", "gone", "jobs", "trained", "filmed", "tokens")}
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        daemon.train("ready")
        stopped = threading.Event()
        thread = threading.Thread(target=work, args=(daemon, rng, acknowledged, stopped))
        thread.start()
        time.sleep(random.Random(seed).uniform(0.1, 1.5))
        needed = {"checkpoints": "trained", "ripnerf.db": "paths"}.get(forgets)
        while needed and not acknowledged[needed] and thread.is_alive():
            time.sleep(0.02)  # until there is something to lose
        mode, oracle = disk.lose(random.Random(seed + 1), daemon, acknowledged)
        stopped.set()
        thread.join()
    finally:
        daemon.stop(signal.SIGKILL)
    told = f"RIPNERF_SEED={seed} RIPNERF_LOSSES=1: {mode}: {oracle}"
    again = Daemon(*programs, disk.kept, {"RIPNERF_FAKE_STEP_US": "300"})
    try:
        again.start()
        check(again, oracle)
    except AssertionError as error:
        raise AssertionError(f"{told}\n{error}\n{again.log_text()[-3000:]}") from error
    finally:
        again.stop()
        shutil.rmtree(folder)


@pytest.mark.parametrize("number", range(COUNT))
def test_nothing_acknowledged_is_lost_with_the_power(programs, photographs, shim, tmp_path, number):
    simulate(programs, photographs, shim, tmp_path / "disk", SEED + number)


@pytest.mark.parametrize("forgets", ["ripnerf.db", "checkpoints"])
def test_a_forgotten_flush_is_found(programs, photographs, shim, tmp_path, forgets):
    """Of the instrument itself: a program that does not flush its records, or its checkpoints, is
    found out within a few losses."""
    for seed in range(12):
        try:
            simulate(programs, photographs, shim, tmp_path / "disk", seed, forgets)
        except AssertionError as error:
            assert "RIPNERF_LOSSES" in str(error), error  # it is what is missing after the loss
            return
    raise AssertionError(f"12 losses have not shown that {forgets} is never flushed")


def test_the_shadow_has_what_was_flushed_and_no_more(shim, tmp_path):
    """Of the instrument itself: bytes after the last flush, and names in a folder that was not
    flushed, are not there."""
    disk = Disk(shim, tmp_path)
    script = ("import os; os.mkdir('d'); a = os.open('d/a', os.O_CREAT | os.O_RDWR);"
              "os.write(a, b'flushed'); os.fsync(a); os.write(a, b'lost');"
              "f = os.open('d', os.O_RDONLY); os.fsync(f); r = os.open('.', os.O_RDONLY); os.fsync(r);"
              "b = os.open('d/b', os.O_CREAT | os.O_RDWR); os.write(b, b'x'); os.fsync(b)")
    subprocess.run(["/usr/bin/python3", "-c", script], cwd=disk.live, check=True,
                   env={**os.environ, **disk.environment})
    disk.kept.mkdir()
    build_dropped(random.Random(1), "dropped", disk.shadow, index(disk.live), id_of(disk.live),
                  disk.kept)
    assert {path.name: path.read_bytes() for path in disk.kept.rglob("*") if path.is_file()} == \
        {"a": b"flushed"}
