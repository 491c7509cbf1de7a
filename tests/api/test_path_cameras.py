"""A dataset's own cameras as paths in other programs' words, written here by each program's rules: the
frames of such a path are the pictures that the dataset's views have."""

import json
import math
import os
import struct
from pathlib import Path

import numpy
import pytest
from PIL import Image

from support.client import Client

SIZE, VIEWS = 48, 3
MOVED = {"scale": 0.25, "offset": [0.4, 0.5, 0.7], "frames": []}  # instant-ngp's, of the dataset
ANGLE = math.radians(25)
TRAINED = numpy.array([[math.cos(ANGLE), -math.sin(ANGLE), 0, 0.3],  # nerfstudio's, of one training
                       [math.sin(ANGLE), math.cos(ANGLE), 0, -1.2], [0, 0, 1, 0.5]])
SCALE = 0.37


def quaternion(m):
    """w, x, y, z of a rotation: the eigenvector of Bar-Itzhack's symmetric matrix."""
    k = numpy.array([
        [m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]],
        [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]],
        [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]]])
    x, y, z, w = numpy.linalg.eigh(k)[1][:, 3]
    return [float(c) for c in (w, x, y, z)]


def opencv(gl):
    return gl[:3] * [1, -1, -1, 1]


def transforms(poses, fov):
    return {"camera_angle_y": fov, "frames": [
        {"file_path": f"{i}.png", "transform_matrix": gl.tolist()} for i, gl in enumerate(poses)]}


def nerfstudio(poses, fov):
    frames = []
    for gl in poses:
        moved = numpy.eye(4)
        moved[:3, :3] = TRAINED[:, :3] @ gl[:3, :3]
        moved[:3, 3] = SCALE * (TRAINED[:, :3] @ gl[:3, 3] + TRAINED[:, 3])
        frames.append({"camera_to_world": moved.ravel().tolist(), "fov": math.degrees(fov), "aspect": 1})
    return {"camera_type": "perspective", "render_height": SIZE, "render_width": SIZE, "fps": 1,
            "seconds": VIEWS, "camera_path": frames}


def instant_ngp(poses, fov):
    """Columns up and backwards are turned round, places scaled and moved, and x, y, z are y, z, x."""
    keys = []
    for gl in poses:
        pose = opencv(gl)
        pose[:, 3] = MOVED["scale"] * pose[:, 3] + MOVED["offset"]
        pose = pose[[1, 2, 0]]
        w, x, y, z = quaternion(pose[:, :3])
        keys.append({"R": [x, y, z, w], "T": pose[:, 3].tolist(), "fov": math.degrees(fov), "slice": 0.5,
                     "scale": 1.5, "aperture_size": 0})
    return {"loop": False, "time": 0.0, "path": keys}


def nerfbaselines(poses, fov):
    f = SIZE / 2 / math.tan(fov / 2)
    return {"format": "nerfbaselines-v1", "camera_model": "pinhole", "image_size": [SIZE, SIZE], "fps": 1,
            "frames": [{"pose": opencv(gl).ravel().tolist(), "intrinsics": [f, f, SIZE / 2, SIZE / 2]}
                       for gl in poses]}


def splatting(poses, fov):
    f = SIZE / 2 / math.tan(fov / 2)
    return [{"id": i, "img_name": str(i), "width": SIZE, "height": SIZE, "fx": f, "fy": f,
             "position": gl[:3, 3].tolist(), "rotation": opencv(gl)[:, :3].tolist()}
            for i, gl in enumerate(poses)]


def colmap(poses, _fov):
    """World to camera, the quaternion's real part first; each line is followed by one of points."""
    lines = ["# Image list with two lines of data per image:"]
    for i, gl in enumerate(poses):
        pose = opencv(gl)
        turned = pose[:, :3].T
        numbers = [*quaternion(turned), *(-turned @ pose[:, 3])]
        lines += [f"{i + 1} {' '.join(map(repr, map(float, numbers)))} 1 {i:03}.png", "12.5 7.25 -1"]
    return "\n".join(lines) + "\n"


PROGRAMS = {
    "transforms": (transforms, []), "nerfstudio": (nerfstudio, ["--space", "space.json"]),
    "instant-ngp": (instant_ngp, ["--dataset", "moved.json"]), "nerfbaselines": (nerfbaselines, []),
    "3dgs": (splatting, []), "colmap": (colmap, [])}


@pytest.fixture
def client(build, tmp_path):
    return Client(build / "client" / "ripnerf", tmp_path, "http://127.0.0.1:1")


@pytest.fixture(name="views", scope="module")
def fixture_views(ball, tmp_path_factory):
    """Poses and field of view as the photographs' own file has them, and what they render."""
    document = json.loads((ball.cwd / "source" / "transforms_test.json").read_text())
    folder = tmp_path_factory.mktemp("views")
    pictures = []
    for i in range(VIEWS):
        ball.run("render", "ball", "--view", f"test:{i}", "-o", folder / f"{i}.png")
        pictures.append(numpy.asarray(Image.open(folder / f"{i}.png").convert("RGB"), float))
    poses = [numpy.array(frame["transform_matrix"]) for frame in document["frames"][:VIEWS]]
    assert all(numpy.abs(a - b).mean() > 1 for a, b in zip(pictures, pictures[1:]))  # they differ
    return poses, document["camera_angle_x"], pictures


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_datasets_cameras_render_its_views(ball, views, tmp_path, name):
    poses, fov, pictures = views
    make, options = PROGRAMS[name]
    document = make(poses, fov)
    source = tmp_path / ("images.txt" if name == "colmap" else "in.json")
    source.write_text(document if isinstance(document, str) else json.dumps(document))
    f = SIZE / 2 / math.tan(fov / 2)
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE {SIZE} {SIZE} {f!r} {f!r} {SIZE / 2} {SIZE / 2}\n")
    (tmp_path / "moved.json").write_text(json.dumps(MOVED))
    (tmp_path / "space.json").write_text(json.dumps({"transform": TRAINED.tolist(), "scale": SCALE}))
    options = [tmp_path / word if word.endswith(".json") else word for word in options]
    ball.run("paths", "convert", source, tmp_path / "path.json", "--from", name, *options,
             "--fps", 1, "--size", f"{SIZE}x{SIZE}")
    ball.run("path", "ball", tmp_path / "path.json", "-o", tmp_path / "frames")
    frames = sorted((tmp_path / "frames").glob("*.png"))
    assert len(frames) == VIEWS
    for frame, truth in zip(frames, pictures, strict=True):
        off = numpy.abs(numpy.asarray(Image.open(frame).convert("RGB"), float) - truth)
        assert off.max() <= 3 and off.mean() < 0.05, name


CUP = Path(os.environ.get("RIPNERF_TEST_DATA", "")) / "real" / "cup_colmap"


def text_of_model(folder, out):
    """COLMAP's images.bin and cameras.bin as its own program writes them in text; the names in order."""
    data = (folder / "images.bin").read_bytes()
    at, images = 8, []
    for _ in range(struct.unpack_from("<Q", data)[0]):
        number, *pose, camera = struct.unpack_from("<I7dI", data, at)
        name = data[at + 64:data.index(b"\0", at + 64)].decode()
        at += 64 + len(name) + 1
        at += 8 + 24 * struct.unpack_from("<Q", data, at)[0]
        images.append((name, f"{number} {' '.join(map(repr, pose))} {camera} {name}\n\n"))
    (out / "images.txt").write_text("# made by hand\n" + "".join(line for _, line in sorted(images)))
    cameras = struct.iter_unpack("<IiQQ3d", (folder / "cameras.bin").read_bytes()[8:])  # of one model
    (out / "cameras.txt").write_text("".join(
        f"{number} SIMPLE_PINHOLE {width} {height} {f!r} {x!r} {y!r}\n"
        for number, _, width, height, f, x, y in cameras))
    return len(images)


@pytest.mark.skipif(not os.environ.get("RIPNERF_TEST_DATA") or not CUP.is_dir(),
                    reason="RIPNERF_TEST_DATA names no folder with real/cup_colmap")
def test_a_published_model_is_where_its_own_llff_poses_are(client, tmp_path):
    """COLMAP's text of a capture as a path, beside the poses_bounds.npy that LLFF's tools made of it:
    columns down, right and backwards."""
    count = text_of_model(CUP / "sparse" / "0", tmp_path)
    client.run("paths", "convert", "images.txt", "path.json")
    keys = json.loads((tmp_path / "path.json").read_text())["path"]["keys"]
    rows = numpy.load(CUP / "poses_bounds.npy")[:, :15].reshape(-1, 3, 5)
    assert len(keys) == count == len(rows)
    for key, row in zip(keys, rows, strict=True):
        wanted = numpy.stack([row[:, 1], row[:, 0], -row[:, 2], row[:, 3]], axis=1)
        assert numpy.abs(numpy.array(key["world_from_camera"]) - wanted).max() < 1e-6
