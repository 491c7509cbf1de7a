"""The runner with the real engine: the same bytes whatever happens on the way."""

import io
import os
import signal
import sys
from pathlib import Path

import pytest
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from photographs import write_dataset  # noqa: E402
from wire import JOB, Scene, ingest, train  # noqa: E402

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
    name, content, _ = runner.wait_for("done", "failed", timeout=60)
    assert name == "done", content
    assert content["result"]["steps"] == OPTIONS["max_steps"]
    return content["result"]["parameters_sha256"]


@pytest.fixture(scope="module")
def digest(program, dataset, tmp_path_factory):
    """Of a run that nothing disturbs."""
    with Scene(program, tmp_path_factory.mktemp("plain") / "scene", dataset) as runner:
        train(runner, **OPTIONS)
        return finish(runner)


def test_bytes_do_not_depend_on_a_crash(program, dataset, digest, tmp_path):
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, checkpoint_interval_s=0, **OPTIONS)
        for _ in range(3):
            runner.wait_for("checkpoint")
        os.kill(runner.process.pid, signal.SIGKILL)
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, **OPTIONS)
        assert runner.wait_for("progress")[1]["progress"]["step"] > 0
        assert finish(runner) == digest


def test_bytes_do_not_depend_on_threads_pauses_and_renders(program, dataset, digest, tmp_path):
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner, **{**OPTIONS, "threads": 1})
        runner.wait_for("progress")
        runner.send("render", request=1, render={"view": "test:0", "format": "png"})
        runner.wait_for("rendered")
        runner.send("pause", job=JOB)
        runner.wait_for("checkpoint")
        runner.send("resume", job=JOB)
        assert finish(runner) == digest


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
