"""POST /v1/camera-paths/convert: other programs' camera paths there and back, and what is refused."""

import json
import math

import pytest

FORMATS = ["ripnerf", "nerfstudio", "instant-ngp", "nerfbaselines", "transforms", "colmap", "3dgs"]


def look(eye):
    """world-from-camera, OpenCV axes, of a camera at `eye` that looks at the origin, z up."""
    length = math.sqrt(sum(x * x for x in eye))
    forward = [-x / length for x in eye]
    flat = math.hypot(forward[0], forward[1])
    right = [forward[1] / flat, -forward[0] / flat, 0]
    down = [forward[1] * right[2] - forward[2] * right[1],
            forward[2] * right[0] - forward[0] * right[2],
            forward[0] * right[1] - forward[1] * right[0]]
    return [[right[i], down[i], forward[i], eye[i]] for i in range(3)]


PATH = {"axes": "opencv", "fps": 1, "width": 64, "height": 48,
        "keys": [{"time": float(i), "fov_y_deg": 40.0,
                  "world_from_camera": look([3 * math.cos(i), 3 * math.sin(i), 1.2])}
                 for i in range(4)]}


@pytest.fixture(name="daemon")
def fixture_daemon(shared):
    return shared


def convert(daemon, status=200, **body):
    reply = daemon.post("/v1/camera-paths/convert", body)
    assert reply.status == status, reply.body
    return reply.json


@pytest.mark.parametrize("to", FORMATS)
def test_there_and_back(daemon, to):
    space = {"space": "dataset"} if to == "nerfstudio" else {}
    written = convert(daemon, path=PATH, to=to, **space)
    assert written["format"] == to
    beside = {"beside": written["beside"]} if "beside" in written else {}
    assert bool(beside) == (to == "colmap") and written.get("beside_name", "") == \
        ("cameras.txt" if to == "colmap" else "")
    read = convert(daemon, file=written["file"], **beside, **space)
    assert read["format"] == to
    for key, was in zip(read["path"]["keys"], PATH["keys"], strict=True):
        for row, expected in zip(key["world_from_camera"], was["world_from_camera"], strict=True):
            assert row == pytest.approx(expected, abs=1e-6)
        assert key["fov_y_deg"] == pytest.approx(40, abs=1e-6)


def keys(count, **change):
    return [{**PATH["keys"][0], "time": float(i), **change} for i in range(count)]


@pytest.mark.parametrize("file, words", [
    ("nonsense", "no camera path that is known"),
    (json.dumps({"path": {**PATH, "keys": []}}), "keys"),
    (json.dumps({"path": {**PATH, "keys": keys(10001)}}), "10001"),
    (json.dumps({"path": {**PATH, "keys": keys(2, time=3.0)}}), "not later"),
    (json.dumps({"path": {**PATH, "keys": keys(1, fov_y_deg=float("nan"))}}), "fov_y_deg"),
    (json.dumps({"path": {**PATH, "keys": keys(1, aperture=1)}}), "focus"),
    (json.dumps({"path": [{"R": [0, 0, 0, 0], "T": [0, 0, 0], "dof": 0, "fov": 50, "glow": 0,
                           "scale": 1, "slice": 0}], "time": 1}), "quaternion of length 0"),
], ids=["nonsense", "no keys", "too many", "times that go back", "nan", "no focus", "no rotation"])
def test_what_is_wrong_with_a_file_is_said(daemon, file, words):
    problem = convert(daemon, 413 if words == "10001" else 422, file=file)
    assert words in json.dumps(problem), problem


def test_what_is_missing_is_said(daemon):
    written = convert(daemon, path=PATH, to="nerfstudio", space="dataset")
    problem = convert(daemon, 422, file=written["file"])
    assert problem["errors"][0]["pointer"] == "#/space"
    assert "dataparser_transforms.json" in problem["errors"][0]["detail"]
    assert "exactly one" in json.dumps(daemon.post("/v1/camera-paths/convert", {}).json)
    assert "#/to" in json.dumps(convert(daemon, 422, path=PATH))


def places(answer):
    return [[row[3] for row in key["world_from_camera"]] for key in answer["path"]["keys"]]


def test_the_dataset_says_where_coordinates_lie(daemon):
    """instant-ngp's scale and offset, and what nerfstudio's tools did to the dataset before training."""
    eyes = [[row[3] for row in key["world_from_camera"]] for key in PATH["keys"]]
    moved = json.dumps({"scale": 0.165, "offset": [0.5, 0.5, 0.5], "frames": []})
    ngp = convert(daemon, path=PATH, to="instant-ngp")["file"]
    found = places(convert(daemon, file=ngp, dataset=moved))
    assert found == [pytest.approx([2 * x for x in eye], abs=1e-6) for eye in eyes]
    again = convert(daemon, path=PATH, to="instant-ngp", dataset=moved)["file"]
    assert places(convert(daemon, file=again, dataset=moved)) == \
        [pytest.approx(eye, abs=1e-6) for eye in eyes]
    studio = convert(daemon, path=PATH, to="nerfstudio", space="dataset")["file"]
    applied = json.dumps({"applied_transform": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]})
    training = json.dumps({"scale": 1, "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]})
    found = places(convert(daemon, file=studio, space=training, dataset=applied))
    assert found == [pytest.approx([x + 5, y, z], abs=1e-6) for x, y, z in eyes]
    problem = convert(daemon, 422, file=studio, dataset=applied)  # whose training is not known
    assert problem["errors"][0]["pointer"] == "#/space"
    plain = convert(daemon, path=PATH, to="3dgs")["file"]
    problem = convert(daemon, 422, file=plain, dataset=applied)
    assert problem["errors"][0]["pointer"] == "#/dataset"
