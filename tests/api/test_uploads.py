"""Uploads in parts: they go on after a lost connection and after a restart, and become one dataset."""

import json
import os
import socket
from pathlib import Path

import pytest

from support.checked import Daemon, make_tar, tar_of
from support.client import Client
from support.fake_daemon import FakeDaemon
from support.photographs import write_blank_dataset

PART = "application/offset+octet-stream"


@pytest.fixture(scope="module")
def tar(photographs):
    return make_tar(photographs)


def begin(daemon, size, **more):
    reply = daemon.post("/v1/uploads", {"size_bytes": size, **more})
    assert reply.status == 201, reply.body
    assert reply.headers["Location"] == f"/v1/uploads/{reply.json['id']}"
    assert reply.headers["Upload-Offset"] == "0" and reply.json["offset"] == 0
    return reply.json["id"]


def send(daemon, upload, offset, data, **headers):
    return daemon.request("PATCH", f"/v1/uploads/{upload}", data,
                          {"Content-Type": PART, "Upload-Offset": str(offset), **headers})


def there(daemon, upload):
    reply = daemon.get(f"/v1/uploads/{upload}")
    head = daemon.request("HEAD", f"/v1/uploads/{upload}")
    assert head.status == 200 and head.body == b""
    assert head.headers["Upload-Offset"] == reply.headers["Upload-Offset"] == str(reply.json["offset"])
    return reply.json["offset"]


def cut_off(daemon, upload, offset, announced, data):
    """Sends so much of a part and hangs up; waits until that has arrived."""
    with socket.create_connection((daemon.host, daemon.port), timeout=60) as line:
        line.sendall(f"PATCH /v1/uploads/{upload} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
                     f"Content-Type: {PART}\r\nUpload-Offset: {offset}\r\n"
                     f"Content-Length: {announced}\r\n\r\n".encode() + data)
        daemon.eventually(lambda: there(daemon, upload) == offset + len(data))


def test_parts_become_a_dataset(shared, tar, photographs):
    upload = begin(shared, len(tar), name="in-parts")
    third = len(tar) // 3
    assert send(shared, upload, 0, tar[:third]).status == 204
    reply = send(shared, upload, third, tar[third:2 * third])
    assert reply.status == 204 and reply.headers["Upload-Offset"] == str(2 * third)
    early = shared.post("/v1/datasets", {"name": "in-parts", "upload": upload})
    assert early.status == 409 and str(len(tar)) in early.json["detail"]
    cut_off(shared, upload, 2 * third, third, tar[2 * third:2 * third + 1000])
    at = there(shared, upload)
    assert at == 2 * third + 1000
    assert send(shared, upload, at - 500, tar[at - 500:]).status == 204  # the same bytes again
    wanted = {"name": "in-parts", "upload": upload, "options": {"split": "every:2"}}
    job = shared.post("/v1/datasets", wanted)
    assert job.status == 202, job.body
    again = shared.post("/v1/datasets", wanted)  # whose answer was lost
    assert again.status == 202 and again.json["id"] == job.json["id"]
    assert shared.wait(job.json["id"])["state"] == "succeeded"
    assert shared.get("/v1/datasets/in-parts").json["views"]["test"] > 0
    assert shared.get(f"/v1/uploads/{upload}").status == 404
    assert shared.post("/v1/datasets", {"name": "other", "upload": upload}).status == 404
    taken = shared.post("/v1/uploads", {"size_bytes": 9, "name": "in-parts"})
    assert taken.status == 409 and taken.json["errors"][0]["pointer"] == "#/name"
    shared.delete("/v1/datasets/in-parts")


def test_what_is_wrong_with_a_part(shared):
    upload = begin(shared, 100)
    ahead = send(shared, upload, 50, b"x" * 10)
    assert ahead.status == 409 and ahead.headers["Upload-Offset"] == "0"
    assert send(shared, upload, 0, b"x" * 101).status == 413
    assert send(shared, upload, -1, b"x").status == 422
    for other in ("application/x-tar", PART + "s"):
        assert send(shared, upload, 0, b"x", **{"Content-Type": other}).status == 415
    assert there(shared, upload) == 0
    assert send(shared, "up_aaaaaaaaaaaa", 0, b"x").status == 404
    assert send(shared, upload, 0, b"x" * 100).status == 204
    assert send(shared, upload, 100, b"").status == 204  # nothing is missing
    assert shared.delete(f"/v1/uploads/{upload}").status == 204
    assert shared.get(f"/v1/uploads/{upload}").status == 404
    assert shared.delete(f"/v1/uploads/{upload}").status == 404
    assert not list(Path(shared.data).glob("spool/up_*"))


FRAMES = b'{"camera_angle_x": 0.6, "frames": [{"file_path": "%s", "transform_matrix": 1}]}'
SPOILT = {"no layout": {"notes.txt": b"hello"},
          "no poses": {"transforms_train.json": FRAMES % b"./a"},
          "no JSON": {"transforms_train.json": b"{"},
          "no numbers": {"transforms.json": b'{"fl_x": "x", "frames": []}'},
          "a path that goes out": {"transforms_train.json": FRAMES % b"../../a"},
          "no model": {"sparse/0/cameras.txt": b"1 NOTHING 2 2 1", "sparse/0/images.txt": b"",
                       "images/a.png": b"x"}}


def in_parts(daemon, files):
    """The upload's id: of files, sent whole."""
    packed = tar_of(files)
    upload = begin(daemon, len(packed))
    assert send(daemon, upload, 0, packed).status == 204
    return upload


@pytest.mark.parametrize("folder", SPOILT)
def test_where_an_upload_was_unpacked_is_told_to_nobody(shared, folder):
    """Of what is sent; and what a browser or the client sends was a folder, or looked like one."""
    for kind in ("dataset", "validate"):
        upload = in_parts(shared, SPOILT[folder])
        if kind == "dataset":
            reply = shared.post("/v1/datasets", {"name": "spoilt", "upload": upload})
        else:
            reply = shared.post("/v1/jobs", {"type": "validate", "upload": upload})
        assert reply.status == 202, reply.body
        job = shared.wait(reply.json["id"])
        assert job["state"] == "failed" or job["result"]["report"]["errors"], job
        told = json.dumps(job)
        assert "spool" not in told and str(shared.data) not in told and "the archive" not in told, told
        if folder == "no layout" and kind == "dataset":
            assert "the folder" in told


@pytest.mark.parametrize("body, status", [
    ({}, 422), ({"size_bytes": 0}, 422), ({"size_bytes": "1"}, 422), ({"size_bytes": 1 << 49}, 413),
    ({"size_bytes": 5, "name": "a b"}, 422)])
def test_what_is_wrong_with_an_upload(shared, body, status):
    assert shared.post("/v1/uploads", body).status == status


@pytest.mark.parametrize("body", [
    {"name": "x"}, {"name": "x", "upload": "up_aaaaaaaaaaaa", "directory": "/data"}])
def test_a_dataset_has_one_source(shared, body):
    reply = shared.post("/v1/datasets", body)
    assert reply.status == 422 and "exactly one" in reply.json["errors"][0]["detail"]


def test_an_upload_outlives_the_daemon_and_not_a_day(programs, tar, tmp_path):
    with Daemon(*programs, tmp_path / "d") as daemon:
        upload, old = begin(daemon, len(tar)), begin(daemon, len(tar))
        assert send(daemon, upload, 0, tar[:5000]).status == 204
        assert send(daemon, old, 0, tar[:5000]).status == 204
        daemon.stop(how=9)
        (file,) = (tmp_path / "d" / "spool").glob(f"{old}-*")
        os.utime(file, (file.stat().st_mtime - 90000,) * 2)
        daemon.start()
        assert daemon.get(f"/v1/uploads/{old}").status == 404 and not file.exists()
        assert there(daemon, upload) == 5000
        assert send(daemon, upload, 5000, tar[5000:]).status == 204
        job = daemon.post("/v1/datasets", {"name": "data", "upload": upload}).json["id"]
        assert daemon.wait(job)["state"] == "succeeded"


def test_open_uploads_have_a_limit(make_daemon):
    daemon = make_daemon()
    uploads = [begin(daemon, 10) for _ in range(64)]
    assert daemon.post("/v1/uploads", {"size_bytes": 10}).status == 503
    daemon.delete(f"/v1/uploads/{uploads[0]}")
    begin(daemon, 10)


@pytest.mark.parametrize("cut_after", [0, 100, 3000])
def test_the_client_goes_on_after_a_lost_connection(build, tmp_path, cut_after):
    folder = write_blank_dataset(tmp_path / "blank")
    with FakeDaemon() as daemon:
        daemon.cut_after = cut_after
        client = Client(build / "client" / "ripnerf", tmp_path, daemon.url)
        result = client.run("import", folder, "--name", "blank")
        assert "the connection is lost; trying again in 0.2 s" in result.stderr
        offsets = [int(headers["Upload-Offset"]) for method, _, headers, _ in daemon.requests
                   if method == "PATCH"]
        assert offsets == [0, cut_after]  # what has arrived is not sent again
        for name, data in daemon.uploads["blank"].items():
            assert data == (folder / name).read_bytes()
