"""A device through client, daemon and runner: the emulated one of tests/ops, and none."""

import json
import os
import re
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from support.client import FAILED, OK, Client
from support.daemon import Daemon
from support.waiting import wait_for


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
    for part in "ripnerf: --device: ", "/nowhere/ripnerf-cuda.so", "not installed", "--device cpu":
        assert part in failed.stderr, failed.stderr
    job = submit(daemon, preset="draft", planes=3, base=16, max_steps=2, device="auto")
    assert client.run("watch", job, code=OK)
    assert client.json("show", "small")["config"]["shading"] == "ray"


def test_a_lost_device_ends_the_runner_alone(start, emulated, tmp_path):
    """The third step is lost; the job goes on from its checkpoint in another runner."""
    loses = tmp_path / "loses"
    loses.touch()
    # The emulator takes the file away, which lies where a runner may not write.
    client, daemon = start(emulated, RIPNERF_EMULATOR_LOSES=loses, RIPNERFD_SANDBOX=0)
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
    for about in (("info",), ("show", "small")):
        said = client.run(*about).stdout
        for part in ("cost, surfaces and a crop of a picture", "aperture, open shutter and parallel rays", "so coarse"):
            assert part in said, said
    client.run("render", "small", "--view", "test:0", "-o", "picture.png")


def test_frames_and_scores_are_those_of_one_at_a_time(start, emulated, tmp_path):
    """What a device renders is encoded, or compared, on the processor's threads while the next ones are rendered."""
    client, daemon = start(emulated)
    client.run("watch", submit(daemon, preset="draft", planes=3, base=16, channels=4, max_steps=2, device="auto"))
    client.run("turntable", "small", "-o", "turn.json")
    client.run("path", "small", "turn.json", "--size", "16x16", "--frames", "0-5", "-o", "all")
    told = [re.findall(r"in one call of the device, first (\d+)", path.read_text())
            for path in (tmp_path / "data").rglob("log")]
    assert ["6"] in told, told
    for frame in (0, 2, 5):
        client.run("path", "small", "turn.json", "--size", "16x16", "--frames", f"{frame}-{frame}", "-o", f"only-{frame}")
        name = f"{frame:05}.png"
        assert (tmp_path / "all" / name).read_bytes() == (tmp_path / f"only-{frame}" / name).read_bytes()
    assert len({path.read_bytes() for path in (tmp_path / "all").glob("*.png")}) > 3
    views = [client.json("eval", "small", "--split", "train", "--views", count)["per_view"] for count in (1, 4)]
    for view in (view for views in views for view in views):
        view.pop("render_ms")
    assert len(views[1]) == 4 and views[0] == views[1][:1]
    assert len({view["psnr"] for view in views[1]}) == 4
    log = "".join(path.read_text() for path in (tmp_path / "data").rglob("log"))
    assert "frames are encoded while the next ones are rendered" in log, log
    assert "views are compared while the next ones are rendered" in log, log


def test_doctor_examines_the_device(build, emulated, tmp_path):
    alone = Client(build / "client" / "ripnerf", tmp_path, "http://127.0.0.1:1")
    report = json.loads(alone.run("doctor", "--json", RIPNERF_CUDA_MODULE=str(emulated)).stdout)
    cases = {case["name"]: case for case in report["cases"] if case["kernels"] == "cuda"}
    assert set(cases) == {"pixels beside the CPU's", "the loss along its gradient"}
    for case in cases.values():
        assert case["passed"] and case["where"] == "emulated" and 0 < case["worst"] < case["bound"]


# ---- memory ---------------------------------------------------------------------------------

def gpu_bytes(daemon):
    """(what runners hold of the GPU, how often a scene made room there)"""
    with urllib.request.urlopen(daemon.url + "/metrics") as reply:
        text = reply.read().decode()
    return tuple(int(float(re.search(rf"^ripnerf_{name} (\S+)$", text, re.MULTILINE).group(1)))
                 for name in ("gpu_memory_bytes", "scenes_rested_total"))


def cpu_seconds(daemon):
    """Of its runners, which no other load of the machine adds to."""
    spent = 0
    for pid in daemon.runners():
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        spent += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return spent


def picture(daemon, scene):
    """(the scene's picture, the runners' processor seconds for it)"""
    begin = cpu_seconds(daemon)
    request = urllib.request.Request(f"{daemon.url}/v1/scenes/{scene}/render",
                                     b'{"view": "test:0"}', {"Content-Type": "application/json"})

    def there():
        try:
            with urllib.request.urlopen(request) as reply:
                return reply.read()
        except urllib.error.HTTPError as error:
            assert error.code == 503, error.read()  # a busy machine takes longer than anybody waits
            return None
    return wait_for(there), cpu_seconds(daemon) - begin


def rested(client, daemon):
    """Names of the scenes that made room, in order."""
    names = {client.json("show", name)["id"]: name for name in "abc"}
    return "".join(names[scene] for scene in re.findall(
        r"makes room on cuda:0: \d+ MiB of scene (\S+)", daemon.log.read_text()))


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
    for scene, there, gone in (("a", 1, ""), ("b", 2, ""), ("c", 2, "a"), ("b", 2, "a"),
                               ("a", 2, "ac"), ("c", 2, "acb"), ("c", 2, "acb"),
                               ("b", 2, "acba")):
        same, seconds = picture(daemon, scene)
        assert same == pictures[scene]
        assert gpu_bytes(daemon) == (each * there, len(gone))
        assert rested(client, daemon) == gone
        reloads.append(seconds)
    there, back = [reloads[i] for i in (3, 6)], [reloads[i] for i in (4, 5, 7)]
    print(f"{each >> 20} MiB a scene; a picture takes {min(there):.2f} s, "
          f"{min(back):.2f} to {max(back):.2f} s where the scene has to come back")
    assert min(back) - min(there) < 5
    client.run("eval", "a")
    assert rested(client, daemon) == "acbac" and gpu_bytes(daemon)[0] == 2 * each


def test_a_training_gets_the_room_of_idle_scenes(three):
    """What fits nowhere says what would; what does not fit beside idle scenes makes them rest."""
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
    assert rested(client, daemon) == "ab" and gpu_bytes(daemon)[0] == each
    picture(daemon, "a")  # there is room again: a scene at rest holds no optimiser
    assert gpu_bytes(daemon) == (2 * each, 2)
