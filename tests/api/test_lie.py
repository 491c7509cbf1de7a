"""Where a scene is and how it lies: asked for, found out, kept, and the same far from the origin."""

import json
import shutil

import pytest
from PIL import Image, ImageChops

from support import contract
from support.client import INVALID, USAGE, Client
from support.daemon import Daemon

UTM = (500123.25, 4649776.5, 117.125)
STEPS = 5  # more of them let roundings grow


@pytest.fixture(scope="module")
def client(build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lie")
    with Daemon(build, folder / "daemon") as daemon:
        made = Client(build / "client" / "ripnerf", folder, daemon.url)
        made.run("synth", "sphere", "near", "--size", 32, "--views", 12)
        shutil.copytree(folder / "near", folder / "far")
        for document in (folder / "far").glob("transforms_*.json"):
            text = json.loads(document.read_text())
            for frame in text["frames"]:
                for axis in range(3):
                    frame["transform_matrix"][axis][3] += UTM[axis]
            document.write_text(json.dumps(text))
        made.folder = folder
        yield made


def test_it_is_found_out(client):
    dataset = client.json("import", "near", "--name", "found")
    contract.check("Dataset", dataset)
    assert dataset["capture"] == "object" and "crop" not in dataset
    assert dataset["up"] == pytest.approx([0, 0, 1], abs=1e-6)
    assert "up is (" in client.run("show", "found").stdout


def test_it_is_asked_for(client):
    dataset = client.json("import", "near", "--name", "asked", "--up", "-y",
                          "--crop", "-1,-1,-0.5,1,1,2")
    contract.check("Dataset", dataset)
    assert dataset["up"] == [0, -1, 0] and dataset["crop"] == [-1, -1, -0.5, 1, 1, 2]
    assert dataset["bounds"] == {"centre": [0, 0, 0.75], "radius": pytest.approx((2 + 1.25**2)**0.5),
                                 "source": "given"}
    assert "crop" in client.run("show", "asked").stdout
    dataset = client.json("import", "near", "--name", "both", "--crop", "-1,-1,-0.5,1,1,2",
                          "--bounds", "0,0,0,3")
    assert dataset["bounds"]["radius"] == 3


def test_a_turntable_turns_about_what_is_up(client, tmp_path):
    """Not about the cameras' own upward directions, which are those of z."""
    client.run("import", "near", "--name", "lain", "--up", "-y")
    client.run("train", "lain", "--name", "lain", "--preset", "draft", "--max-steps", 1, "--wait")
    client.run("turntable", "lain", "--whole", "-o", tmp_path / "turn.json")
    keys = json.loads((tmp_path / "turn.json").read_text())["path"]["keys"]
    x, y, z = ([key["world_from_camera"][axis][3] for key in keys] for axis in range(3))
    assert max(y) - min(y) < 1e-6 and max(x) - min(x) > 1 and max(z) - min(z) > 1


@pytest.mark.parametrize("option, value", [("--up", "0,0,0"), ("--up", "w"), ("--up", "1,2"),
                                           ("--crop", "1,1,1,0,2,2"), ("--crop", "0,0,0,1"),
                                           ("--bounds", "0,0,0,-1")])
def test_what_is_no_direction_or_box(client, option, value):
    for verb in (("validate", "near"), ("import", "near", "--name", "bad")):
        result = client.run(*verb, option, value, code=USAGE)
        assert option in result.stderr and "must be" in result.stderr


def test_far_from_the_origin(client, tmp_path):
    """Metres of a survey's grid: the same field and pictures as at the origin, paths stay there."""
    pictures, cameras = [], []
    for name, offset in (("near", (0, 0, 0)), ("far", UTM)):
        bounds = ",".join(repr(float(x)) for x in (*offset, 1.5))
        dataset = client.json("import", name, "--name", f"{name}-set", "--bounds", bounds)
        assert dataset["up"] == pytest.approx([0, 0, 1], abs=1e-6)
        client.run("train", f"{name}-set", "--name", name, "--preset", "draft", "--max-steps", STEPS,
                   "--seed", 1, "--threads", 1, "--wait")
        client.run("render", name, "--view", "test:0", "-o", tmp_path / f"{name}.png")
        pictures.append(Image.open(tmp_path / f"{name}.png").convert("RGB"))
        client.run("turntable", name, "-o", tmp_path / f"{name}.json")
        keys = json.loads((tmp_path / f"{name}.json").read_text())["path"]["keys"]
        cameras.append([[row[3] for row in key["world_from_camera"][:3]] for key in keys])
    difference = ImageChops.difference(*pictures)
    assert max(high for _, high in difference.getextrema()) <= 2
    for near, far in zip(*cameras):
        assert far == pytest.approx([x + y for x, y in zip(near, UTM)], abs=1e-3)
