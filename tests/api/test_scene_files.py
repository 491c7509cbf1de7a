"""Scenes for viewing: written within a size or a loss, brought back elsewhere, refused when damaged."""

import hashlib
import json
import math
import re
import struct
import urllib.error
import urllib.request

import pytest

from support.client import FAILED, INVALID, NOT_FOUND, USAGE, Client
from support.daemon import Daemon
from support.photographs import pose

CAMERA = {"camera": {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
                     "width": 48, "height": 48, "fov_y_deg": 40}}


@pytest.fixture(name="elsewhere", scope="module")
def fixture_elsewhere(build, tmp_path_factory):
    """Another machine: another daemon, with no dataset."""
    with Daemon(build, tmp_path_factory.mktemp("elsewhere") / "daemon") as daemon:
        client = Client(build / "client" / "ripnerf", tmp_path_factory.mktemp("there"), daemon.url)
        client.url = daemon.url
        yield client


def export(client, out, *options, code=0):
    run = client.run("export", "ball", "--as", "scene", *options, "-o", out, "--json", code=code)
    return json.loads(run.stdout) if code == 0 else run.stderr


@pytest.fixture(name="exported", scope="module")
def fixture_exported(ball, tmp_path_factory):
    out = tmp_path_factory.mktemp("exported") / "ball.ripscene"
    return out, export(ball, out)


def picture(client, scene, out):
    camera = out.with_suffix(".json")
    camera.write_text(json.dumps(CAMERA))
    client.run("render", scene, "--camera", camera, "-o", out)
    return out.read_bytes()


def start_of(client, scene):
    """Where to begin to look."""
    with urllib.request.urlopen(f"{client.environment['RIPNERF_HOST']}/v1/scenes/{scene}/start") as reply:
        return json.load(reply)


def distance(camera, scene):
    """Of a camera from the middle of a scene."""
    return math.dist([row[3] for row in camera["world_from_camera"][:3]], scene["bounds"]["centre"])


def test_it_is_the_same_elsewhere(ball, elsewhere, exported, tmp_path):
    """The file is what it says, and what it lost is what is lost where it is opened."""
    file, said = exported
    assert said["bytes"] == file.stat().st_size and said["file"] == str(file)
    assert said["loss"] <= 0.05 and abs(said["trained"] - said["psnr"] - said["loss"]) < 1e-9
    whole = ball.json("show", "ball")["checkpoints"][0]["size_bytes"]
    assert said["bytes"] < whole / 10

    told = ball.run("import", file, "--name", "light", "--dataset", "sphere")
    assert "it is not trained further" in told.stdout and "\n0\n" not in told.stderr
    assert "--measure" in ball.run("effects", "ball").stdout
    assert "--measure" not in ball.run("effects", "light").stdout  # how it was trained is not known
    own = ball.json("eval", "light", "--split", "test", "--views", 6)
    assert own["views"] == said["views"] and abs(own["psnr"] - said["psnr"]) < 1e-3
    before = ball.json("eval", "ball", "--split", "test", "--views", 6)
    assert abs(before["psnr"] - said["trained"]) < 1e-3

    made = elsewhere.json("import", file, "--name", "light")
    assert made["dataset"] is None and made["viewing"]["bits"] == said["bits"]
    assert start_of(elsewhere, "light") == start_of(ball, "ball")
    assert made["viewing"]["parameters_sha256"] == ball.json("show", "ball")["parameters_sha256"]
    assert made["parameters_sha256"] == ball.json("show", "light")["parameters_sha256"]
    shown = elsewhere.run("show", "light").stdout
    assert "not trained further" in shown and "dB less than the scene" in shown
    assert picture(elsewhere, "light", tmp_path / "there.png") == \
        picture(ball, "light", tmp_path / "here.png")
    elsewhere.run("turntable", "light", "-o", tmp_path / "turn.json")
    turn = json.loads((tmp_path / "turn.json").read_text())["path"]
    first = start_of(ball, "ball")["camera"]
    assert turn["width"] == first["width"]
    assert distance(turn["keys"][0], made) == pytest.approx(distance(first, made))
    assert "--dataset" in elsewhere.run("export", "light", "-o", "p.ply", code=USAGE).stderr
    assert "light" in elsewhere.run("scenes").stdout
    # As its own file, once more: nothing is lost twice.
    elsewhere.run("import", file, "--name", "again")
    assert elsewhere.json("show", "again")["parameters_sha256"] == made["parameters_sha256"]


def test_it_is_taken_in_without_a_sandbox(build, ball, exported, tmp_path):
    with Daemon(build, tmp_path / "daemon", "--sandbox", 0) as daemon:
        client = Client(build / "client" / "ripnerf", tmp_path, daemon.url)
        made = client.json("import", exported[0], "--name", "light")
    assert made["viewing"]["parameters_sha256"] == ball.json("show", "ball")["parameters_sha256"]


def test_a_curve_without_photographs(ball, elsewhere, exported, tmp_path):
    """Against the full pictures from around: of the scene, not of what lies beside it."""
    elsewhere.run("import", exported[0], "--name", "measured")
    curve = elsewhere.json("curve", "measured", "--measure", "--views", 4)
    *points, full = curve["points"]
    assert not curve["photographs"] and curve["views"] == 4 and curve["around"] == [] and points
    assert {point["psnr"] for point in curve["points"]} == {None} and full["psnr_full"] is None
    assert [point["psnr_full"] for point in points] == sorted(point["psnr_full"] for point in points)
    seen = ball.json("curve", "ball", "--measure", "--views", 4)
    assert 0.6 < full["samples"] / seen["points"][-1]["samples"] < 1.6
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    told = elsewhere.json("render", "measured", "--camera", tmp_path / "camera.json", "--quality", 0,
                          "-o", tmp_path / "rough.png")
    assert told["curve"] == "measured" and told["expected_psnr"] > 0
    assert "against the full picture" in elsewhere.run("curve", "measured").stdout


def test_a_budget_is_kept(ball, tmp_path):
    """The finest form that fits; the smallest that loses no more; what cannot be says what can."""
    finest = export(ball, tmp_path / "all.ripscene", "--max-bytes", "1G")
    assert finest["bits"] == 32 and finest["loss"] == 0
    bits, most = [32], finest["bytes"]
    while bits[-1] > 4:
        said = export(ball, tmp_path / "less.ripscene", "--overwrite", "--max-bytes", most - 1)
        assert said["bytes"] < most and said["bits"] < bits[-1]
        bits.append(said["bits"])
        most = said["bytes"]
    assert bits == [32, 16, 8, 6, 5, 4]
    refused = export(ball, tmp_path / "none.ripscene", "--max-bytes", most - 1, code=INVALID)
    assert f"the smallest file that this scene can be is {most} bytes" in refused
    assert not (tmp_path / "none.ripscene").exists()
    said = export(ball, tmp_path / "loss.ripscene", "--max-loss", "5dB")
    assert said["bits"] == 4 and said["loss"] <= 5
    coarse = said["loss"]
    assert coarse > 0.001  # or the next line would say nothing
    said = export(ball, tmp_path / "loss.ripscene", "--overwrite", "--max-loss", f"{coarse / 2}dB")
    assert said["bits"] > 4 and said["loss"] <= coarse / 2
    refused = export(ball, tmp_path / "none.ripscene", "--max-bytes", most, "--max-loss", "0",
                     code=INVALID)
    assert f"loses {coarse:.3f} dB at least" in refused


def sealed(bytes_):
    """The file with its digest made anew."""
    at = re.search(rb'"sha256":"([0-9a-f]{64})"', bytes_)
    zeros = bytes_[: at.start(1)] + b"0" * 64 + bytes_[at.end(1):]
    digest = hashlib.sha256(zeros).hexdigest().encode()
    return zeros[: at.start(1)] + digest + zeros[at.end(1):]


def changed(bytes_, old, new):
    assert bytes_.count(old) >= 1 and len(old) == len(new)
    return sealed(bytes_.replace(old, new, 1))


BITS = rb'\"bits\":'
FORMAT = rb'\"viewing\":{\"format\":'
START = rb'\"start\":{'


def test_damaged_files_are_refused(ball, exported, tmp_path):
    """Each with its reason, before it is sent where that can be known here, else by the daemon."""
    whole = exported[0].read_bytes()
    header = struct.unpack("<Q", whole[:8])[0] + 8
    bad = tmp_path / "bad.ripscene"
    flipped = bytearray(whole)
    flipped[header + 1000] ^= 1
    newer = changed(whole, FORMAT + b"1", FORMAT + b"2")
    askew = changed(whole, rb'\"up\":[', rb'\"op\":[')
    odd = changed(whole, BITS + b"%d" % exported[1]["bits"], BITS + b"7")
    short = sealed(whole[: header + 100])
    for content, words in ((b"", "is empty"), (b"hello", "is no scene"), (whole[:-1], "as it was written"),
                           (whole[:5000], "as it was written"), (bytes(flipped), "as it was written"),
                           (newer, "written by a newer ripnerf"), (odd, "form of planes"),
                           (askew, "direction that is up"),
                           (short, "cut off")):
        bad.write_bytes(content)
        run = ball.run("import", bad, "--name", "bad", code=None)
        assert run.returncode in (FAILED, INVALID) and words in run.stderr, (words, run.stderr)
        assert "/spool/" not in run.stderr
    ball.run("show", "bad", code=NOT_FOUND)
    assert ball.json("validate", exported[0]) == {"file": str(exported[0]), "bytes": len(whole)}
    assert ball.run("validate", bad, code=None).returncode == 0  # only its header is wrong


def test_where_to_begin_is_not_known_of_an_older_file(elsewhere, exported, tmp_path):
    older = tmp_path / "older.ripscene"
    older.write_bytes(changed(exported[0].read_bytes(), START, START.replace(b"start", b"other")))
    made = elsewhere.json("import", older, "--name", "older")
    assert "start" not in made["viewing"]
    with pytest.raises(urllib.error.HTTPError, match="404") as refusal:
        start_of(elsewhere, "older")
    assert "export it again" in json.load(refusal.value)["detail"]


def test_what_is_no_request(ball, exported, tmp_path):
    for wrong in ("abc", "-1dB", "0.05MB", "101"):
        out = ball.run("export", "ball", "--as", "scene", f"--max-loss={wrong}", "-o",
                         tmp_path / "a.ripscene", code=USAGE)
        assert "--max-loss" in out.stderr
    for wrong in ("0", "-1", "abc", "1X"):
        out = ball.run("export", "ball", "--as", "scene", f"--max-bytes={wrong}", "-o",
                         tmp_path / "a.ripscene", code=USAGE)
        assert "--max-bytes" in out.stderr
    ball.run("export", "ball", "--as", "scene", "-o", tmp_path / "a.ply", code=USAGE)
    ball.run("export", "ball", "--as", "scene", "--cells", 9, "-o", "a.ripscene", code=USAGE)
    ball.run("export", "ball", "--max-bytes", "1M", "-o", "a.ply", code=USAGE)
    ball.run("import", exported[0], "--name", "x", "--split", "every:8", code=USAGE)
    ball.run("import", "source", "--name", "x", "--dataset", "sphere", code=USAGE)
    ball.run("import", exported[0], "--name", "x", "--dataset", "nothing", code=NOT_FOUND)
