"""The runner where its engine, which only pretends, makes several pictures in one call."""

import pytest

from support.photographs import pose, write_dataset
from support.wire import JOB, Scene, ingest, train

PATH = {"axes": "opengl", "fps": 4, "interpolation": "linear", "loop": False, "width": 12, "height": 10,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1, 2)]}


@pytest.fixture(scope="module")
def program(build):
    return build / "tests" / "support" / "ripnerf-runner-fake"


@pytest.fixture(scope="module")
def dataset(program, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset")
    last, target, _ = ingest(program, folder, write_dataset(folder / "source"), options={"scales": 2})
    assert last[0] == "done", last
    return target


def test_pictures_made_in_one_call_are_those_of_one_at_a_time(program, dataset, tmp_path, monkeypatch):
    """Frames, scores on two scales in turn, what is told of them and its order; an attempt that goes on."""
    def make(folder, together):
        monkeypatch.setenv("RIPNERF_FAKE_TOGETHER", str(together))
        with Scene(program, tmp_path / folder, dataset) as scene:
            train(scene)
            scene.wait_for("done")
            frames = tmp_path / folder / "frames" / JOB
            order = {"job": JOB, "folder": str(frames), "camera_path": PATH, "options": {}}
            told = []
            for again in (False, True):
                if again:
                    for name in ("00001.png", "00002.png", "00005.png"):
                        (frames / name).unlink()
                scene.seen.clear()
                scene.send("path", **order)
                scene.wait_for("done")
                told.append([message["index"] for name, message, _ in scene.seen if name == "frame"])
            scene.send("eval", job="job_bbbbbbbbbbbb", options={"split": "train"})
            result = scene.wait_for("done")[1]["result"]
            for view in result["per_view"]:
                view.pop("render_ms")
            return told, {file.name: file.read_bytes() for file in frames.iterdir()}, result["per_view"]
    alone = make("alone", 1)
    assert alone[0][1] == [1, 2, 5] and len(alone[1]) > 6 and {view["scale"] for view in alone[2]} == {0, 1}
    assert make("together", 4) == alone
