"""Films of path jobs: every codec, what a film is made of, and jobs that end without one."""

import io
import json
import os
import struct

import pytest
from PIL import Image, ImageChops, ImageStat

POSE = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]
PATH = {"axes": "opencv", "fps": 12.5, "width": 64, "height": 48,
        "keys": [{"time": t, "world_from_camera": POSE, "fov_y_deg": 40 + 10 * t} for t in (0, 1)]}


@pytest.fixture(scope="module")
def module(build):
    path = build / "server/film/ripnerf-film.so"
    if not path.is_file():
        pytest.skip("built without FFmpeg's libraries")
    return path


@pytest.fixture
def daemon(make_daemon, photographs, module):
    daemon = make_daemon({"RIPNERF_FILM_MODULE": str(module)})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("scene")
    return daemon


def boxes(data):
    """The names of an MP4's outermost boxes, in order."""
    names, at = [], 0
    while at < len(data):
        size, name = struct.unpack(">I4s", data[at:at + 8])
        names.append(name.decode())
        at += size
    return names


def film(daemon, codec, **options):
    job = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=PATH,
                                    options={"film": codec, **options}))
    assert job["state"] == "succeeded", job
    reply = daemon.get(f"/v1/jobs/{job['id']}/film")
    assert reply.status == 200 and len(reply.body) == job["result"]["film_bytes"]
    return job, reply


@pytest.mark.parametrize("codec", ["h264", "av1"])
def test_mp4_begins_with_its_index(daemon, codec):
    job, reply = film(daemon, codec)
    assert job["result"]["film"] == "film.mp4" and job["result"]["frames"] == 13
    assert reply.headers["Content-Type"] == "video/mp4"
    assert daemon.get("/v1/info").json["films"] is True
    names = boxes(reply.body)
    assert names[0] == "ftyp" and names.index("moov") < names.index("mdat")
    assert (b"avc1" if codec == "h264" else b"av01") in reply.body


def test_webm(daemon):
    job, reply = film(daemon, "vp9")
    assert job["result"]["film"] == "film.webm" and reply.headers["Content-Type"] == "video/webm"
    assert reply.body[:4] == b"\x1a\x45\xdf\xa3" and b"V_VP9" in reply.body


def test_gif_shows_the_frames_at_their_pace(daemon):
    job, reply = film(daemon, "gif", video_quality=100)
    pictures = Image.open(io.BytesIO(reply.body))
    assert pictures.n_frames >= 2 and pictures.size == (64, 48)
    lasts = 0
    for i in range(pictures.n_frames):
        pictures.seek(i)
        lasts += pictures.info["duration"]
    assert abs(lasts - 13 * 80) <= 90
    pictures.seek(0)
    frame = Image.open(io.BytesIO(daemon.get(f"/v1/jobs/{job['id']}/frames/0").body))
    difference = ImageChops.difference(pictures.convert("RGB"), frame.convert("RGB"))
    assert max(ImageStat.Stat(difference).mean) < 6


def test_the_frames_of_a_film_are_as_without_one(daemon):
    job, _ = film(daemon, "h264")
    plain = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=PATH))
    assert plain["result"].get("film") is None
    assert daemon.get(f"/v1/jobs/{plain['id']}/film").status == 404
    for i in (0, 12):
        assert daemon.get(f"/v1/jobs/{job['id']}/frames/{i}").body == \
            daemon.get(f"/v1/jobs/{plain['id']}/frames/{i}").body


def test_rate_and_size_are_told_and_can_be_chosen(daemon):
    job = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=PATH))
    assert {key: job["options"][key] for key in ("fps", "width", "height")} == \
        {"fps": 12.5, "width": 64, "height": 48}
    kept = daemon.post("/v1/camera-paths", {"name": "kept", "path": PATH})
    assert kept.status == 201
    job = daemon.wait(daemon.submit(type="path", scene="scene", path="kept", options={"fps": 25}))
    assert job["options"]["fps"] == 25 and job["result"]["frames"] == 26


@pytest.mark.parametrize("options, pointer", [
    ({"film": "theora"}, "#/options/film"), ({"video_quality": 101}, "#/options/video_quality"),
    ({"fps": 0}, "#/options/fps"), ({"fps": float("nan")}, None)])
def test_wrong_options_are_refused(daemon, options, pointer):
    body = {"type": "path", "scene": "scene", "camera_path": PATH, "options": options}
    reply = daemon.request("POST", "/v1/jobs", json.dumps(body).encode(),
                           {"Content-Type": "application/json"})
    assert reply.status in (400, 422)
    assert pointer is None or pointer in [e["pointer"] for e in reply.json["errors"]]


def test_without_the_module_no_frame_is_rendered(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FILM_MODULE": os.devnull})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("scene")
    job = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=PATH,
                                    options={"film": "h264"}))
    told = job["problem"]["detail"]
    assert job["state"] == "failed" and "films need ripnerf-film.so, which is not installed" in told
    assert "libavcodec-dev" in told and "-o FOLDER" in told
    assert daemon.get(f"/v1/jobs/{job['id']}/frames").json["items"] == []
    plain = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=PATH))
    assert plain["state"] == "succeeded" and plain["result"]["frames"] == 13
    assert daemon.get("/v1/info").json["films"] is False
    assert daemon.get(f"/v1/jobs/{job['id']}/film").status == 404
