"""The runner from outside, over its protocol, with the engine that only pretends."""

import io
import json
import os
import signal
import socket
import struct
import tarfile
import time
from pathlib import Path

import jsonschema
import pytest
import yaml
from PIL import Image

from support.photographs import pose, write_dataset
from support.waiting import PATIENCE_S, wait_for
from support.wire import JOB, Runner, Scene, checkpoints, ingest, train

OTHER = "job_bbbbbbbbbbbb"
PROMPT_S = 60  # of what goes on for minutes where it is not cut short
PROTO = Path(__file__).resolve().parents[2] / "proto"
CAMERA = {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
          "width": 24, "height": 20, "fov_y_deg": 40}
PATH = {"axes": "opengl", "fps": 4, "interpolation": "linear", "loop": False, "width": 12, "height": 10,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40}
                 for t in (0, 1, 2)]}


@pytest.fixture(scope="session")
def program(build):
    path = build / "tests" / "support" / "ripnerf-runner-fake"
    assert path.is_file(), f"{path} was not built"
    return path


@pytest.fixture(scope="session")
def check():
    """check(schema, value): the value is what openapi.yaml says."""
    components = yaml.safe_load((PROTO / "openapi.yaml").read_text())["components"]

    def validate(name, value):
        schema = {"$ref": f"#/components/schemas/{name}", "components": components}
        jsonschema.Draft202012Validator(schema).validate(value)
    return validate


@pytest.fixture(scope="session")
def dataset(program, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    last, target, _ = ingest(program, folder, write_dataset(folder / "source"),
                             options={"scales": 2})
    assert last[0] == "done", last
    return target


@pytest.fixture
def scene(program, dataset, tmp_path):
    with Scene(program, tmp_path / "scene", dataset) as runner:
        assert runner.receive()[0] == "opened"
        yield runner


# ---- probe and process ----------------------------------------------------------------------


def test_probe_describes_the_device(program):
    with Runner(program, "probe") as runner:
        assert runner.receive()[1]["protocol"] == 8
        name, info, _ = runner.receive()
        assert name == "info" and info["device"] == "cpu" and info["threads"] >= 1
        assert runner.receive() is None


def test_bad_arguments_are_a_usage_error(program):
    import subprocess
    for arguments in ([], ["--mode", "field"], ["--mode", "field", "--fd", "0x"],
                      ["--mode", "nonsense", "--fd", "1"]):
        assert subprocess.run([program, *arguments], capture_output=True, check=False,
                              stdin=subprocess.DEVNULL).returncode == 2


@pytest.mark.parametrize("mode", ["field", "ingest"])
def test_runner_ends_when_the_socket_closes(program, mode):
    with Runner(program, mode) as runner:
        runner.receive()
        runner.socket.shutdown(2)
        runner.process.wait(PATIENCE_S)


@pytest.mark.parametrize("magic, number, body", [
    (0x12345678, 1, b"{}"), (0x31574E52, 1, b"not json"), (0x31574E52, 200, b"{}"),
    (0x31574E52, 1, b'{"scene_folder":"/x","dataset_folder":"/y","load":true,"more":1}')])
def test_garbage_ends_the_runner(program, magic, number, body):
    with Runner(program, "field") as runner:
        runner.receive()
        runner.send_raw(number, body, magic)
        assert runner.receive() is None


def test_a_daemon_of_another_version_is_refused(program, dataset, tmp_path):
    """Before anything of its scene is touched, and with both versions."""
    with Runner(program, "field") as runner:
        own = runner.receive()[1]
        runner.send("open", scene_folder=str(tmp_path / "scene"), dataset_folder=str(dataset),
                    load=False, version="9.8.7", protocol=99)
        text = runner.wait_for("failed")[1]["text"]
        assert "9.8.7 (protocol 99)" in text and f"{own['version']} (protocol {own['protocol']})" in text
        assert not (tmp_path / "scene").exists()


def test_help_makes_its_part_of_a_path(program, dataset, tmp_path, scene):
    """A runner that helps takes no lock, makes the frames that it is told, and neither film nor list;
    of a scene that is at another step it makes none."""
    train(scene)
    scene.wait_for("done")
    frames = tmp_path / "scene" / "frames" / JOB
    order = {"job": JOB, "folder": str(frames), "camera_path": PATH, "options": {}}
    with Runner(program, "field") as helper:
        helper.send("open", scene_folder=str(tmp_path / "scene"), dataset_folder=str(dataset),
                    load=True, helps=True)
        assert helper.wait_for("opened")[1]["loaded"]
        helper.send("path", **order, begin=1, end=2)
        assert "shows another step" in helper.wait_for("failed")[1]["text"]
        scene.send("path", **order)
        scene.wait_for("done")
        whole = {file.name: file.read_bytes() for file in frames.glob("*.png")}
        for name in ("00001.png", "00002.png", "SHA256SUMS"):
            (frames / name).unlink()
        helper.send("path", **order, begin=1, end=2)
        assert [helper.wait_for("frame")[1]["index"] for _ in range(2)] == [1, 2]
        helper.wait_for("done")
        assert {file.name: file.read_bytes() for file in frames.glob("*.png")} == whole
        assert not (frames / "SHA256SUMS").exists() and not list(frames.glob(".part*"))
        helper.send("path", **order, begin=1, end=99)
        assert "are not among" in helper.wait_for("failed")[1]["text"]


def test_help_makes_its_part_of_an_evaluation(program, dataset, tmp_path, scene):
    """Scores that are kept are taken as they are: the result is that of one runner."""
    train(scene)
    scene.wait_for("done")
    scores = tmp_path / "scene" / "frames" / JOB
    order = {"job": JOB, "options": {"split": "train"}}

    def comparable(result):
        for part in (result, *result["per_view"], *result["scales"]):
            for name in ("render_ms", "render_ms_median"):
                part.pop(name, None)
        return result
    scene.send("eval", **order)
    alone = comparable(scene.wait_for("done")[1]["result"])
    assert not scores.exists()
    views = len(alone["per_view"])
    with Runner(program, "field") as helper:
        helper.send("open", scene_folder=str(tmp_path / "scene"), dataset_folder=str(dataset),
                    load=True, helps=True)
        assert helper.wait_for("opened")[1]["loaded"]
        helper.send("eval", **order, folder=str(scores), begin=views - 2, end=views - 1)
        assert "shows another step" in helper.wait_for("failed")[1]["text"]
        (scores / ".step").write_text(f"{alone['protocol']['step']}\n")
        helper.send("eval", **order, folder=str(scores), begin=views - 2, end=views - 1)
        assert [helper.wait_for("frame")[1]["index"] for _ in range(2)] == [views - 2, views - 1]
        helper.wait_for("done")
        helper.send("eval", **order, folder=str(scores), begin=1, end=views)
        assert "are not among" in helper.wait_for("failed")[1]["text"]
    last = scores / f"{views - 1:05}.json"
    last.write_text(last.read_text().replace('"ssim":0.9', '"ssim":0.7'))  # so that it shows
    scene.seen.clear()
    scene.send("eval", **order, folder=str(scores))
    together = comparable(scene.wait_for("done")[1]["result"])
    made = [message["index"] for name, message, _ in scene.seen if name == "frame"]
    assert made == list(range(views - 2))
    assert together["per_view"][-1].pop("ssim") < alone["per_view"][-1].pop("ssim")
    assert together["per_view"] == alone["per_view"]


def test_curve_mixes_no_machines(program, dataset, tmp_path, scene, capfd):
    """What a runner that was killed had measured is gone on with on the same machine and with the
    same kernels, and with no others."""
    train(scene)
    scene.wait_for("done")
    scene.send("shutdown")
    while scene.receive() is not None:
        pass

    def measure_on(machine, kernels, said=""):
        environment = {"SLURMD_NODENAME": machine, "RIPNERF_FAKE_KERNELS": kernels,
                       "RIPNERF_FAKE_HOLD": str(tmp_path), "RIPNERF_FAKE_HELD_PICTURES": "20"}
        with Scene(program, tmp_path / "scene", dataset, True, environment) as runner:
            runner.wait_for("opened")
            runner.send("curve", job=JOB, options={})
            wait_for((tmp_path / "scene" / "curve.part").exists)
            told = ""
            while said not in (told := told + capfd.readouterr().err):
                runner.receive()
    measure_on("n1", "narrow")
    measure_on("n1", "narrow", "on n1, narrow, it goes on from there")
    measure_on("n2", "narrow", "on n2, narrow, it begins anew")
    measure_on("n2", "wide", "on n2, wide, it begins anew")


def test_scene_is_locked(program, dataset, tmp_path, scene):
    with Scene(program, tmp_path / "scene", dataset) as second:
        second.send("shutdown")
        name, failed, _ = second.receive()
        assert name == "failed" and failed["status"] == "busy"


# ---- training -------------------------------------------------------------------------------


def test_training_runs_to_its_last_step(scene, tmp_path, check):
    train(scene, max_steps=300, evaluate_interval_s=1000)
    name, done, _ = scene.wait_for("done", "failed")
    assert name == "done", done
    check("TrainResult", done["result"])
    assert done["result"]["steps"] == 300 and done["result"]["finished_by"] == "steps"
    messages = [m for m in scene.seen if m[1].get("job") == JOB]
    states = [m[1] for m in messages if m[0] == "state"]
    assert states[0]["state"] == "running" and states[0]["scene"]["held_out"]
    for _, content, _ in (m for m in messages if m[0] == "progress"):
        check("TrainProgress", content["progress"])
    metrics = [m[1]["metric"] for m in messages if m[0] == "metric"]
    assert [metric["step"] for metric in metrics] == [300]  # it is over before a first round is due
    last = [m[1] for m in messages if m[0] == "checkpoint"][-1]
    assert last["parameters_sha256"] == done["result"]["parameters_sha256"]
    assert checkpoints(tmp_path / "scene") == ["step-000000300.safetensors"]
    record = json.loads((PROTO / "examples" / "Scene.json").read_text())
    record.update({key: last["scene"][key] for key in last["scene"]})
    check("Scene", record)


@pytest.mark.parametrize("step_s, first", [(0.005, 2), (0.01, 2.56), (0.1, 10)])
def test_figures_come_within_seconds_and_then_ever_fewer(program, dataset, tmp_path, step_s, first):
    """The first after 2 s, but once 256 steps have cleared the fog, for which 10 s are waited at most."""
    with Scene(program, tmp_path / "scene", dataset, environment={"RIPNERF_FAKE_STEP_S": str(step_s)}) as scene:
        train(scene, max_steps=100000, max_time_s=3.5 * first)
        scene.wait_for("done")
    at = [m[1]["metric"]["train_seconds"] for m in scene.seen if m[0] == "metric"]
    assert first - 1e-6 <= at[0] < first + max(0.5, 12 * step_s) and 4 <= len(at) <= 5
    assert all(1.5 <= later / sooner < 2 for sooner, later in zip(at[:-2], at[1:-1]))


def test_bytes_do_not_depend_on_pauses_checkpoints_or_a_crash(program, dataset, tmp_path):
    digests = []

    def result(runner):
        digests.append(runner.wait_for("done")[1]["result"]["parameters_sha256"])

    hold = tmp_path / "hold"
    held = {"RIPNERF_FAKE_HOLD": str(hold), "RIPNERF_FAKE_HELD_AT": "100"}
    options = {"max_steps": 150, "seed": 5, "evaluate_interval_s": 1000}
    with Scene(program, tmp_path / "plain", dataset) as runner:
        train(runner, **options)
        result(runner)
    hold.touch()
    with Scene(program, tmp_path / "paused", dataset, environment=held) as runner:
        train(runner, checkpoint_interval_s=0, **options)
        runner.wait_for("checkpoint")
        runner.send("pause", job=JOB)
        while runner.wait_for("state")[1]["state"] != "paused":
            pass
        runner.send("resume", job=JOB)
        hold.unlink()
        result(runner)
    hold.touch()
    with Scene(program, tmp_path / "killed", dataset, environment=held) as runner:
        train(runner, checkpoint_interval_s=0, **options)
        for _ in range(3):
            runner.wait_for("checkpoint")
        os.kill(runner.process.pid, signal.SIGKILL)
    with Scene(program, tmp_path / "killed", dataset) as runner:
        train(runner, **options)
        first = runner.wait_for("progress")[1]["progress"]
        assert 0 < first["step"] <= 100
        result(runner)
    assert len(set(digests)) == 1, digests


def test_pause_stops_the_clock_and_is_reported(scene):
    train(scene, max_steps=100000)
    scene.wait_for("state")
    begin = time.monotonic()
    scene.send("pause", job=JOB)
    assert scene.wait_for("state")[1]["state"] == "paused"
    assert scene.wait_for("checkpoint")
    before = [m[1]["progress"] for m in scene.seen if m[0] == "progress"][-1]
    time.sleep(2)
    scene.send("resume", job=JOB)
    after = scene.wait_for("progress")[1]["progress"]
    assert after["paused_seconds"] >= 2
    assert after["train_seconds"] - before["train_seconds"] < time.monotonic() - begin - 2
    assert after["step"] > before["step"]


def test_finish_keeps_the_scene(scene):
    train(scene, max_steps=100000)
    scene.wait_for("state")
    scene.send("finish", job=JOB)
    name, done, _ = scene.wait_for("done", "failed")
    assert name == "done" and done["result"]["finished_by"] == "finish"
    assert done["result"]["psnr"] is not None
    scene.send("render", request=1, render={"view": "test:0", "format": "png"})
    assert scene.wait_for("rendered")[1]["step"] == done["result"]["steps"]


def test_cancel_is_prompt_and_keeps_a_checkpoint(scene, tmp_path):
    train(scene, max_steps=100000)
    scene.wait_for("state")
    scene.send("cancel", job=JOB)
    assert scene.wait_for("failed", timeout=PROMPT_S)[1]["status"] == "cancelled"
    assert len(checkpoints(tmp_path / "scene")) == 1


def test_old_checkpoints_are_pruned(scene, tmp_path):
    train(scene, max_steps=100, checkpoint_interval_s=0)
    scene.wait_for("done")
    assert len([m for m in scene.seen if m[0] == "checkpoint"]) > 3
    assert len(checkpoints(tmp_path / "scene")) == 2


def test_damaged_checkpoint_gives_way_to_the_one_before(program, dataset, tmp_path):
    folder = tmp_path / "scene"
    with Scene(program, folder, dataset) as runner:
        train(runner, checkpoint_interval_s=0)
        runner.wait_for("done")
    older, newest = checkpoints(folder)
    damaged = folder / "checkpoints" / newest
    damaged.write_bytes(damaged.read_bytes()[:100])
    for rest in (".left.1-1.tmp", ".fresh.tmp", ".fresh.tmp.partial"):  # of a runner that was killed while it saved
        (folder / "checkpoints" / rest).write_bytes(b"x")
    with Scene(program, folder, dataset, load=True) as runner:
        opened = runner.wait_for("opened")[1]
        assert opened["loaded"] and f"step-{opened['steps']:09d}.safetensors" == older
    assert checkpoints(folder) == [older, newest + ".damaged"]


def test_divergence_fails_the_job_and_not_the_runner(program, dataset, tmp_path):
    with Scene(program, tmp_path / "scene", dataset,
               environment={"RIPNERF_FAKE_DIVERGE_AT": "20"}) as runner:
        train(runner)
        failed = runner.wait_for("failed")[1]
        assert failed["job"] == JOB and failed["status"] == "numeric"
        runner.send("render", request=1, render={"view": "test:0", "format": "png"})
        assert runner.wait_for("failed")[1]["status"] == "conflict"


def test_options_are_checked_by_the_engine(scene):
    train(scene, planes=5)
    failed = scene.wait_for("failed")[1]
    assert failed["status"] == "invalid" and failed["where"] == "#/options/planes"
    train(scene, kernels="avx9")
    assert scene.wait_for("failed")[1]["status"] == "unsupported"
    train(scene, job=OTHER)
    assert scene.wait_for("done")[1]["job"] == OTHER


def test_second_training_is_refused(scene):
    train(scene, max_steps=100000)
    train(scene, job=OTHER)
    failed = scene.wait_for("failed")[1]
    assert failed["job"] == OTHER and failed["status"] == "conflict"


def test_what_a_cluster_ends_saves_and_says_so(scene, tmp_path):
    """SIGTERM, as before a time limit, closes the runner's end for reading: the daemon hears of what
    was saved, or it would count the attempt as one that came to nothing."""
    train(scene, max_steps=100000, checkpoint_interval_s=3600)
    scene.wait_for("state")
    scene.socket.shutdown(socket.SHUT_WR)
    scene.wait_for("checkpoint")
    assert len(checkpoints(tmp_path / "scene")) == 1


def test_shutdown_saves(scene, tmp_path):
    train(scene, max_steps=100000)
    scene.wait_for("state")
    scene.send("shutdown")
    scene.wait_for("checkpoint")
    while scene.receive():
        pass
    assert len(checkpoints(tmp_path / "scene")) == 1


# ---- renders --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(program, dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "scene"
    with Scene(program, folder, dataset) as runner:
        train(runner)
        runner.wait_for("done")
    with Scene(program, folder, dataset, load=True) as runner:
        assert runner.wait_for("opened")[1]["steps"] == 60
        yield runner


def render(runner, number=1, **request):
    runner.send("render", request=number, render=request)
    return runner.wait_for("rendered", "failed")


@pytest.mark.parametrize("request_, size, mode", [
    ({"camera": CAMERA, "format": "png"}, (24, 20), "RGBA"),
    ({"camera": CAMERA, "format": "png", "size": {"width": 7, "height": 5}}, (7, 5), "RGBA"),
    ({"camera": CAMERA, "format": "jpeg"}, (24, 20), "RGB"),
    ({"camera": CAMERA, "output": "depth", "format": "png"}, (24, 20), "I;16"),
    ({"camera": CAMERA, "output": "alpha", "format": "png"}, (24, 20), None),
    ({"camera": CAMERA, "output": "normal", "format": "png"}, (24, 20), "RGBA"),
    ({"camera": CAMERA, "output": "footprint", "format": "jpeg"}, (24, 20), "RGB"),
    ({"view": "test:1", "format": "png"}, (16, 16), "RGBA"),
    ({"view": "train:r_2", "scale": 1, "format": "png"}, (8, 8), "RGBA")])
def test_render(trained, request_, size, mode):
    name, content, blob = render(trained, 7, **request_)
    assert name == "rendered", content
    assert content["request"] == 7 and content["step"] == 60 and not content["training"]
    assert (content["width"], content["height"]) == size
    image = Image.open(io.BytesIO(blob))
    assert image.size == size
    assert image.format == ("JPEG" if request_["format"] == "jpeg" else "PNG")
    if mode == "I;16":
        assert image.mode.startswith("I")


@pytest.mark.parametrize("request_, status, where", [
    ({"view": "test:99"}, "not-found", "#/view"),
    ({"view": "test:r_99"}, "not-found", "#/view"),
    ({"view": "test:0", "scale": 9}, "not-found", "#/view")])
def test_wrong_render_is_refused(trained, request_, status, where):
    name, content, _ = render(trained, 3, format="png", **request_)
    assert (name, content["request"], content["status"]) == ("failed", 3, status)
    assert content["where"].startswith(where)


def test_renders_are_served_while_training(scene):
    train(scene, max_steps=100000)
    scene.wait_for("state")
    scene.send_all(*(("render", {"request": number, "render": {"camera": CAMERA, "format": "png"}})
                     for number in range(20)))
    steps = []
    for _ in range(20):
        name, content, _ = scene.wait_for("rendered", "failed")
        assert name == "rendered" and content["training"]
        steps.append(content["step"])
    waited = [later - sooner for sooner, later in zip(steps, steps[1:])]
    assert min(waited) >= 0 < max(waited) <= 10  # of a millisecond each: a slice
    scene.send("pause", job=JOB)
    scene.wait_for("checkpoint")
    assert [m[1]["progress"] for m in scene.seen if m[0] == "progress"] or \
        scene.wait_for("progress")


def test_time_given_to_renders_is_reported(program, dataset, tmp_path):
    with Scene(program, tmp_path / "scene", dataset,
               environment={"RIPNERF_FAKE_ROW_US": "5000"}) as runner:
        train(runner, max_steps=100000)
        runner.wait_for("state")
        render(runner, camera=CAMERA, format="png")
        runner.send("pause", job=JOB)
        while runner.wait_for("progress")[1]["progress"]["yielded_seconds"] < 0.1:
            pass


def test_render_can_be_cancelled_before_and_during(program, dataset, tmp_path):
    with Scene(program, tmp_path / "scene", dataset,
               environment={"RIPNERF_FAKE_ROW_US": "500000"}) as runner:
        train(runner, max_steps=1)
        runner.wait_for("done")
        for number in (1, 2):
            runner.send("render", request=number, render={
                "camera": {**CAMERA, "height": 500}, "format": "png"})
        time.sleep(0.3)
        runner.send("cancel", request=2)
        runner.send("cancel", request=1)
        for number in (1, 2):
            failed = runner.wait_for("failed", timeout=PROMPT_S)[1]
            assert (failed["request"], failed["status"]) == (number, "cancelled")


# ---- paths and evaluations ------------------------------------------------------------------


def test_path_renders_numbered_frames(trained, tmp_path, check):
    folder = tmp_path / "frames"
    trained.send("path", job=JOB, folder=str(folder), camera_path=PATH,
                 options={"first": 2, "last": 6, "output": "depth"})
    name, done, _ = trained.wait_for("done", "failed", job=JOB)
    assert name == "done", done
    check("PathResult", done["result"])
    assert done["result"] | {"render_ms_median": 0} == \
        {"frames": 5, "width": 12, "height": 10, "step": 60, "render_ms_median": 0}
    assert sorted(p.name for p in folder.glob("*.png")) == [f"{i:05d}.png" for i in range(2, 7)]
    png = (folder / "00002.png").read_bytes()
    width, height, depth, colour = struct.unpack(">IIBB", png[16:26])
    assert (width, height, depth, colour) == (12, 10, 16, 0)
    progress = [m[1]["progress"] for m in trained.seen
                if m[0] == "progress" and m[1]["job"] == JOB]
    check("WorkProgress", progress[-1])
    assert progress[-1]["done"] == progress[-1]["total"] == 5


def test_path_keeps_frames_that_are_there(trained, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "00001.png").write_bytes(b"kept")
    (folder / ".step").write_text("60\n")
    trained.send("path", job=OTHER, folder=str(folder), camera_path=PATH,
                 options={"last": 2, "width": 6, "height": 5})
    assert trained.wait_for("done", job=OTHER)[1]["result"]["width"] == 6
    assert (folder / "00001.png").read_bytes() == b"kept"
    assert Image.open(folder / "00002.png").size == (6, 5)
    frames = [m[1]["index"] for m in trained.seen if m[0] == "frame" and m[1]["job"] == OTHER]
    assert frames == [0, 2]


def test_wrong_path_fails(trained, tmp_path):
    trained.send("path", job="job_cccccccccccc", folder=str(tmp_path / "f"), camera_path=PATH,
                 options={"last": 9})
    failed = trained.wait_for("failed", job="job_cccccccccccc")[1]
    assert failed["status"] == "invalid" and failed["where"] == "#/options/last"


# The daemon has refused these by the same table: a message with one is none of its messages.
@pytest.mark.parametrize("name, content", [
    ("render", {"request": 1, "render": {"format": "png", "camera": {**CAMERA, "width": 0}}}),
    ("path", {"job": JOB, "folder": "/f", "options": {}, "camera_path": {**PATH, "keys": []}})])
def test_wrong_cameras_end_the_runner(program, dataset, tmp_path, name, content):
    with Scene(program, tmp_path / "scene", dataset) as runner:
        runner.wait_for("opened")
        runner.send(name, **content)
        assert runner.receive() is None


def test_path_is_cancelled_between_rows_and_goes_on_later(program, dataset, tmp_path):
    hold = tmp_path / "hold"
    hold.touch()
    with Scene(program, tmp_path / "scene", dataset,
               environment={"RIPNERF_FAKE_HOLD": str(hold), "RIPNERF_FAKE_HELD_PICTURES": "2"}) as runner:
        train(runner, max_steps=1)
        runner.wait_for("done")
        frames = tmp_path / "frames"
        order = {"job": JOB, "folder": str(frames), "camera_path": PATH, "options": {"last": 4}}
        runner.send("path", **order)
        runner.wait_for("frame")
        runner.send("cancel", job=JOB)
        assert runner.wait_for("failed")[1]["status"] == "cancelled"
        kept = len(list(frames.glob("*.png")))
        assert 1 <= kept < 5
        hold.unlink()
        runner.send("path", **{**order, "job": OTHER})
        assert runner.wait_for("done")[1]["result"]["frames"] == 5
        made = [m for m in runner.seen if m[0] == "frame" and m[1]["job"] == OTHER]
        assert len(made) == 5 - kept


@pytest.mark.parametrize("options, views, scales", [
    ({}, 4, [0, 1]), ({"split": "val", "views": 3}, 3, [0, 1]), ({"scale": 1}, 4, [1]),
    ({"split": "train", "views": 100}, 6, [0, 1])])
def test_evaluation(trained, check, options, views, scales):
    trained.send("eval", job=JOB, options=options)
    name, done, _ = trained.wait_for("done", "failed", job=JOB)
    assert name == "done", done
    result = done["result"]
    check("EvalResult", result)
    assert result["views"] == views and len(result["per_view"]) == views * len(scales)
    assert [entry["scale"] for entry in result["scales"]] == scales
    for entry in result["scales"]:
        figures = [v["psnr"] for v in result["per_view"] if v["scale"] == entry["scale"]]
        assert entry["psnr"] == pytest.approx(sum(figures) / len(figures))
    assert result["psnr"] == pytest.approx(
        sum(entry["psnr"] for entry in result["scales"]) / len(scales))
    assert result["protocol"]["split"] == options.get("split", "test")
    assert result["protocol"]["step"] == 60


def test_evaluated_views_are_evenly_spaced(trained):
    trained.send("eval", job=JOB, options={"split": "val", "views": 4, "scale": 0})
    views = trained.wait_for("done", job=JOB)[1]["result"]["per_view"]
    assert [view["index"] for view in views] == [0, 2, 4, 6]


def test_evaluation_of_views_that_are_not_there_fails(trained):
    trained.send("eval", job=JOB, options={"scale": 7})
    failed = trained.wait_for("failed", job=JOB)[1]
    assert failed["status"] == "invalid" and failed["where"] == "#/options/scale"


# ---- import ---------------------------------------------------------------------------------


def make_tar(path, folder, name=".", extra=()):
    with tarfile.open(path, "w") as tar:
        tar.add(folder, name)
        for entry, data in extra:
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return path


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("photographs") / "toy")


@pytest.mark.parametrize("top", [".", "toy"])
def test_tar_is_imported(program, photographs, tmp_path, check, top):
    hidden = tarfile.TarInfo(".DS_Store")
    archive = make_tar(tmp_path / "d.tar", photographs, top, [(hidden, b"x")])
    last, target, seen = ingest(program, tmp_path, archive, options={"max_size": 8})
    assert last[0] == "done", last
    record = {"id": "ds_aaaaaaaaaaaa", "name": "d", "created_at": "2026-03-01T09:30:00.000Z",
              "state": "ready", **last[1]["result"]}
    check("Dataset", record)
    assert record["views"] == {"train": 6, "val": 8, "test": 4}
    assert (record["width"], record["height"]) == (8, 8)
    assert (target / "dataset.json").is_file()
    assert any(m[0] == "progress" for m in seen)


def entry_of(name, kind=tarfile.REGTYPE, link=""):
    entry = tarfile.TarInfo(name)
    entry.type, entry.linkname = kind, link
    return entry


@pytest.mark.parametrize("entry", [
    entry_of("../up"), entry_of("/abs"), entry_of("a/../../b"),
    entry_of("link", tarfile.SYMTYPE, "/etc/passwd"),
    entry_of("hard", tarfile.LNKTYPE, "transforms_train.json"),
    entry_of("dev", tarfile.CHRTYPE), entry_of("pipe", tarfile.FIFOTYPE),
    entry_of("train/r_0.png")], ids=lambda entry: entry.name)
def test_hostile_entry_is_refused_by_name(program, photographs, tmp_path, entry):
    archive = make_tar(tmp_path / "d.tar", photographs, extra=[(entry, b"")])
    last, target, _ = ingest(program, tmp_path, archive)
    assert last[0] == "failed" and last[1]["status"] == "invalid"
    assert last[1]["where"] == entry.name
    assert not target.exists() and not (tmp_path / "up").exists()


@pytest.mark.parametrize("limits", [(1000, 1000), (1 << 30, 5)])
def test_limits_hold(program, photographs, tmp_path, limits):
    last, target, _ = ingest(program, tmp_path, make_tar(tmp_path / "d.tar", photographs),
                             limits=limits)
    assert last[0] == "failed" and last[1]["status"] == "limit" and last[1]["where"]
    assert not target.exists()


@pytest.mark.parametrize("content", [b"", b"\0" * 1024, b"garbage" * 200],
                         ids=["nothing", "zeros", "garbage"])
def test_what_is_no_tar_is_refused(program, tmp_path, content):
    (tmp_path / "d.tar").write_bytes(content)
    last, _, _ = ingest(program, tmp_path, tmp_path / "d.tar")
    assert last[0] == "failed" and last[1]["status"] == "invalid"


def test_cut_tar_is_refused(program, photographs, tmp_path):
    archive = make_tar(tmp_path / "d.tar", photographs)
    archive.write_bytes(archive.read_bytes()[:5000])
    last, target, _ = ingest(program, tmp_path, archive)
    assert last[0] == "failed" and last[1]["status"] == "invalid"
    assert not target.exists()


def test_broken_image_is_reported_with_its_place(program, tmp_path):
    source = write_dataset(tmp_path / "source")
    broken = source / "test" / "r_1.png"
    broken.write_bytes(broken.read_bytes()[:40])
    last, _, _ = ingest(program, tmp_path, source)
    assert last[0] == "done", last
    report = last[1]["result"]["report"]
    assert report["errors"] == 1
    assert report["problems"][0]["where"] == "transforms_test.json#/frames/1/file_path"


def test_folder_without_a_dataset_fails(program, tmp_path):
    (tmp_path / "empty").mkdir()
    last, target, _ = ingest(program, tmp_path, tmp_path / "empty")
    assert last[0] == "failed" and last[1]["status"] == "not-found"
    assert not target.exists()


def test_existing_target_is_left_alone(program, photographs, tmp_path):
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "mine").write_text("x")
    last, target, _ = ingest(program, tmp_path, photographs)
    assert last[0] == "failed" and last[1]["status"] == "conflict"
    assert (target / "mine").exists()
