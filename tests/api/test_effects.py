"""What a scene's effects bring: short trainings with each and without it, in pairs."""

import os
import signal

import pytest

from support.client import NOT_FOUND, Client


@pytest.fixture(name="ready")
def fixture_ready(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_STEP_S": "0.001"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready", seed=7)
    return daemon


def measure(daemon, **options):
    reply = daemon.post("/v1/scenes/ready/effects", options)
    assert reply.status == 202, reply.json
    return reply.json["id"]


def test_effects_are_measured(ready):
    assert ready.get("/v1/scenes/ready/effects").status == 404
    job = ready.wait(measure(ready, seconds=1, seeds=2))
    assert job["state"] == "succeeded" and job["type"] == "effects", job
    measured = ready.get("/v1/scenes/ready/effects").json
    assert measured == job["result"] and measured["seconds"] == 1 and measured["seeds"] == 2
    # The engine that pretends says of all effects that they are on, with and without: none is told.
    names = {gain["name"] for gain in measured["gains"]}
    assert names == {"distortion"}, names
    (gain,) = measured["gains"]
    assert gain["on"] and abs(gain["gain"] - 2) < 0.5 and gain["gain_spread"] < 0.5
    assert abs(gain["psnr"] - gain["psnr_without"] - gain["gain"]) < 1e-9
    assert ready.get("/v1/scenes/ready").json["state"] == "ready"
    for body in ({"seconds": 0.5}, {"seeds": 0}, {"seeds": 17}, {"views": 1}):
        assert ready.post("/v1/scenes/ready/effects", body).status == 422
    assert ready.post("/v1/scenes/nobody/effects", {}).status == 404
    assert ready.get("/v1/scenes/nobody/effects").status == 404
    submitted = ready.submit(type="effects", scene="ready", options={"seconds": 1, "seeds": 1})
    assert ready.wait(submitted)["result"]["gains"][0]["gain_spread"] is None


def test_effects_are_measured_anew_after_a_crash_and_can_be_cancelled(ready):
    ready.hold()
    job = measure(ready, seconds=2, seeds=1)
    ready.eventually(lambda: ((ready.job(job)["progress"] or {}).get("done") or 0) >= 2)
    for pid in ready.runners():
        os.kill(pid, signal.SIGKILL)
    ready.let_go_on()
    record = ready.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2, record
    job = measure(ready, seconds=30, seeds=1)
    ready.wait(job, {"running"})
    assert ready.post(f"/v1/jobs/{job}/cancel").status in (200, 202)
    assert ready.wait(job)["state"] == "cancelled"


def test_the_client_tells_effects(ready, build, tmp_path):
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{ready.port}")
    told = client.run("effects", "ready").stdout
    assert "was not measured: ripnerf effects ready --measure (" in told and "of trainings)" in told
    assert "distortion" in told
    client.run("effects", "ready", "--json", code=NOT_FOUND)
    told = client.run("effects", "ready", "--measure", "--seconds", "1", "--seeds", "1").stdout
    (line,) = [line for line in told.splitlines() if line.startswith("distortion")]
    assert ("+2." in line or "+1." in line) and "pretended" in line
    assert "1 trainings of 1 s with each and without, in pairs; 8 pretended views" in told
    assert client.json("effects", "ready")["gains"][0]["name"] == "distortion"
