"""Bad datasets, one defect each: `validate` and the daemon's import name the file and the field."""

import json
import struct
import subprocess
import tarfile
import zlib
from pathlib import Path

import pytest
from PIL import Image

from support import heif
from support.checked import Daemon, make_tar
from support.client import INVALID, OK
from support.photographs import pose, write_dataset
from support.waiting import PATIENCE_S

TRAIN = "transforms_train.json"
FIRST = f"{TRAIN}#/frames/0/file_path"


@pytest.fixture(scope="module")
def daemon(build, tmp_path_factory):
    with Daemon(build / "server" / "ripnerfd", build / "server" / "ripnerf-runner",
                tmp_path_factory.mktemp("bad") / "data") as running:
        yield running


def image(folder, name="r_0.png"):
    return folder / "train" / name


def edit(folder, change, name=TRAIN):
    document = json.loads((folder / name).read_text())
    change(document)
    (folder / name).write_text(json.dumps(document))


def put(folder, text, name=TRAIN):
    (folder / name).write_text(text)


def set_pose(matrix):
    return lambda folder: edit(folder, lambda d: d["frames"][0].update(transform_matrix=matrix))


def set_path(path):
    return lambda folder: edit(folder, lambda d: d["frames"][0].update(file_path=path))


def saved(mode, kind="png", size=(16, 16), **options):
    """Replaces the first photograph by one of another kind under the same name."""
    def spoil(folder):
        Image.new(mode, size, 40).save(image(folder), kind, **options)
    return spoil


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(width, height, depth, colour, interlace, rows):
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlace)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def raw(content):
    return lambda folder: image(folder).write_bytes(content)


def cut_jpeg(folder):
    """Its head is sound, its picture ends too early."""
    name = image(folder, "r_0.jpg")
    Image.frombytes("RGB", (16, 16), bytes(range(256)) * 3).save(name, "jpeg", quality=100)
    name.write_bytes(name.read_bytes()[:-100])
    set_path("./train/r_0.jpg")(folder)


def duplicate_keys(folder):
    put(folder, '{"camera_angle_x": 0.7, "camera_angle_x": 0.8, "frames": []}')


SCALED = [[2 * value for value in row] for row in pose(0)[:3]] + [[0, 0, 0, 1]]
MIRRORED = [[-row[0], *row[1:]] for row in pose(0)[:3]] + [[0, 0, 0, 1]]
NOT_A_NUMBER = json.loads(json.dumps(pose(0)).replace("0.0", "0", 1))
NOT_A_NUMBER[1][3] = float("nan")
GRID = (1, "grid", heif.grid(1, 1, 64, 64), [heif.size(64, 64), heif.bits(8, 8, 8)])
HUGE = png(100000, 100000, 8, 6, 0, b"\0" * 100)

# What is spoilt, how, where the problem is said to be, and a word of what is said. An image that
# cannot be used is reported and left out by the daemon; a document that cannot be read ends the job.
IMAGES = {
    "missing": (lambda folder: image(folder).unlink(), FIRST, "r_0"),
    "truncated": (lambda folder: image(folder).write_bytes(image(folder).read_bytes()[:60]),
                  "train/r_0.png", "damaged"),
    "truncated JPEG": (cut_jpeg, "train/r_0.jpg", "damaged"),
    "empty": (raw(b""), FIRST, ""),
    "no image": (raw(b"#!/bin/sh\n" * 20), FIRST, ""),
    "huge": (raw(HUGE), FIRST, "100000"),
    "HEIC its own tile": (raw(heif.file([GRID], [("dimg", 1, [1])])), FIRST, "made of itself"),
    "HEIC tiles of each other": (raw(heif.file(
        [GRID, (2, *GRID[1:])], [("dimg", 1, [2]), ("dimg", 2, [1])])), FIRST, "made of itself"),
    "HEIC alpha of its alpha": (raw(heif.file(
        [heif.tile(i, 64, 64, heif.alpha()) for i in (1, 2)],
        [("auxl", 1, [2]), ("auxl", 2, [1])])), FIRST, "made of itself"),
    "HEIC of a huge size": (raw(heif.file(
        [(*GRID[:3], [heif.size(60000, 60000)]), heif.tile(2)], [("dimg", 1, [2])])), FIRST,
                            "over a limit"),
    "HEIC of another size": (raw(heif.file(
        [(1, "grid", heif.grid(1, 1, 32000, 32000), [heif.size(16, 16)]), heif.tile(2)], [("dimg", 1, [2])])),
                             "r_0.png", "over a limit"),
    # What asks for more than it says, before room is made for it: 1 to 5 GB for 400 bytes.
    "HEIC of a large grid": (raw(heif.file(
        [(1, "grid", heif.grid(1, 1, 16384, 16384), [heif.size(16, 16)]), heif.tile(2)], [("dimg", 1, [2])])),
                             "r_0.png", "over a limit"),
    "HEIC grid in a grid": (raw(heif.file(
        [(1, "grid", heif.grid(1, 1, 16, 16), [heif.size(16, 16)]),
         (3, "grid", heif.grid(1, 1, 16384, 16384), [heif.size(16, 16)]), heif.tile(2)],
        [("dimg", 1, [3]), ("dimg", 3, [2])])), "r_0.png", "over a limit"),
    "HEIC of another grid": (raw(heif.file(
        [(1, "grid", heif.grid(1, 1, 16384, 8192), [heif.size(16, 16)]), heif.tile(2)], [("dimg", 1, [2])])),
                             "r_0.png", "another size (16384 x 8192) than its header says (16 x 16)"),
    "HEIC overlay of nothing": (raw(heif.file(
        [(1, "iovl", heif.overlay(16, 16), [heif.size(16, 16)]), heif.tile(2)], [("dimg", 1, [3])])),
                                "r_0.png", "laid over others"),
    "HEIC identity of nothing": (raw(heif.file(
        [(1, "iden", b"", [heif.size(16, 16)]), heif.tile(2)], [("dimg", 1, [3])])), "r_0.png", "derived"),
    "HEIC coded larger": (raw(heif.file(
        [(1, "hvc1", heif.coded()[1], [heif.configured(32768, 32768), heif.size(16, 16)])], [])),
                          "r_0.png", "32768 x 32768"),
    "HEIC coded larger within": (raw(heif.file(
        [(1, "hvc1", struct.pack(">I", len(heif.parameters(32768, 32768))) + heif.parameters(32768, 32768)
          + heif.coded()[1], [heif.coded()[0], heif.size(16, 16)])], [])), "r_0.png", "32768 x 32768"),
    "AVIF coded larger": (raw(heif.file([heif.av1(32768, 32768)], [])), "r_0.png", "32768 x 32768"),
    "AVIF of another size": (raw(heif.file([heif.av1(8192, 8192)], [])), "r_0.png",
                             "another size (8192 x 8192) than its header says (16 x 16)"),
    "HEIC that is cut": (raw(heif.tiled(2, 2)[:-20]), FIRST, "damaged"),
    "HEIC tiles of tiles": (raw(heif.file(
        [(i, "grid", heif.grid(128, 128, 8192, 8192), GRID[3]) for i in (1, 2, 3)] + [heif.tile(4, 8, 8)],
        [("dimg", i, [i + 1] * 128 * 128) for i in (1, 2, 3)])), FIRST, "65536 parts"),
    "cmyk": (lambda folder: (saved("CMYK", "jpeg")(folder),
                             image(folder).rename(image(folder, "r_0.jpg")),
                             set_path("./train/r_0.jpg")(folder)), FIRST, "CMYK"),
    "another size": (lambda folder: (edit(folder, lambda d: d.update(w=16, h=16)),
                                     saved("RGB", size=(20, 12))(folder)), f"{TRAIN}#/frames/0",
                     "20x12 pixels, the file says 16x16"),
    "NaN in a pose": (set_pose(NOT_A_NUMBER), f"{TRAIN}#/frames/0/transform_matrix/1/3", "finite"),
    "a scaled pose": (set_pose(SCALED), f"{TRAIN}#/frames/0/transform_matrix", "rotation"),
    "a mirrored pose": (set_pose(MIRRORED), f"{TRAIN}#/frames/0/transform_matrix", "mirrored"),
    "a name with ..": (set_path("../../etc/passwd"), FIRST, ""),
    "an absolute name": (set_path("/etc/passwd"), FIRST, ""),
}
DOCUMENTS = {
    "zero views": (lambda folder: edit(folder, lambda d: d.update(frames=[])), f"{TRAIN}#/frames",
                   "no views"),
    "duplicate keys": (duplicate_keys, TRAIN, "camera_angle_x"),
    "no JSON": (lambda folder: put(folder, "{"), TRAIN, ""),
    "a huge number": (lambda folder: put(folder, '{"camera_angle_x": 1e999, "frames": []}'), TRAIN,
                      ""),
    "no field of view": (lambda folder: edit(folder, lambda d: d.pop("camera_angle_x")), TRAIN,
                         "camera_angle_x"),
}
# Unusual, and read all the same.
GOOD = {
    "16-bit": raw(png(16, 16, 16, 6, 0, (b"\0" + b"\x80\x01" * 64) * 16)),
    "interlaced": raw(png(16, 16, 8, 6, 1, b"".join(
        (b"\0" + b"\x80" * (4 * w)) * h
        for w, h in ((2, 2), (2, 2), (4, 2), (4, 4), (8, 4), (8, 8), (16, 8))))),
    "palette": saved("P"),
    "grey": saved("L"),
    "HEIC of tiles": raw(heif.tiled(4, 3, 250, 190)),
    "AVIF": raw(heif.file([heif.av1(16, 16)], [])),
    "spaces and unicode": lambda folder: (
        image(folder).rename(image(folder, "zwölf Äpfel 日本.png")),
        set_path("./train/zwölf Äpfel 日本")(folder)),
}


def validate(build, folder):
    done = subprocess.run([build / "client" / "ripnerf", "--json", "validate", folder],
                          capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    return done.returncode, json.loads(done.stdout)


def upload(daemon, folder, name):
    job = daemon.wait(daemon.upload(name.replace(" ", "-"), folder))
    assert daemon.get("/healthz").status == 200
    return job


def is_said(problem, where, word):
    return problem["where"].endswith(where) and word in problem["text"]


@pytest.mark.parametrize("what", IMAGES)
def test_bad_image(build, daemon, tmp_path, what):
    spoil, where, word = IMAGES[what]
    spoil(write_dataset(tmp_path / "data"))
    code, report = validate(build, tmp_path / "data")
    assert code == INVALID and report["errors"] == 1
    assert is_said(report["problems"][0], where, word), report["problems"]
    job = upload(daemon, tmp_path / "data", "image-" + what.replace("..", "dots"))
    assert job["state"] == "succeeded", job
    dataset = daemon.get(f"/v1/datasets/{job['dataset']}").json
    assert dataset["views"] == {"train": 5, "val": 8, "test": 4}
    assert dataset["report"]["usable"]["train"] == 5 and dataset["report"]["unusable"]["train"] == 1
    assert any(is_said(problem, where, word) for problem in dataset["report"]["problems"])
    assert str(daemon.data) not in json.dumps(dataset)  # nobody needs to know where it was unpacked


@pytest.mark.parametrize("what", DOCUMENTS)
def test_bad_document(build, daemon, tmp_path, what):
    spoil, where, word = DOCUMENTS[what]
    spoil(write_dataset(tmp_path / "data"))
    code, report = validate(build, tmp_path / "data")
    assert code == INVALID and report["errors"] >= 1
    assert any(where in problem["where"] and word in problem["where"] + problem["text"]
               for problem in report["problems"]), report["problems"]
    job = upload(daemon, tmp_path / "data", "document " + what)
    assert job["state"] == "failed" and where in job["problem"]["detail"], job
    assert str(daemon.data) not in json.dumps(job)


def test_unknown_members_are_named(build, daemon, tmp_path):
    """Other programs write members of their own into this layout: a warning, no error."""
    edit(write_dataset(tmp_path / "data"), lambda d: d["frames"][0].update(colour=3))
    code, report = validate(build, tmp_path / "data")
    assert code == OK and report["warnings"] == 1
    assert "colour" in report["problems"][0]["where"] + report["problems"][0]["text"]
    assert TRAIN in report["problems"][0]["where"]
    job = upload(daemon, tmp_path / "data", "unknown")
    assert daemon.get(f"/v1/datasets/{job['dataset']}").json["report"]["warnings"] == 1


@pytest.mark.parametrize("what", GOOD)
def test_unusual_image(build, daemon, tmp_path, what):
    GOOD[what](write_dataset(tmp_path / "data"))
    code, report = validate(build, tmp_path / "data")
    assert code == OK and report["usable"]["train"] == 6, report["problems"]
    rounded = [item for item in report["problems"] if is_said(item, FIRST, "16 bits a channel")]
    assert len(rounded) == (what == "16-bit")
    job = upload(daemon, tmp_path / "data", "good " + what)
    assert job["state"] == "succeeded", job
    assert daemon.get(f"/v1/datasets/{job['dataset']}").json["views"]["train"] == 6


def entry(name, kind=tarfile.REGTYPE, target="", size=0):
    info = tarfile.TarInfo(name)
    info.type, info.linkname, info.size = kind, target, size
    return info


@pytest.mark.parametrize("info", [
    entry("link.png", tarfile.SYMTYPE, "/etc/passwd"), entry("hard.png", tarfile.LNKTYPE, "x"),
    entry("/absolute.png"), entry("../outside.png"), entry("pipe.png", tarfile.FIFOTYPE),
    entry("claims-too-much.png", size=1 << 40)], ids=lambda info: info.name)
def test_bad_archive(daemon, tmp_path, info):
    """The job fails and names the entry; nothing of it stays."""
    archive = make_tar(write_dataset(tmp_path / "data"))
    spoilt = info.tobuf(tarfile.USTAR_FORMAT if info.size < 1 << 33 else tarfile.GNU_FORMAT) + archive
    reply = daemon.post("/v1/datasets", body=spoilt, query={"name": "archive"},
                        headers={"Content-Type": "application/x-tar"})
    assert reply.status == 202, reply.body
    job = daemon.wait(reply.json["id"])
    assert job["state"] == "failed" and info.name in job["problem"]["detail"], job
    assert daemon.get("/v1/datasets/archive").status == 404
    assert not (Path(daemon.data) / "datasets" / job["dataset"]).exists()
    daemon.eventually(lambda: not list((Path(daemon.data) / "spool").glob(f"*{job['id']}*")))


@pytest.mark.parametrize("name", ["..", "a/b", "two words", "größe", "a" * 65, ".hidden", "-x",
                                  "ds_aaaaaaaaaaaa", ""])
def test_bad_name(daemon, tmp_path, name):
    archive = make_tar(write_dataset(tmp_path / "data"))
    reply = daemon.post("/v1/datasets", body=archive, query={"name": name},
                        headers={"Content-Type": "application/x-tar"})
    assert reply.status == 422 and reply.json["detail"].startswith("name"), reply.body
    reply = daemon.post("/v1/jobs", {"type": "train", "dataset": "x", "scene": name})
    assert reply.status == 422 and reply.json["errors"][0]["pointer"] == "#/scene", reply.body
