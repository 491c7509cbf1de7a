"""The whole path with the real parts: client, daemon, runner, engine, on a tiny scene."""

import io
import json
import math
import os
import re
import shutil
import signal
import threading
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from PIL import Image, ImageChops, ImageStat

from support import contract
from support.client import CANCELLED, FAILED, INVALID, NOT_FOUND, OK, USAGE, Client
from support.daemon import Daemon
from support.waiting import PATIENCE_S

STEPS = 40


@pytest.fixture(scope="module")
def gate(tmp_path_factory):
    """While this file is there no runner of a scene begins."""
    return tmp_path_factory.mktemp("gate") / "closed"


@pytest.fixture(scope="module")
def daemon(build, gate, tmp_path_factory):
    runner = gate.with_name("ripnerf-runner")
    runner.write_text(f"#!/bin/sh\nwhile [ \"$2\" = field ] && [ -e '{gate}' ]; do sleep 0.05; done\n"
                      f"exec '{build}/server/ripnerf-runner' \"$@\"\n")
    runner.chmod(0o755)
    with Daemon(build, tmp_path_factory.mktemp("data") / "daemon", "--runner", runner) as running:
        yield running


@pytest.fixture(scope="module")
def client(build, daemon, tmp_path_factory):
    return Client(build / "client" / "ripnerf", tmp_path_factory.mktemp("client"), daemon.url)


@pytest.fixture(scope="module")
def dataset(client):
    client.run("synth", "sphere", "source", "--size", 32, "--views", 12)
    return client.json("import", "source", "--name", "sphere", "--scales", 2)


@pytest.fixture(scope="module")
def trained(client, dataset):
    """The end of `train --wait --json` and the scene it made."""
    result = client.run("train", "sphere", "--name", "ball", "--preset", "draft", "--max-steps",
                        STEPS, "--seed", 5, "--threads", 1, "--wait", "--json")
    return json.loads(result.stdout.splitlines()[-1]), client.json("show", "ball")


def train(client, name, *options):
    return client.json("train", "sphere", "--name", name, "--preset", "draft", *options)["id"]


def is_training(client, job):
    record = client.json("show", job)
    assert record["state"] in ("queued", "running"), record
    return bool(record["progress"] and record["progress"]["step"])


def test_the_dataset_is_what_was_sent(client, dataset):
    contract.check("Dataset", dataset)
    assert dataset["views"] == {"train": 12, "val": 8, "test": 8}
    assert dataset["scales"] == 2 and (dataset["width"], dataset["height"]) == (32, 32)
    assert dataset["report"]["errors"] == 0
    assert client.json("show", "sphere") == dataset
    assert client.json("datasets")["items"] == [dataset]


def test_training_ends_with_its_figures(client, trained):
    end, scene = trained
    contract.check("Scene", scene)
    contract.check("Job", client.json("show", end["job"]))
    assert end["state"] == "succeeded" and end["steps"] == scene["steps"] == STEPS
    assert end["scene"] == scene["id"] and end["samples"] > 0 and end["train_seconds"] > 0
    assert end["parameters_sha256"] == scene["parameters_sha256"]
    assert end["psnr"] == scene["psnr"] > 8
    assert scene["state"] == "ready" and [effect["name"] for effect in scene["effects"]] == [
        "background", "scale-pyramid", "anisotropy", "view-dependence", "split-pixels", "cones",
        "distortion", "masks", "exposure", "appearance", "forward-facing", "unbounded", "straight-alpha",
        "pose-refinement", "robust-loss", "downscaling"]
    assert all(effect["reason"] for effect in scene["effects"])


def test_a_path_is_the_same_while_others_look(client, daemon, trained, tmp_path):
    """Pictures of other cameras, far ones too, between a frame's tiles."""
    def camera(distance):
        return {"world_from_camera": [[1, 0, 0, 0], [0, 0, 1, -distance], [0, -1, 0, 0]],
                "axes": "opencv", "width": 48, "height": 48, "fov_y_deg": 45}

    keys = [{"time": t, "world_from_camera": camera(4 - t)["world_from_camera"], "fov_y_deg": 40}
            for t in (0, 1)]
    path = {"axes": "opencv", "fps": 4, "width": 256, "height": 256, "keys": keys}
    (tmp_path / "p.json").write_text(json.dumps({"path": path}))
    client.run("path", "ball", tmp_path / "p.json", "-o", tmp_path / "alone")
    statuses = []

    def look(number):
        body = {"camera": camera(4 if number % 2 else 400 + number), "supersample": 1,
                **({"crop": [-9, -9, 0, 9, 9, 9 + number]} if number % 3 == 0 else {})}
        request = Request(f"{daemon.url}/v1/scenes/ball/render", json.dumps(body).encode(),
                          {"Content-Type": "application/json"})
        with urlopen(request, timeout=PATIENCE_S) as reply:
            statuses.append(reply.status)
    looks = [threading.Thread(target=look, args=(number,)) for number in range(12)]
    runners = daemon.runners()
    for pid in runners:
        os.kill(pid, signal.SIGSTOP)  # until all are asked for
    try:
        job = client.start("path", "ball", tmp_path / "p.json", "-o", tmp_path / "watched")
        daemon.wait_until(lambda: any(item["type"] == "path" and item["state"] == "running"
                                      for item in client.json("jobs")["items"]))
        for thread in looks:
            thread.start()
        daemon.wait_until(lambda: daemon.metric("renders_waiting") > 3)
    finally:
        for pid in runners:
            os.kill(pid, signal.SIGCONT)
    for thread in looks:
        thread.join()
    _, err = job.communicate(timeout=PATIENCE_S)
    assert job.returncode == OK, err
    assert statuses == [200] * len(looks)
    for i in range(5):
        name = f"{i:05}.png"
        assert (tmp_path / "watched" / name).read_bytes() == (tmp_path / "alone" / name).read_bytes()


def import_measured(client, daemon, name, synth, measured):
    """A sphere's photographs as if their import had measured of each what `measured` says of its frame."""
    client.run("synth", "sphere", name, *synth)
    client.run("import", name, "--name", f"plain-{name}")
    folder = daemon.folder / "datasets" / client.json("show", f"plain-{name}")["id"]
    document = json.loads((folder / "dataset.json").read_text())
    document["name"] = name
    for frame in document["frames"]:
        frame.update(measured(frame))
    shutil.copytree(folder, client.cwd / f"measured-{name}")
    (client.cwd / f"measured-{name}" / "dataset.json").write_text(json.dumps(document))
    client.run("import", f"measured-{name}", "--name", name)


def test_a_view_in_its_photograph_s_own_exposure(client, daemon):
    """Where photographs were made even, and asked for; else it is the same picture."""
    import_measured(client, daemon, "uneven", ("--size", 24, "--views", 6),
                    lambda frame: {"gain": [0.5, 1, 1.25] if frame["index"] % 2 else [1, 1, 1]})
    for name, choice in (("even", "on"), ("uncorrected", "off")):
        client.run("train", "uneven", "--name", name, "--preset", "draft", "--max-steps", STEPS,
                   "--threads", 1, "--effect", f"exposure={choice}", "--wait")

    def picture(scene, colours, view=1):
        client.run("render", scene, "--view", f"train:{view}", "--colours", colours, "-o", "p.png")
        return Image.open(client.cwd / "p.png").convert("RGB")

    even, taken = picture("even", "even"), picture("even", "as-taken")
    pixels = list(zip(even.getdata(), taken.getdata()))
    background = even.getpixel((0, 0))
    inside = [(a, b) for a, b in pixels if a != background]
    assert inside and all(b == background for a, b in pixels if a == background)
    assert any(a[0] != b[0] for a, b in inside) and all(abs(a[1] - b[1]) <= 1 for a, b in inside)
    assert all(b[0] <= a[0] and b[2] >= a[2] for a, b in inside)
    assert ImageChops.difference(picture("even", "even", 0), picture("even", "as-taken", 0)).getbbox() is None
    assert ImageChops.difference(picture("uncorrected", "even"),
                                 picture("uncorrected", "as-taken")).getbbox() is None


def test_a_photograph_in_its_own_light(client, daemon):
    """Where the light differs by the import's numbers, each photograph has an appearance of its own."""
    import_measured(client, daemon, "light", ("--size", 48, "--views", 8), lambda frame: {"light": 0.2})
    client.run("train", "light", "--name", "in-light", "--preset", "draft", "--max-steps", 60,
               "--threads", 1, "--wait")
    effect = {e["name"]: e for e in client.json("show", "in-light")["effects"]}["appearance"]
    assert effect["on"] and abs(effect["number"] - 100 * (math.exp(0.2) - 1)) < 0.1, effect
    assert "light on shared points" in effect["reason"]

    def picture(colours):
        client.run("render", "in-light", "--view", "train:1", "--colours", colours, "-o", "p.png")
        return Image.open(client.cwd / "p.png").convert("RGB")

    assert ImageChops.difference(picture("even"), picture("as-taken")).getbbox() is not None
    told = client.json("eval", "in-light")
    assert told["psnr"] > 8 and told["psnr_fitted"] > 8


def test_photographs_that_stand_on_one_colour(client):
    """What stands on it is cut out, and pictures stand on it too; unless it is to be kept."""
    client.run("synth", "sphere", "standing", "--size", 24, "--views", 6)
    colour = (210, 255, 240)
    for path in (client.cwd / "standing").rglob("*.png"):
        under = Image.new("RGBA", (24, 24), colour)
        under.alpha_composite(Image.open(path))
        under.convert("RGB").save(path)
    for choice, cut in (("cut", True), ("keep", False)):
        told = client.run("import", "standing", "--name", choice, "--backdrop", choice)
        assert "all photographs stand on one colour, 210,255,240" in told.stdout + told.stderr
        assert client.json("show", choice)["has_alpha"] == cut
        client.run("train", choice, "--name", f"on-{choice}", "--preset", "draft", "--max-steps",
                   STEPS, "--threads", 1, "--wait")
        effect = next(effect for effect in client.json("show", f"on-{choice}")["effects"]
                      if effect["name"] == "background")
        assert effect["on"] == cut and ("from the colour 210,255,240" in effect["reason"]) == cut
        client.run("render", f"on-{choice}", "--view", "test:0", "-o", "p.png")
        corner = Image.open(client.cwd / "p.png").convert("RGB").getpixel((0, 0))
        assert (corner == colour) == cut
    assert "--backdrop" in client.run("import", "standing", "--backdrop", "off", code=USAGE).stderr


def test_bytes_do_not_depend_on_threads_or_pauses(client, daemon, gate, trained):
    end, _ = trained
    gate.touch()  # or it might be over before the client has started
    job = train(client, "again", "--max-steps", STEPS, "--seed", 5, "--threads", 2)
    client.run("pause", job)
    gate.unlink()
    daemon.wait_until(lambda: client.json("show", "again")["checkpoints"])
    client.run("resume", job)
    client.run("watch", job)
    assert client.json("show", "again")["parameters_sha256"] == end["parameters_sha256"]
    client.run("rm", "again")


def test_render(client, trained, tmp_path):
    name = client.json("validate", "source")  # the names in the JSON are r_0, r_1, ...
    assert name["layout"] == "blender"
    for file, options in (("a.png", []), ("b.png", []), ("d.png", ["--output", "depth"]),
                          ("m.png", ["--output", "alpha"]), ("j.jpg", []),
                          ("s.png", ["--size", "20x12"]), ("w.png", ["--size", "64x32"])):
        view = "test:r_3" if file == "b.png" else "test:3"
        result = client.json("render", "ball", "--view", view, *options, "-o", tmp_path / file)
        assert result["step"] == STEPS and result["render_ms"] > 0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert Image.open(tmp_path / "a.png").size == (32, 32)
    assert Image.open(tmp_path / "s.png").size == (20, 12)
    # A wider picture shows more at the sides and the same in the middle.
    wide = Image.open(tmp_path / "w.png").crop((16, 0, 48, 32))
    difference = ImageChops.difference(wide, Image.open(tmp_path / "a.png"))
    assert max(high for _, high in difference.getextrema()) <= 2
    depth = Image.open(tmp_path / "d.png")
    assert depth.mode.startswith("I")
    unit = float(depth.info["ripnerf:depth_scale"]) / 65535
    near, far = (unit * grey for grey in (min(v for v in depth.getdata() if v), max(depth.getdata())))
    assert 2.5 <= near < 4.03 < far <= 5.6  # the camera is 4.03 from a ball of radius 1
    assert Image.open(tmp_path / "j.jpg").format == "JPEG"
    client.run("render", "ball", "--view", "test:99", "-o", tmp_path / "x.png", code=NOT_FOUND)


def test_what_a_picture_is_made_of(client, trained, tmp_path):
    file = tmp_path / "map.png"
    for output, unit in (("cost", "samples"), ("level", "levels"), ("footprint", "dataset units")):
        told = client.json("render", "ball", "--view", "test:3", "--output", output, "-o", file)
        low, high, found = told["scale"].split(" ", 2)
        assert low == "0" and float(high) > 0 and found == unit
        assert f"bright {high} {unit}" in client.run("render", "ball", "--view", "test:3",
                                                     "--output", output, "-o", file).stdout
        colours = {pixel[:3] for pixel in Image.open(file).convert("RGB").getdata()}
        assert (0, 0, 0) in colours
        assert len(colours) > 3, (output, colours)
    told = client.json("render", "ball", "--view", "test:3", "--output", "normal", "-o", file)
    assert "scale" not in told or not told["scale"]
    pixels = Image.open(file).convert("RGB")
    lengths = [sum((v / 127.5 - 1) ** 2 for v in pixel) for pixel in pixels.getdata() if any(pixel)]
    assert len(lengths) > 100 and all(0.9 < length < 1.1 for length in lengths)


def test_a_tolerance_spares_work(client, daemon, trained, tmp_path):
    def render(tolerance, output="rgb"):
        body = {"view": "test:3", "tolerance": tolerance, "output": output}
        request = Request(f"{daemon.url}/v1/scenes/ball/render", json.dumps(body).encode(),
                          {"Content-Type": "application/json"})
        with urlopen(request) as reply:
            return int(reply.headers["X-Ripnerf-Samples"]), Image.open(io.BytesIO(reply.read()))

    client.run("render", "ball", "--view", "test:3", "-o", tmp_path / "full.png")
    client.run("render", "ball", "--view", "test:3", "--tolerance", 0.1, "-o", tmp_path / "q.png")
    work, full = render(0)
    assert ImageChops.difference(full, Image.open(tmp_path / "full.png")).getbbox() is None
    for tolerance in (0.01, 0.1):
        less, quick = render(tolerance)
        error = ImageStat.Stat(ImageChops.difference(full, quick)).rms
        assert less < work and 0 < max(error) < 255 * tolerance
        work = less
    assert ImageChops.difference(quick, Image.open(tmp_path / "q.png")).getbbox() is None
    assert render(0.1, "depth")[0] != work  # depths agree elsewhere than colours
    for wrong in (-0.1, 0.6, "fine"):
        with pytest.raises(HTTPError) as refused:
            render(wrong)
        problem = json.loads(refused.value.read())
        assert refused.value.code == 422 and problem["errors"][0]["pointer"] == "#/tolerance"


def test_path(client, trained, tmp_path):
    document = contract.example("PathFile")
    document["path"].update(width=24, height=16)
    (tmp_path / "path.json").write_text(json.dumps(document))
    result = client.json("path", "ball", tmp_path / "path.json", "-o", tmp_path / "all")
    files = sorted((tmp_path / "all").iterdir())
    assert result["frames"] == len(files) > 2
    assert files[1].name == "00001.png" and Image.open(files[1]).size == (24, 16)
    client.run("path", "ball", tmp_path / "path.json", "--frames", "1-2", "-o", tmp_path / "some")
    some = sorted((tmp_path / "some").iterdir())
    assert [file.name for file in some] == ["00001.png", "00002.png"]
    assert some[0].read_bytes() == files[1].read_bytes()
    client.run("path", "ball", tmp_path / "path.json", "--frames", "1-1", "--tolerance", 0.1, "-o",
               tmp_path / "quick")
    assert (tmp_path / "quick" / "00001.png").read_bytes() != files[1].read_bytes()


def untimed(scores):
    return [{name: value for name, value in score.items() if name != "render_ms"}
            for score in scores]


def test_eval(client, trained):
    result = client.json("eval", "ball", "--views", 2)
    contract.check("EvalResult", result)
    assert [score["scale"] for score in result["scales"]] == [0, 1]
    assert result["views"] == 2 and result["protocol"]["split"] == "test"
    one = client.json("eval", "ball", "--views", 2, "--scale", 1)
    assert untimed(one["scales"]) == untimed(result["scales"][1:])
    given = client.json("eval", "ball", "--views", 2, "--scale", 1, "--supersample", 2)
    assert untimed(given["scales"]) == untimed(one["scales"])
    single = client.json("eval", "ball", "--views", 2, "--scale", 1, "--supersample", 1)
    assert single["psnr"] < one["psnr"]
    quick = client.json("eval", "ball", "--views", 2, "--scale", 1, "--tolerance", 0.1)
    assert abs(quick["psnr"] - one["psnr"]) < 3 and quick["psnr"] != one["psnr"]
    error = client.run("eval", "ball", "--supersample", 3, code=USAGE).stderr
    assert "supersample" in error and "1, 2, 4, 8 or 16" in error


def test_cancel_finish_and_conflicts(client, daemon, dataset, trained):
    waiting = client.start("train", "sphere", "--name", "long", "--max-time", "10m", "--wait",
                           "--json")
    daemon.wait_until(lambda: any(scene["name"] == "long" and scene["state"] == "training"
                                  for scene in client.json("scenes")["items"]))
    job = client.json("show", "long")["job"]
    daemon.wait_until(lambda: is_training(client, job))
    assert "long" in client.run("train", "sphere", "--name", "long", code=FAILED).stderr
    client.run("rm", "long", code=FAILED)
    client.run("rm", "sphere", code=FAILED)
    client.run("cancel", "long")
    out, _ = waiting.communicate(timeout=PATIENCE_S)  # of ten minutes
    assert waiting.returncode == CANCELLED and json.loads(out)["state"] == "cancelled"
    job = train(client, "short", "--max-time", "10m")
    daemon.wait_until(lambda: is_training(client, job))
    client.run("finish", job)
    client.run("watch", job)
    assert client.json("show", job)["result"]["finished_by"] == "finish"
    for name in ("long", "short"):
        client.run("rm", name)


def test_ctrl_c_leaves_the_job_running(client, daemon, dataset):
    waiting = client.start("train", "sphere", "--name", "left", "--max-time", "10m", "--wait")
    daemon.wait_until(lambda: any(scene["name"] == "left"
                                  for scene in client.json("scenes")["items"]))
    job = client.json("show", "left")["job"]
    daemon.wait_until(lambda: is_training(client, job))
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == FAILED and f"ripnerf watch {job}" in err
    assert client.json("show", job)["state"] == "running"
    client.run("cancel", job)
    client.run("watch", job, code=CANCELLED)
    client.run("rm", "left")


def test_crashes_of_runner_and_daemon_change_nothing(client, daemon, trained):
    end, _ = trained
    waiting = client.start("train", "sphere", "--name", "crash", "--preset", "draft",
                           "--max-steps", STEPS, "--seed", 5, "--wait", "--json")
    daemon.wait_until(lambda: any(scene["name"] == "crash"
                                  for scene in client.json("scenes")["items"]))
    job = client.json("show", "crash")["job"]
    daemon.wait_until(lambda: client.json("show", job)["state"] != "queued")
    daemon.kill_runners()
    daemon.kill()
    daemon.start()
    out, err = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == OK, err
    result = json.loads(out)
    assert result["steps"] == STEPS
    assert result["parameters_sha256"] == end["parameters_sha256"]
    client.run("rm", "crash")


def wait_for_training(client, daemon, name):
    """A client that waits for a long training under way, and the training's job."""
    waiting = client.start("train", "sphere", "--name", name, "--preset", "draft", "--max-time",
                           "10m", "--wait")
    daemon.wait_until(lambda: any(scene["name"] == name
                                  for scene in client.json("scenes")["items"]))
    job = client.json("show", name)["job"]
    daemon.wait_until(lambda: is_training(client, job))
    return waiting, job


def test_a_lost_runner_is_told(client, daemon, trained):
    waiting, job = wait_for_training(client, daemon, "lost")
    daemon.kill_runners()
    daemon.wait_until(lambda: client.json("show", job)["attempt"] == 2)
    client.run("cancel", job)
    _, err = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == CANCELLED
    assert "the runner ended in attempt 1: killed by signal 9 (Killed), as the kernel does where memory runs out" in err
    assert "--memory-limit" in err
    assert "it is started again" in err and "interrupted" in err
    client.run("rm", "lost")


def test_a_lost_daemon_is_told(client, daemon, trained):
    waiting, job = wait_for_training(client, daemon, "gone")
    daemon.kill()
    said = ""
    while "the daemon does not answer" not in said:  # it has noticed before there is another
        assert (said := waiting.stderr.readline())
    daemon.start()
    daemon.wait_until(lambda: client.json("show", job)["attempt"] == 2)
    client.run("cancel", job)
    _, err = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == CANCELLED
    assert "the daemon ended in attempt 1" in err and "it is started again" in err
    client.run("rm", "gone")


def test_bad_photographs_are_refused_before_they_are_sent(client, tmp_path):
    client.run("synth", "fence", tmp_path / "fence", "--size", 16, "--views", 4)
    image = tmp_path / "fence" / "train" / "r_2.png"
    image.write_bytes(image.read_bytes()[:60])
    result = client.run("import", tmp_path / "fence", "--name", "fence", code=INVALID)
    assert "r_2.png" in result.stderr
    client.run("show", "fence", code=NOT_FOUND)


def test_kernels_can_be_forced(client, dataset, trained):
    info = client.json("info")
    text = client.run("info").stdout
    assert f"{info['kernels']}, of {' '.join(info['available_kernels'])}" in " ".join(text.split())
    client.run("train", "sphere", "--name", "by-generic", "--preset", "draft", "--max-steps", 3,
               "--kernels", "generic", "--wait")
    assert client.json("show", "by-generic")["kernels"] == "generic"
    assert re.search(r"kernels +generic\n", client.run("show", "by-generic").stdout)
    result = client.run("train", "sphere", "--name", "odd", "--preset", "draft", "--max-steps", 3,
                        "--kernels", "mmx", "--wait", code=FAILED)
    assert "mmx" in result.stderr and "generic" in result.stderr


def test_masks_keep_what_they_cover_out_of_the_scene(client, dataset):
    """A bright square over half of the training photographs ruins the scene unless it is masked."""
    source = client.cwd / "source"
    spoilt = client.cwd / "spoilt"
    shutil.copytree(source, spoilt)
    for path in sorted((spoilt / "train").glob("*.png"))[::2]:
        image = Image.open(path)
        image.paste((255, 0, 255, 255), (8, 8, 24, 24))
        image.save(path)
        mask = Image.new("L", image.size, 255)
        mask.paste(0, (8, 8, 24, 24))
        (spoilt / "covers").mkdir(exist_ok=True)
        mask.save(spoilt / "covers" / f"{path.name}.png")
    scores = {}
    for name, options in (("spoilt", ["--format", "blender"]), ("masked", ["--masks", "covers"])):
        client.json("import", "spoilt", "--name", name, *options)
        client.run("train", name, "--name", f"{name}-scene", "--preset", "draft", "--max-steps",
                   STEPS, "--seed", 5, "--threads", 1, "--wait", "--json")
        scores[name] = client.json("eval", f"{name}-scene", "--split", "val", "--json")
    scene = client.json("show", "masked-scene")
    (masks,) = [effect for effect in scene["effects"] if effect["name"] == "masks"]
    assert masks["on"] and masks["number"] == pytest.approx(12.5)
    (masks,) = [effect for effect in client.json("show", "spoilt-scene")["effects"]
                if effect["name"] == "masks"]
    assert not masks["on"] and masks["number"] == 0
    assert scores["masked"]["psnr"] > scores["spoilt"]["psnr"] + 1.5
