"""Frames of paths and single pictures as JPEG, PNG of 16 bits and EXR: what they hold, where they go."""

import io
import json
import struct
import tarfile
import zlib

import numpy as np
import pytest
from PIL import Image

from support import exr
from support.client import INVALID, USAGE, Client

POSE = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]
PATH = {"axes": "opencv", "fps": 4, "width": 40, "height": 24,
        "keys": [{"time": t, "world_from_camera": POSE, "fov_y_deg": 40} for t in (0, 1)]}
CAMERA = {"world_from_camera": POSE, "axes": "opencv", "width": 40, "height": 24, "fov_y_deg": 40}


def frames_of(daemon, **options):
    job = daemon.wait(daemon.submit(type="path", scene="ready", camera_path=PATH, options=options))
    assert job["state"] == "succeeded" and job["result"]["frames"] == 5, job
    reply = daemon.get(f"/v1/jobs/{job['id']}/frames/4")
    assert reply.status == 200
    items = daemon.get(f"/v1/jobs/{job['id']}/frames").json["items"]
    assert [item["index"] for item in items] == list(range(5))
    with tarfile.open(fileobj=io.BytesIO(daemon.get(f"/v1/jobs/{job['id']}/frames.tar").body)) as tar:
        names = tar.getnames()
        assert tar.extractfile(names[4]).read() == reply.body
    return reply, names


def needs_exr(build):
    if b"libopenexr-dev, or take png16" in (build / "server/ripnerf-runner").read_bytes():
        pytest.skip("built without OpenEXR")


def png_header(data):
    """Width, height, bit depth, colour type."""
    return struct.unpack(">IIBB", data[16:26])


def samples_of(data, channels):
    """Of a PNG of 16 bits, which Pillow rounds to 8."""
    at, packed = 8, b""
    while at < len(data):
        (size,), kind = struct.unpack_from(">I", data, at), data[at + 4:at + 8]
        packed += data[at + 8:at + 8 + size] if kind == b"IDAT" else b""
        at += 12 + size
    width, height = png_header(data)[:2]
    raw = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, -1)
    stride, bpp = 2 * channels * width, 2 * channels
    rows = np.zeros((height + 1, stride + bpp), np.int64)
    for y in range(height):
        kind, row, above = raw[y, 0], rows[y + 1], rows[y]
        for i in range(stride):
            a, b, c = row[i], above[i + bpp], above[i]
            p = a + b - c
            guess = (0, a, b, (a + b) // 2,
                     min((abs(p - v), n, v) for n, v in enumerate((a, b, c)))[2])[kind]
            row[i + bpp] = (raw[y, 1 + i] + guess) % 256
    bytes_ = rows[1:, bpp:].astype(np.uint8).reshape(height, width, channels, 2)
    return bytes_[..., 0].astype(int) * 256 + bytes_[..., 1]


@pytest.fixture
def client(build, shared, tmp_path):
    return Client(build / "client" / "ripnerf", tmp_path, f"http://{shared.host}:{shared.port}")


def test_jpeg_frames(shared):
    reply, names = frames_of(shared, format="jpeg", jpeg_quality=95)
    assert names == [f"{i:05}.jpg" for i in range(5)]
    assert reply.headers["Content-Type"] == "image/jpeg"
    small, _ = frames_of(shared, format="jpeg", jpeg_quality=10)
    assert len(small.body) < len(reply.body)
    plain, _ = frames_of(shared)
    difference = np.abs(np.asarray(Image.open(io.BytesIO(reply.body)), int) -
                        np.asarray(Image.open(io.BytesIO(plain.body)).convert("RGB"), int))
    assert difference.mean() < 3


def test_frames_of_16_bits(shared):
    reply, names = frames_of(shared, format="png16")
    assert names[0] == "00000.png" and reply.headers["Content-Type"] == "image/png"
    assert png_header(reply.body) == (40, 24, 16, 2)
    samples = samples_of(reply.body, 3)
    assert np.abs(samples[3, :, 0] - 65535 * np.arange(40) / 40).max() <= 0.51
    assert np.abs(samples[:, 5, 1] - 65535 * np.arange(24) / 24).max() <= 0.51
    grey, _ = frames_of(shared, format="png16", output="alpha")
    assert png_header(grey.body) == (40, 24, 16, 0)


def test_an_exr_holds_colour_alpha_depth_and_normals(shared, build):
    needs_exr(build)
    reply, names = frames_of(shared, format="exr")
    assert names[0] == "00000.exr" and reply.headers["Content-Type"] == "image/x-exr"
    planes, about = exr.read(reply.body)
    assert sorted(planes) == ["A", "B", "G", "N.X", "N.Y", "N.Z", "R", "Z"]
    assert b"linear light" in about["comments"]
    across, down = np.arange(40) / 40, np.arange(24) / 24
    half = 2.0 ** -11
    alpha = np.tile(across, (24, 1))
    assert np.abs(planes["A"] - alpha).max() <= half
    assert np.abs(planes["Z"] - alpha).max() <= 1e-6  # in whole floats
    # The engine's colours are over black: straight red is 1, straight green down / across.
    assert np.abs(planes["R"] - alpha).max() <= half
    straight = np.minimum(1, down[:, None] / np.maximum(across, 1e-9)[None])
    light = np.where(straight <= 0.04045, straight / 12.92, ((straight + 0.055) / 1.055) ** 2.4)
    assert np.abs(planes["G"] - light * alpha).max() <= 2 * half
    assert np.abs(planes["N.Y"][:, 7] - down).max() <= half


def test_single_pictures_have_the_same_formats(shared, build):
    needs_exr(build)
    reply = shared.post("/v1/scenes/ready/render", {"camera": CAMERA, "format": "png16"})
    assert png_header(reply.body)[2:] == (16, 2)
    reply = shared.post("/v1/scenes/ready/render", {"camera": CAMERA, "format": "exr"})
    assert reply.headers["Content-Type"] == "image/x-exr" and "Z" in exr.read(reply.body)[0]
    blurred = {"camera": CAMERA, "format": "exr", "optics": {"ortho_height": 2}}
    assert sorted(exr.read(shared.post("/v1/scenes/ready/render", blurred).body)[0]) == \
        ["A", "B", "G", "R", "Z"]


@pytest.mark.parametrize("options, pointer", [
    ({"format": "tiff"}, "#/options/format"), ({"jpeg_quality": 0}, "#/options/jpeg_quality"),
    ({"format": "exr", "output": "depth"}, "#/options/format"),
    ({"format": "jpeg", "output": "depth"}, "#/options/format"),
    ({"format": "exr", "film": "gif"}, "#/options/format")])
def test_wrong_formats_are_refused(shared, options, pointer):
    reply = shared.post("/v1/jobs", {"type": "path", "scene": "ready", "camera_path": PATH,
                                     "options": options})
    assert reply.status == 422 and [e["pointer"] for e in reply.json["errors"]] == [pointer]


def test_the_client_names_and_fetches_them(client, shared, tmp_path):
    (tmp_path / "p.json").write_text(json.dumps({"path": PATH}))
    client.run("path", "ready", "p.json", "-o", "out", "--format", "jpeg")
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [f"{i:05}.jpg" for i in range(5)]
    assert "holds frames already" in client.run("path", "ready", "p.json", "-o", "out",
                                                code=USAGE).stderr
    assert "--format" in client.run("path", "ready", "p.json", "-o", "f.mp4", "--format", "exr",
                                    code=USAGE).stderr
    client.run("path", "ready", "p.json", "-o", "deep", "--output", "depth")
    assert png_header((tmp_path / "deep" / "00000.png").read_bytes())[2:] == (16, 0)
    client.run("render", "ready", "--view", "test:0", "-o", "a.png", "--format", "png16")
    assert png_header((tmp_path / "a.png").read_bytes())[2] == 16
    assert "leave output out" in client.run("render", "ready", "--view", "test:0", "-o", "a.exr",
                                            "--output", "depth", code=INVALID).stderr
