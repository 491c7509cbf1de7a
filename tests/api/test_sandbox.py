"""Runners that the daemon starts: what they may do, and the limits of imports."""

import io
import json
import os
import subprocess
import tarfile
from pathlib import Path

import pytest
from PIL import Image

from support.checked import make_tar
from support.photographs import pose, write_dataset

TAR = {"Content-Type": "application/x-tar"}


def status_of(pid):
    with open(f"/proc/{pid}/status", encoding="utf-8") as file:
        return dict(line.rstrip("\n").split(":\t", 1) for line in file if ":\t" in line)


def environment_of(pid):
    with open(f"/proc/{pid}/environ", "rb") as file:
        return {entry.split(b"=", 1)[0].decode() for entry in file.read().split(b"\0") if entry}


def test_runners_are_confined(make_daemon, photographs):
    """No new privileges, filtered calls, and none of the daemon's environment but settings."""
    daemon = make_daemon({"SECRET": "x", "RIPNERF_TOKEN": "y", "RIPNERF_FAKE_STEP_US": "2000",
                          "HOME": "/root"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 100000})
    daemon.wait(job, ["running"])
    next(event for event in daemon.follow(f"/v1/jobs/{job}/events") if event[1] == "progress")
    (runner,) = daemon.eventually(lambda: len(found := daemon.runners()) == 1 and found)
    status = status_of(runner)
    assert status["NoNewPrivs"] == "1" and status["Seccomp"] == "2"
    seen = environment_of(runner)
    assert "RIPNERF_FAKE_STEP_US" in seen and not seen & {"SECRET", "HOME", "RIPNERF_TOKEN"}
    daemon.post(f"/v1/jobs/{job}/cancel")
    daemon.wait(job, ["cancelled"])


def test_confinement_can_be_left_out(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "2000"}, sandbox=0)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 100000})
    daemon.wait(job, ["running"])
    assert status_of(daemon.runners()[0])["Seccomp"] == "0"


@pytest.mark.parametrize("name", ["ripnerfd", "ripnerf-runner"])
def test_programs_are_hardened(build, name):
    def tell(*words):
        return subprocess.run([*words, build / "server" / name], capture_output=True, text=True,
                              check=True).stdout
    assert "DYN" in tell("readelf", "-hW")
    assert "NOW" in tell("readelf", "-dW") and "GNU_RELRO" in tell("readelf", "-lW")
    symbols = tell("nm", "-D")
    if "asan" not in symbols:
        assert "__stack_chk_fail" in symbols and "_chk@" in symbols.replace("__stack_chk_fail", "")


def one_image_many_times(folder, count):
    write_dataset(folder)
    path = folder / "transforms_train.json"
    document = json.loads(path.read_text())
    document["frames"] = [document["frames"][i % 6] for i in range(count)]
    path.write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("option, value, name", [("max_frames", 40, "--max-frames"),
                                                 ("max_pixels", 16 * 16 * 40, "--max-pixels")])
def test_frames_and_pixels_have_limits(make_daemon, tmp_path, option, value, name):
    """One image named by many frames is counted as often as it is named, before it is decoded."""
    daemon = make_daemon(**{option: value})
    good = write_dataset(tmp_path / "good")
    assert daemon.wait(daemon.upload("good", good))["state"] == "succeeded"
    many = one_image_many_times(tmp_path / "many", 200)
    job = daemon.wait(daemon.upload("many", many))
    assert job["state"] == "failed" and job["problem"]["status"] == 413
    assert name in job["problem"]["detail"]
    daemon.eventually(lambda: not os.listdir(os.path.join(daemon.data, "spool")))
    assert len(os.listdir(os.path.join(daemon.data, "datasets"))) == 1


def test_imports_have_a_deadline(make_daemon, tmp_path):
    daemon = make_daemon(import_time=1)
    many = one_image_many_times(tmp_path / "many", 60000)
    job = daemon.wait(daemon.upload("many", many))
    assert job["state"] == "failed" and job["problem"]["status"] == 413, job
    assert "--import-time" in job["problem"]["detail"]


def test_what_an_import_lacks_memory_for_names_the_limit(make_daemon, tmp_path):
    """One decoded photograph of 4 megapixels is more than the limit."""
    folder = write_dataset(tmp_path / "source")
    for path in (folder / "train").glob("*.png"):
        Image.new("RGB", (2000, 2000)).save(path)
    daemon = make_daemon(memory_limit="8M")
    job = daemon.wait(daemon.upload("data", folder))
    assert job["state"] == "failed" and job["problem"]["status"] == 413, job
    assert "8 MiB" in job["problem"]["detail"] and "--memory-limit" in job["problem"]["detail"]


def test_pax_names(make_daemon, tmp_path):
    """Names that are not ASCII come in pax headers; whatever the daemon's locale, they are UTF-8."""
    daemon = make_daemon({"LC_ALL": "C"})
    folder = write_dataset(tmp_path / "source")
    (folder / "train").rename(folder / "entraînement")
    for path in folder.glob("transforms_train.json"):
        path.write_text(path.read_text().replace("./train/", "./entraînement/"))
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.PAX_FORMAT) as tar:
        tar.add(folder, arcname=".")
    for name, body in (("pax", archive.getvalue()), ("ustar", make_tar(folder))):
        reply = daemon.post("/v1/datasets", body=body, query={"name": name}, headers=TAR)
        job = daemon.wait(reply.json["id"])
        assert job["state"] == "succeeded", job


@pytest.mark.parametrize("name", [b"images/caf\xe9.png", b"../x" + "é".encode() * 700],
                         ids=["latin-1", "long"])
def test_names_that_are_not_utf8_are_refused_with_the_reason(make_daemon, name):
    """At once: the refusal quotes the name, with what is not UTF-8, or is cut in a character, made so."""
    entry = tarfile.TarInfo(name.decode("latin-1"))
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.GNU_FORMAT, encoding="latin-1") as tar:
        tar.addfile(entry)
    daemon = make_daemon()
    reply = daemon.post("/v1/datasets", body=archive.getvalue(), query={"name": "odd"}, headers=TAR)
    job = daemon.wait(reply.json["id"])
    assert job["attempt"] == 1 and job["problem"]["status"] == 422, job
    assert "an entry's name must be relative, UTF-8" in job["problem"]["detail"]


def test_frames_are_lent_to_the_runner(make_daemon, photographs):
    """While a path is rendered its frames lie in the scene's folder, all that its runner may write."""
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "3"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("s", max_steps=3)
    daemon.hold()
    keys = [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 2)]
    job = daemon.submit(type="path", scene="s", camera_path={
        "axes": "opengl", "fps": 20, "width": 8, "height": 8, "keys": keys})
    root = Path(daemon.data)
    items = daemon.eventually(lambda: daemon.get(f"/v1/jobs/{job}/frames").json["items"])
    assert list(root.glob(f"scenes/*/frames/{job}/*.png")) and not list(root.glob(f"jobs/{job}/*/"))
    assert daemon.get(items[0]["url"]).status == 200
    daemon.let_go_on()
    assert daemon.wait(job)["result"]["frames"] == 41
    assert not list(root.glob("scenes/*/frames/*"))
    assert len(list(root.glob(f"jobs/{job}/frames/*.png"))) == 41
    assert len(daemon.get(f"/v1/jobs/{job}/frames").json["items"]) == 41
