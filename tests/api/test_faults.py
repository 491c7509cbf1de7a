"""The n-th allocation or system call fails, for n = 1, 2, 3 and so on, until a round meets none.

The daemon must go on serving, answer what it documents (or nothing), and keep what it acknowledged.
"""

import errno
import http.client
import re
import resource
import time
from pathlib import Path

import pytest

from support.checked import Daemon
from support.faults import Faults
from support.photographs import pose, write_dataset
from support.waiting import wait_for

PATH = {"axes": "opengl", "width": 8, "height": 8,
        "keys": [{"time": 0, "world_from_camera": pose(0)[:3], "fov_y_deg": 40}]}
FAILURES = [("malloc", 0), ("write", errno.ENOSPC), ("write", errno.EIO), ("short-write", 0),
            ("sync", errno.EIO), ("read", errno.EINTR)]


@pytest.fixture(scope="module")
def faults(build, tmp_path_factory):
    return Faults(build, tmp_path_factory.mktemp("faults") / "plan", "ripnerfd")


@pytest.fixture(scope="module")
def daemon(programs, faults, tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    with Daemon(*programs, folder / "data", faults.environment, keep_alive=0) as running:
        running.wait(running.upload("data", write_dataset(folder / "photographs")))
        running.train("s", max_steps=3)
        yield running


def post(daemon, path, body):
    """The reply, or None when the connection ended without one."""
    try:
        return daemon.post(path, body)
    except (http.client.HTTPException, ConnectionError):
        return None


def is_well(daemon):
    """It serves again as soon as nothing fails any more."""
    wait_for(lambda: daemon.get("/readyz").status == 200)


def rounds(daemon, faults, kind, error, ask, most=400):
    """Calls ask(n) with the n-th call failing; the first call without a failure ends it."""
    for n in range(1, most):
        faults.arm(kind, n, error)
        try:
            ask(n)
        finally:
            hits = faults.disarm()
        assert daemon.process.poll() is None, daemon.log_text()[-3000:]
        assert daemon.get("/healthz").status == 200
        if not hits:
            return n
    return most


@pytest.mark.parametrize("kind, error", FAILURES)
def test_acknowledged_paths_are_kept(daemon, faults, kind, error):
    kept = []

    def ask(n):
        name = f"{kind}-{error}-{n}"
        reply = post(daemon, "/v1/camera-paths", {"name": name, "path": PATH})
        faults.disarm()
        there = daemon.get(f"/v1/camera-paths/{name}").status
        if reply is not None and reply.status == 201:
            kept.append(name)
            assert there == 200, n
        elif reply is not None and kind != "malloc":  # an answer may find no memory after the deed
            assert there == 404, (n, reply.body)
    assert 1 < rounds(daemon, faults, kind, error, ask) < 400
    assert kept
    is_well(daemon)


@pytest.mark.parametrize("kind, error", FAILURES + [("open", errno.EMFILE),
                                                    ("mkdir", errno.ENOSPC),
                                                    ("socket", errno.EMFILE)])
def test_jobs_end_whatever_fails(daemon, faults, kind, error):
    """A submission that was acknowledged is a job, and every job ends."""
    def ask(n):
        reply = post(daemon, "/v1/jobs", {"type": "eval", "scene": "s", "options": {"views": 1}})
        time.sleep(0.02)
        if n == 1:  # which is met for certain
            wait_for(lambda: faults.plan.hits)
        faults.disarm()
        if reply is not None and reply.status == 202:
            record = daemon.wait(reply.json["id"])
            assert record["state"] in ("succeeded", "failed"), record
    assert rounds(daemon, faults, kind, error, ask, 60) > 1
    is_well(daemon)
    job = daemon.submit(type="eval", scene="s", options={"views": 1})
    assert daemon.wait(job)["state"] == "succeeded"


def refuse(faults, ask):
    """Calls ask() with each call on its way failing once, until none is left; how many failed."""
    tried = quiet = 0
    while quiet < 3 and tried < 1000:
        faults.arm_stacks()
        ask()
        hit = faults.disarm()
        tried, quiet = tried + hit, 0 if hit else quiet + 1
    return tried


def test_a_refused_submission_is_no_job(daemon, faults):
    """Whichever call fails on the way to it: none stays queued that nobody runs."""
    assert refuse(faults, lambda: post(daemon, "/v1/jobs", {
        "type": "eval", "scene": "s", "options": {"views": 1}})) > 100
    wait_for(lambda: not daemon.get("/v1/jobs?state=queued").json["items"])
    is_well(daemon)


def test_a_refused_token_is_none(daemon, faults):
    """None stays whose secret nobody was told, and which has the name."""
    def ask():
        reply = post(daemon, "/v1/tokens", {"name": "anna", "scope": "read"})
        faults.disarm()
        names = [token["name"] for token in daemon.get("/v1/tokens").json["items"]]
        assert reply is None or reply.status == 201 or "anna" not in names, faults.last()
        if "anna" in names:
            assert daemon.delete("/v1/tokens/anna").status == 204
    assert refuse(faults, ask) > 30
    is_well(daemon)


def test_no_connection_can_be_accepted(daemon, faults):
    """Out of descriptors for a moment: later ones are served."""
    faults.arm("accept", 1, errno.EMFILE)
    try:
        daemon.get("/healthz")
    except (http.client.HTTPException, OSError):
        pass
    faults.disarm()
    assert daemon.get("/healthz").status == 200


def test_all_is_there_after_a_restart(daemon):
    names = [item["name"] for item in daemon.get("/v1/camera-paths?limit=200").json["items"]]
    assert names
    assert daemon.stop() == 0
    daemon.start()
    assert names == [item["name"]
                     for item in daemon.get("/v1/camera-paths?limit=200").json["items"]]
    assert daemon.train("after", max_steps=3)[0]["state"] == "succeeded"


# ---- the runner -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runner_faults(build, tmp_path_factory):
    return Faults(build, tmp_path_factory.mktemp("faults") / "plan", "ripnerf-runner")


@pytest.fixture(scope="module")
def real(build, runner_faults, tmp_path_factory):
    """A daemon with the real engine, whose runner's calls fail."""
    folder = tmp_path_factory.mktemp("real")
    with Daemon(build / "server" / "ripnerfd", build / "server" / "ripnerf-runner",
                folder / "data", runner_faults.environment) as running:
        running.wait(running.upload("data", write_dataset(folder / "photographs")))
        yield running


TRAIN = {"preset": "draft", "max_steps": 20, "seed": 3, "threads": 1}


@pytest.mark.parametrize("kind, error", [("write", errno.ENOSPC), ("short-write", 0),
                                         ("sync", errno.EIO), ("rename", errno.EIO),
                                         ("open", errno.EMFILE), ("malloc", 0)])
def test_training_survives_a_checkpoint_that_fails(real, runner_faults, kind, error):
    """A checkpoint in between that cannot be written is done without: training goes on."""
    job = real.submit(type="train", dataset="data", scene=f"{kind}-{error}",
                      options={**TRAIN, "max_steps": 100000, "checkpoint_interval_s": 0.2})

    def step():
        return (real.job(job)["progress"] or {}).get("step") or 0

    def is_over():
        return real.job(job)["state"] not in ("queued", "running", "interrupted")

    wait_for(step)
    runner_faults.arm(kind, 2, error)
    wait_for(lambda: runner_faults.plan.hits or is_over())
    assert runner_faults.disarm() > 0
    before = step()
    wait_for(lambda: step() > before + 3 or is_over())
    if not is_over():
        assert real.post(f"/v1/jobs/{job}/finish").status == 200
    record = real.wait(job)
    if kind != "malloc":  # which may be one that a step cannot do without
        assert record["state"] == "succeeded" and record["result"]["steps"] > before, record
    assert real.get("/healthz").status == 200


def test_a_full_disk_ends_a_training_with_its_reason(real, runner_faults):
    runner_faults.arm("write", 1, errno.ENOSPC, for_good=True)
    job = real.submit(type="train", dataset="data", scene="full", options=TRAIN)
    record = real.wait(job)
    runner_faults.disarm()
    assert record["state"] == "failed" and record["problem"]["type"] == "/problems/no-space", record
    assert real.get("/v1/scenes/full").json["state"] == "failed"
    assert real.train("healed", **TRAIN)[0]["state"] == "succeeded"


def only_whole_checkpoints(folder):
    return all(re.fullmatch(r"step-\d{9}.safetensors", path.name) for path in (folder / "checkpoints").iterdir())


def test_a_checkpoint_of_which_only_a_part_has_room(real):
    """The training goes on without it and fails at its end, with the reason; the scene is what its last whole
    checkpoint is, and nothing of those that were cut off is left."""
    job = real.submit(type="train", dataset="data", scene="cut-off",
                      options={**TRAIN, "max_steps": 100000, "checkpoint_interval_s": 0.2})
    scene = real.get("/v1/scenes/cut-off").json["id"]
    folder = Path(real.data) / "scenes" / scene
    wait_for(lambda: (real.get("/v1/scenes/cut-off").json["steps"] or 0) > 0)
    size = max(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    runner, = (pid for pid in real.runners() if any(folder in file.resolve().parents
                                                    for file in Path(f"/proc/{pid}/fd").iterdir()))
    resource.prlimit(runner, resource.RLIMIT_FSIZE, (size // 2, size // 2))
    assert real.post(f"/v1/jobs/{job}/finish").status == 200
    record = real.wait(job)
    assert record["state"] == "failed" and record["problem"]["type"] == "/problems/no-space", record
    assert "File too large" in record["problem"]["detail"]
    left = real.get("/v1/scenes/cut-off").json
    assert left["state"] == "ready" and left["steps"] > 0
    assert f"step-{left['steps']:09d}.safetensors" in [path.name for path in folder.rglob("step-*")]
    assert only_whole_checkpoints(folder)
    assert real.post("/v1/scenes/cut-off/render", {"view": "test:0"}).status == 200


@pytest.mark.parametrize("n", [1, 2])
def test_a_checkpoint_that_cannot_be_put_in_place_leaves_nothing(real, runner_faults, n):
    runner_faults.arm("rename", n, errno.ENOSPC, for_good=True)
    record = real.wait(real.submit(type="train", dataset="data", scene=f"no-name-{n}", options=TRAIN))
    runner_faults.disarm()
    assert record["state"] == "failed" and record["problem"]["type"] == "/problems/no-space", record
    assert only_whole_checkpoints(Path(real.data) / "scenes" / record["scene"])


def test_a_frame_that_cannot_be_written_fails_the_path(real, runner_faults):
    real.train("for-frames", **TRAIN)
    path = {**PATH, "fps": 10, "keys": [{**PATH["keys"][0], "time": t} for t in (0, 1)]}
    real.wait(real.submit(type="path", scene="for-frames", camera_path=path))
    runner_faults.arm("write", 3, errno.ENOSPC, for_good=True)
    record = real.wait(real.submit(type="path", scene="for-frames", camera_path=path))
    runner_faults.disarm()
    assert record["state"] == "failed" and record["problem"]["type"] == "/problems/no-space", record
    again = real.wait(real.submit(type="path", scene="for-frames", camera_path=path))
    assert again["state"] == "succeeded" and again["result"]["frames"] == 11


def test_a_disk_that_fills_while_a_film_is_written(real, runner_faults, build):
    """The reason is told, frames that were made stay, no part of a film is left, and with room the
    same path becomes a film."""
    if not (build / "server/film/ripnerf-film.so").is_file():
        pytest.skip("built without FFmpeg's libraries")
    real.train("for-a-film", **TRAIN)
    path = {**PATH, "width": 64, "height": 48, "fps": 2,
            "keys": [{**PATH["keys"][0], "time": t} for t in (0, 1)]}

    def render():
        return real.wait(real.submit(type="path", scene="for-a-film", camera_path=path,
                                     options={"film": "h264"}))
    whole = 0
    for n in (3, 5, 6, 8):  # a frame; the film's first part, those that follow
        runner_faults.arm("write", n, errno.ENOSPC, for_good=True)
        record = render()
        runner_faults.disarm()
        assert record["state"] == "failed", record
        assert record["problem"]["type"] == "/problems/no-space", record
        frames = real.get(f"/v1/jobs/{record['id']}/frames").json["items"]
        assert all(real.get(f"/v1/jobs/{record['id']}/frames/{frame['index']}").status == 200
                   for frame in frames)
        whole += len(frames) == 3 and "the frames are kept" in record["problem"]["detail"]
        assert real.get(f"/v1/jobs/{record['id']}/film").status == 404
        assert not list(Path(real.data).rglob(f"{record['id']}/*film*"))
    assert whole >= 2
    record = render()
    assert record["state"] == "succeeded" and record["result"]["frames"] == 3
    assert real.get(f"/v1/jobs/{record['id']}/film").status == 200
