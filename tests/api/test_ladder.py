"""Ladders: jobs of jobs, their tables, their reports, and what becomes of them in a crash."""

import csv
import io
import json
import re
import signal

import pytest

from support.client import INVALID, NOT_FOUND, USAGE, Client

# A training of 8 s is 200 steps, which the pretending engine does in a fifth of one.
FAST = {"RIPNERF_FAKE_STEP_S": "0.04", "RIPNERF_FAKE_STEP_US": "1000"}


@pytest.fixture(name="daemon")
def fixture_daemon(make_daemon, photographs):
    daemon = make_daemon(FAST)
    assert daemon.wait(daemon.upload("lego-small", photographs))["state"] == "succeeded"
    return daemon


def submit(daemon, over, seconds=8, **options):
    train = {"max_time_s": seconds, **options.pop("train", {})}
    return daemon.submit(type="ladder", dataset="lego-small",
                         options={"over": over, "train": train, **options})


def report(daemon, job):
    reply = daemon.get(f"/v1/jobs/{job}/report", query={"format": "json"})
    assert reply.status == 200, reply.body
    return reply.json


def jobs(daemon, kind):
    return {job["id"]: job for job in
            daemon.get("/v1/jobs", query={"type": kind, "limit": 200}).json["items"]}


def wait_for_cells(daemon, job, count):
    """Until so many cells are over, and one more is at work."""
    def found():
        cells = daemon.get(f"/v1/jobs/{job}/report", query={"format": "json"})
        cells = cells.json["ladder"]["cells"] if cells.status == 200 else []
        states = [cell["state"] for cell in cells]
        return states.count("done") >= count and "training" in states and cells
    return daemon.eventually(found)


def test_a_table_is_trained_and_compared(daemon):
    job = submit(daemon, "planes=3,4 footprint=rip", seeds=2, views=2, one_cone=True, seconds=16)
    record = daemon.wait(job)
    assert record["state"] == "succeeded", record
    assert record["result"] | {"train_seconds": 0} == \
        {"trainings": 4, "failed": 0, "arms": 2, "train_seconds": 0}
    assert record["progress"]["done"] == 4 and record["progress"]["fraction"] == 1
    found = report(daemon, job)
    cells = found["ladder"]["cells"]
    labels = ["planes=3 footprint=rip", "planes=4 footprint=rip"]
    assert [(cell["label"], cell["seed"]) for cell in cells] == \
        [(label, seed) for seed in (1, 2) for label in labels]
    trained = jobs(daemon, "train")
    for cell in cells:
        options = trained[cell["train_job"]]["options"]
        assert options == {"planes": 3 if "=3" in cell["label"] else 4, "footprint": "rip",
                           "seed": cell["seed"], "max_time_s": 16}
        assert cell["state"] == "done" and cell["train_seconds"] >= 16
        assert cell["psnr"] > 29 and cell["ssim"] > 0.8 and cell["render_ms"] >= 0
        assert cell["one_cone_psnr"] == cell["psnr"] and cell["disk_bytes"] > 0
        assert all(moment["psnr"] > 29 for moment in cell.get("moments", []))
        assert all(moment["train_seconds"] < 0.9 * cell["train_seconds"] for moment in cell.get("moments", []))
    assert any(cell.get("moments") for cell in cells)
    assert found["ladder"]["views"] == 2 and found["ladder"]["protocol"]["split"] == "test"
    for arm, label in zip(found["arms"], labels):
        assert arm["label"] == label and arm["psnr"]["count"] == 2
        assert arm["margin"] == {"mean": 0, "low": 0, "high": 0, "count": 2}
    assert daemon.get("/v1/scenes").json["items"] == []


def test_its_report(daemon):
    job = submit(daemon, "planes=3,4", seeds=1, views=1)
    assert daemon.wait(job)["state"] == "succeeded"
    page = daemon.get(f"/v1/jobs/{job}/report")
    text = page.body.decode()
    assert page.type == "text/html" and "default-src 'none'" in page.headers["Content-Security-Policy"]
    assert text.count("<svg") == 5 and "planes=4" in text and "lego-small" in text
    assert not re.search(r"<script|src=|https?://", text.replace("data:", ""))
    rows = list(csv.DictReader(io.StringIO(
        daemon.get(f"/v1/jobs/{job}/report", query={"format": "csv"}).body.decode())))
    assert [row["arm"] for row in rows if row["at"] == "end"] == ["planes=3", "planes=4"]
    assert {row["at"] for row in rows} <= {"moment", "end"}
    assert all(float(row["psnr"]) > 29 for row in rows)
    paper = {figure["what"]: figure["psnr"] for figure in report(daemon, job)["paper"]}
    assert paper["10 planes, rip; four scales, 800 to 100 px"] == 38.36 and "36.94" in text
    assert daemon.get(f"/v1/jobs/{job}/report", query={"format": "pdf"}).status in (400, 422)
    other = jobs(daemon, "train").popitem()[0]
    assert daemon.get(f"/v1/jobs/{other}/report").status == 404


def test_it_goes_on_after_a_crash(make_daemon, photographs):
    """What was trained before the daemon was killed is not trained again, nor lost."""
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_HELD_AT": "100", "RIPNERF_FAKE_HELD_SEED": "2"})
    assert daemon.wait(daemon.upload("lego-small", photographs))["state"] == "succeeded"
    daemon.hold()
    job = submit(daemon, "planes=3,4,6", seeds=2, views=1, seconds=16)
    before = wait_for_cells(daemon, job, 3)  # of the first seed
    daemon.stop(signal.SIGKILL)
    daemon.let_go_on()
    daemon.start()
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2, record
    after = report(daemon, job)["ladder"]["cells"]
    trained = jobs(daemon, "train")
    assert len(after) == 6 == len(trained), "a cell was trained twice"
    for old, new in zip(before, after):
        assert new["state"] == "done" and new["train_job"] in trained
        if old["state"] == "done":
            assert new == old and trained[old["train_job"]]["attempt"] == 1
    assert len(jobs(daemon, "eval")) == sum(1 + len(cell.get("moments", [])) for cell in after)


def test_it_is_cancelled(make_daemon, photographs):
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_STEP_S": "0.001"})
    assert daemon.wait(daemon.upload("lego-small", photographs))["state"] == "succeeded"
    job = submit(daemon, "planes=3,4", seconds=600)
    wait_for_cells(daemon, job, 0)
    assert daemon.delete("/v1/datasets/lego-small").status == 409
    assert daemon.post(f"/v1/jobs/{job}/cancel").status == 200
    assert daemon.wait(job)["state"] == "cancelled"
    assert [training["state"] for training in jobs(daemon, "train").values()] == ["cancelled"]
    assert daemon.get("/v1/scenes").json["items"] == []
    cells = report(daemon, job)["ladder"]["cells"]
    assert {cell["state"] for cell in cells} == {"cancelled"} and len(cells) == 6


def test_a_cancelling_one_ends_after_a_crash(make_daemon, photographs):
    daemon = make_daemon({**FAST, "RIPNERF_FAKE_STEP_S": "0.001"})
    assert daemon.wait(daemon.upload("lego-small", photographs))["state"] == "succeeded"
    job = submit(daemon, "planes=3,4", seconds=600)
    wait_for_cells(daemon, job, 0)
    daemon.stop(signal.SIGKILL)
    daemon.start()
    daemon.post(f"/v1/jobs/{job}/cancel")
    daemon.stop(signal.SIGKILL)
    daemon.start()
    assert daemon.wait(job)["state"] == "cancelled"
    assert {training["state"] for training in jobs(daemon, "train").values()} == {"cancelled"}


def test_a_lost_cell_costs_itself_alone(daemon):
    daemon.hold()
    job = submit(daemon, "planes=3,4", seeds=1, views=1, keep=True, seconds=120)
    cells = wait_for_cells(daemon, job, 0)
    assert daemon.post(f"/v1/jobs/{cells[0]['train_job']}/cancel").status == 200
    daemon.let_go_on()
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["result"]["failed"] == 1
    states = [cell["state"] for cell in report(daemon, job)["ladder"]["cells"]]
    assert states == ["cancelled", "done"]
    assert "was cancelled" in daemon.get(f"/v1/jobs/{job}/report").body.decode()
    kept = {scene["name"] for scene in daemon.get("/v1/scenes").json["items"]}
    assert {cell["scene"] for cell in cells} == kept


def test_where_nothing_can_be_trained(daemon):
    job = submit(daemon, "planes=3,4", seeds=1, train={"kernels": "none"})
    record = daemon.wait(job)
    assert record["state"] == "failed" and "kernels" in record["problem"]["detail"], record


def test_planes_of_equal_size(daemon):
    """As the paper's ablation has them: as many texels as 10 planes of 512."""
    job = submit(daemon, "planes=10,6,4,3", seeds=1, views=1, moments=0, equal="size",
                 train={"preset": "paper", "max_steps": 20})
    assert daemon.wait(job)["state"] == "succeeded"
    trained = sorted(jobs(daemon, "train").values(), key=lambda one: one["created_at"])
    assert [one["options"]["base"] for one in trained] == [512, 661, 810, 935]


def test_settings_by_name(daemon):
    """Those that have no option, in what is asked for and in the scene's record."""
    job = submit(daemon, "width=16,128 + cone_step=false", seeds=1, views=1, moments=0, keep=True,
                 train={"settings": {"carve": False}})
    assert daemon.wait(job)["state"] == "succeeded"
    scenes = {scene["name"]: scene["config"] for scene in daemon.get("/v1/scenes").json["items"]}
    cells = report(daemon, job)["ladder"]["cells"]
    configs = [scenes[cell["scene"]] for cell in cells]
    assert [config["width"] for config in configs] == [16, 128, 64]
    assert [config["cone_step"] for config in configs] == [True, True, False]
    assert not any(config["carve"] for config in configs)


@pytest.mark.parametrize("options, pointer, words", [
    ({"over": "plains=3"}, "over", "there is no setting 'plains'"),
    ({"over": "planes=5"}, "over", "use 3, 4, 6 or 10"),
    ({"over": "planes=3,99"}, "over", "must be 1 to"),
    ({"over": "planes=3,"}, "over", "must be 1 to"),
    ({"over": "planes"}, "over", "is not NAME=VALUE"),
    ({"over": ""}, "over", "names no settings"),
    ({"over": "planes=3 +"}, "over", "names no settings"),
    ({"over": "planes=3 planes=4"}, "over", "twice"),
    ({"over": "footprint=square"}, "over", "must be rip, mip or point"),
    ({"over": "learning_rate=-1"}, "over", "must be more than 0"),
    ({"over": "seed=1,2"}, "over", "seeds are the ladder's own"),
    ({"over": "space=ball"}, "over", "follows from the photographs"),
    ({"over": "max-time=5,10"}, "over", "equal by time"),
    ({"over": "base=64", "equal": "size"}, "over", "equal by size"),
    ({"over": "planes=3", "equal": "steps"}, "train/max_steps", "must be given"),
    ({"over": "channels=4,8,16 base=2,3,4,5,6,7,8,9 width=16,32,48"}, "over", "more than 64 arms"),
    ({"over": "channels=4,8,16 base=2,3,4,5,6,7", "seeds": 16}, "over", "at most 256"),
    ({"over": "planes=3", "seeds": 0}, "seeds", "at least 1"),
    ({"over": "planes=3", "seeds": 17}, "seeds", "at most 16"),
    ({"over": "planes=3", "train": {"settings": {"planes": 3}}}, "train/settings/planes", "not a field"),
    ({"seeds": 1}, "over", "is missing")])
def test_what_is_refused(shared, options, pointer, words):
    reply = shared.post("/v1/jobs", {"type": "ladder", "dataset": "data", "options": options})
    assert reply.status == 422, reply.body
    error = reply.json["errors"][0]
    assert error["pointer"] == f"#/options/{pointer}" and words in error["detail"], error


def test_the_client(daemon, build, tmp_path):
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{daemon.port}")
    words = client.run("ladder", "lego-small", "--over", "planes=3,4", "footprint=rip", "+",
                       "planes=10", "--max-time", "8s", "--seeds", 1, "--views", 1, "--with",
                       "carve=false width=32", "--report", "a.html").stdout
    assert "planes=4 footprint=rip" in words and "planes=10 " in words and "PSNR" in words
    assert "<svg" in (tmp_path / "a.html").read_text(encoding="utf-8")
    job = jobs(daemon, "ladder").popitem()[0]
    for training in jobs(daemon, "train").values():
        assert training["options"]["settings"] == {"width": 32, "carve": False}
    assert "planes=10 " in client.run("ladder", job, "--report", "a.csv").stdout
    assert (tmp_path / "a.csv").read_text(encoding="utf-8").startswith("arm,seed,")
    assert len(client.json("ladder", job)["arms"]) == 3
    assert "3 trainings of 3 arms" in client.run("jobs").stdout
    assert "--overwrite" in client.run("ladder", job, "--report", "a.csv", code=USAGE).stderr
    for wrong, code, told in (
            (("lego-small",), USAGE, "needs --over"), (("lego-small", "--over", "planes=5"), INVALID, "--over"),
            (("lego-small", "--over", "planes=3", "--seeds", 0), USAGE, "--seeds"),
            (("lego-small", "--over", "planes=3", "--equal", "steps"), INVALID, "--max-steps"),
            (("lego-small", "--over", "planes=3", "--with", "width=16,32"), USAGE, "several values"),
            (("nobody", "--over", "planes=3"), NOT_FOUND, "nobody"),
            (("lego-small", "--over", "planes=3", "--report", "a.pdf"), USAGE, ".html, .csv or .json")):
        assert told in client.run("ladder", *wrong, code=code).stderr
    assert json.loads(client.run("ladder", "job_aaaaaaaaaaaa", "--json", code=NOT_FOUND).stderr)
