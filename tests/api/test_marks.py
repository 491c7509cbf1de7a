"""Back in time: what is kept of a training, and pictures and scores of it."""

import os
import signal
import re
import time

import pytest

from support.client import Client
from support.photographs import pose

CAMERA = {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
          "width": 8, "height": 8, "fov_y_deg": 40}
# A training of 40 s is 1000 steps, which the pretending engine does in one.
FAST = {"RIPNERF_FAKE_STEP_S": "0.04", "RIPNERF_FAKE_STEP_US": "1000"}
SECONDS = (3.75, 7.5, 15, 30)


def look(daemon, scene="past", **options):
    return daemon.post(f"/v1/scenes/{scene}/render", {"camera": CAMERA, **options})


def marks(daemon, scene="past"):
    return daemon.get(f"/v1/scenes/{scene}").json["marks"]


def train(daemon, seconds, **options):
    return daemon.submit(type="train", dataset="data", scene="past",
                         options={"max_time_s": seconds, **options})


def wait_for_marks(daemon, count):
    daemon.eventually(lambda: len(marks(daemon)) >= count)


@pytest.fixture(name="daemon")
def fixture_daemon(make_daemon, photographs):
    daemon = make_daemon(FAST)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    return daemon


@pytest.fixture(name="trained")
def fixture_trained(daemon):
    assert daemon.wait(train(daemon, 40))["state"] == "succeeded"
    return daemon


def test_marks_stand_at_times_that_double(make_daemon, photographs):
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_STEP_US": "5000"})  # one is written before the next is due
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    assert daemon.wait(train(daemon, 40))["state"] == "succeeded"
    found = marks(daemon)
    assert len(found) == len(SECONDS)
    for mark, seconds in zip(found, SECONDS):
        assert seconds <= mark["train_seconds"] < seconds + 2.5 and mark["size_bytes"] > 0
    assert [mark["step"] for mark in found] == sorted(mark["step"] for mark in found)


def test_a_picture_of_the_past(trained):
    """The nearest mark answers, and says which it is; what is now is one of them."""
    now = trained.get("/v1/scenes/past").json
    pictures = []
    for mark in marks(trained):
        reply = look(trained, at=mark["train_seconds"] * 1.1)
        assert reply.status == 200
        assert int(reply.headers["X-Ripnerf-Step"]) == mark["step"]
        assert abs(float(reply.headers["X-Ripnerf-At"]) - mark["train_seconds"]) < 0.02
        pictures.append(reply.body)
    reply = look(trained, at=now["train_seconds"])
    assert int(reply.headers["X-Ripnerf-Step"]) == now["steps"]
    assert reply.body == look(trained).body and "X-Ripnerf-At" not in look(trained).headers
    # The pretending engine paints its step, of which a byte shows.
    shown = {step % 256 for step in [now["steps"], *(mark["step"] for mark in marks(trained))]}
    assert len({*pictures, reply.body}) == len(shown) > 1


def test_a_time_that_nothing_was_kept_near(trained):
    for at in (0.5, 1000):
        reply = look(trained, at=at)
        assert reply.status == 422 and reply.json["errors"][0]["pointer"] == "#/at", reply.json
        assert " there is " in reply.json["errors"][0]["detail"]
    for at in (0, -3, "15s"):
        assert look(trained, at=at).status == 422
    for budget in ({"within_ms": 50}, {"quality": 40}, {"render_psnr": 30}):
        reply = look(trained, at=15, **budget)
        assert reply.status == 422 and reply.json["errors"][0]["pointer"] == "#/at"


def test_an_evaluation_of_the_past(trained):
    mark = marks(trained)[1]
    job = trained.submit(type="eval", scene="past", options={"at": 7.5})
    result = trained.wait(job)["result"]
    assert result["protocol"]["step"] == mark["step"]
    refused = trained.wait(trained.submit(type="eval", scene="past", options={"at": 0.1}))
    assert refused["state"] == "failed" and " there is " in str(refused["problem"])
    reply = trained.post("/v1/jobs", {"type": "eval", "scene": "past",
                                      "options": {"at": 7.5, "within_ms": 50}})
    assert reply.status == 422 and reply.json["errors"][0]["pointer"] == "#/options/at"


def test_only_the_newest_are_kept(make_daemon, photographs):
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_STEP_S": "2"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    assert daemon.wait(train(daemon, 4000))["state"] == "succeeded"
    found = marks(daemon)
    assert len(found) == 8 and found[-1]["train_seconds"] >= 1920


def test_a_crash_takes_back_what_it_undoes(daemon):
    """Marks of steps that a resumed training has not done yet are none."""
    daemon.hold()
    job = train(daemon, 100, checkpoint_interval_s=0.3)
    wait_for_marks(daemon, 3)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGKILL)
    daemon.let_go_on()
    assert daemon.wait(job)["state"] == "succeeded"
    now = daemon.get("/v1/scenes/past").json
    steps = [mark["step"] for mark in now["marks"]]
    assert steps == sorted(set(steps)) and steps[-1] <= now["steps"]
    reply = look(daemon, at=now["marks"][-1]["train_seconds"])
    assert int(reply.headers["X-Ripnerf-Step"]) == steps[-1]


def test_a_scene_that_trains_is_looked_back_at(daemon):
    daemon.hold()
    job = train(daemon, 300)
    wait_for_marks(daemon, 2)
    first = marks(daemon)[0]
    reply = look(daemon, at=first["train_seconds"])
    assert int(reply.headers["X-Ripnerf-Step"]) == first["step"]
    later = time.monotonic() + 0.2
    while time.monotonic() < later:
        assert look(daemon, at=first["train_seconds"]).body == reply.body
    assert daemon.job(job)["state"] == "running"
    daemon.let_go_on()
    assert daemon.wait(job)["state"] == "succeeded"


def test_the_client_looks_back(trained, build, tmp_path):
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{trained.port}")
    mark = marks(trained)[2]
    shown = client.run("show", "past").stdout
    assert "marks" in shown and f"{mark['train_seconds']:.1f} s, step {mark['step']}" in shown
    told = client.json("render", "past", "--view", "test:0", "--at", "15s", "-o", "a.png")
    assert told["step"] == mark["step"] and abs(told["at"] - mark["train_seconds"]) < 0.02
    words = client.run("render", "past", "--view", "test:0", "--at", "15s", "-o", "a.png").stdout
    (seconds,) = re.findall(r"after ([\d.]+) s of training", words)
    assert abs(float(seconds) - mark["train_seconds"]) < 0.11  # told to a tenth
    assert client.json("eval", "past", "--at", "15s")["protocol"]["step"] == mark["step"]
    refused = client.run("render", "past", "--view", "test:0", "--at", "1s", "-o", "b.png", code=4)
    assert "--at" in refused.stderr and " there is " in refused.stderr
    assert not (tmp_path / "b.png").exists()


def test_marks_count_towards_a_quota(daemon):
    made = daemon.post("/v1/tokens", {"name": "anna", "scope": "train"})
    assert made.status == 201, made.body
    daemon.token = made.json["token"]
    assert daemon.wait(train(daemon, 40))["state"] == "succeeded"
    scene = daemon.get("/v1/scenes/past").json
    sizes = [part["size_bytes"] for part in scene["marks"] + scene["checkpoints"]]
    assert daemon.get("/v1/info").json["you"]["bytes"] == sum(sizes)
