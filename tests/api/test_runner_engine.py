"""The runner with the real engine: the same bytes whatever happens on the way."""

import io
import json
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from support.photographs import write_dataset
from support.wire import JOB, Scene, ingest, train

OPTIONS = {"preset": "draft", "max_steps": 12, "seed": 3, "threads": 2}


@pytest.fixture(scope="module")
def program(build):
    return build / "server" / "ripnerf-runner"


@pytest.fixture(scope="module")
def dataset(program, tmp_path_factory):
    folder = tmp_path_factory.mktemp("engine")
    last, target, _ = ingest(program, folder, write_dataset(folder / "source"),
                             options={"scales": 2})
    assert last[0] == "done", last
    return target


def finish(runner):
    name, content, _ = runner.wait_for("done", "failed")
    assert name == "done", content
    assert content["result"]["steps"] == OPTIONS["max_steps"]
    return content["result"]["parameters_sha256"]


@pytest.fixture(scope="module")
def undisturbed(program, dataset, tmp_path_factory):
    """(digest, most bytes of memory) of a run that nothing disturbs."""
    with Scene(program, tmp_path_factory.mktemp("plain") / "scene", dataset) as runner:
        train(runner, **OPTIONS)
        digest = finish(runner)
        status = Path(f"/proc/{runner.process.pid}/status").read_text()
        return digest, 1024 * int(re.search(r"VmHWM:\s+(\d+) kB", status)[1])


@pytest.fixture(scope="module")
def digest(undisturbed):
    return undisturbed[0]


def test_bytes_do_not_depend_on_a_crash(program, dataset, digest, tmp_path):
    """One checkpoint of before its end is certain: it is asked for after the first slice of 10 ms. Where
    the training is over before the kill, it was killed as the last one was written, which goes."""
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, checkpoint_interval_s=0, **OPTIONS)
        runner.wait_for("checkpoint")
        os.kill(runner.process.pid, signal.SIGKILL)
    (tmp_path / "scene" / "checkpoints" / f"step-{OPTIONS['max_steps']:09}.safetensors").unlink(missing_ok=True)
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, **OPTIONS)
        while "stage" in (progress := runner.wait_for("progress")[1]["progress"]):
            continue  # photographs are loaded
        assert 0 < progress["step"] < OPTIONS["max_steps"]
        assert finish(runner) == digest


def test_bytes_do_not_depend_on_threads_pauses_and_renders(program, dataset, digest, tmp_path):
    """Between a render and what comes behind it there is one slice of training."""
    render = {"request": 1, "render": {"view": "test:0", "format": "png"}}
    with Scene(program, tmp_path / "scene", dataset) as runner:
        runner.send_all(("train", {"job": JOB, "options": {**OPTIONS, "threads": 1}}),
                        ("render", render), ("pause", {"job": JOB}))
        assert 0 < runner.wait_for("checkpoint")[1]["step"] < OPTIONS["max_steps"]
        runner.send_all(("resume", {"job": JOB}), ("render", render))
        assert finish(runner) == digest
        assert [name for name, _, _ in runner.seen].count("rendered") == 2


def test_needs_are_known_before_it_starts(program, dataset, undisturbed, tmp_path):
    """The memory that a training is said to need holds what it takes in the end, its planes grown,
    and is no more than three times as much."""
    told = subprocess.run([program, "--mode", "needs", "--dataset", dataset, "--scene", tmp_path / "none",
                           "--train", json.dumps(OPTIONS), "--sandbox"], check=True,
                          capture_output=True, text=True).stdout
    said = re.fullmatch(r"memory_bytes (\d+) gpus -1\n", told)
    taken = undisturbed[1]
    assert taken < int(said[1]) < 3 * taken


def test_a_loaded_scene_is_the_trained_one(program, dataset, tmp_path):
    pictures = []
    request = {"view": "test:1", "format": "png"}
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, **OPTIONS)
        trained = finish(runner)
        runner.send("render", request=1, render=request)
        pictures.append(runner.wait_for("rendered")[2])
    with Scene(program, tmp_path / "scene", dataset, load=True) as runner:
        assert runner.wait_for("opened")[1]["parameters_sha256"] == trained
        runner.send("render", request=1, render=request)
        pictures.append(runner.wait_for("rendered")[2])
    assert pictures[0] == pictures[1]
    assert Image.open(io.BytesIO(pictures[0])).size == (16, 16)


@pytest.mark.parametrize("split, withheld", [("train", False), ("trainval", True)])
def test_only_what_would_be_trained_on_is_withheld(program, dataset, tmp_path, split, withheld):
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, train_split=split, **OPTIONS)
        finish(runner)
        told = next(content["scene"] for name, content, _ in runner.seen
                    if name == "state" and "scene" in content)
        assert ("withheld" in told["held_out"]) == withheld
        assert any("withheld" in each["what"] for each in told["differences"]) == withheld
        for view, words in (("test:99", "the test split has test:0 to test:3"),
                            ("val:none", "the val split has val:0 to val:7")):
            runner.send("render", request=1, render={"view": view, "format": "png"})
            _, refused, _ = runner.wait_for("rendered", "refused", "error", "failed")
            assert words in str(refused), refused


def test_the_last_figure_is_of_before_photographs_are_given_back(program, tmp_path):
    """A folder without splits: all of it is trained on from half of the steps on."""
    source = write_dataset(tmp_path / "source", train=16, val=0, test=0)
    for split in ("val", "test"):
        (source / f"transforms_{split}.json").unlink()
    last, target, _ = ingest(program, tmp_path, source)
    assert last[0] == "done", last
    with Scene(program, tmp_path / "scene", target) as runner:
        train(runner, **OPTIONS)
        result = runner.wait_for("done", "failed")[1]["result"]
        scene = [content["scene"] for name, content, _ in runner.seen if name == "checkpoint"][-1]
        measured = [content["metric"] for name, content, _ in runner.seen if name == "metric"]
    half = OPTIONS["max_steps"] // 2
    assert measured[-1]["step"] == result["psnr_step"] == half
    assert result["psnr"] == pytest.approx(measured[-1]["psnr"])
    assert scene["held_out"].startswith("2 training views (one of 8) withheld from training until "
                                        f"step {half} and trained on since")
