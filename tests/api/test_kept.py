"""What was stored stays, whatever becomes of the records or of single bytes, and says when it is
not what it was."""

import http.client
import os
import signal
import sqlite3
import struct
import subprocess
import json
from pathlib import Path

import pytest

from support.checked import Daemon
from support.photographs import pose, write_dataset
from support.waiting import PATIENCE_S, wait_for
from support.wire import Scene, checkpoints, ingest, train

LISTS = ("datasets", "scenes", "jobs", "camera-paths")
PATH = {"axes": "opengl", "fps": 20, "interpolation": "linear", "loop": False, "width": 8,
        "height": 8,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1)]}


@pytest.fixture
def filled(programs, photographs, tmp_path):
    """A daemon that was killed, and what it showed: two datasets, three scenes, jobs, a path."""
    daemon = Daemon(*programs, tmp_path / "d").start()
    for name in ("data", "more"):
        assert daemon.wait(daemon.upload(name, photographs))["state"] == "succeeded"
    for name in ("a", "b", "c"):
        daemon.train(name)
    assert daemon.post("/v1/camera-paths", {"name": "orbit", "path": PATH}).status == 201
    job = daemon.submit(type="path", scene="a", camera_path=PATH)
    assert daemon.wait(job)["state"] == "succeeded"
    assert daemon.delete("/v1/scenes/c").status == 204
    shown = listing(daemon)
    daemon.stop(signal.SIGKILL)
    yield daemon, shown
    daemon.stop()


def listing(daemon):
    def stable(item):
        for checkpoint in item.get("checkpoints", []):
            checkpoint.pop("created_at")  # a file's own time is a little earlier
        return {key: value for key, value in item.items() if key not in ("loaded", "memory_bytes")}
    return {kind: [stable(item) for item in daemon.get(f"/v1/{kind}").json["items"]]
            for kind in LISTS}


def contents(daemon):
    return {str(path) for path in Path(daemon.data).rglob("*")
            if path.is_file() and not path.name.startswith("ripnerf.db")}


def database(daemon):
    return Path(daemon.data) / "ripnerf.db"


def lose(daemon):
    for path in Path(daemon.data).glob("ripnerf.db*"):
        path.unlink()


def refused(daemon):
    result = subprocess.run([daemon.program, "--data", daemon.data, "--runner", daemon.runner,
                             "--listen", "127.0.0.1:0"], capture_output=True, text=True,
                            timeout=PATIENCE_S, check=False)
    assert result.returncode == 1 and result.stdout == ""
    return result.stderr


def rebuild(daemon):
    daemon.flags = ["--rebuild"]
    daemon.start()
    daemon.flags = []


@pytest.mark.parametrize("how", ["missing", "empty"])
def test_lost_database(filled, how):
    """The start is refused, nothing is touched, and --rebuild brings all of it back."""
    daemon, shown = filled
    before = contents(daemon)
    lose(daemon)
    if how == "empty":
        database(daemon).touch()
    assert "--rebuild" in refused(daemon)
    assert "--rebuild" in refused(daemon)  # still: the first start made no records
    assert contents(daemon) == before
    rebuild(daemon)
    assert listing(daemon) == shown
    assert daemon.post("/v1/scenes/a/render", {"view": "test:0"}).status == 200
    daemon.stop()
    daemon.start()
    assert listing(daemon) == shown


def test_partly_recovered_database(filled):
    """Content whose records were lost is left where it is, counted, and found again."""
    daemon, shown = filled
    before = contents(daemon)
    with sqlite3.connect(database(daemon)) as db:
        db.execute("DROP TRIGGER scenes_removed")
        db.execute("DROP TRIGGER datasets_removed")
        db.execute("DELETE FROM scenes WHERE name = 'b'")
        db.execute("DELETE FROM datasets WHERE name = 'more'")
        db.execute("DELETE FROM jobs WHERE type = 'path'")
    db.close()
    daemon.start()
    assert [scene["name"] for scene in daemon.get("/v1/scenes").json["items"]] == ["a"]
    assert "content have no record" in daemon.log_text()
    assert contents(daemon) == before
    daemon.stop()
    rebuild(daemon)
    assert listing(daemon) == shown


def test_half_zeroed_database(filled):
    daemon, shown = filled
    daemon.start()
    daemon.stop()  # all of the log is in the database now
    size = database(daemon).stat().st_size
    with open(database(daemon), "r+b") as file:
        file.seek(size // 2 // 4096 * 4096)
        file.write(bytes(size - file.tell()))
    assert "damaged" in refused(daemon)
    rebuild(daemon)
    assert listing(daemon) == shown
    assert list(Path(daemon.data).glob("ripnerf.db.damaged-*"))


def test_etag_is_the_same_after_a_restart(filled):
    daemon, _ = filled
    daemon.start()
    tags = set()
    for _ in range(2):
        for _ in range(2):
            reply = daemon.post("/v1/scenes/a/render", {"view": "test:0"})
            tags.add(reply.headers["ETag"])
        daemon.stop()
        daemon.start()
    assert len(tags) == 1 and None not in tags


# ---- the real engine's checkpoints ------------------------------------------------------------


@pytest.fixture(scope="module")
def program(build):
    return build / "server" / "ripnerf-runner"


@pytest.fixture(scope="module")
def trained(program, tmp_path_factory):
    """(dataset, scene) with two checkpoints."""
    folder = tmp_path_factory.mktemp("real")
    last, dataset, _ = ingest(program, folder, write_dataset(folder / "source"))
    assert last[0] == "done", last
    with Scene(program, folder / "scene", dataset) as runner:
        train(runner, preset="draft", max_steps=8, seed=3, threads=1, checkpoint_interval_s=0)
        assert runner.wait_for("done", "failed")[0] == "done"
    assert len(checkpoints(folder / "scene")) == 2
    return dataset, folder / "scene"


def tensors(path):
    """Where the tensors lie in a safetensors file: {name: (begin, end)}."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8:8 + size])
    header.pop("__metadata__")
    return {name: [8 + size + at for at in entry["data_offsets"]]
            for name, entry in header.items()}


def opened(program, trained):
    with Scene(program, trained[1], trained[0], load=True) as runner:
        return runner.wait_for("opened")[1]


@pytest.mark.parametrize("part", ["planes", "occupancy", "hull", "adam.v", "header"])
def test_a_flipped_bit_in_a_checkpoint(program, trained, part):
    """Found wherever it is; the checkpoint before takes its place, and that is said."""
    folder = trained[1] / "checkpoints"
    older, newest = checkpoints(trained[1])
    kept = (folder / newest).read_bytes()
    begin, end = tensors(folder / newest).get(part, (100, 101))
    assert opened(program, trained)["steps"] == 8
    try:
        with open(folder / newest, "r+b") as file:
            file.seek((begin + end) // 2)
            byte = file.read(1)[0]
            file.seek(-1, os.SEEK_CUR)
            file.write(bytes([byte ^ 4]))
        message = opened(program, trained)
        assert message["steps"] == int(older[5:14]) < 8
        assert newest in message["set_aside"]
        assert (folder / (newest + ".damaged")).exists()
    finally:
        (folder / (newest + ".damaged")).unlink(missing_ok=True)
        (folder / newest).write_bytes(kept)
    assert opened(program, trained)["steps"] == 8


def test_etags_follow_the_checkpoint_that_is_rendered(programs, program, photographs, tmp_path):
    """No picture of an older checkpoint under the newer one's tag."""
    daemon = Daemon(programs[0], program, tmp_path / "d").start()
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        daemon.train("s", preset="draft", max_steps=8, threads=1, checkpoint_interval_s=0)
        request = {"view": "test:0"}
        first = daemon.post("/v1/scenes/s/render", request)
        scene = daemon.get("/v1/scenes/s").json
        daemon.stop()
        newest = max(Path(daemon.data).glob("scenes/*/checkpoints/step-*"))
        begin, end = tensors(newest)["occupancy"]
        with open(newest, "r+b") as file:
            file.seek(begin)
            file.write(bytes(end - begin))
        daemon.start()
        second = daemon.post("/v1/scenes/s/render", request)
        assert second.status == 200 and second.headers["ETag"] != first.headers["ETag"]
        third = daemon.post("/v1/scenes/s/render", request)
        assert third.headers["ETag"] not in (first.headers["ETag"], None)
        assert third.body == second.body
        after = daemon.get("/v1/scenes/s").json
        assert after["steps"] < scene["steps"] and len(after["checkpoints"]) == 1
        assert b"ripnerf_checkpoints_damaged_total 1" in daemon.get("/metrics").body
        assert "a checkpoint is damaged" in daemon.log_text()
    finally:
        daemon.stop()


def test_a_resumed_job_tells_of_a_damaged_checkpoint(programs, program, photographs, tmp_path):
    """Training goes on from the checkpoint before; the job's progress and result say so."""
    daemon = Daemon(programs[0], program, tmp_path / "d").start()
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        job = daemon.submit(type="train", dataset="data", scene="s", options={
            "preset": "draft", "max_steps": 100000, "threads": 1, "checkpoint_interval_s": 0})
        wait_for(lambda: len(list(Path(daemon.data).glob("scenes/*/checkpoints/step-*"))) >= 2)
        runners = daemon.runners()
        daemon.stop(signal.SIGKILL)
        wait_for(lambda: all(map(has_ended, runners)))  # they save before they leave
        newest = max(Path(daemon.data).glob("scenes/*/checkpoints/step-*"))
        flip(newest, newest.stat().st_size // 2)
        daemon.start()
        daemon.wait(job, ["running"])
        daemon.eventually(lambda: "fell_back" in (daemon.job(job)["progress"] or {}))
        assert daemon.post(f"/v1/jobs/{job}/finish").status == 200
        record = daemon.wait(job)
        assert record["state"] == "succeeded" and newest.name in record["result"]["fell_back"]
        assert b"ripnerf_checkpoints_damaged_total 1" in daemon.get("/metrics").body
    finally:
        daemon.stop()


def test_what_is_served_is_what_was_stored(programs, program, photographs, tmp_path):
    """Photographs, frames and checkpoints with a flipped bit are not handed out as if all was well."""
    daemon = Daemon(programs[0], program, tmp_path / "d").start()
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        daemon.train("s", preset="draft", max_steps=2, threads=1)
        job = daemon.submit(type="path", scene="s", camera_path=PATH)
        assert daemon.wait(job)["state"] == "succeeded"
        urls = ["/v1/datasets/data/images/train/0", f"/v1/jobs/{job}/frames/3",
                "/v1/scenes/s/checkpoint"]
        whole = [daemon.get(url) for url in urls]
        assert [reply.status for reply in whole] == [200] * 3
        root = Path(daemon.data)
        files = [next(root.glob("datasets/*/train/*0*.png"), None) or
                 next(root.glob("datasets/*/**/*.png")), root / f"jobs/{job}/frames/00003.png",
                 next(root.glob("scenes/*/checkpoints/step-*"))]
        assert [path.read_bytes() for path in files[1:]] == [reply.body for reply in whole[1:]]
        for path in root.glob("datasets/*/**/*.png"):
            flip(path, 60)
        flip(files[1], -20)
        flip(files[2], -20)
        for url in urls[:2]:
            reply = daemon.get(url)
            assert reply.status == 500 and reply.json["type"] == "/problems/corrupt", reply.body
        with pytest.raises((http.client.HTTPException, ConnectionError)):
            daemon.get(urls[2])
    finally:
        daemon.stop()


def flip(path, at=-1):
    data = bytearray(path.read_bytes())
    data[at] ^= 4
    path.write_bytes(data)


def test_a_flipped_bit_in_a_dataset(make_daemon, photographs):
    """Training does not begin on photographs that are not what was imported, and names the file."""
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    (picture, *_) = sorted(Path(daemon.data).glob("datasets/*/**/*.png"))
    flip(picture, 60)
    job = daemon.wait(daemon.submit(type="train", dataset="data", scene="s",
                                    options={"max_steps": 5}))
    assert job["state"] == "failed" and job["problem"]["type"] == "/problems/corrupt"
    assert picture.name in job["problem"]["detail"]
    assert "import the dataset again" in job["problem"]["detail"]


def scrub(daemon):
    result = subprocess.run([daemon.program, "--data", daemon.data, "--scrub"],
                            capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    return result.returncode, result.stdout, result.stderr


def test_scrub(programs, program, photographs, tmp_path):
    """By hand and in idle time: every kind of stored file is read and found when it is damaged."""
    daemon = Daemon(programs[0], program, tmp_path / "d", scrub_interval=1).start()
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        daemon.train("s", preset="draft", max_steps=8, threads=1)
        assert daemon.post("/v1/camera-paths", {"name": "orbit", "path": PATH}).status == 201
        assert daemon.wait(daemon.submit(type="path", scene="s", camera_path=PATH))["result"]
        code, said, _ = scrub(daemon)
        assert code == 0 and said.endswith(" 0 damaged\n") and int(said.split()[0]) >= 7, said
        victims = [next(Path(daemon.data).glob(pattern)) for pattern in
                   ("datasets/*/**/*.png", "scenes/*/checkpoints/step-*.safetensors",
                    "jobs/*/frames/*.png", "jobs/*/record.json", "camera-paths/*/record.json")]
        for victim in victims:
            flip(victim, -20)
        code, said, why = scrub(daemon)
        assert code == 1 and said.endswith(f" {len(victims)} damaged\n")
        for victim in victims:
            assert str(victim) in why
        daemon.eventually(lambda: daemon.metric("scrub_damaged_total") > 0)
        assert "scrub: " in daemon.log_text()
    finally:
        daemon.stop()


# ---- runners of a daemon that is gone ---------------------------------------------------------


def has_ended(pid):
    """Whether a process is gone, or is dead and nobody has asked how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def test_stopped_runner_of_a_killed_daemon(programs, photographs, tmp_path):
    """It is woken by its daemon's death, saves and leaves: before there is a next daemon, which could
    end it."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        daemon.hold()
        job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 1500})
        daemon.eventually(lambda: (daemon.job(job)["progress"] or {"step": 0})["step"] > 0)
        (runner,) = daemon.eventually(lambda: len(found := daemon.runners()) == 1 and found)
        os.kill(runner, signal.SIGSTOP)
        daemon.stop(signal.SIGKILL)
        wait_for(lambda: has_ended(runner),
                 said=lambda: "the runner is still there, and nobody left to wake it")
        assert list((tmp_path / "d").glob("scenes/*/checkpoints/step-*"))
        daemon.let_go_on()
        daemon.start()
        assert daemon.wait(job)["state"] == "succeeded"
    finally:
        daemon.stop()
        if not has_ended(runner):
            os.kill(runner, signal.SIGKILL)


def test_runner_that_hangs_without_its_daemon(programs, photographs, tmp_path):
    """One that cannot leave is killed by the next runner of its scene, which holds it then."""
    wrapped = tmp_path / "wrapped"
    wrapped.write_text(f'#!/bin/sh\n"{programs[1]}" "$@"\nexit $?\n')  # another parent
    wrapped.chmod(0o755)
    _, dataset, _ = ingest(programs[1], tmp_path, photographs)
    with Scene(programs[1], tmp_path / "scene", dataset) as hanging:
        train(hanging, max_steps=100000)
        hanging.wait_for("progress")
        os.kill(hanging.process.pid, signal.SIGSTOP)
        with Scene(wrapped, tmp_path / "scene", dataset) as runner:
            assert runner.wait_for("opened", "failed")[0] == "opened"
        assert hanging.process.wait(PATIENCE_S) == -signal.SIGKILL
