"""Trainings that end where no more is gained."""


def figures(daemon, job):
    """Pairs of training seconds and held-out PSNR."""
    items = daemon.get(f"/v1/jobs/{job}/metrics", query={"limit": 1000}).json["items"]
    return [(item["train_seconds"], item["psnr"]) for item in items if item.get("psnr")]


def test_a_training_ends_at_its_plateau(ball):
    """By the real engine: a ball of 48 pixels is as good as it gets long before 2,000 steps."""
    end = ball.json("train", "sphere", "--name", "whole", "--preset", "draft", "--max-steps", 2000, "--until-plateau",
                    "--threads", 1, "--wait")
    assert end["finished_by"] == "plateau" and 0.35 * 1.5 * 2000 < end["steps"] < 2000, end


def test_a_plateau_is_looked_for_often(make_daemon, photographs):
    """The pretending engine knows no plateau: the training goes on to its limit, and says so."""
    daemon = make_daemon({"RIPNERF_FAKE_STEP_S": "0.01", "RIPNERF_FAKE_STEP_US": "100"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job = daemon.submit(type="train", dataset="data", scene="whole",
                        options={"max_time_s": 120, "until_plateau": True})
    assert daemon.wait(job)["result"]["finished_by"] == "time"
    looked = [seconds for seconds, _ in figures(daemon, job)]
    assert looked[-1] > 100
    for last, seconds in zip(looked, looked[1:]):
        assert last < 40 or seconds - last < 0.1 * last + 5, looked
