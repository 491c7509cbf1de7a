"""A device through client, daemon and runner: the emulated one of tests/ops, and none."""

import json
import os
import re
import time
import urllib.error
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


def submit(daemon, scene="small", **options):
    body = {"type": "train", "dataset": "ball", "scene": scene, "options": options}
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


# ---- memory ---------------------------------------------------------------------------------

def gpu_bytes(daemon):
    """(what runners hold of the GPU, how many were ended for it)"""
    with urllib.request.urlopen(daemon.url + "/metrics") as reply:
        text = reply.read().decode()
    return tuple(int(float(re.search(rf"^ripnerf_{name} (\S+)$", text, re.MULTILINE).group(1)))
                 for name in ("gpu_memory_bytes", "runners_evicted_total"))


def picture(daemon, scene):
    """(the scene's picture, seconds until it came)"""
    begin = time.monotonic()
    request = urllib.request.Request(f"{daemon.url}/v1/scenes/{scene}/render",
                                     b'{"view": "test:0"}', {"Content-Type": "application/json"})
    while True:
        try:
            with urllib.request.urlopen(request) as reply:
                return reply.read(), time.monotonic() - begin
        except urllib.error.HTTPError as error:  # its old runner is ending
            assert error.code == 503 and time.monotonic() - begin < 30, error.read()
            time.sleep(0.02)


def loaded(client):
    return {scene["name"] for scene in client.json("scenes")["items"] if scene["loaded"]}


def restart(daemon, *options):
    daemon.stop()
    daemon.options = [str(option) for option in options]
    daemon.start()


@pytest.fixture
def three(start, emulated):
    """Client and daemon with scenes a, b and c, trained on the CPU; what each holds of a GPU."""
    client, daemon = start(emulated)
    for seed, scene in enumerate("abc"):
        job = submit(daemon, scene, preset="draft", planes=3, base=16, channels=4, max_steps=4,
                     seed=seed, device="cpu")
        client.run("watch", job)
    assert gpu_bytes(daemon) == (0, 0)
    restart(daemon)
    each = []
    for scene in "abc":
        before = gpu_bytes(daemon)[0]
        picture(daemon, scene)
        each.append(gpu_bytes(daemon)[0] - before)
    assert each[0] > 1 << 20 and each[1:] == each[:-1]
    return client, daemon, each[0]


@pytest.mark.parametrize("by_option", [True, False])
def test_scenes_share_a_gpu(three, monkeypatch, by_option):
    """Room for two of three scenes: the one used longest ago goes, and comes back the same."""
    client, daemon, each = three
    pictures = {scene: picture(daemon, scene)[0] for scene in "abc"}
    assert len(set(pictures.values())) == 3
    capacity = each * 5 // 2
    if not by_option:  # what is free
        monkeypatch.setenv("RIPNERF_EMULATOR_MEMORY", str(capacity))
    restart(daemon, *(["--gpu-memory", capacity] if by_option else []))
    reloads = []
    for turn, scene, there in ((0, "a", "a"), (0, "b", "ab"), (1, "c", "bc"), (1, "b", "bc"),
                               (2, "a", "ab"), (3, "c", "ac"), (3, "c", "ac"), (4, "b", "bc")):
        same, seconds = picture(daemon, scene)
        assert same == pictures[scene]
        assert gpu_bytes(daemon) == (each * len(there), turn)
        assert loaded(client) == set(there)
        if turn > 1:
            reloads.append(seconds)
    print(f"{each >> 20} MiB a scene, reloaded in {min(reloads):.2f} to {max(reloads):.2f} s")
    assert min(reloads) < 1


def test_a_training_gets_the_room_of_idle_scenes(three):
    """What fits nowhere says what would; what does not fit beside idle scenes ends them."""
    client, daemon, each = three
    options = {"preset": "draft", "planes": 3, "base": 16, "channels": 4, "max_steps": 2,
               "device": "cuda:0"}
    restart(daemon, "--gpu-memory", "64M")
    failed = client.run("watch", submit(daemon, "large", **options), code=FAILED)
    needed = re.search(r"needs (\d+) MiB .* of which 64 MiB may be used: "
                       r"(a base of \d+ texels|not even the smallest base) would fit",
                       failed.stderr)
    assert needed, failed.stderr
    assert gpu_bytes(daemon) == (0, 0)
    restart(daemon, "--gpu-memory", f"{needed.group(1)}M")
    for scene in "ab":
        picture(daemon, scene)
    assert gpu_bytes(daemon) == (2 * each, 0)
    client.run("watch", submit(daemon, "fits", **options))
    assert gpu_bytes(daemon)[1] == 2 and loaded(client) == {"fits"}
    picture(daemon, "a")  # there is room again: a scene at rest holds no optimiser
    assert loaded(client) == {"fits", "a"}
