"""The wall clock is set while the daemon works: nothing waits for it, and nothing gets old by it."""

import datetime
from pathlib import Path

from support.clocks import YEAR_S

PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": time_s, "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]],
                  "fov_y_deg": 40} for time_s in (0, 1)]}


def years_between(record, first, second):
    first, second = (datetime.datetime.fromisoformat(record[name][:-1]) for name in (first, second))
    return round((second - first).total_seconds() / YEAR_S)


def path_job(daemon):
    job = daemon.submit(type="path", scene="ready", camera_path=PATH)
    record = daemon.wait(job)
    assert record["state"] == "succeeded"
    return record


def frames_of(daemon, job):
    return len(daemon.get(f"/v1/jobs/{job['id']}/frames").json["items"])


def wait_for_steps(daemon, job, count):
    """So many more than it has."""
    def step():
        return (daemon.job(job)["progress"] or {}).get("step", 0)
    begin = step()
    daemon.eventually(lambda: step() >= begin + count)


def test_a_clock_that_is_set_stops_and_ends_nothing(make_daemon, photographs, clock):
    daemon = make_daemon({**clock.environment, "RIPNERF_FAKE_STEP_US": "1000"}, keep_alive="1s")
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 1000000})
    wait_for_steps(daemon, job, 1)
    for years in (10, -10):
        clock.set(years)
        wait_for_steps(daemon, job, 200)
        assert daemon.post("/v1/scenes/s/render", {"view": "test:0"}).status == 200
    assert daemon.post(f"/v1/jobs/{job}/finish").status == 200
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 1, record
    assert years_between(record, "created_at", "finished_at") == -10
    # Idle runners end after their time all the same.
    daemon.eventually(lambda: not any(daemon.get(f"/v1/scenes/{name}").json["loaded"] for name in ("s", "ready")))
    assert daemon.stop() == 0


def test_a_clock_that_is_set_makes_no_pictures_old(make_daemon, photographs, clock):
    """What is kept for an hour stays when the clock is ten years ahead: the same look removes what
    has no room."""
    daemon = make_daemon(clock.environment)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    oldest = path_job(daemon)
    size = sum(path.stat().st_size for path in (Path(daemon.data) / "jobs" / oldest["id"] / "frames").iterdir())
    daemon.stop()
    daemon.options |= {"retain_pictures": "1h", "retain_space": 2 * size}
    daemon.start()
    before = path_job(daemon)
    clock.set(10)
    after = path_job(daemon)
    assert years_between({**after, "before": before["finished_at"]}, "before", "finished_at") == 10
    daemon.eventually(lambda: frames_of(daemon, oldest) == 0)
    assert frames_of(daemon, before) == frames_of(daemon, after) == 3
