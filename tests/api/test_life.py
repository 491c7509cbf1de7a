"""The life of what is stored: backed up and restored, kept and cleaned up, brought up to date."""

import os
import re
import signal
import sqlite3
import subprocess
import threading
from pathlib import Path

import pytest

from support.checked import Daemon, tar_of
from support.waiting import PATIENCE_S, wait_for

PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": t, "fov_y_deg": 40, "world_from_camera":
                  [[1, 0, 0, t], [0, 1, 0, 0], [0, 0, 1, 4]]} for t in (0, 1)]}
RENDER = {"view": "test:0", "size": {"width": 8, "height": 8}}


def everything(daemon):
    """All records and one picture, without what changes from start to start."""
    lists = {kind: daemon.get(f"/v1/{kind}").json["items"]
             for kind in ("datasets", "scenes", "jobs", "camera-paths", "tokens")}
    for scene in lists["scenes"]:
        scene["loaded"] = False
    metrics = [daemon.get(f"/v1/jobs/{job['id']}/metrics").json for job in lists["jobs"]]
    picture = daemon.post("/v1/scenes/ready/render", RENDER)
    assert picture.status == 200
    return lists, metrics, picture.headers["ETag"], picture.body


@pytest.fixture
def run(build):
    def run_client(*words, daemon=None, code=0):
        environment = dict(os.environ)
        if daemon is not None:
            environment["RIPNERF_HOST"] = f"http://{daemon.host}:{daemon.port}"
        done = subprocess.run([build / "client/ripnerf", *map(str, words)], env=environment,
                              capture_output=True, text=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr
    return run_client


@pytest.fixture
def full(own):
    """A daemon with one of everything."""
    own.train("ready")
    assert own.wait(own.submit(type="path", scene="ready", camera_path=PATH))["state"] == "succeeded"
    assert own.post("/v1/camera-paths", {"name": "kept", "path": PATH}).status == 201
    assert own.post("/v1/tokens", {"name": "anna", "scope": "train"}).status == 201
    return own


def test_backup_and_restore(full, programs, run, tmp_path):
    """The same records, frames and pictures, from a backup that was made while a scene trained."""
    before = everything(full)
    job = full.submit(type="train", dataset="data", scene="busy", options={"max_steps": 100000})
    full.wait(job, states=("running",))
    run("backup", tmp_path / "all.tar", daemon=full)
    wait_for(lambda: not list((Path(full.data) / "spool").iterdir()))
    assert full.get("/v1/backup").status == 200
    full.post(f"/v1/jobs/{job}/cancel")
    full.wait(job)
    run("restore", tmp_path / "all.tar", tmp_path / "again")
    scrub = subprocess.run([programs[0], "--data", tmp_path / "again", "--scrub"],
                           capture_output=True, text=True, check=False)
    assert scrub.returncode == 0 and ", 0 damaged" in scrub.stdout, scrub.stdout + scrub.stderr
    with Daemon(*programs, tmp_path / "again", {"RIPNERF_FAKE_STEP_US": "2000"}) as restored:
        assert "no record" not in restored.log_text()
        assert restored.get("/v1/scenes/busy").status == 200
        restored.post(f"/v1/jobs/{job}/cancel")
        restored.wait(job)
        assert restored.delete("/v1/scenes/busy").status == 204
        after = everything(restored)
        after[0]["jobs"] = [item for item in after[0]["jobs"] if item["id"] != job]
        path = next(item["id"] for item in after[0]["jobs"] if item["type"] == "path")
        assert restored.get(f"/v1/jobs/{path}/frames/0").body == \
            full.get(f"/v1/jobs/{path}/frames/0").body
    assert after[0] == before[0] and after[2:] == before[2:]
    assert after[1][-len(before[1]):] == before[1]


def test_what_has_no_record_is_in_no_backup(full, programs, tmp_path):
    """What a failed import left of a dataset keeps no backup from being taken in."""
    left = Path(full.data) / "datasets" / "ds_leftleftleft"
    left.mkdir()
    (left / "SHA256SUMS").write_text(f"{'0' * 64}  images/gone.png\n")
    backup = full.get("/v1/backup")
    with Daemon(*programs, tmp_path / "there") as there:
        taken = there.request("POST", "/v1/backup", body=backup.body, check=False,
                              headers={"Content-Type": "application/x-tar"})
        assert taken.status == 200, taken.body
        assert pictures_of(there, "ready") == pictures_of(full, "ready")


def test_a_backup_is_taken_in_where_a_rest_of_its_content_lies(full):
    """What a deletion could not remove is in nobody's way; what has no record otherwise is not touched."""
    def send():
        return full.post("/v1/backup", body=backup, headers={"Content-Type": "application/x-tar"})
    before = pictures_of(full, "ready")
    scene = full.get("/v1/scenes/ready").json
    backup = full.get("/v1/backup").body
    content = [Path(full.data) / "scenes" / scene["id"], Path(full.data) / "datasets" / scene["dataset"]]
    for folder in content:
        assert full.delete(f"/v1/{folder.parent.name}/{folder.name}").status == 204
        (folder / "images").mkdir(parents=True)
    assert send().json["datasets"] == 1
    assert pictures_of(full, "ready") == before
    for folder in content:
        assert full.delete(f"/v1/{folder.parent.name}/{folder.name}").status == 204
    full.stop()
    full.start()  # it is not remembered any more what was deleted
    (content[1] / "images").mkdir(parents=True)
    refused = send()
    assert refused.status == 409 and content[1].name in refused.json["detail"], refused.body
    assert (content[1] / "images").is_dir() and full.get("/v1/scenes").json["items"] == []
    content[1].rename(Path(full.data) / "aside")
    assert send().status == 200
    assert pictures_of(full, "ready") == before


def pictures_of(daemon, scene):
    answers = [daemon.post(f"/v1/scenes/{scene}/render", {**RENDER, "view": f"test:{i}"}) for i in (0, 1)]
    assert [answer.status for answer in answers] == [200, 200]
    return [answer.body for answer in answers]


def test_a_scene_moves_to_another_machine(full, programs, photographs, run, tmp_path):
    """One scene with its checkpoints, dataset and jobs, from a daemon that goes on, into a new folder or
    among what another daemon has; nothing that tells of others goes along."""
    assert full.wait(full.upload("other-photographs", photographs))["state"] == "succeeded"
    full.train("secret-scene", dataset="other-photographs")
    scene = full.get("/v1/scenes/ready").json
    before = pictures_of(full, "ready")
    run("backup", tmp_path / "none.tar", "--scene", "no such", daemon=full, code=3)
    run("backup", tmp_path / "one.tar", "--scene", "ready", daemon=full)
    everything_in_it = (tmp_path / "one.tar").read_bytes()
    for word in (b"other-photographs", b"secret-scene", b"anna"):
        assert word not in everything_in_it
    run("restore", tmp_path / "one.tar", tmp_path / "new")
    with Daemon(*programs, tmp_path / "new") as moved:
        assert "no record" not in moved.log_text()
        assert [item["name"] for item in moved.get("/v1/scenes").json["items"]] == ["ready"]
        assert [item["name"] for item in moved.get("/v1/datasets").json["items"]] == ["data"]
        assert {item["type"] for item in moved.get("/v1/jobs").json["items"]} == \
            {"ingest", "train", "path"}
        assert pictures_of(moved, "ready") == before


def test_a_scene_joins_what_a_daemon_has(full, programs, photographs, run, tmp_path):
    """Into a daemon that goes on, under another name where its own is taken; twice is once, and what is
    damaged changes nothing. It is there after a crash."""
    scene = full.get("/v1/scenes/ready").json
    before = pictures_of(full, "ready")
    run("backup", tmp_path / "one.tar", "--scene", "ready", daemon=full)
    with Daemon(*programs, tmp_path / "there") as there:
        assert there.wait(there.upload("data", photographs))["state"] == "succeeded"
        there.train("ready")
        own = pictures_of(there, "ready")
        damaged = bytearray((tmp_path / "one.tar").read_bytes())
        photograph = 512 + list(re.finditer(rb"datasets/\w+/images/", damaged))[-1].start()
        damaged[photograph + 60] ^= 1
        (tmp_path / "damaged.tar").write_bytes(damaged)
        assert "not as they were written" in run("restore", tmp_path / "damaged.tar", daemon=there, code=4)
        assert there.get(f"/v1/scenes/{scene['id']}").status == 404
        assert "1 scenes, 1 datasets, 0 camera paths, 3 jobs" in \
            run("restore", tmp_path / "one.tar", daemon=there)
        assert "0 scenes, 0 datasets, 0 camera paths, 0 jobs" in \
            run("restore", tmp_path / "one.tar", daemon=there)
        names = [item["name"] for item in there.get("/v1/scenes").json["items"]]
        added = there.get(f"/v1/scenes/{scene['id']}").json
        assert sorted(names) == sorted(["ready", added["name"]]) and added["name"] != "ready"
        assert added["parameters_sha256"] == scene["parameters_sha256"]
        assert pictures_of(there, added["name"]) == before and pictures_of(there, "ready") == own
        assert there.wait(there.submit(type="eval", scene=added["name"],
                                       options={"split": "test"}))["state"] == "succeeded"
        assert not list((tmp_path / "there" / "spool").iterdir())
        there.stop(signal.SIGKILL)
        there.start()
        assert pictures_of(there, added["name"]) == before
    scrub = subprocess.run([programs[0], "--data", tmp_path / "there", "--scrub"],
                           capture_output=True, text=True, check=False)
    assert scrub.returncode == 0 and ", 0 damaged" in scrub.stdout, scrub.stdout + scrub.stderr


def test_a_training_goes_on_where_its_backup_is_taken_in(full, programs, run, tmp_path):
    job = full.submit(type="train", dataset="data", scene="busy", options={"max_steps": 100000})
    full.eventually(lambda: full.get("/v1/scenes/busy").json["steps"] > 0)
    run("backup", tmp_path / "busy.tar", "--scene", "busy", daemon=full)
    with Daemon(*programs, tmp_path / "there") as there:
        run("restore", tmp_path / "busy.tar", daemon=there)
        there.wait(job, states=("running",))
        assert there.post(f"/v1/jobs/{job}/finish").status == 200
        assert there.wait(job)["state"] == "succeeded"


@pytest.mark.parametrize("body, type_, code", [
    (b"", "application/x-tar", 422), (b"nonsense", "application/x-tar", 422), (b"{}", "application/json", 415),
])
def test_what_is_no_backup_is_not_taken_in(full, body, type_, code):
    reply = full.post("/v1/backup", body=body, headers={"Content-Type": type_})
    assert reply.status == code, reply.body
    full.eventually(lambda: not list((Path(full.data) / "spool").iterdir()))


def test_backups_while_much_is_written(full, run, programs, tmp_path):
    """Scenes come and go while backups are made: each one starts, and names nothing that it lacks."""
    stopped = threading.Event()
    def churn():
        for i in range(1000):
            if stopped.is_set():
                return
            full.train(f"s{i}", max_steps=2)
            full.delete(f"/v1/scenes/s{i}")
    thread = threading.Thread(target=churn)
    thread.start()
    try:
        for i in range(5):
            run("backup", tmp_path / f"{i}.tar", daemon=full)
            wait_for(lambda: not list((Path(full.data) / "spool").iterdir()))
    finally:
        stopped.set()
        thread.join()
    for i in range(5):
        run("restore", tmp_path / f"{i}.tar", tmp_path / f"r{i}")
        with Daemon(*programs, tmp_path / f"r{i}") as restored:
            for scene in restored.get("/v1/scenes").json["items"]:
                assert (tmp_path / f"r{i}" / "scenes" / scene["id"]).is_dir()
            assert restored.post("/v1/scenes/ready/render", RENDER).status == 200


@pytest.mark.parametrize("bytes_, words", [
    (b"", "its end is missing"), (b"x" * 5000, "a header is wrong"),
    (tar_of({"a": b"x"}), "it has no records"),
    (tar_of({"ripnerf.db": b"x", "../a": b"x"}), "a name is not safe"),
    (tar_of({"/tmp/a": b"x"}), "a name is not safe"),
    (tar_of({"ripnerf.db": b"x" * 9000})[:5000], "its end is missing")])
def test_what_is_no_backup_restores_nothing(run, tmp_path, bytes_, words):
    (tmp_path / "a.tar").write_bytes(bytes_)
    assert words in run("restore", tmp_path / "a.tar", tmp_path / "new", code=1)
    assert [path.name for path in tmp_path.iterdir()] == ["a.tar"]


def test_a_restore_replaces_nothing(full, run, tmp_path):
    run("backup", tmp_path / "all.tar", daemon=full)
    run("backup", tmp_path / "all.tar", daemon=full, code=2)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "a").write_text("kept")
    run("restore", tmp_path / "all.tar", tmp_path / "there", code=2)
    assert (tmp_path / "there" / "a").read_text() == "kept"


def test_a_restore_takes_an_empty_folder_with_a_slash(full, run, tmp_path):
    run("backup", tmp_path / "all.tar", daemon=full)
    (tmp_path / "new").mkdir()
    run("restore", tmp_path / "none.tar", f"{tmp_path}/new/", code=3)
    assert (tmp_path / "new").is_dir()
    run("restore", tmp_path / "all.tar", f"{tmp_path}/new/")
    assert (tmp_path / "new" / "ripnerf.db").exists() and not (tmp_path / "new.partial").exists()


def make_paths(daemon, count):
    jobs = [daemon.submit(type="path", scene="ready", camera_path=PATH) for _ in range(count)]
    for job in jobs:
        assert daemon.wait(job)["state"] == "succeeded"
    return jobs


def frames_of(daemon, job):
    return len(daemon.get(f"/v1/jobs/{job}/frames").json["items"])


def test_retention_by_age(make_daemon, photographs):
    """Frames go after their time, linked ones and all else stay; it is said in the log. Their folder, in
    which a request may look meanwhile, is there all the time: it is the same one."""
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    gone, linked = make_paths(daemon, 2)
    assert daemon.post("/v1/tokens", {"name": "film", "job": linked}).status == 201
    assert frames_of(daemon, gone) == frames_of(daemon, linked) == 3
    daemon.stop()
    folder = Path(daemon.data) / "jobs" / gone / "frames"
    before = os.open(folder, os.O_RDONLY)  # nothing else gets its number
    daemon.options["retain_pictures"] = "1s"
    daemon.start()
    wait_for(lambda: frames_of(daemon, gone) == 0 and not list(folder.iterdir()))  # nor their sums
    assert os.path.samestat(os.fstat(before), folder.stat())
    os.close(before)
    assert frames_of(daemon, linked) == 3
    assert daemon.job(gone)["state"] == "succeeded"
    assert f"the pictures of job {gone} are removed" in daemon.log_text()
    assert daemon.post("/v1/scenes/ready/render", RENDER).status == 200
    daemon.stop()
    daemon.start()
    assert frames_of(daemon, gone) == 0 and frames_of(daemon, linked) == 3


def test_retention_goes_on_after_a_crash(make_daemon, photographs):
    """Pictures that are not removed yet when the daemon is killed are removed by the next one."""
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    job, = make_paths(daemon, 1)
    daemon.stop()
    frames = Path(daemon.data) / "jobs" / job / "frames"
    aside = frames.rename(frames.with_name("aside"))
    frames.symlink_to(frames)  # it cannot be opened
    daemon.options["retain_pictures"] = "1s"
    daemon.start()
    daemon.logged(f"the pictures of job {job}: ")
    daemon.stop(signal.SIGKILL)
    frames.unlink()
    aside.rename(frames)
    daemon.start()
    daemon.logged(f"the pictures of job {job} are removed")
    assert not list(frames.iterdir())


def test_retention_by_space(make_daemon, photographs):
    """The oldest frames go first, and only so many."""
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    jobs = make_paths(daemon, 4)
    assert daemon.post("/v1/tokens", {"name": "anna", "scope": "train"}).status == 201
    sizes = [sum(path.stat().st_size for path in (Path(daemon.data) / "jobs" / job / "frames").iterdir())
             for job in jobs]
    daemon.stop()
    daemon.options["retain_space"] = sizes[2] + sizes[3]
    daemon.start()
    wait_for(lambda: frames_of(daemon, jobs[1]) == 0)
    assert [frames_of(daemon, job) for job in jobs] == [0, 0, 3, 3]


STORES = sorted((Path(__file__).parent / "stores").glob("*.tar.xz"))


@pytest.mark.parametrize("store", STORES, ids=lambda path: path.name.split(".")[0])
def test_older_stores_are_brought_up_to_date(programs, tmp_path, store):
    """What each earlier layout held is there, is shown and rendered, and can be added to. What a crash
    had left half written of a job that is over is gone."""
    subprocess.run(["tar", "-C", tmp_path, "-xJf", store], check=True)
    frames = next((tmp_path / "data" / "jobs").glob("*/frames/00000.png")).parent
    whole = sorted(path.name for path in frames.iterdir())
    rests = (".00002.png.77-1.tmp", ".part-4", ".film.mp4", "scene.safetensors.partial")
    for name in rests:
        (frames / name).write_bytes(bytes(100000))
    for _ in range(2):  # the second start finds nothing to do
        with Daemon(*programs, tmp_path / "data") as daemon:
            assert "no record" not in daemon.log_text() and "WARN" not in daemon.log_text().upper()
            assert [item["name"] for item in daemon.get("/v1/datasets").json["items"]] == ["data"]
            assert daemon.get("/v1/datasets/data/images/test/0").status == 200
            scene = daemon.get("/v1/scenes/ready").json
            assert scene["state"] == "ready" and scene["steps"] == 30
            assert daemon.post("/v1/scenes/ready/render", RENDER).status == 200
            jobs = {item["type"]: item for item in daemon.get("/v1/jobs").json["items"]}
            assert {item["state"] for item in jobs.values()} == {"succeeded"}
            assert frames_of(daemon, jobs["path"]["id"]) == 3
            assert sorted(path.name for path in frames.iterdir()) == whole
            assert daemon.get(f"/v1/jobs/{jobs['path']['id']}/frames/1").status == 200
            assert daemon.get(f"/v1/jobs/{jobs['train']['id']}/metrics").json["items"]
            assert len(daemon.get("/v1/scenes/ready/evaluations").json["items"]) == 1
            assert daemon.get("/v1/camera-paths/kept").json["path"]["keys"]
    with Daemon(*programs, tmp_path / "data") as daemon:
        daemon.train("again")
        assert daemon.delete("/v1/scenes/ready").status == 204


def test_todays_layout_is_kept():
    """A new version of the schema comes with a store of the one before and of its own."""
    header = (Path(__file__).parents[2] / "server/store/store.h").read_text(encoding="utf-8")
    version = int(re.search(r"#define RN_STORE_VERSION (\d+)", header)[1])
    assert [path.name for path in STORES] == [f"{i}.tar.xz" for i in range(3, version + 1)]


def test_a_newer_store_is_refused_in_words(programs, tmp_path):
    """Nothing is changed in a folder that a later version wrote."""
    subprocess.run(["tar", "-C", tmp_path, "-xJf", STORES[-1]], check=True)
    database = tmp_path / "data" / "ripnerf.db"
    with sqlite3.connect(database) as records:
        records.execute("PRAGMA user_version = 99")
    records.close()
    before = database.read_bytes()
    refused = subprocess.run([programs[0], "--data", tmp_path / "data", "--listen", "127.0.0.1:0"],
                             capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert refused.returncode == 1 and "newer ripnerfd (version 99" in refused.stderr
    assert database.read_bytes() == before
