"""A device through client, daemon and runner: the emulated one of tests/ops, and none."""

import json
import os
import urllib.request

import pytest

from support.client import FAILED, OK, Client
from support.daemon import Daemon


@pytest.fixture
def start(build, tmp_path, monkeypatch):
    """start(MODULE): client and daemon, with a dataset `ball`, whose runners load that module."""
    opened = []

    def open_with(module, **environment):
        monkeypatch.setenv("RIPNERF_CUDA_MODULE", str(module))
        for name, value in environment.items():
            monkeypatch.setenv(name, str(value))
        daemon = Daemon(build, tmp_path / "data")
        daemon.__enter__()
        opened.append(daemon)
        client = Client(build / "client" / "ripnerf", tmp_path, daemon.url)
        client.run("synth", "sphere", "source", "--size", 16, "--views", 8)
        client.run("import", "source", "--name", "ball")
        return client, daemon
    yield open_with
    for daemon in opened:
        daemon.__exit__()


@pytest.fixture
def emulated(build):
    module = build / "tests" / "ops" / "ripnerf-cuda-emulated.so"
    if not module.is_file():
        pytest.skip("the emulator was not built: it needs a C++ compiler")
    return module


def submit(daemon, **options):
    body = {"type": "train", "dataset": "ball", "scene": "small", "options": options}
    request = urllib.request.Request(daemon.url + "/v1/jobs", json.dumps(body).encode(),
                                     {"Content-Type": "application/json"})
    with urllib.request.urlopen(request) as reply:
        return json.load(reply)["id"]


def test_what_is_not_there_is_said(start):
    client, daemon = start("/nowhere/ripnerf-cuda.so")
    assert client.json("info")["device"] == "cpu"
    failed = client.run("train", "ball", "--name", "none", "--preset", "draft", "--device",
                        "cuda:0", "--wait", code=FAILED)
    for part in "/options/device", "/nowhere/ripnerf-cuda.so", "not installed", "--device cpu":
        assert part in failed.stderr, failed.stderr
    job = submit(daemon, preset="draft", planes=3, base=16, max_steps=2, device="auto")
    assert client.run("watch", job, code=OK)
    assert client.json("show", "small")["config"]["shading"] == "ray"


def test_a_lost_device_ends_the_runner_alone(start, emulated, tmp_path):
    """The third step is lost; the job goes on from its checkpoint in another runner."""
    loses = tmp_path / "loses"
    loses.touch()
    client, daemon = start(emulated, RIPNERF_EMULATOR_LOSES=loses)
    assert client.json("info")["device"] == "cuda:0"
    job = submit(daemon, preset="draft", planes=3, base=16, channels=4, max_steps=4,
                 checkpoint_interval_s=0, device="auto")
    client.run("watch", job)
    ended = client.json("show", job)
    assert not os.path.exists(loses)
    assert ended["state"] == "succeeded" and ended["attempt"] == 2, ended
    assert ended["result"]["steps"] == 4
    logs = [log.read_text() for log in (tmp_path / "data").rglob("log")]
    assert sum(log.count("the device is lost: cuda: ") for log in logs) == 1, logs
    scene = client.json("show", "small")
    assert scene["kernels"].startswith("sm_") and scene["steps"] == 4
    client.run("render", "small", "--view", "test:0", "-o", "picture.png")
