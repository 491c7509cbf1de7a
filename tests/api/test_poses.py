"""Photographs without poses: a stand-in for COLMAP finds them, or fails in each of its ways."""

import io
import itertools
import math
import os
import re
import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

FAKE = Path(__file__).parents[1] / "support" / "fake_colmap.py"


@pytest.fixture
def pictures(tmp_path):
    """Nine photographs of several kinds, one of them with a mask, and a file that is none."""
    folder = tmp_path / "pictures"
    (folder / "masks").mkdir(parents=True)
    for i in range(9):
        image = Image.new("RGB", (16, 16), (20 * i, 100, 200))
        ending = "webp" if i == 3 else "tif" if i == 4 else "jpg"
        image.save(folder / f"IMG_{i}.{ending}")
    Image.new("L", (16, 16), 255).save(folder / "masks" / "IMG_0.jpg.png")
    (folder / "notes.txt").write_text("none")
    return folder


def make(make_daemon, mood="", **options):
    return make_daemon({"RIPNERF_COLMAP": str(FAKE), "RIPNERF_FAKE_COLMAP": mood}, **options)


def import_photos(daemon, folder, name="found", **options):
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                tar.add(path, path.relative_to(folder))
    query = "&".join(f"{key}={value}" for key, value in {"poses": "find", **options}.items())
    reply = daemon.request("POST", f"/v1/datasets?name={name}&{query}", archive.getvalue(),
                           {"Content-Type": "application/x-tar"})
    assert reply.status == 202, reply.body
    return reply.json["id"]


def wait_until_tidied(daemon):
    daemon.eventually(lambda: not list(Path(daemon.data, "spool").iterdir()))


def problems_of(daemon, name="found"):
    return [problem["text"] for problem in daemon.get(f"/v1/datasets/{name}").json["report"]["problems"]]


def test_poses_are_found(make_daemon, pictures):
    daemon = make(make_daemon)
    job = import_photos(daemon, pictures)
    assert daemon.wait(job)["state"] == "succeeded", daemon.get(f"/v1/jobs/{job}").json
    dataset = daemon.get("/v1/datasets/found").json
    assert dataset["views"]["train"] == 9 and dataset["report"]["layout"] == "colmap"
    texts = problems_of(daemon)
    assert any("poses for 9 of 9 photographs" in text for text in texts)
    assert any("one camera" in text for text in texts)
    assert any("matched with every other, 36 pairs, by about 4096 features" in text
               for text in texts), texts
    assert any(text.startswith("COLMAP took finding features") for text in texts)
    assert any("1 photographs have masks" in text for text in texts)
    points = daemon.get("/v1/datasets/found/points").json
    assert points == {"count": 1, "items": [[0, 0, 0, 200, 100, 50]]}
    assert daemon.get("/v1/datasets/found/points?x=1").status == 422
    reply = daemon.get("/v1/datasets/found/model")
    names = tarfile.open(fileobj=io.BytesIO(reply.body)).getnames()
    assert sorted(names) == [f"sparse/0/{part}.bin" for part in ("cameras", "images", "points3D")]
    wait_until_tidied(daemon)
    log = Path(daemon.data, "jobs", job, "log").read_text()
    assert "--ImageReader.mask_path" in log and "OPENCV" not in log


def test_photographs_of_one_camera_share_it(make_daemon, tmp_path):
    """By size, as they stand upright, and EXIF; whoever says nothing of the camera has one alone."""
    folder = tmp_path / "pictures"
    folder.mkdir()

    def save(name, size, focal=None, orientation=1):
        exif = Image.Exif()
        exif[0x0112] = orientation
        if focal:
            exif[0x010F], exif[0x0110] = "Maker", "Model"
            exif[0x8769] = {0x920A: IFDRational(focal)}
        Image.new("RGB", size, (90, 100, 200)).save(folder / name, exif=exif)

    for i in range(10):
        save(f"a{i}.jpg", (16, 12), focal=4.5)
    save("b0.jpg", (16, 12), focal=4.5, orientation=6)
    save("b1.jpg", (12, 16), focal=4.5)
    save("c0.jpg", (16, 12), focal=9.0)
    for i in range(2):
        save(f"d{i}.jpg", (16, 12))
    daemon = make(make_daemon)
    job = import_photos(daemon, folder)
    assert daemon.wait(job)["state"] == "succeeded", daemon.get(f"/v1/jobs/{job}").json
    texts = problems_of(daemon)
    assert any("15 photographs, by sizes and EXIF of 5 cameras" in text for text in texts), texts
    log = Path(daemon.data, "jobs", job, "log").read_text()
    found = sorted(line.split()[1:] for line in log.splitlines() if line.startswith("camera "))
    radial, names = ["20", "8", "6", "0"], [f"a{i}.jpg" for i in range(10)]
    assert found == sorted([
        ["4", "16", "12", "20", "20", "8", "6", "0", "0", "0", "0", *names],
        ["2", "12", "16", "20", "6", "8", "0", "b0.jpg.png", "b1.jpg"],
        *(["2", "16", "12", *radial, name] for name in ("c0.jpg", "d0.jpg", "d1.jpg"))])


def test_many_photographs_are_matched_with_those_alike(make_daemon, tmp_path):
    """79 photographs that share features with ten before and after: in order by their names, or not."""
    for number in range(79):
        for folder, name in (("ordered", f"IMG_{number}.jpg"), ("spaced", f"a walk/IMG {number}.jpg"),
                             ("mixed", f"{chr(97 + number * 11 % 26)}{7 * number}.jpg")):
            (tmp_path / folder / name).parent.mkdir(parents=True, exist_ok=True)
            Image.new("RGB", (16, 16), (3 * number, 100, 200)).save(tmp_path / folder / name)
    (tmp_path / "mixed" / "a0.jpg").rename(tmp_path / "mixed" / "a1000000.jpg")  # alike to none
    daemon = make(make_daemon)
    for folder, words in (("ordered", "and, since names count upwards, with those near it, "),
                          ("mixed", "whose largest features match best"),
                          ("spaced", "and, since names count upwards, with those near it, ")):
        job = import_photos(daemon, tmp_path / folder, folder)
        assert daemon.wait(job)["state"] == "succeeded", daemon.job(job)
        texts = problems_of(daemon, folder)
        assert any(words in text for text in texts), texts
        log = Path(daemon.data, "jobs", job, "log").read_text()
        names = [name for pair in re.findall(r"^pair (.*)$", log, re.MULTILINE) for name in pair.split()]
        numbers = [int(re.sub(r"\D", "", name)) for name in names]
        apart = [abs(a - b) for a, b in zip(numbers[::2], numbers[1::2])]
        assert all(name.isascii() and name.isprintable() for name in names)
        if folder in ("ordered", "spaced"):
            assert max(apart) <= 7 and 79 * 6 - 30 < len(apart) < 79 * 8
            assert sum(distance <= 3 for distance in apart) == 78 + 77 + 76
        if folder == "mixed":
            assert set(apart) == {7} and len(apart) > 60 and 1000000 not in numbers


@pytest.mark.parametrize("step, placed", [(40, True), (3, False)])
def test_photographs_near_each_other_by_gps_are_matched(make_daemon, tmp_path, step, placed):
    """A flight of 7 lanes of 10, alike along their lanes alone."""
    for lane, along in itertools.product(range(7), range(10)):
        exif = Image.Exif()
        north, east = 47 + lane * step / 111_160, 8 + along * step / 76_080
        exif[0x8825] = {1: "N", 2: degrees(north), 3: "E", 4: degrees(east), 5: b"\0", 6: IFDRational(100)}
        name = f"{chr(97 + along)}{100 * lane + along}.jpg"
        Image.new("RGB", (16, 16), (30 * lane, 100, 200)).save(tmp_path / name, exif=exif)
    daemon = make(make_daemon)
    job = import_photos(daemon, tmp_path)
    assert daemon.wait(job)["state"] == "succeeded", daemon.job(job)
    assert any("by GPS, with those around it" in text for text in problems_of(daemon)) == placed
    log = Path(daemon.data, "jobs", job, "log").read_text()
    pairs = [sorted(int(re.sub(r"\D", "", name)) for name in pair.split())
             for pair in re.findall(r"^pair (.*)$", log, re.MULTILINE)]
    assert len(set(map(tuple, pairs))) == len(pairs)
    assert sum(b - a < 10 for a, b in pairs) > 7 * 9
    assert sum(b - a == 100 for a, b in pairs) == (60 if placed else 0)
    assert ("--Mapper.abs_pose_min_num_inliers" in log) == placed


@pytest.mark.parametrize("orientation", [1, 3])  # as it is; turned upright into a PNG, which has no EXIF
def test_where_photographs_were_taken_is_compared_with_their_poses(make_daemon, tmp_path, orientation):
    """A circle of 100 metres, which the stand-in has as one of 4 units."""
    for i in range(12):
        angle, exif = math.radians(30 * i), Image.Exif()
        exif[0x0112] = orientation
        north, east = 47 + 100 * math.cos(angle) / 111_170, 8 + 100 * math.sin(angle) / 76_050
        exif[0x8825] = {1: "N", 2: degrees(north), 3: "E", 4: degrees(east), 5: b"\0", 6: IFDRational(100)}
        Image.new("RGB", (16, 16), (20 * i, 100, 200)).save(tmp_path / f"IMG_{i:02}.jpg", exif=exif)
    daemon = make(make_daemon)
    assert daemon.wait(import_photos(daemon, tmp_path))["state"] == "succeeded"
    (told,) = [text for text in problems_of(daemon) if "GPS" in text and "a unit is" in text]
    assert "by the GPS of 12 of 12 photographs" in told and "a unit is 25 m" in told, told


def degrees(angle):
    """As EXIF has them: degrees, minutes, seconds."""
    minutes = angle % 1 * 60
    return (IFDRational(int(angle)), IFDRational(int(minutes)), IFDRational(round(minutes % 1 * 60 * 10 ** 6), 10 ** 6))


def test_a_database_that_does_not_agree_with_itself(make_daemon, tmp_path):
    for number in range(40):
        Image.new("RGB", (16, 16), (3 * number, 100, 200)).save(tmp_path / f"IMG_{number}.jpg")
    daemon = make(make_daemon, "damaged")
    job = daemon.wait(import_photos(daemon, tmp_path))
    assert job["state"] == "failed"
    assert "1408 bytes of descriptors for 1 features" in str(job["problem"]), job


def test_stages_are_told(make_daemon, pictures):
    daemon = make(make_daemon, "slow")
    job = import_photos(daemon, pictures)
    stages = [event[2]["stage"] for event in daemon.follow(f"/v1/jobs/{job}/events")
              if event[1] == "progress" and event[2].get("stage")]
    assert "finding features" in stages and "placing cameras" in stages


def test_photographs_without_a_place_are_told(make_daemon, pictures):
    daemon = make(make_daemon, "some")
    assert daemon.wait(import_photos(daemon, pictures))["state"] == "succeeded"
    (text,) = [text for text in problems_of(daemon) if "poses for 8 of 9" in text]
    assert "IMG_8.jpg" in text and "photograph again" in text
    assert daemon.get("/v1/datasets/found").json["views"]["train"] == 8


def test_two_models_are_told_and_the_largest_is_used(make_daemon, pictures):
    daemon = make(make_daemon, "two")
    assert daemon.wait(import_photos(daemon, pictures))["state"] == "succeeded"
    texts = problems_of(daemon)
    assert any("another model, of 2 photographs" in text or "of 7 photographs" in text
               for text in texts), texts
    assert any("poses for 7 of 9" in text for text in texts)


@pytest.mark.parametrize("mood, words", [
    ("crash", ["matching", "signal 6", "about to fail"]),
    ("kill", ["matching", "signal 9"]),
    ("fail", ["placing cameras", "found no poses"]),
    ("none", ["found no poses", "No good initial image pair", "again"]),
    ("bad", ["images.bin"]),
])
def test_colmap_that_fails(make_daemon, pictures, mood, words):
    daemon = make(make_daemon, mood)
    job = daemon.wait(import_photos(daemon, pictures))
    assert job["state"] == "failed"
    told = str(job["problem"])
    assert all(word in told for word in words), told
    assert daemon.get("/v1/datasets").json["items"] == []
    wait_until_tidied(daemon)
    assert not list(Path(daemon.data, "datasets").iterdir())


def test_colmap_that_is_not_there(make_daemon, pictures):
    daemon = make_daemon({"RIPNERF_COLMAP": "/nonexistent/colmap"})
    job = daemon.wait(import_photos(daemon, pictures))
    assert job["state"] == "failed"
    assert "apt-get install --no-install-recommends colmap" in job["problem"]["detail"]


def test_too_few_photographs(make_daemon, pictures):
    for path in list(pictures.glob("IMG_*"))[2:]:
        path.unlink()
    daemon = make(make_daemon)
    job = daemon.wait(import_photos(daemon, pictures))
    assert job["state"] == "failed" and "poses are found for 3 at least" in str(job["problem"])


def test_cancelling_ends_colmap(make_daemon, pictures):
    daemon = make(make_daemon, "slow")
    job = import_photos(daemon, pictures)
    next(event for event in daemon.follow(f"/v1/jobs/{job}/events")
         if event[1] == "progress" and event[2].get("stage") == "finding features")
    daemon.post(f"/v1/jobs/{job}/cancel")
    assert daemon.wait(job)["state"] == "cancelled"
    wait_until_tidied(daemon)


def test_a_dataset_with_poses_has_no_model(shared):
    reply = shared.get("/v1/datasets/data/model")
    assert reply.status == 404 and "no model" in reply.json["detail"]
    assert shared.get("/v1/datasets/data/model?x=1").status == 422


def test_the_client_asks_for_poses_where_there_are_none(make_daemon, pictures, build):
    daemon = make(make_daemon)
    host = f"{daemon.host}:{daemon.port}"

    def run(*words):
        return subprocess.run([build / "client" / "ripnerf", "--host", host, *words],
                              capture_output=True, text=True, check=False)
    result = run("validate", pictures)
    assert result.returncode == 0 and "9 photographs without poses" in result.stdout
    result = run("import", pictures, "--name", "mine")
    assert result.returncode == 0, result.stderr
    assert daemon.get("/v1/datasets/mine").json["views"]["train"] == 9
    result = run("import", pictures, "--name", "mine")
    assert result.returncode == 1 and "already" in result.stderr
    result = run("import", pictures, "--name", "other", "--poses", "file")
    assert result.returncode == 4 and "holds no dataset" in result.stderr
    (pictures / "IMG_1.jpg").rename(pictures / "away.dat")
    (pictures / "IMG_1.jpg").symlink_to(pictures / "elsewhere.jpg")
    result = run("validate", pictures)
    assert result.returncode == 4 and "IMG_1.jpg: the link there leads nowhere" in result.stdout + result.stderr
    (pictures / "IMG_1.jpg").unlink()
    (pictures / "IMG_1.jpg").write_bytes(b"no picture")
    result = run("import", pictures, "--name", "other")
    assert result.returncode == 4 and "IMG_1.jpg" in result.stderr and "--skip-bad" in result.stderr
    result = run("import", pictures, "--name", "other", "--skip-bad")
    assert result.returncode == 0, result.stderr
    assert daemon.get("/v1/datasets/other").json["views"]["train"] == 8


@pytest.mark.skipif(not shutil.which("ffmpeg"), reason="ffmpeg is not installed")
def test_a_film(make_daemon, tmp_path):
    """Every tenth frame is sharp, the others are blurred; the sharp ones are taken."""
    frames = tmp_path / "frames"
    frames.mkdir()
    for i in range(40):
        image = Image.effect_noise((64, 64), 90).convert("RGB")
        if i % 10 != 4:
            image = image.resize((4, 4)).resize((64, 64))
        image.save(frames / f"{i:03}.png")
    folder = tmp_path / "film"
    folder.mkdir()
    film = folder / "walk.mp4"
    subprocess.run(["ffmpeg", "-loglevel", "error", "-framerate", "20", "-i", frames / "%03d.png",
                    "-c:v", "mpeg4", "-q:v", "2", film], check=True)
    daemon = make(make_daemon)
    job = daemon.wait(import_photos(daemon, folder))
    assert job["state"] == "succeeded", job
    texts = problems_of(daemon)
    assert any("has 40 frames in 2.0 s" in text and "4 stretches" in text for text in texts), texts
    assert any("each photograph is matched with every other" in text for text in texts)
    dataset = daemon.get("/v1/datasets/found").json
    assert dataset["views"]["train"] == 4
    for i in range(4):
        body = daemon.get(f"/v1/datasets/found/images/train/{i}").body
        grey = Image.open(io.BytesIO(body)).convert("L")
        low, high = grey.getextrema()
        assert high - low > 150
    (folder / "walk.mp4").write_bytes(os.urandom(5000))
    job = daemon.wait(import_photos(daemon, folder, "broken"))
    assert job["state"] == "failed" and "ffmpeg" in str(job["problem"])
