"""A disk that flushes more slowly than a runner has something to tell: everybody else is answered."""


def test_figures_faster_than_the_disk(make_daemon, build, photographs):
    """A hundred figures a second, each of which is flushed in 30 ms."""
    daemon = make_daemon({"LD_PRELOAD": str(build / "tests" / "support" / "ripnerf-slowdisk.so"),
                          "RIPNERF_FAKE_STEP_US": "10000"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job = daemon.submit(type="train", dataset="data", scene="s",
                        options={"max_steps": 100000, "evaluate_interval_s": 1e-9})
    figures = f"/v1/jobs/{job}/metrics"
    daemon.eventually(lambda: len(daemon.get(figures).json["items"]) > 20)
    for _ in range(20):
        assert daemon.job(job)["state"] == "running"
    assert daemon.post(f"/v1/jobs/{job}/cancel").status == 200
    daemon.wait(job, ["cancelled"])
