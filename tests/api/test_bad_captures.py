"""Every reader and every fault that a capture of its layout may have: what is told, and what is kept.

FAULTS is the table: a fault, how a capture is spoilt, and for each reader what `validate` says.
The import does the same as `validate` says: a capture that cannot be read leaves nothing behind, a
photograph that cannot be used is left out and named, and what is merely told changes nothing.
"""

import json
import re
import struct
import subprocess
import zlib
from pathlib import Path

import pytest
from PIL import Image

from support import captures
from support.captures import COUNT, LAYOUTS
from support.checked import Daemon, make_tar
from support.client import INVALID, OK
from support.waiting import PATIENCE_S

FAKE = Path(__file__).parents[1] / "support" / "fake_colmap.py"
ENDS, LEFT_OUT, TOLD = "cannot be read", "a photograph is left out", "told"
NAN = float("nan")

BINARY, TEXT, STUDIO, NGP, OPENSFM, BUNDLER, LLFF, BLENDER, BARE = LAYOUTS
TRANSFORMS, TRAIN = "transforms.json#", "transforms_train.json#"


def where(binary="", text="", transforms="", llff="", train="", opensfm="reconstruction.json#/0/shots/p1.png",
          bundler="bundle.out:8"):
    """Where each reader finds the same fault."""
    return {BINARY: binary, TEXT: text, STUDIO: transforms, NGP: transforms, LLFF: llff,
            BLENDER: train, OPENSFM: opensfm, BUNDLER: bundler}


IMAGE = where('images.bin, image "p1.png"', 'images.txt, image "p1.png"', f"{TRANSFORMS}/frames/1",
              "poses_bounds.npy, row 1", f"{TRAIN}/frames/1")
POSE = IMAGE | where('images.bin, image "p1.png"', 'images.txt, image "p1.png"',
                     f"{TRANSFORMS}/frames/1/transform_matrix", "poses_bounds.npy, row 1",
                     f"{TRAIN}/frames/1/transform_matrix")


def all_of(kind, places, words, **others):
    return {layout: (kind, place, words) for layout, place in places.items()} | others


# ---- how captures are spoilt: before they are written, or after ----

def photograph(**members):
    def spoil(capture):
        for name, value in members.items():
            setattr(capture.photographs[1], name, value)
    return spoil


def set_pose(row, column, value):
    def spoil(capture):
        capture.photographs[1].pose[row][column] = value
    return spoil


def no_rotation(capture):
    capture.photographs[1].quaternion = (0.0, 0.0, 0.0, 0.0)
    for row in range(3):
        capture.photographs[1].pose[row][:3] = [0, 0, 0]


def no_images(capture):
    capture.photographs, capture.sightings = [], {}


def unknown_lens(capture):
    capture.extra["camera_model"] = "NEW_LENS"
    _, *rest = capture.cameras[2]
    capture.cameras[2] = ((99, "NEW_LENS"), *rest)


def elsewhere(capture):
    for one in capture.photographs:
        one.name = "/home/someone/shots/" + one.name


def unknown_ids(capture):
    """A camera, a point and a photograph of a list; a photograph that sees a point."""
    capture.sightings[2] = [5, 77]
    capture.sightings[77] = [5]
    capture.extra |= {"train_filenames": [one.name for one in capture.photographs] + ["images/none.png"]}


def unlink(layout, folder):
    (folder / "images" / "p1.png").unlink()


def cut_picture(layout, folder):
    path = folder / "images" / "p1.png"
    path.write_bytes(path.read_bytes()[:400])


def patch(name, offset, data):
    def spoil(layout, folder):
        path = folder / name
        content = bytearray(path.read_bytes())
        content[offset:offset + len(data)] = data
        path.write_bytes(content)
    return spoil


def huge_count(layout, folder):
    huge = 1 << 63
    if layout == BINARY:
        patch("sparse/0/images.bin", 0, struct.pack("<Q", huge))(layout, folder)
    elif layout == BUNDLER:
        path = folder / "bundle.out"
        path.write_text(path.read_text().replace("\n4 2\n", f"\n{huge} 2\n"))
    elif layout == LLFF:
        path = folder / "poses_bounds.npy"
        path.write_bytes(path.read_bytes().replace(b"(4, 17)", b"(%d, 17)" % huge))
    elif layout == BARE:
        header = struct.pack(">IIBBBBB", (1 << 31) - 1, (1 << 31) - 1, 8, 6, 0, 0, 0)
        parts = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(100))), (b"IEND", b""))
        (folder / "images" / "p1.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
            for name, data in parts))
    else:
        for path in folder.rglob("*.json" if layout != TEXT else "cameras.txt"):
            old = {TEXT: "PINHOLE 40", OPENSFM: '"width": 40'}.get(layout, '"w": 40')
            path.write_text(re.sub(old, old.replace("40", str(huge)), path.read_text()))


# What is spoilt: (before or None, after or None, {reader: (kind, where, words)}). A reader that
# cannot have the fault is missing, and NOT_THERE says why.
FAULTS = {
    "a count of 2^63": (None, huge_count, {
        BINARY: (ENDS, "images.bin", "9223372036854775808 records"),
        TEXT: (ENDS, "cameras.txt:3", "WIDTH"),
        STUDIO: (ENDS, "transforms.json", "integer"), NGP: (ENDS, "transforms.json", "integer"),
        LLFF: (ENDS, "poses_bounds.npy", "9223372036854775808 rows"),
        BLENDER: (ENDS, "transforms_train.json", "integer"),
        OPENSFM: (ENDS, "reconstruction.json", "integer"),
        BUNDLER: (ENDS, "bundle.out:2", "9223372036854775808 cameras"),
        BARE: (LEFT_OUT, "p1.png", "2147483647")}),
    "a camera that does not exist": (photograph(camera=7), None, {
        OPENSFM: (LEFT_OUT, f"{IMAGE[OPENSFM]}/camera", '"7", which is not among'),
        **{reader: (LEFT_OUT, IMAGE[reader], "camera 7, which is not among") for reader in (BINARY, TEXT)}}),
    "a point or a name that does not exist": (unknown_ids, None, {
        BINARY: (TOLD, "images.bin", "the first to point 77"),
        TEXT: (TOLD, "images.txt", "the first to point 77"),
        STUDIO: (TOLD, "transforms.json", "images/none.png"),
        NGP: (TOLD, "transforms.json", "images/none.png"),
        BUNDLER: (TOLD, "bundle.out", "1 of its sightings")}),
    "a photograph that is not there": (None, unlink, {
        **all_of(LEFT_OUT, IMAGE, "does not exist"),
        NGP: (TOLD, f"{TRANSFORMS}/frames/1/file_path", "does not exist"),
        LLFF: (ENDS, "poses_bounds.npy", "3 in images")}),
    "no images": (no_images, None, {
        BINARY: (ENDS, "images.bin", "has no images"), TEXT: (ENDS, "images.txt", "has no images"),
        STUDIO: (ENDS, "#/frames", ""), NGP: (ENDS, "#/frames", ""),
        OPENSFM: (ENDS, "#/0/shots", "none was placed"),
        BUNDLER: (ENDS, "bundle.out:2", "has no cameras"),
        LLFF: (ENDS, "poses_bounds.npy", "no rows"), BLENDER: (ENDS, "#/frames", "no views"),
        BARE: (ENDS, "", "holds no")}),
    "NaN in a pose": (set_pose(0, 3, NAN), None, all_of(LEFT_OUT, POSE, "finite")),
    "a pose at 1e300": (set_pose(0, 3, 1e300), None, all_of(LEFT_OUT, POSE, "beyond 1e12")),
    "a camera out of this world": (set_pose(0, 3, 9e11), None, {
        reader: (ENDS, "p1.png", "stands farthest") for reader in LAYOUTS if reader not in (BLENDER, BARE)}),
    "a rotation of length 0": (no_rotation, None, {
        **all_of(LEFT_OUT, POSE, "rotation"),
        **{reader: (LEFT_OUT, POSE[reader], "no length") for reader in (BINARY, TEXT)}}),
    "a size that differs": (photograph(size=(40, 40)), None, {
        **all_of(LEFT_OUT, IMAGE, "40x30"), STUDIO: (LEFT_OUT, f"{TRANSFORMS}/w", "40x40"),
        NGP: (LEFT_OUT, f"{TRANSFORMS}/w", "40x40"), BARE: (TOLD, "", "several sizes")}),
    "portrait among landscape": (photograph(size=(30, 40)), None, {
        **all_of(LEFT_OUT, IMAGE, "40x30"), STUDIO: (LEFT_OUT, f"{TRANSFORMS}/w", "30x40"),
        NGP: (LEFT_OUT, f"{TRANSFORMS}/w", "30x40"), BARE: (TOLD, "", "several sizes")}),
    "a mask of another size": (photograph(mask=(30, 30)), None,
                               {reader: (LEFT_OUT, "masks/p1.png.png", "the mask has 30x30 pixels")
                                for reader in LAYOUTS}),
    "a path that leaves the folder": (photograph(name="../../etc/p9.png"), None, {
        **all_of(LEFT_OUT, IMAGE | {BINARY: 'images.bin, image "../../etc/p9.png"',
                                    TEXT: 'images.txt, image "../../etc/p9.png"',
                                    OPENSFM: "#/0/shots/", STUDIO: f"{TRANSFORMS}/frames/", NGP: f"{TRANSFORMS}/frames/"},
                 "leaves the dataset's folder")}),
    "paths of another machine": (elsewhere, None, {
        reader: (TOLD, "", "found by its name") for reader in (BINARY, TEXT, STUDIO, NGP, OPENSFM, BUNDLER, BLENDER)}),
    "an unknown camera model": (unknown_lens, None, {
        BINARY: (ENDS, "cameras.bin, record 2 of 2", "the model 99"),
        TEXT: (LEFT_OUT, IMAGE[TEXT], "NEW_LENS"),
        OPENSFM: (LEFT_OUT, "#/0/cameras/2/projection_type", "NEW_LENS"),
        **{reader: (ENDS, "#/camera_model", "NEW_LENS") for reader in (STUDIO, NGP, BLENDER)}}),
    "a photograph that is cut": (None, cut_picture,
                                 {reader: (LEFT_OUT, "p1.png", "damaged") for reader in LAYOUTS}),
}
FAULTS["a path that leaves the folder"][2].pop(LLFF)
FAULTS["a rotation of length 0"][2].pop(OPENSFM)
FAULTS["a size that differs"][2].pop(BUNDLER)
FAULTS["portrait among landscape"][2].pop(BUNDLER)
NOT_THERE = {
    ("a camera out of this world", BLENDER): "has a sphere by its layout",
    ("a camera out of this world", BARE): "has no document"} | {
    ("a camera that does not exist", reader): "gives each photograph its camera in place"
    for reader in (STUDIO, NGP, BUNDLER, LLFF, BLENDER, BARE)} | {
    ("an unknown camera model", BUNDLER): "has one kind of lens",
    ("a size that differs", BUNDLER): "says no sizes",
    ("portrait among landscape", BUNDLER): "says no sizes"} | {
    ("a point or a name that does not exist", reader): "names nothing by an identifier"
    for reader in (LLFF, BLENDER, BARE)} | {
    ("a point or a name that does not exist", OPENSFM): "has tracks that became no point as a rule",
    ("a rotation of length 0", OPENSFM): "means that the camera is not turned"} | {
    (fault, BARE): "has no document" for fault in
    ("a photograph that is not there", "NaN in a pose", "a pose at 1e300", "a rotation of length 0",
     "a path that leaves the folder", "paths of another machine", "an unknown camera model")} | {
    (fault, LLFF): "names neither photographs nor a lens" for fault in
    ("a path that leaves the folder", "paths of another machine", "an unknown camera model")}
CASES = [(fault, reader) for fault, (_, _, told) in FAULTS.items() for reader in told]


@pytest.fixture(scope="module")
def daemon(programs, tmp_path_factory):
    with Daemon(*programs, tmp_path_factory.mktemp("captures") / "data",
                {"RIPNERF_COLMAP": str(FAKE)}) as running:
        yield running


def validate(build, folder):
    done = subprocess.run([build / "client" / "ripnerf", "--json", "validate", folder],
                          capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    return done.returncode, json.loads(done.stdout)


def tells(problems, place, words, severities=("info", "warning", "error")):
    return any(place in problem["where"] and words in problem["where"] + problem["text"]
               and problem["severity"] in severities for problem in problems)


def upload(daemon, folder, name, **query):
    return daemon.wait(daemon.upload(re.sub(r"[^a-z0-9]+", "-", name.lower()), folder, **query))


def assert_nothing_is_kept(daemon, job):
    assert job["state"] == "failed", job
    assert daemon.get(f"/v1/datasets/{job['dataset']}").status == 404
    assert not (Path(daemon.data) / "datasets" / job["dataset"]).exists()
    assert not list((Path(daemon.data) / "spool").glob(f"*{job['id']}*"))
    assert str(daemon.data) not in json.dumps(job)


def test_the_table_is_whole():
    for fault in FAULTS:
        for reader in LAYOUTS:
            assert ((fault, reader) in CASES) != ((fault, reader) in NOT_THERE), (fault, reader)


def farthest(cameras, capture):
    """From the capture's own poses: of rotations, and of centres as a share of the scene's size."""
    poses = {Path(one.name).stem: one.pose for one in capture.photographs}
    centres = list(zip(*[[row[3] for row in one[:3]] for one in poses.values()]))
    size = max(max(axis) - min(axis) for axis in centres)
    worst = 0
    for camera in cameras:
        assert camera["camera"]["axes"] == "opencv"
        for row, mine in zip(camera["camera"]["world_from_camera"], poses[camera["name"]]):
            right, up, back, centre = row[0], -row[1], -row[2], row[3]
            worst = max(worst, *(abs(a - b) for a, b in zip((right, up, back), mine)),
                        abs(centre - mine[3]) / size)
    return worst


@pytest.mark.parametrize("layout", LAYOUTS)
def test_it_is_sound_without_a_fault(build, daemon, tmp_path, layout):
    """One scene, anywhere in the world: every layout that has poses gives the same ones."""
    capture = captures.make()
    captures.put_elsewhere(capture)
    folder = captures.write(layout, capture, tmp_path / "data")
    code, report = validate(build, folder)
    assert code == OK and report["errors"] == 0, report
    assert layout == BARE or report["usable"]["train"] == COUNT
    job = upload(daemon, folder, f"sound-{layout}", **({"poses": "find"} if layout == BARE else {}))
    assert job["state"] == "succeeded", job
    assert daemon.get(f"/v1/datasets/{job['dataset']}").json["views"]["train"] == COUNT
    cameras = daemon.get(f"/v1/datasets/{job['dataset']}/cameras").json["items"]
    assert layout == BARE or farthest(cameras, capture) < 1e-6, cameras


@pytest.mark.parametrize("fault, layout", CASES, ids=[f"{a}: {b}" for a, b in CASES])
def test_fault(build, daemon, tmp_path, fault, layout):
    before, after, told = FAULTS[fault]
    kind, place, words = told[layout]
    capture = captures.make()
    if before:
        before(capture)
    folder = captures.write(layout, capture, tmp_path / "data")
    if after:
        after(layout, folder)
    code, report = validate(build, folder)
    assert code == (OK if kind == TOLD else INVALID), report
    severities = ("info", "warning") if kind == TOLD else ("error",)
    assert tells(report["problems"], place, words, severities), report["problems"]
    if kind == LEFT_OUT:
        assert report["errors"] == 1, report["problems"]
        assert layout == BARE or report["usable"]["train"] == COUNT - 1, report
    if fault == "no images" and layout == BARE:
        return  # the client finds nothing to send
    job = upload(daemon, folder, f"{fault}-{layout}"[:60],
                 **({"poses": "find"} if layout == BARE else {}))
    if kind == ENDS:
        assert_nothing_is_kept(daemon, job)
        return
    assert job["state"] == "succeeded", job
    dataset = daemon.get(f"/v1/datasets/{job['dataset']}").json
    gone = kind == LEFT_OUT or fault == "a photograph that is not there"
    assert dataset["views"]["train"] == COUNT - gone
    assert kind == TOLD or tells(dataset["report"]["problems"], place, words, severities), dataset
    assert str(daemon.data) not in json.dumps(dataset)


@pytest.mark.parametrize("layout", [layout for layout in LAYOUTS if layout != BARE])
def test_cut_anywhere(build, tmp_path, layout):
    """A document that ends early never passes for whole: something is said of it."""
    folder = captures.write(layout, captures.make(), tmp_path / "data")
    for name in LAYOUTS[layout][1]:
        whole = (folder / name).read_bytes()
        for size in sorted({len(whole) * k // 41 for k in range(41)} | {len(whole) - 1}):
            (folder / name).write_bytes(whole[:size])
            code, report = validate(build, folder)
            part = Path(name).stem
            assert code == INVALID or tells(report["problems"], "", part, ("warning",)), (name, size)
            assert tells(report["problems"], "", part, ("warning", "error")), (name, size, report)
        (folder / name).write_bytes(whole)


@pytest.mark.parametrize("offset, name", [(-1, "cameras.bin"), (0, "images.bin"), (-1, "points3D.bin")])
def test_counts_within_records(build, tmp_path, offset, name):
    """How many keypoints an image has and how many photographs see a point, as well."""
    folder = captures.write(BINARY, captures.make(), tmp_path / "data")
    inner = {"cameras.bin": 0, "images.bin": 8 + 64 + len("p0.png\0"),
             "points3D.bin": 8 + 8 + 24 + 3 + 8}[name]
    patch(f"sparse/0/{name}", inner, struct.pack("<Q", 1 << 63))(BINARY, folder)
    code, report = validate(build, folder)
    assert code == INVALID and tells(report["problems"], name, ""), report["problems"]


def test_views_that_are_trained_on_test_nothing(build, tmp_path):
    """transforms_test.json names what transforms_train.json does: what it would score is not unseen."""
    folder = captures.write(BLENDER, captures.make(), tmp_path / "data")
    train = json.loads((folder / "transforms_train.json").read_text())
    alone = train["frames"].pop()
    (folder / "transforms_train.json").write_text(json.dumps(train))
    (folder / "transforms_val.json").write_text(json.dumps({**train, "frames": [alone]}))
    (folder / "transforms_test.json").write_text(json.dumps(train))
    code, report = validate(build, folder)
    assert code == OK
    assert report["usable"] == {"train": COUNT - 1, "val": 1, "test": 0}
    shared = [problem["text"] for problem in report["problems"] if "trained on too" in problem["text"]]
    assert len(shared) == 1
    assert f"{COUNT - 1} of {COUNT - 1} test views" in shared[0] and "--split every:8" in shared[0]


def test_an_archive_that_is_cut(daemon, tmp_path):
    """Anywhere: in a header, in a file, between files, in the zeros at its end."""
    archive = make_tar(captures.write(STUDIO, captures.make(), tmp_path / "data"))
    content = archive.rstrip(b"\0")
    ends = sorted({len(content) * k // 23 for k in range(1, 23)} |
                  {512 * (len(content) // 512 * k // 11) for k in range(1, 11)})
    for number, size in enumerate(ends):
        reply = daemon.post("/v1/datasets", body=archive[:size], query={"name": f"cut-{number}"},
                            headers={"Content-Type": "application/x-tar"})
        if reply.status != 202:
            assert reply.status == 422 and "tar" in reply.json["detail"], reply.body
            continue
        job = daemon.wait(reply.json["id"])
        assert "tar" in job["problem"]["detail"], job
        assert_nothing_is_kept(daemon, job)
