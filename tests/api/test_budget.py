"""Asking for a picture by what it may cost, and the curve that says what it will."""

import json
import os
import signal
import time
from pathlib import Path

import pytest

from support.client import Client
from support.curves import POINT, write_curve
from support.photographs import pose, write_dataset

CAMERA = {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
          "width": 64, "height": 64, "fov_y_deg": 40}
PATH = {"axes": "opengl", "fps": 4, "interpolation": "linear", "loop": False, "width": 12, "height": 10,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1)]}
ROW_US = 2000  # so that a picture of 64 rows takes 128 ms in full, 8 to 16 with `subsample` 8


def ask(daemon, scene="ready", **budget):
    return daemon.post(f"/v1/scenes/{scene}/render", {"camera": CAMERA, **budget})


def start(make_daemon, photographs, row_us):
    """A daemon whose rows take their time, with scene `ready`."""
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": str(row_us)})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    assert ask(daemon).status == 200  # it is loaded
    return daemon


@pytest.fixture(name="slow")
def fixture_slow(make_daemon, photographs):
    return start(make_daemon, photographs, ROW_US)


@pytest.fixture(name="quick")
def fixture_quick(make_daemon, photographs):
    return start(make_daemon, photographs, ROW_US // 20)


def test_within_a_time(slow):
    """A picture is there in time, rough where that must be; the answer says what it is."""
    for within in (60, 400):
        reply = ask(slow, within_ms=within)
        headers = reply.headers
        assert reply.status == 200 and reply.body[:4] == b"\x89PNG"
        assert float(headers["X-Ripnerf-Asked-Ms"]) == within
        assert headers["Cache-Control"] == "no-store" and "ETag" not in headers
        assert headers["X-Ripnerf-Curve"] == "preset"
        late = float(headers["X-Ripnerf-Spent-Ms"]) > within
        assert headers["X-Ripnerf-Late"] == ("1" if late else "0")
        assert float(headers["X-Ripnerf-Expected-Psnr"]) > 0
        # What was thought to take a millisecond, and takes 128, is given up for a quick picture.
        assert within == 400 or "subsample" in headers["X-Ripnerf-Setting"]
    assert "subsample" in ask(slow, within_ms=40).headers["X-Ripnerf-Setting"]
    assert ask(slow, within_ms=60000).headers["X-Ripnerf-Setting"] == "full"


def test_less_time_than_the_cheapest_picture_takes(slow):
    headers = ask(slow, within_ms=1).headers
    assert headers["X-Ripnerf-Late"] == "1" and "subsample=8" in headers["X-Ripnerf-Setting"]


def test_without_a_budget_nothing_is_said(shared):
    headers = ask(shared).headers
    assert "ETag" in headers and "X-Ripnerf-Late" not in headers


@pytest.mark.parametrize("budget, pointer", [
    ({"within_ms": 0}, "#/within_ms"), ({"within_ms": -1}, "#/within_ms"),
    ({"within_ms": 1e9}, "#/within_ms"), ({"within_ms": "abc"}, "#/within_ms"),
    ({"quality": 101}, "#/quality"), ({"quality": -1}, "#/quality"),
    ({"render_psnr": 0}, "#/render_psnr"), ({"render_psnr": 1e9}, "#/render_psnr"),
    ({"within_ms": 50, "quality": 10}, "#/quality"),
    ({"render_psnr": 30, "tolerance": 0.1}, "#/render_psnr"),
    ({"quality": 30, "subsample": 1}, "#/quality")])
def test_what_is_no_budget(shared, budget, pointer):
    reply = ask(shared, **budget)
    assert reply.status == 422
    assert [error["pointer"] for error in reply.json["errors"]] == [pointer]
    options = {"type": "eval", "scene": "ready", "options": budget}
    reply = shared.post("/v1/jobs", options)
    assert reply.status == 422
    assert reply.json["errors"][0]["pointer"] == pointer.replace("#/", "#/options/")


def test_quality_and_psnr(shared):
    low, high = ask(shared, quality=0), ask(shared, quality=100)
    assert high.headers["X-Ripnerf-Setting"] == "full"
    assert "subsample=8" in low.headers["X-Ripnerf-Setting"]
    assert low.headers["X-Ripnerf-Late"] == high.headers["X-Ripnerf-Late"] == "0"
    assert "X-Ripnerf-Asked-Ms" not in low.headers
    reached = ask(shared, render_psnr=21)
    assert float(reached.headers["X-Ripnerf-Expected-Psnr"]) >= 21
    assert reached.headers["X-Ripnerf-Late"] == "0"
    missed = ask(shared, render_psnr=99)
    assert missed.headers["X-Ripnerf-Setting"] == "full" and missed.headers["X-Ripnerf-Late"] == "1"


def test_what_a_file_loses_is_expected(shared):
    """A PNG is the picture; what a JPEG takes from it is measured."""
    png, fine, coarse = (float(ask(shared, quality=100, **how).headers["X-Ripnerf-Expected-Psnr"])
                         for how in ({}, {"format": "jpeg", "jpeg_quality": 95},
                                     {"format": "jpeg", "jpeg_quality": 1}))
    assert coarse + 0.5 < fine < png


def test_psnr_is_what_is_expected_of_this_view(quick, build, tmp_path):
    """Not by what points are worth on average: pictures of some places are better than of others."""
    measure(quick, views=4)
    mean = quick.get("/v1/scenes/ready/curve").json["points"][-1]["psnr"]
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{quick.port}")
    here = []
    for view in range(4):
        def view_asked(**budget):
            reply = quick.post("/v1/scenes/ready/render", {"view": f"test:{view}", **budget})
            spread = float(reply.headers["X-Ripnerf-Expected-Spread"])
            if "quality" in budget:
                assert spread < 0.15  # this very picture was compared with its photograph
            return float(reply.headers["X-Ripnerf-Expected-Psnr"]), reply.headers["X-Ripnerf-Late"]
        best, _ = view_asked(quality=100)
        here.append(best - mean)
        for less in (0.02, 0.5, 1, 2, 4):
            expected, late = view_asked(render_psnr=best - less)
            assert expected >= best - less - 0.01 and late == "0"
        most, late = view_asked(render_psnr=99)
        assert late == "1" and most >= best
        told = client.run("render", "ready", "--view", f"test:{view}", "--render-psnr", 99,
                          "-o", f"{view}.png").stdout
        assert "below what was asked for" in told
    assert min(abs(more) for more in here) > 0.05  # or this would say nothing


def test_less_than_was_asked_for_is_told(make_daemon, photographs):
    """Of what would be less by what was interpolated in it, four times as much as in the curve's pictures, a better
    one is made. What only the file loses is known from the second one on."""
    daemon = start(make_daemon, photographs, 0)
    half = {**POINT, "psnr": 24, "interpolation": 1e-4, "roughness": 0, "setting": {"subsample": 2}}
    full = {**POINT, "setting": {}, "ms_median": 9, "psnr": 25, "psnr_full": None}
    write_curve(daemon, {"subsample": 8}, points=[{**POINT, "setting": {"subsample": 8}}, half, full])

    def told(asked, fov_y_deg, **how):
        reply = daemon.post("/v1/scenes/ready/render",
                            {"camera": {**CAMERA, "fov_y_deg": fov_y_deg}, "render_psnr": asked, **how})
        assert reply.status == 200, reply.json
        return (reply.headers["X-Ripnerf-Setting"], float(reply.headers["X-Ripnerf-Expected-Psnr"]),
                reply.headers["X-Ripnerf-Late"])
    assert told(22, 40) == ("subsample=2", 24, "0")
    assert told(21.8, 15) == ("subsample=2", 21.91, "0")
    assert told(22, 15) == ("full", 25, "0")
    assert told(25.1, 40) == ("full", 25, "1")
    jpeg = {"format": "jpeg", "jpeg_quality": 60}
    setting, expected, late = told(24, 40, **jpeg)
    assert setting == "subsample=2" and expected < 24 and late == "1"
    setting, expected, late = told(24, 40, **jpeg)
    assert setting == "full" and expected > 24 and late == "0"


def test_a_job_keeps_what_its_budget_became(shared):
    for kind, more in (("path", {"camera_path": PATH}), ("eval", {})):
        job = shared.wait(shared.submit(type=kind, scene="ready", options={"quality": 0}, **more))
        assert job["state"] == "succeeded", job
        assert job["options"]["quality"] == 0 and job["options"]["subsample"] == 8
        assert job["result"]["setting"] == "stop=0.1,subsample=8"
        job = shared.wait(shared.submit(type=kind, scene="ready", options={"quality": 100}, **more))
        assert job["options"]["tolerance"] == 0 and "subsample" not in job["options"]
        assert job["result"]["setting"] == "full"
        job = shared.wait(shared.submit(type=kind, scene="ready", options={"subsample": 2}, **more))
        assert "setting" not in job["result"]  # it was asked for itself


@pytest.mark.parametrize("kind, more", [("path", {"camera_path": {**PATH, "fps": 30}}), ("eval", {})])
@pytest.mark.parametrize("killed", ["runner", "daemon"])
def test_what_a_budget_became_stays_it(make_daemon, photographs, kind, more, killed):
    """Whatever the curve says when a runner goes on where one was killed."""
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "1"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    daemon.hold()
    job = daemon.submit(type=kind, scene="ready", options={"quality": 0}, **more)
    became = {"quality": 0, "stop": 0.1, "subsample": 8}
    daemon.eventually(lambda: became.items() <= daemon.job(job)["options"].items())
    if killed == "daemon":
        daemon.stop(signal.SIGKILL)
    for pid in daemon.runners() if killed == "runner" else ():
        os.kill(pid, signal.SIGKILL)
    write_curve(daemon, {"subsample": 16})
    daemon.let_go_on()
    if killed == "daemon":
        daemon.start()
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2, record
    assert became.items() <= record["options"].items()
    assert record["result"]["setting"] == "stop=0.1,subsample=8"
    assert ask(daemon, quality=0).headers["X-Ripnerf-Setting"] == "subsample=16"  # or it would say nothing
    again = daemon.wait(daemon.submit(type=kind, scene="ready", options={"quality": 0}, **more))
    assert again["result"]["setting"] == "subsample=16"
    if kind == "path":
        assert "expected_psnr" not in record["result"]  # the curve has no such setting
        assert again["result"]["expected_psnr"] == 20 and again["result"]["expected_spread"] == 0.5


@pytest.mark.parametrize("kind, more", [("path", {"camera_path": PATH}), ("eval", {})])
def test_a_job_knows_how_slow_pictures_are_now(slow, kind, more):
    """The curve says that the full picture takes a millisecond, and it takes 20 and more."""
    write_curve(slow, {"subsample": 8})
    for within, setting in ((10, "subsample=8"), (60000, "full")):
        job = slow.wait(slow.submit(type=kind, scene="ready", options={"within_ms": within}, **more))
        assert job["state"] == "succeeded", job
        assert job["result"]["setting"] == setting


@pytest.mark.parametrize("last, within, setting", [({"aperture": 0.2}, 200, "supersample=2"),
                                                   ({"fov_y_deg": 15}, 50, "subsample=8")])
def test_a_path_knows_its_dearest_frame(slow, last, within, setting):
    """The first one takes 20 ms in full. Those through a lens take 64 times as long with the cones a pixel that
    such a picture has, 80 ms with four; those that are narrower take 80 ms too."""
    write_curve(slow, {"subsample": 8})
    keys = [{**PATH["keys"][0], "aperture": 0, "focus": 3}, {**PATH["keys"][1], "aperture": 0, "focus": 3, **last}]
    job = slow.wait(slow.submit(type="path", scene="ready", camera_path={**PATH, "keys": keys},
                                options={"within_ms": within}))
    assert job["state"] == "succeeded", job
    assert job["result"]["setting"] == setting
    assert dict([setting.split("=")]).items() <= {k: str(v) for k, v in job["options"].items()}.items()


def test_curve_of_another_machine_says_so(quick):
    """What it was measured on stands in it; what of that is another now is told."""
    measure(quick, views=1)
    curve = quick.get("/v1/scenes/ready/curve").json
    assert curve["machine"] and curve["threads"] >= 1 and curve["version"] and len(curve["digest"]) == 64
    del curve["points"], curve["around"]
    for name, other, words in (("machine", "an abacus", "the machine"), ("kernels", "none", "the kernel set"),
                               ("threads", 1000, "the number of threads"), ("version", "0", "the version"),
                               ("device", "cuda:9", "the device"), ("digest", "0" * 64, "the scene's parameters")):
        write_curve(quick, {"subsample": 16}, **{**curve, name: other})
        told = quick.get("/v1/scenes/ready/curve").json
        assert told["stale"] and told["stale_because"] == words, told
    write_curve(quick, {"subsample": 16}, **curve)
    assert not quick.get("/v1/scenes/ready/curve").json["stale"]


def measure(daemon, scene="ready", **options):
    reply = daemon.post(f"/v1/scenes/{scene}/curve", options)
    assert reply.status == 202, reply.json
    job = daemon.wait(reply.json["id"])
    assert job["state"] == "succeeded" and job["type"] == "curve", job
    return job


def test_curve(quick):
    assert quick.get("/v1/scenes/ready/curve").status == 404
    job = measure(quick, views=2)
    curve = quick.get("/v1/scenes/ready/curve").json
    assert curve == job["result"] and not curve["stale"] and curve["photographs"]
    points = curve["points"]
    assert [point["ms_median"] for point in points] == sorted(p["ms_median"] for p in points)
    worth = [point["psnr"] for point in points[:-1]]
    assert worth == sorted(worth) and points[-1]["setting"] == {}
    assert points[-1]["psnr_full"] is None and points[0]["setting"]["subsample"] >= 4
    # The curve is the scene's own from now on.
    headers = ask(quick, quality=0).headers
    assert headers["X-Ripnerf-Curve"] == "measured"
    # What is expected goes by the views nearest to the camera.
    seen = [view["psnr"] for view in curve["around"]]
    full = float(ask(quick, quality=100).headers["X-Ripnerf-Expected-Psnr"])
    assert min(seen) - 0.01 <= full <= max(seen) + 0.01
    for body in ({"views": 0}, {"views": 65}, {"view": 1}):
        assert quick.post("/v1/scenes/ready/curve", body).status == 422
    assert quick.post("/v1/scenes/nobody/curve", {}).status == 404
    assert quick.get("/v1/scenes/nobody/curve").status == 404


def test_a_curve_knows_every_view_that_was_held_out(make_daemon, tmp_path):
    """Also of many: what is expected of a picture from the place of one is what that one is worth."""
    daemon = make_daemon()
    held_out = {"val": 66, "test": 70}
    folder = write_dataset(tmp_path / "many", size=8, train=2, **held_out)
    assert daemon.wait(daemon.upload("data", folder))["state"] == "succeeded"
    daemon.train("ready")
    measure(daemon, views=1)
    curve = daemon.get("/v1/scenes/ready/curve").json
    assert len(curve["around"]) == sum(held_out.values())


def test_curve_of_other_parameters_is_stale(own):
    """What was measured while a scene trained says so when the training is over."""
    job = own.submit(type="train", dataset="data", scene="moving", options={"max_steps": 100000})
    own.eventually(lambda: own.get("/v1/scenes/moving").json["state"] == "training" and
                   ask(own, "moving").status == 200)
    measure(own, "moving", views=1)
    assert own.post(f"/v1/jobs/{job}/finish").status == 200
    assert own.wait(job)["state"] == "succeeded"
    curve = own.get("/v1/scenes/moving/curve").json
    assert curve["stale"] and "parameters" in curve["stale_because"] and curve["digest"] is None
    assert ask(own, "moving", quality=0).headers["X-Ripnerf-Curve"] == "stale"


def test_an_older_curve_is_measured_anew(make_daemon, photographs):
    """One that was measured in another way says so, and in idle time there is a new one."""
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": "100"}, curve_after=1)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    curve = "/v1/scenes/ready/curve"
    daemon.eventually(lambda: daemon.get(curve).status == 200)
    assert not daemon.get(curve).json["stale"]
    assert daemon.stop() == 0
    (file,) = Path(daemon.data).glob("scenes/*/curve.json")
    older = json.loads(file.read_text(encoding="utf-8"))
    del older["method"]
    file.write_text(json.dumps(older), encoding="utf-8")
    daemon.start()
    told = daemon.get(curve).json
    assert told["stale"] and told["stale_because"] == "the way of measuring"
    assert ask(daemon, quality=0).headers["X-Ripnerf-Curve"] == "stale"
    daemon.eventually(lambda: not daemon.get(curve).json["stale"])
    assert ask(daemon, quality=0).headers["X-Ripnerf-Curve"] == "measured"


def test_curve_goes_on_after_its_runner_was_killed(make_daemon, photographs):
    """What is kept each second holds all but the last of what it had measured: of the first 66 ways, which
    leave no row out, 16 are no less than a second."""
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": "4000", "RIPNERF_FAKE_HELD_PICTURES": "60"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    daemon.hold()
    job = daemon.post("/v1/scenes/ready/curve", {"views": 1}).json["id"]

    def until(condition):
        def found():
            record = daemon.job(job)
            assert record["state"] not in ("succeeded", "failed")
            return condition(record) and record
        return daemon.eventually(found)

    until(lambda record: record["progress"] and record["progress"]["done"] >= 40)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGKILL)
    again = until(lambda record: record["attempt"] == 2 and record["progress"]
                  and record["state"] == "running" and record["progress"]["done"] > 0)
    assert again["progress"]["done"] >= 10
    daemon.let_go_on()
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2
    assert record["result"]["points"][-1]["setting"] == {}


def test_client(shared, build, tmp_path):
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{shared.port}")
    told = client.json("render", "ready", "--view", "test:0", "--within", "500ms", "-o", "a.png")
    assert told["asked_ms"] == 500 and told["curve"] == "preset" and told["client_ms"] > 0
    parts = told["queue_ms"] + told["render_ms"] + told["encode_ms"]
    assert 0 < parts <= told["spent_ms"] + 0.2 <= told["client_ms"] + 0.4
    plain = client.json("render", "ready", "--view", "test:0", "-o", "a.png")
    assert plain.keys() == {"file", "step", "render_ms"}  # the rest is of a budget alone
    assert told["late"] == (told["spent_ms"] > 500) and told["setting"]
    for wrong in ("0", "-1", "1e9", "abc", "50", "0ms", "50 apples", "61s"):
        out = client.run("render", "ready", "--view", "test:0", f"--within={wrong}", "-o", "b.png",
                         code=2)
        assert "with its unit" in out.stderr
    for wrong in ("101", "-1", "abc"):
        client.run("render", "ready", "--view", "test:0", f"--quality={wrong}", "-o", "b.png", code=2)
    (tmp_path / "path.json").write_text(json.dumps({"path": PATH}), encoding="utf-8")
    words = client.run("path", "ready", "path.json", "--quality", 0, "-o", "frames").stdout
    assert "; by what was asked for: stop=0.1,subsample=8, " in words and " dB expected" in words
    told = client.json("path", "ready", "path.json", "--quality", 100, "-o", "frames", "--overwrite")
    assert told["setting"] == "full" and told["expected_psnr"] > 0
    words = client.run("eval", "ready", "--quality", 0).stdout
    assert "by what was asked for, all were rendered with: stop=0.1,subsample=8" in words
    assert "asked for" not in client.run("eval", "ready").stdout
    measured = client.json("curve", "ready", "--measure", "--views", "1")
    told = client.run("curve", "ready", "--plot", "curve.svg").stdout
    assert "full" in told and measured["points"][-1]["setting"] == {}
    svg = (tmp_path / "curve.svg").read_text(encoding="utf-8")
    assert svg.count("<circle") == sum(point["psnr"] is not None for point in measured["points"])


def test_curves_are_measured_in_idle_time(make_daemon, photographs):
    """Of a scene that was trained; whoever wants something goes first."""
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "20"}, curve_after=1)
    daemon.hold()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    jobs = "/v1/jobs?type=curve"

    def wait_for(state, count=1):
        daemon.eventually(lambda: count <= [
            job["state"] for job in daemon.get(jobs).json["items"]].count(state))
    wait_for("running")
    daemon.train("other")
    assert daemon.get(jobs).json["items"][-1]["state"] in ("cancelling", "cancelled")
    wait_for("running")
    assert daemon.delete("/v1/scenes/other").status == 204
    assert daemon.delete("/v1/scenes/ready").status == 204
    assert daemon.get("/v1/scenes").json["items"] == []


def test_jobs_stand_still_between_pictures(make_daemon, photographs):
    """Where one picture follows another a job's frames have a tenth of the time, and all of it afterwards."""
    daemon = start(make_daemon, photographs, 20000)
    job = daemon.submit(type="path", scene="ready", camera_path={**PATH, "width": 8, "height": 1,
                                                                 "fps": 240})
    camera = {**CAMERA, "width": 8, "height": 8}

    def done():
        return (daemon.job(job)["progress"] or {"done": 0})["done"]
    daemon.eventually(done)
    before = done()
    for _ in range(100):
        assert daemon.post("/v1/scenes/ready/render", {"camera": camera, "quality": 0}).status == 200
    beside = done() - before
    assert 0 < beside < 50
    daemon.eventually(lambda: done() > before + beside + 50)


def test_a_measured_curve_is_not_measured_again(make_daemon, photographs):
    """One asked for before there was time for the one of idle time is as good."""
    daemon = make_daemon({}, curve_after=3)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    job = daemon.post("/v1/scenes/ready/curve", {"views": 1}).json["id"]
    assert daemon.wait(job)["state"] == "succeeded"
    time.sleep(5)
    assert [item["id"] for item in daemon.get("/v1/jobs?type=curve").json["items"]] == [job]


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_curve_of_idle_time_makes_way_after_a_restart_too(make_daemon, photographs, end):
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "20"}, curve_after=1)
    daemon.hold()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")

    def curve():
        return daemon.get("/v1/jobs?type=curve").json["items"][-1]
    daemon.eventually(lambda: daemon.get("/v1/jobs?type=curve").json["items"]
                      and curve()["state"] == "running")
    daemon.stop(end)
    daemon.start()
    assert curve()["state"] in ("queued", "running")
    assert daemon.post("/v1/scenes/ready/curve", {"views": 1}).status == 202
    assert curve()["state"] in ("cancelling", "cancelled")
    assert daemon.post("/v1/jobs", {"type": "eval", "scene": "ready"}).status == 202
    assert daemon.get("/v1/jobs?type=curve").json["items"][0]["state"] in ("queued", "running")
