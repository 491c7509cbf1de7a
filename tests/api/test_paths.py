"""Camera paths of other programs, in both directions; what goes where, and what is refused."""

import json
import math
import os
from pathlib import Path

import pytest

from support.checked import Daemon
from support.client import Client
from support.photographs import pose, write_dataset

FORMATS = ["nerfstudio", "instant-ngp", "nerfbaselines", "transforms", "colmap", "supersplat", "3dgs"]
EXACT = [name for name in FORMATS if name != "supersplat"]  # which has no roll
USAGE, INVALID, FAILED = 2, 4, 1


def look(eye, up=(0, 0, 1)):
    """world-from-camera, OpenCV axes, of a camera at `eye` that looks at the origin."""
    def cross(a, b):
        return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

    def unit(a):
        return [x / math.sqrt(sum(y * y for y in a)) for x in a]
    forward = unit([-x for x in eye])
    right = unit(cross(forward, up))
    down = cross(forward, right)
    return [[right[i], down[i], forward[i], eye[i]] for i in range(3)]


def ring(count, **more):
    keys = [{"time": float(i), "fov_y_deg": 40.0,
             "world_from_camera": look([3 * math.cos(i), 3 * math.sin(i), 1.2])}
            for i in range(count)]
    return {"axes": "opencv", "fps": 4, "width": 64, "height": 48, "keys": keys, **more}


@pytest.fixture
def client(build, tmp_path):
    return Client(build / "client" / "ripnerf", tmp_path, "http://127.0.0.1:1")


@pytest.fixture
def run(client, tmp_path):
    """run(IN, OUT, ...) converts in the test's folder and returns OUT's native path."""
    def convert(source, target, *options, code=0):
        result = client.run("paths", "convert", source, target, *options, code=code)
        return result if code else read(tmp_path / target)
    return convert


def read(file):
    return json.loads(file.read_text())["path"] if file.suffix == ".json" else file.read_text()


def write(file, document):
    file.write_text(document if isinstance(document, str) else json.dumps(document))


def far(a, b):
    return max(abs(x - y) for p, q in zip(a["world_from_camera"], b["world_from_camera"])
               for x, y in zip(p, q))


@pytest.mark.parametrize("name", EXACT)
def test_cameras_come_back_as_they_went(run, client, tmp_path, name):
    write(tmp_path / "a.json", {"path": ring(3)})
    out = "images.txt" if name == "colmap" else "b.json"
    client.run("paths", "convert", "a.json", out, "--to", name)
    space = ["--space", "dataset"] if name == "nerfstudio" else []
    back = run(out, "c.json", "--from", name, "--fps", "4", "--seconds", "2", "--size", "64x48", *space)
    first, last = ring(3)["keys"][0], ring(3)["keys"][-1]
    assert far(back["keys"][0], first) < 1e-9 and far(back["keys"][-1], last) < 1e-9
    assert back["keys"][-1]["time"] == pytest.approx(2)
    assert all(key["fov_y_deg"] == pytest.approx(40) for key in back["keys"])


def test_supersplat_keeps_place_direction_and_field_of_view(run, client, tmp_path):
    write(tmp_path / "a.json", {"path": ring(3)})
    client.run("paths", "convert", "a.json", "b.json", "--to", "supersplat")
    back = run("b.json", "c.json", "--size", "64x48")
    for a, b in zip(ring(3)["keys"], back["keys"]):
        for row, other in zip(a["world_from_camera"], b["world_from_camera"]):
            assert row[2:] == pytest.approx(other[2:], abs=1e-9)
        assert b["fov_y_deg"] == pytest.approx(40)


def test_a_known_camera_in_each_programs_own_words(run, tmp_path):
    """At (0, -4, 0) and looking along y, z upwards: written by hand after each program's rules."""
    wanted = {"world_from_camera": [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]}
    gl = [[1, 0, 0, 0], [0, 0, -1, -4], [0, 1, 0, 0], [0, 0, 0, 1]]
    half = math.sqrt(0.5)
    ngp_fov = {"fov": 40.0, "slice": 0, "scale": 1, "aperture_size": 0}
    cases = {
        "nerfstudio": {"camera_type": "perspective", "camera_path": [
            {"camera_to_world": sum(gl, []), "fov": 40, "aspect": 1}]},
        "transforms": {"camera_angle_y": math.radians(40), "frames": [
            {"file_path": "a", "transform_matrix": gl}]},
        "nerfbaselines": {"format": "nerfbaselines-v1", "image_size": [64, 48], "frames": [
            {"pose": sum(wanted["world_from_camera"], []),
             "intrinsics": [24 / math.tan(math.radians(20))] * 2 + [32, 24]}]},
        "3dgs": [{"position": [0, -4, 0], "rotation": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
                  "width": 64, "height": 48, "fy": 24 / math.tan(math.radians(20)), "fx": 50}],
        # its x, y, z are y, z, x of the dataset, scaled by 0.33 and moved by 0.5; columns right,
        # down, forward are (0 0 1), (0 -1 0), (1 0 0) there: a turn by 180 degrees about (1 0 1)
        "instant-ngp": {"path": [{"R": [half, 0, half, 0], "T": [0.5 - 4 * 0.33, 0.5, 0.5],
                                  **ngp_fov}]},
    }
    for name, document in cases.items():
        write(tmp_path / "in.json", document)
        space = ["--space", "dataset"] if name == "nerfstudio" else []
        got = run("in.json", "out.json", "--from", name, "--overwrite", *space)["keys"][0]
        assert far(got, wanted) < 1e-9, name
        assert got["fov_y_deg"] == pytest.approx(40), name
    (tmp_path / "images.txt").write_text(
        f"# head\n7 {half} {half} 0 0 0 0 4 3 a name with spaces.png\n\n")
    (tmp_path / "cameras.txt").write_text("3 SIMPLE_RADIAL 64 48 50 32 24 0.1\n")
    got = run("images.txt", "out.json", "--overwrite")["keys"][0]
    assert far(got, {"world_from_camera": [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]}) < 1e-9
    assert got["fov_y_deg"] == pytest.approx(2 * math.degrees(math.atan(24 / 50)))


def test_nerfstudios_coordinates_need_their_training(run, client, tmp_path):
    frame = {"camera_to_world": sum(look([0, -4, 0]) + [[0, 0, 0, 1]], []), "fov": 40, "aspect": 1}
    write(tmp_path / "in.json", {"camera_type": "perspective", "camera_path": [frame]})
    said = run("in.json", "out.json", code=FAILED).stderr
    assert "dataparser_transforms.json" in said and not (tmp_path / "out.json").exists()
    # training = 0.5 * (turned about z by a quarter, moved by (1, 2, 3))
    write(tmp_path / "space.json", {"scale": 0.5, "transform": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]})
    got = run("in.json", "out.json", "--space", "space.json")["keys"][0]["world_from_camera"]
    place = [row[3] for row in got]
    assert place == pytest.approx([-8 - 2, -(0 - 1), 0 - 3])
    # the dataset itself was moved before: its applied_transform is undone
    write(tmp_path / "transforms.json", {"applied_transform": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]})
    got = run("in.json", "out2.json", "--space", "space.json", "--dataset", "transforms.json")
    assert [row[3] for row in got["keys"][0]["world_from_camera"]] == \
        pytest.approx([place[0] + 5, place[1], place[2]])


def test_ngp_takes_scale_and_offset_of_its_dataset(run, client, tmp_path):
    write(tmp_path / "a.json", {"path": ring(2)})
    write(tmp_path / "transforms.json", {"scale": 0.1, "offset": [0.1, 0.2, 0.3], "frames": []})
    client.run("paths", "convert", "a.json", "b.json", "--to", "instant-ngp",
               "--dataset", "transforms.json")
    place = json.loads((tmp_path / "b.json").read_text())["path"][0]["T"]
    eye = [row[3] for row in ring(2)["keys"][0]["world_from_camera"]]
    assert place == pytest.approx([0.1 * eye[1] + 0.2, 0.1 * eye[2] + 0.3, 0.1 * eye[0] + 0.1])
    back = run("b.json", "c.json", "--dataset", "transforms.json")
    assert far(back["keys"][0], ring(2)["keys"][0]) < 1e-9


def test_the_path_of_a_job_is_one_alone_in_a_file_too(run, tmp_path):
    write(tmp_path / "a.json", ring(2))
    assert far(run("a.json", "b.json")["keys"][1], ring(2)["keys"][1]) < 1e-9
    write(tmp_path / "a.json", ring(2, colour="red"))
    assert "a.json#/colour" in run("a.json", "c.json", code=INVALID).stderr


def ngp(**more):
    key = {"R": [0, 0, 0, 1], "T": [0, 0, 0], "fov": 40, "slice": 0, "scale": 1}
    return {"path": [{**key, **more}, {**key, "T": [1, 0, 0]}]}


@pytest.mark.parametrize("document, words", [
    ({"path": []}, "has no cameras"),
    ({"camera_type": "perspective", "camera_path": []}, "has no cameras"),
    (ngp(R=[0, 0, 0, 0]), "quaternion of length 0"),
    ('{"path": [{"R": [NaN, 0, 0, 1], "T": [0, 0, 0], "fov": 40}]}', "in.json#/path/0/R/0"),
    (ngp(fov=200), "in.json#/path/0/fov"),
    ({"path": [{"R": [0, 0, 0, 1], "T": [0, 0, 0], "fov": 40, "timestamp": t} for t in (0.5, 0.2)]},
     "not later than the one before it"),
    ({"camera_type": "equirectangular", "camera_path": [{}]}, "perspective"),
    ({"frames": [{"transform_matrix": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]}]}, "no rotation"),
    ({"frames": [{"transform_matrix": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]}, "mirrored"),
    ({"frames": [{"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]}, "field of view"),
    ([{"position": [0, 0, 0], "target": [0, 0, 0]}], "where the camera stands"),
    ({"something": "else"}, "is no camera path that is known"), ("hello\n", "is no camera path"),
    ("", "is no camera path"), ("{", "in.json"),
    ("1 0 0 0 0 0 0 0 1 a.png\n\n", "cameras.txt must lie beside"),
])
def test_what_is_no_path_is_refused_with_its_place(run, tmp_path, document, words):
    write(tmp_path / "in.json", document)
    code = FAILED if "equirectangular" in str(document) else INVALID
    said = run("in.json", "out.json", "--space", "dataset", code=code).stderr \
        if "camera_path" in str(document) else run("in.json", "out.json", code=code).stderr
    assert words in said and not (tmp_path / "out.json").exists()


def test_one_key_is_a_path_and_100000_are_too_many(run, client, tmp_path):
    frame = {"pose": sum(look([0, -4, 0]), []), "intrinsics": [50, 50, 32, 24]}
    document = {"format": "nerfbaselines-v1", "image_size": [64, 48], "fps": 30}
    write(tmp_path / "in.json", {**document, "frames": [frame]})
    assert len(run("in.json", "out.json")["keys"]) == 1
    write(tmp_path / "in.json", {**document, "frames": [frame] * 100000})
    said = run("in.json", "out2.json", code=FAILED).stderr
    assert "100000 cameras; a path has 10000 at most" in said


def test_another_format_than_was_said(run, tmp_path):
    write(tmp_path / "in.json", ngp())
    said = run("in.json", "out.json", "--from", "nerfstudio", "--space", "dataset", code=INVALID).stderr
    assert "is a path of instant-ngp, not of nerfstudio" in said


def test_nothing_is_replaced_unasked(run, tmp_path):
    write(tmp_path / "in.json", ngp())
    write(tmp_path / "out.json", "mine")
    assert "--overwrite" in run("in.json", "out.json", code=USAGE).stderr
    assert (tmp_path / "out.json").read_text() == "mine"
    assert run("in.json", "out.json", "--overwrite")["keys"]


REAL = Path(os.environ.get("RIPNERF_TEST_DATA", "")) / "camera_paths"


@pytest.mark.skipif(not os.environ.get("RIPNERF_TEST_DATA") or not REAL.is_dir(),
                    reason="RIPNERF_TEST_DATA names no folder with camera_paths")
def test_files_that_people_published(run, tmp_path):
    counts = {"3dgs_cameras_miku97/cameras.json": 97, "3dgs_cameras_vr29/cameras.json": 29,
              "ingp_new_tractor/base_cam.json": 6, "ingp_old_artem42/base_cam.json": 42,
              "nerfstudio_YueYin27_cycle/camera_path.json": 96,
              "nerfstudio_byang12159/camera_path.json": 96,
              "nerfstudio_timothyyao7/camera_path.json": 96}
    for file, count in counts.items():
        space = ["--space", "dataset"] if "nerfstudio" in file else []
        assert len(run(str(REAL / file), "out.json", "--overwrite", *space)["keys"]) == count, file
    # one that was written by hand: two of its four cameras are no rotations
    file = REAL / "nerfstudio_Bhoomika_handwritten/camera_path.json"
    said = run(file, "bad.json", "--space", "dataset", code=INVALID).stderr
    assert "camera_path.json#/camera_path/1/camera_to_world: holds no rotation" in said


# ---- with a daemon: what a job makes, and where it goes ----

@pytest.fixture
def served(programs, photographs, build, tmp_path):
    module = build / "server/film/ripnerf-film.so"
    environment = {"RIPNERF_FILM_MODULE": str(module)}
    with Daemon(*programs, tmp_path / "data", environment, dataset_root=photographs.parent) as daemon:
        daemon.wait(daemon.upload("data", photographs))
        daemon.train("scene")
        yield daemon



def test_frames_go_to_a_folder_once(client, served, tmp_path):
    write(tmp_path / "p.json", {"path": ring(2)})
    host = ["--host", f"http://{served.host}:{served.port}"]
    client.run("path", "scene", "p.json", "-o", "out", *host)
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == [f"{i:05}.png" for i in range(5)]
    said = client.run("path", "scene", "p.json", "-o", "out", *host, code=USAGE).stderr
    assert "holds frames already" in said
    client.run("path", "scene", "p.json", "-o", "out", "--overwrite", *host)
    for name in ("film.mov", "out.avi"):
        assert ".mp4" in client.run("path", "scene", "p.json", "-o", name, *host, code=USAGE).stderr


def test_a_film_is_one_file_and_is_never_lost(client, served, build, tmp_path):
    if not (build / "server/film/ripnerf-film.so").is_file():
        pytest.skip("built without FFmpeg's libraries")
    write(tmp_path / "p.json", {"path": ring(2)})
    host = ["--host", f"http://{served.host}:{served.port}"]
    result = json.loads(client.run("path", "scene", "p.json", "-o", "f.mp4", "--json", *host).stdout)
    film = tmp_path / "f.mp4"
    assert result["frames"] == 5 and result["bytes"] == film.stat().st_size
    assert film.read_bytes()[4:8] == b"ftyp" and not (tmp_path / "f.mp4.job").exists()
    assert "--overwrite" in client.run("path", "scene", "p.json", "-o", "f.mp4", *host, code=USAGE).stderr
    client.run("turntable", "scene", "-o", "t.gif", "--seconds", "1", "--fps", "5", *host)
    assert (tmp_path / "t.gif").read_bytes()[:4] == b"GIF8"
    client.run("turntable", "scene", "-o", "turn", "--seconds", "1", "--fps", "5", *host)
    assert len(list((tmp_path / "turn").glob("*.png"))) == 5


def test_an_interrupted_call_is_gone_on_with(client, served, tmp_path):
    write(tmp_path / "p.json", {"path": ring(2)})
    host = ["--host", f"http://{served.host}:{served.port}"]
    job = served.wait(served.submit(type="path", scene="scene", camera_path=ring(2)))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "00000.png").write_bytes(b"from before")
    (tmp_path / "out" / ".ripnerf-job").write_text(job["id"] + "\n")
    said = client.run("path", "scene", "p.json", "-o", "out", *host, code=USAGE).stderr
    assert "--resume goes on with it" in said
    client.run("path", "scene", "p.json", "-o", "out", "--resume", *host)
    assert (tmp_path / "out" / "00000.png").read_bytes() == b"from before"
    assert len(list((tmp_path / "out").glob("*.png"))) == 5
    assert not (tmp_path / "out" / ".ripnerf-job").exists()
    assert [j["id"] for j in served.get("/v1/jobs", query={"type": "path"}).json["items"]] == [job["id"]]


@pytest.mark.parametrize("held, together", [(3, 1), (9, 4)])
def test_a_path_that_was_cancelled_is_gone_on_with(make_daemon, photographs, client, tmp_path, held, together):
    """By another job, over a restart: with what was there, which stays where it was, too."""
    def frames(job):
        folder = Path(daemon.data) / "jobs" / job / "frames"
        return {file.name: file.stat().st_ino for file in folder.glob("*.png")}
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": str(held), "RIPNERF_FAKE_TOGETHER": str(together)})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("scene")
    daemon.hold()
    path = ring(2, fps=30, width=32, height=16)
    first = daemon.submit(type="path", scene="scene", camera_path=path, options={"tolerance": 0.1})
    daemon.eventually(lambda: daemon.get(f"/v1/jobs/{first}/frames").json["items"])
    daemon.post(f"/v1/jobs/{first}/cancel")
    assert daemon.wait(first)["state"] == "cancelled"
    old = frames(first)
    assert 1 <= len(old) < 31
    daemon.stop()
    daemon.let_go_on()
    daemon.start()
    reply = daemon.post(f"/v1/jobs/{first}/resume")
    second = reply.json["id"]
    assert reply.status == 202 and second != first
    assert reply.headers["Location"] == f"/v1/jobs/{second}"
    job = daemon.wait(second)
    assert job["state"] == "succeeded" and job["result"]["frames"] == 31
    assert job["options"] == daemon.job(first)["options"] and job["options"]["tolerance"] == 0.1
    new = frames(second)
    assert len(new) == 31 and {name: new[name] for name in old} == old
    assert len(daemon.get(f"/v1/jobs/{first}/frames").json["items"]) == len(old)
    assert daemon.post(f"/v1/jobs/{second}/resume").status == 409
    assert daemon.job(first)["state"] == "cancelled"

    write(tmp_path / "p.json", {"path": path})
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".ripnerf-job").write_text(first + "\n")
    host = ["--host", f"http://{daemon.host}:{daemon.port}"]
    told = json.loads(client.run("path", "scene", "p.json", "-o", "out", "--resume", "--json", *host).stdout)
    assert told["job"] not in (first, second) and told["frames"] == 31
    assert len(list((tmp_path / "out").glob("*.png"))) == 31
    assert not (tmp_path / "out" / ".ripnerf-job").exists()


def test_a_call_whose_job_fails_says_how_it_is_gone_on_with(make_daemon, photographs, client, tmp_path):
    daemon = make_daemon({"RIPNERF_FILM_MODULE": os.devnull})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("scene")
    write(tmp_path / "p.json", {"path": ring(2)})
    host = ["--host", f"http://{daemon.host}:{daemon.port}"]
    said = client.run("path", "scene", "p.json", "-o", "f.gif", *host, code=FAILED).stderr
    assert "films need ripnerf-film.so" in said and "--resume goes on with what is there" in said
    job = (tmp_path / "f.gif.job").read_text().strip()
    said = client.run("path", "scene", "p.json", "-o", "f.gif", "--resume", *host, code=FAILED).stderr
    assert "films need ripnerf-film.so" in said
    assert (tmp_path / "f.gif.job").read_text().strip() != job  # the one that went on
    resumed = client.run("resume", job, *host).stdout
    assert resumed.startswith("job_") and job not in resumed


def test_paths_are_listed_and_removed(client, served, tmp_path):
    host = ["--host", f"http://{served.host}:{served.port}"]
    served.post("/v1/camera-paths", {"name": "arc", "path": ring(2)})
    assert "arc" in client.run("paths", *host).stdout
    client.run("paths", "rm", "arc", *host)
    assert "arc" not in client.run("paths", "ls", *host).stdout
    client.run("paths", "rm", "arc", *host, code=3)
    client.run("paths", "fly", *host, code=USAGE)


def test_a_turntable_keeps_its_distance_and_looks_at_the_middle(client, served, tmp_path):
    said = client.run("turntable", "scene", "-o", "t.json", "--elevation", "20", "--distance", "5",
                      "--host", f"http://{served.host}:{served.port}").stdout
    assert said.startswith("t.json: a camera path of 6 s, 30 frames a second; ")
    path = read(tmp_path / "t.json")
    centre = served.get("/v1/scenes/scene").json["bounds"]["centre"]
    assert path["loop"] and path["interpolation"] == "circle" and len(path["keys"]) == 8
    for key in path["keys"]:
        pose = key["world_from_camera"]
        for i in range(3):
            assert pose[i][3] + 5 * pose[i][2] == pytest.approx(centre[i], abs=1e-9)


def test_a_turntable_swings_over_the_part_that_photographs_cover(client, programs, tmp_path):
    """Of half a circle of photographs, and of a whole one with a gap that is small enough."""
    for name, covered in (("half", 180), ("most", 280)):
        folder = write_dataset(tmp_path / "in" / name)
        for split in ("train", "val", "test"):
            file = folder / f"transforms_{split}.json"
            document = json.loads(file.read_text())
            last = len(document["frames"]) - 1
            for i, frame in enumerate(document["frames"]):
                frame["transform_matrix"] = pose(math.radians(30 + covered * i / last))
            file.write_text(json.dumps(document))
    with Daemon(*programs, tmp_path / "data", dataset_root=tmp_path / "in") as daemon:
        host = ["--host", f"http://{daemon.host}:{daemon.port}"]

        def turn(name, *options):
            told = client.run("turntable", name, "-o", "t.json", "--overwrite", *options, *host).stderr
            return told, read(tmp_path / "t.json")
        for name in ("half", "most"):
            daemon.wait(daemon.upload(f"{name}_data", tmp_path / "in" / name))
            daemon.train(name, f"{name}_data")
        centre = daemon.get("/v1/scenes/half").json["bounds"]["centre"]
        told, path = turn("half")
        assert "cover 180 of 360 degrees: a swing over them; --whole for a whole turn" in told
        angles = [math.degrees(math.atan2(key["world_from_camera"][1][3] - centre[1],
                                          key["world_from_camera"][0][3] - centre[0])) % 360
                  for key in path["keys"]]
        assert min(angles) == pytest.approx(30, abs=1) and max(angles) == pytest.approx(210, abs=1)
        assert path["loop"] and angles.index(max(angles)) == len(angles) // 2
        for told, path in (turn("half", "--whole"), turn("most")):
            assert told == "" and len(path["keys"]) == 8
