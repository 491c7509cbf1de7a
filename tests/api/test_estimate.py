"""What a training will take, told before it starts; and what came of it."""

import math
import os
import signal
from datetime import datetime

import pytest

from support.client import Client

# The pretending engine has 20 + 15 (1 - exp(-steps / 200)) dB: 30 after 220 steps, 33 after 403.
FAST = {"RIPNERF_FAKE_STEP_S": "0.04", "RIPNERF_FAKE_STEP_US": "1000"}
OPTIONS = {"preset": "standard", "max_time_s": 60}
LOOKED = 0.46875  # of the training, what an estimate makes of it


@pytest.fixture(name="daemon")
def fixture_daemon(make_daemon, photographs):
    daemon = make_daemon(FAST)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    return daemon


def submit(daemon, **options):
    asked = {key: value for key, value in {**OPTIONS, **options}.items() if value is not None}
    return daemon.submit(type="estimate", dataset="data", options=asked)


def estimate(daemon, **options):
    job = daemon.wait(submit(daemon, **options))
    assert job["state"] == "succeeded", job
    return job


def train(daemon, scene, **options):
    job = daemon.submit(type="train", dataset="data", scene=scene, options={**OPTIONS, **options})
    return daemon.wait(job)["result"]


def spooled(daemon):
    return os.listdir(os.path.join(daemon.data, "spool"))


def test_what_a_training_takes(daemon):
    result = estimate(daemon)["result"]
    assert result["seconds"] == 60 and result["psnr"] > 25 and result["psnr_spread"] > 0
    measured = result["calibration"]
    assert measured["seconds"] == pytest.approx([60 * LOOKED * n / 3 for n in (1, 2, 3)], rel=0.1)
    assert measured["psnr"] == sorted(measured["psnr"]) and measured["psnr"][2] < result["psnr"]
    assert [passing["psnr"] for passing in result["passings"]] == [30, 33]
    assert result["memory_bytes"] > 0 and result["disk_bytes"] > 0
    assert result["past"] == {"estimates": 0, "psnr_off": None, "seconds_off": None}


def test_steps_take_longer_than_those_at_the_beginning(daemon):
    result = estimate(daemon, max_time_s=10, max_steps=100)["result"]
    assert result["seconds"] == pytest.approx(122 * result["calibration"]["step_seconds"])
    steps = estimate(daemon, max_time_s=None, max_steps=100000)["result"]
    assert steps["seconds"] == pytest.approx(1.22e5 * steps["calibration"]["step_seconds"])


def test_passes_over_the_photographs_are_made_once(make_daemon, photographs):
    """15 s of them, and steps of 0.04 s: more steps take no more of them."""
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_PASS_S": "15"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    steps = estimate(daemon, max_time_s=None, max_steps=100000)["result"]
    assert steps["calibration"]["turn_seconds"] == 15
    assert steps["calibration"]["step_seconds"] == pytest.approx(0.04)
    assert steps["seconds"] == pytest.approx(15 + 1.22e5 * 0.04)


def test_a_longer_training_is_begun_as_one_of_a_minute(daemon):
    result = estimate(daemon, max_time_s=600)["result"]
    assert result["calibration"]["seconds"][2] == pytest.approx(60 * LOOKED, rel=0.1)
    assert result["seconds"] == 600 and result["psnr"] > estimate(daemon)["result"]["psnr"]


@pytest.mark.parametrize("passes_s, looked_s", [(15, 0.04 * 2 * 234 + 15), (30, 0.8 * 60)])
def test_the_last_look_waits_for_steps(make_daemon, photographs, passes_s, looked_s):
    """Passes over the photographs after the first look, of 9.4 s or 234 steps, would leave the last nothing
    new to see."""
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_PASS_S": str(passes_s)})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    measured = estimate(daemon)["result"]["calibration"]
    assert measured["seconds"][2] == pytest.approx(looked_s, rel=0.06)


def test_nothing_of_it_is_kept(daemon):
    estimate(daemon)
    assert daemon.get("/v1/scenes").json["items"] == []
    daemon.eventually(lambda: not daemon.runners() and not spooled(daemon))


def test_the_truth_is_kept_beside_it(daemon):
    first = estimate(daemon, evaluate_interval_s=1)
    result = train(daemon, "one", evaluate_interval_s=1)
    told = result["estimate"]
    assert told["job"] == first["id"] and told["psnr"] == first["result"]["psnr"]
    assert told["seconds"] == 60 and result["train_seconds"] == pytest.approx(60, rel=0.1)
    reached = [passing["reached"] for passing in told["passings"]]
    assert 0 < reached[0] < reached[1] < 61
    past = estimate(daemon)["result"]["past"]
    assert past["estimates"] == 1
    assert past["psnr_off"] == pytest.approx(abs(result["psnr"] - told["psnr"]), abs=1e-6)


def test_what_trainings_took_here_is_told_of_each_dataset(make_daemon, build, tmp_path, photographs):
    """By formula before any has ended; then by those with `standard`: what a training spends beside its
    own clock, the least that was seen, is added to a minute and not multiplied with it."""
    daemon = make_daemon({"RIPNERF_FAKE_STEP_S": "0.0005", "RIPNERF_FAKE_STEP_US": "1000"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    before = daemon.get("/v1/datasets/data").json
    assert before["report"]["expected"]["seconds"] == 60 and "past" not in before
    train(daemon, "drafted", preset="draft", max_steps=50)
    assert "past" not in daemon.get("/v1/datasets/data").json
    beside = []
    for steps in (400, 50, 800):
        job = daemon.submit(type="train", dataset="data", scene=f"of-{steps}",
                            options={**OPTIONS, "max_steps": steps})
        job = daemon.wait(job)
        took = [datetime.fromisoformat(job[f"{end}_at"]) for end in ("started", "finished")]
        beside.append((took[1] - took[0]).total_seconds() - job["result"]["train_seconds"])
        past = daemon.get("/v1/datasets/data").json["past"]
        assert past["trainings"] == len(beside)
        assert past["seconds"] == pytest.approx(60 + min(beside), abs=0.002)
    assert past["memory_bytes"] > 1e6
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{daemon.port}")
    told = client.run("import", photographs, "--name", "again").stdout
    assert "training with standard takes" in told and "of memory, by 3 trainings here" in told
    assert "past" not in daemon.get("/v1/datasets").json["items"][0]


def test_only_what_was_estimated_is_checked(daemon):
    estimate(daemon)
    assert "estimate" not in train(daemon, "other", seed=3)
    assert "estimate" in train(daemon, "same")


def forecast(result):
    """Of the calibration alone: 0.45 of what was gained between the first look and 15/32 is still to come
    then, and less of it the later the last look is; of a longer training, 0.3 of what is gained after the
    second look for twice the time, and 0.72 of it for twice that."""
    seconds, psnr = result["calibration"]["seconds"], result["calibration"]["psnr"]
    whole = result["calibration"]["whole_seconds"]
    left = ((1 - seconds[2] / whole) / (1 - LOOKED)) ** 2.2
    rise = 0.45 * left * (psnr[2] - psnr[0]) / (1 + 0.45 * (1 - left))
    doublings = math.log2(result["seconds"] / whole)
    return psnr[2] + rise + (rise + psnr[2] - psnr[1]) * 0.3 * (1 - 0.72 ** doublings) / 0.28


def test_past_errors_are_learnt_from(daemon):
    """What was promised too much or too little is taken back, the more the more is known."""
    off = []
    for i in range(3):
        result = estimate(daemon)["result"]
        assert result["psnr"] - forecast(result) == pytest.approx(sum(off) / (i + 2), abs=1e-3)
        off.append(train(daemon, f"scene-{i}")["psnr"] - result["psnr"])
    result = estimate(daemon)["result"]
    mean = sum(abs(one) for one in off) / 3
    assert result["psnr_spread"] == pytest.approx(mean) == result["past"]["psnr_off"]


def test_what_cannot_be_trained_is_refused(daemon):
    def ask(options, dataset="data"):
        return daemon.post("/v1/jobs", {"type": "estimate", "dataset": dataset, "options": options})
    assert ask({"planes": 5}).json["errors"][0]["pointer"] == "#/options/planes"
    assert ask({"max_time_s": -1}).status == 422 and ask({}, "none").status == 404
    assert daemon.post("/v1/jobs", {"type": "estimate", "dataset": "data", "scene": "x"}).status == 422
    job = daemon.wait(submit(daemon, kernels="none"))
    assert job["state"] == "failed" and "kernels" in str(job["problem"])


def test_it_is_cancelled_and_survives_its_runner(make_daemon, photographs):
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_STEP_S": "0.004"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.hold()
    job = submit(daemon)
    daemon.wait(job, ("running",))
    assert daemon.delete("/v1/datasets/data").status == 409
    assert daemon.post(f"/v1/jobs/{job}/cancel").status == 200
    assert daemon.wait(job)["state"] == "cancelled"
    job = submit(daemon)
    daemon.wait(job, ("running",))
    daemon.eventually(daemon.runners)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGKILL)
    daemon.let_go_on()
    job = daemon.wait(job)
    assert job["state"] == "succeeded" and job["attempt"] == 2


def test_the_client_tells(daemon, build, tmp_path):
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{daemon.port}")
    words = client.run("train", "data", "--estimate", "--max-time", "60s").stdout
    assert "ends after 60.0 s of training, with " in words and "no training here has ended" in words
    assert " of memory, " in words and " on disk; measured in " in words
    told = client.json("train", "data", "--estimate", "--max-time", "60s")
    assert told["seconds"] == 60 and told["calibration"]["threads"] >= 1
    told = client.run("train", "data", "--estimate", "--name", "a", "--max-time", "60s", code=2)
    assert "--name and --estimate exclude each other" in told.stderr
    assert daemon.get("/v1/scenes").json["items"] == []
    client.run("train", "data", "--name", "a", "--max-time", "60s", "--wait")
    words = client.run("train", "data", "--estimate", "--max-time", "60s").stdout
    assert "1 estimate of trainings here was off by" in words
