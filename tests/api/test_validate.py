"""A validation: what an import would keep, from documents and the beginnings of images."""

import io
import json
import math
import tarfile

import pytest
from PIL import Image, ImageFilter, ImageOps

from support import captures
from support.checked import Daemon
from support.photographs import pose, write_dataset

HEADS = {".png": 48, ".jpg": 1024}  # bytes of a photograph that hold its size


@pytest.fixture(scope="module", name="real")
def fixture_real(build, programs, tmp_path_factory):
    """A daemon with the runner that reads photographs."""
    folder = tmp_path_factory.mktemp("validate") / "data"
    with Daemon(programs[0], build / "server" / "ripnerf-runner", folder) as daemon:
        yield daemon


def small(path):
    """A photograph as the page shrinks it: an upright JPEG."""
    picture = io.BytesIO()
    ImageOps.exif_transpose(Image.open(path)).convert("RGB").save(picture, "JPEG", quality=90)
    return picture.getvalue()


def heads(folder, spoil=None, looks=()):
    """A tar of the folder's documents and of its images' beginnings, and of small pictures of some."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            content = path.read_bytes()
            content = content[:HEADS.get(path.suffix)]
            member = tarfile.TarInfo(str(path.relative_to(folder)))
            content = spoil(member.name, content) if spoil else content
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
        for path in looks:
            content = small(folder / path)
            member = tarfile.TarInfo(f"ripnerf-looks/{path}.jpg")
            content = spoil(member.name, content) if spoil else content
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return archive.getvalue()


def upload(daemon, content, part=None):
    made = daemon.post("/v1/uploads", {"size_bytes": len(content)})
    assert made.status == 201, made.json
    sent = daemon.request("PATCH", f"/v1/uploads/{made.json['id']}", body=content[:part],
                          headers={"Content-Type": "application/offset+octet-stream",
                                   "Upload-Offset": "0"})
    assert sent.status == 204
    return made.json["id"]


def validate(daemon, there, **options):
    job = daemon.wait(daemon.submit(type="validate", upload=there, options=options))
    assert job["state"] == "succeeded", job.get("problem", job)
    return job["result"]


def test_what_an_import_would_keep(real, photographs):
    there = upload(real, heads(photographs))
    found = validate(real, there)
    imported = real.wait(real.upload("data", photographs))
    dataset = real.get(f"/v1/datasets/{imported['result']['dataset']}").json
    cameras = real.get(f"/v1/datasets/{imported['result']['dataset']}/cameras").json["items"]
    assert found["views"] == dataset["views"] and found["bounds"] == dataset["bounds"]
    assert found["report"]["usable"] == dataset["report"]["usable"]
    told, known = found["report"]["survey"], dataset["report"]["survey"]
    assert "blurred" in known and "blurred" not in told  # no picture was looked at
    assert told["looking_away"] == known["looking_away"] and "azimuth_gap_deg" in told
    assert found["report"]["expected"] == dataset["report"]["expected"]
    assert [item["camera"] for item in found["items"]] == [
        item["camera"] for item in cameras if item["scale"] == 0]
    assert all((photographs / item["file"]).is_file() for item in found["items"])
    assert real.get(f"/v1/uploads/{there}").status == 200
    assert len(real.get("/v1/datasets").json["items"]) == 1


def test_the_effect_of_options_is_told(real, tmp_path):
    folder = write_dataset(tmp_path / "untested", train=6, val=2, test=0)
    there = upload(real, heads(folder))
    assert validate(real, there)["views"] == {"train": 6, "val": 2, "test": 0}
    found = validate(real, there, split="every:2", max_size=8, scales=2, bounds="1,2,3,4")
    assert found["views"] == {"train": 3, "val": 2, "test": 3} and found["scales"] == 2
    assert found["report"]["expected"]["memory_bytes"] == 330e6 + 4 * 3 * (8 * 8 + 4 * 4)
    assert {item["camera"]["width"] for item in found["items"]} == {8}
    assert [item["split"] for item in found["items"][:4]] == ["test", "train", "test", "train"]
    assert found["bounds"] == {"centre": [1, 2, 3], "radius": 4, "source": "given"}
    assert real.get(f"/v1/uploads/{there}").status == 200


def test_what_other_options_would_give_is_told(real, tmp_path):
    folder = write_dataset(tmp_path / "untested", train=9, val=2, test=0)
    there = upload(real, heads(folder))
    as_is, split, scales = validate(real, there)["report"]["choices"]
    assert as_is["views"] == {"train": 9, "val": 2, "test": 0} and "split" not in as_is
    assert split["split"] == "every:8" and split["views"] == {"train": 7, "val": 2, "test": 2}
    assert scales["scales"] == 4 and scales["memory_bytes"] > as_is["memory_bytes"]
    asked = validate(real, there, split="every:3", max_size=8)["report"]
    assert [(c["max_size"], c["split"], c["width"]) for c in asked["choices"]] == [
        (8, "every:3", 8)] * 2  # as asked, and at several scales
    for choice in asked["choices"]:
        told = validate(real, there, **{key: choice[key] for key in ("max_size", "split", "scales")
                                        if key in choice})
        assert told["views"] == choice["views"]
        assert told["report"]["expected"]["memory_bytes"] == choice["memory_bytes"]
    imported = real.wait(real.upload("chosen", folder))
    kept = real.get(f"/v1/datasets/{imported['result']['dataset']}").json
    assert "choices" not in kept["report"]


def imported_survey(daemon, name, folder):
    job = daemon.wait(daemon.upload(name, folder))
    return daemon.get(f"/v1/datasets/{job['result']['dataset']}").json["report"]["survey"]


def test_small_pictures_are_judged_as_photographs_are(real, tmp_path):
    folder, frames, names = tmp_path / "ring", [], [f"r_{i}.png" for i in range(16)]
    folder.mkdir()
    for i, name in enumerate(names):
        picture = Image.effect_noise((96, 96), 60).resize((192, 192), Image.Resampling.BICUBIC)
        if i == 5:
            picture = picture.filter(ImageFilter.GaussianBlur(4))
        if i == 12:
            picture = Image.open(folder / names[11])
        picture.convert("RGB").save(folder / name)
        frames.append({"file_path": name, "transform_matrix": pose(0.3 * (i - (i == 12)))})
    (folder / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    found = validate(real, upload(real, heads(folder, looks=names)))["report"]
    known = imported_survey(real, "ring", folder)
    assert known["blurred"] == 1 and known["duplicates"] == 1
    assert {key: found["survey"][key] for key in known} == known
    told = " ".join(problem["text"] for problem in found["problems"])
    assert "before and after: r_5" in told and "r_11 and r_12" in told
    some = validate(real, upload(real, heads(folder, looks=names[:8])))["report"]["survey"]
    assert some["blurred"] == 1 and some["duplicates"] == 0
    assert some["azimuth_gap_deg"] == known["azimuth_gap_deg"]  # of all cameras


def test_photographs_without_poses_are_judged_by_their_pictures(real, tmp_path):
    folder, names = tmp_path / "walk", [f"w_{i}.jpg" for i in range(12)]
    folder.mkdir()
    exif = Image.Exif()
    exif[0x0112] = 6
    for i, name in enumerate(names):
        picture = Image.effect_noise((96, 48), 60).resize((192, 96), Image.Resampling.BICUBIC)
        if i == 5:
            picture = picture.filter(ImageFilter.GaussianBlur(4))
        picture.convert("RGB").save(folder / name, quality=92, exif=exif)
    (folder / names[9]).write_bytes((folder / names[8]).read_bytes())
    there = upload(real, heads(folder, looks=names))
    found = validate(real, there, poses="find")
    assert found["views"] == {"train": 12, "val": 0, "test": 0} and found["items"] == []
    assert "bounds" not in found and "up" not in found
    assert found["report"]["survey"] == {"blurred": 1, "duplicates": 1}
    told = " ".join(problem["text"] for problem in found["report"]["problems"])
    assert "before and after: w_5.jpg" in told and "nearly the same: w_8.jpg and w_9.jpg" in told
    assert {problem["where"] for problem in found["report"]["problems"]} == {"dataset"}
    assert "12 photographs without poses, the first of 192x96 pixels, all of one camera" in told
    wide = io.BytesIO()
    Image.new("L", (4096, 64)).save(wide, "JPEG")
    bad = {"ripnerf-looks/w_8.jpg.jpg": wide.getvalue(), "ripnerf-looks/w_5.jpg.jpg": b"no picture"}
    some = validate(real, upload(real, heads(folder, bad.get, names)), poses="find")["report"]
    assert some["survey"] == {"blurred": 0, "duplicates": 0} and some["errors"] == 0
    unseen = validate(real, upload(real, heads(folder)), poses="find")["report"]
    assert unseen.get("survey", {}) == {} and len(unseen["problems"]) == 1
    job = real.wait(real.submit(type="validate", upload=there))  # nothing says that they have none
    assert job["state"] == "failed"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_small_pictures_of_photographs_that_lie_are_laid_down(real, tmp_path, orientation):
    """A strip that shared points lie on differs from photograph to photograph, in whichever way EXIF
    says that the camera was held: small pictures stand upright, the document's photographs do not."""
    capture, folder = captures.make(), tmp_path / "lying"
    for photograph in capture.photographs:
        photograph.name = photograph.name.replace(".png", ".jpg")
        photograph.size = (60, 30)
    lens = (captures.PINHOLE, 60, 30, [50.0, 50.0, 30.0, 15.0])
    capture.cameras = {1: lens, 2: lens}
    capture.points = {i: (0.1 * math.sin(i), 0.1 * math.cos(i), 0.01 * i) for i in range(1, 41)}
    capture.sightings = {i: list(capture.points) for i in range(captures.COUNT)}
    captures.write_colmap_binary(capture, folder)
    (folder / "images").mkdir()
    exif = Image.Exif()
    exif[0x0112] = orientation
    for i, photograph in enumerate(capture.photographs):
        picture = Image.new("RGB", photograph.size, (128, 128, 128))
        picture.paste((60 + 40 * i,) * 3, (6, 9, 54, 16))  # points are in row 12, columns 10 to 49
        picture.save(folder / photograph.name, quality=95, exif=exif)
    looks = [photograph.name for photograph in capture.photographs]
    found = validate(real, upload(real, heads(folder, looks=looks)))["report"]["survey"]
    known = imported_survey(real, f"lying{orientation}", folder)
    assert known["exposure_spread"] > 0.2
    assert found["exposure_spread"] == pytest.approx(known["exposure_spread"], rel=0.1)


def test_what_is_wrong_is_told(real, photographs):
    def cut(name, content):
        return b"[" if name.endswith("train.json") else content

    job = real.wait(real.submit(type="validate", upload=upload(real, heads(photographs, cut))))
    assert job["state"] == "failed" and "train.json" in str(job["problem"]), job
    broken = next(p for p in sorted(photographs.rglob("*.png")))

    def spoil(name, content):
        return b"no picture" if name == str(broken.relative_to(photographs)) else content

    found = validate(real, upload(real, heads(photographs, spoil)))
    assert sum(found["report"]["unusable"].values()) == 1
    (problem,) = [p for p in found["report"]["problems"] if p["severity"] == "error"]
    assert broken.stem in problem["where"] + problem["text"], problem


def test_what_cannot_be_validated(real):
    def refused(body):
        return real.post("/v1/jobs", {"type": "validate", **body})

    assert refused({"upload": "up_aaaaaaaaaaaa"}).status == 404
    assert refused({}).status == 422
    half = upload(real, b"\0" * 2048, 1000)
    assert refused({"upload": half}).status == 409
    whole = upload(real, b"\0" * 2048)
    assert refused({"upload": whole, "options": {"scales": 99}}).status == 422
    assert real.wait(refused({"upload": whole}).json["id"])["state"] == "failed"
