"""A validation: what an import would keep, from documents and the beginnings of images."""

import io
import tarfile

import pytest

from support.checked import Daemon
from support.photographs import write_dataset

HEAD = 48  # bytes of a photograph that hold its size


@pytest.fixture(scope="module", name="real")
def fixture_real(build, programs, tmp_path_factory):
    """A daemon with the runner that reads photographs."""
    folder = tmp_path_factory.mktemp("validate") / "data"
    with Daemon(programs[0], build / "server" / "ripnerf-runner", folder) as daemon:
        yield daemon


def heads(folder, spoil=None):
    """A tar of the folder's documents and of its images' beginnings."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            content = path.read_bytes()
            content = content[:HEAD] if path.suffix == ".png" else content
            member = tarfile.TarInfo(str(path.relative_to(folder)))
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
    assert job["state"] == "succeeded", job
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
    imported = real.wait(real.upload("data", folder))
    kept = real.get(f"/v1/datasets/{imported['result']['dataset']}").json
    assert "choices" not in kept["report"]


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
