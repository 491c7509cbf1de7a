"""Jobs through their states, crashes of runner and daemon, restarts, shutdown."""

import fcntl
import json
import os
import signal
import threading
import time

from support.checked import Daemon
from support.photographs import pose
from support.waiting import PATIENCE_S, wait_for

LONG = {"max_steps": 100000}
ENOUGH = 1500  # steps: under way for as long as the daemon's runners are held
HANGS_S = 10  # of silence: longer than a busy machine stops a runner for, which says every 2 s that it is alive
PATH = {"axes": "opengl", "fps": 20, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40} for t in (0, 1, 2)]}


def train(daemon, scene, **options):
    return daemon.submit(type="train", dataset="data", scene=scene, options=options or LONG)


def step_of(daemon, job):
    return (daemon.job(job)["progress"] or {"step": 0})["step"]


def wait_for_step(daemon, job, step):
    wait_for(lambda: step_of(daemon, job) >= step, said=lambda: daemon.job(job))


def wait_until_saved(daemon, scene):
    """A runner that was paused says all that it has to say before it tells of a checkpoint."""
    daemon.eventually(lambda: daemon.get(f"/v1/scenes/{scene}").json["checkpoints"])


def command(daemon, job, verb, status=200):
    reply = daemon.post(f"/v1/jobs/{job}/{verb}")
    assert reply.status == status, reply.body
    return reply.json


def test_commands_do_not_wait_for_the_runner(own):
    """It may be deep in a step, or hang."""
    job = train(own, "s")
    wait_for_step(own, job, 10)
    runners = own.runners()
    for pid in runners:
        os.kill(pid, signal.SIGSTOP)
    try:
        assert command(own, job, "pause")["state"] == "paused"
        assert command(own, job, "resume")["state"] in ("queued", "running")
        assert command(own, job, "cancel")["state"] == "cancelling"
    finally:
        for pid in runners:
            os.kill(pid, signal.SIGCONT)
    own.wait(job, ["cancelled"])


def test_pause_and_resume(own):
    own.hold()
    job = train(own, "s", max_steps=ENOUGH)
    wait_for_step(own, job, 20)
    command(own, job, "resume", 409)
    assert command(own, job, "pause")["state"] == "paused"
    wait_until_saved(own, "s")
    before = step_of(own, job)
    time.sleep(0.7)
    assert step_of(own, job) == before
    scene = own.get("/v1/scenes/s").json
    assert scene["state"] == "paused" and scene["checkpoints"]
    command(own, job, "pause", 409)
    assert own.post("/v1/scenes/s/render", {"view": "test:0"}).status == 200
    evaluation = own.wait(own.submit(type="eval", scene="s", options={"views": 1}))
    assert evaluation["state"] == "succeeded"
    assert command(own, job, "resume")["state"] in ("queued", "running")
    own.let_go_on()
    record = own.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 1
    _, straight = own.train("straight", max_steps=ENOUGH)
    assert straight["parameters_sha256"] == record["result"]["parameters_sha256"]


def test_finish(own):
    job = train(own, "s")
    wait_for_step(own, job, 10)
    command(own, job, "finish")
    record = own.wait(job)
    assert record["state"] == "succeeded" and record["result"]["finished_by"] == "finish"
    assert own.get("/v1/scenes/s").json["steps"] == record["result"]["steps"] < 100000
    command(own, job, "finish", 409)


def test_finish_while_paused(own):
    job = train(own, "s")
    wait_for_step(own, job, 10)
    command(own, job, "pause")
    command(own, job, "finish")
    assert own.wait(job)["result"]["finished_by"] == "finish"


def test_cancel(own):
    job = train(own, "s")
    wait_for_step(own, job, 10)
    assert command(own, job, "cancel")["state"] in ("cancelling", "cancelled")
    own.wait(job, ["cancelled"])
    assert command(own, job, "cancel")["state"] == "cancelled"
    command(own, job, "pause", 409)
    scene = own.get("/v1/scenes/s").json
    assert scene["state"] == "ready" and scene["parameters_sha256"]
    assert own.post("/v1/scenes/s/render", {"view": "test:0"}).status == 200


def test_a_training_cancelled_in_the_queue_leaves_its_scene_new(own):
    """Nothing failed: it never began."""
    own.submit(type="train", dataset="data", scene="busy", options={"max_time_s": 600})
    job = own.submit(type="train", dataset="data", scene="waiting", options={"max_steps": 5})
    assert own.get("/v1/scenes/waiting").json["state"] == "new"
    assert command(own, job, "cancel")["state"] == "cancelled"
    assert own.get("/v1/scenes/waiting").json["state"] == "new"


def test_cancel_of_what_succeeded(shared):
    job, _ = shared.train("done-already")
    reply = shared.post(f"/v1/jobs/{job['id']}/cancel")
    assert reply.status == 409 and "succeeded" in reply.json["detail"]


def test_what_was_not_finite_is_recorded_counted_and_told(make_daemon, photographs, tmp_path):
    daemon = make_daemon({"RIPNERF_FAKE_INCIDENT_AT": "40"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job, scene = daemon.train("wild", max_steps=120)
    assert job["progress"]["nonfinite"] == {"rays": 70, "steps_rejected": 0, "rollbacks": 1}
    event = {"kind": "rollback", "step": 40, "rays": 70, "parameters": 1,
             "file": "incidents/step-000000040-rollback.json"}
    events = daemon.events(f"/v1/jobs/{job['id']}/events", {"Last-Event-ID": "0"})
    assert [data for _, name, data in events if name == "incident"] == [event]
    (path,) = tmp_path.glob(f"*/scenes/{scene['id']}/{event['file']}")
    record = json.loads(path.read_text())
    assert (record["step"], record["seed"]) == (40, job["options"].get("seed", record["seed"]))
    assert [ray["fault"] for ray in record["rays"]] == ["colour", "colour"]
    assert record["rays"][0]["target"] == [0, 0.5, 1] and record["rays"][1]["id"] == 1
    assert record["parameters"] == [{"index": 5, "value": "-inf"}]
    metrics = daemon.get("/metrics").body.decode()
    assert 'ripnerf_nonfinite_total{kind="rays"} 70\n' in metrics
    assert 'ripnerf_nonfinite_total{kind="rollbacks"} 1\n' in metrics
    assert 'ripnerf_nonfinite_total{kind="steps_rejected"} 0\n' in metrics


def test_pictures_that_a_crash_left_half_written_go(programs, photographs, tmp_path):
    """The daemon and a runner are killed in the midst of a frame; nothing of it stays once the path is over."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_HELD_PICTURES": "4"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        daemon.train("s")
        daemon.hold()
        path = daemon.submit(type="path", scene="s", camera_path=PATH)
        lent = wait_for(lambda: list((tmp_path / "d").glob(f"scenes/*/frames/{path}/00003.png")))[0].parent
        runners = daemon.runners()
        daemon.stop(signal.SIGKILL)
        for pid in runners:
            os.kill(pid, signal.SIGKILL)
        for name in (".00004.png.77-1.tmp", ".part-4", ".film.mp4", "scene.safetensors.partial"):
            (lent / name).write_bytes(bytes(100000))
        daemon.let_go_on()
        daemon.start()
        assert daemon.wait(path)["result"]["frames"] == 41
        kept = os.listdir(tmp_path / "d" / "jobs" / path / "frames")
        assert sorted(kept) == [".step", *(f"{i:05}.png" for i in range(41)), "SHA256SUMS"]
    finally:
        daemon.stop()


def test_queue(own):
    first, second, third = train(own, "a"), train(own, "b"), train(own, "c", max_steps=5)
    wait_for_step(own, first, 1)
    assert own.job(second)["state"] == own.job(third)["state"] == "queued"
    assert own.get("/v1/scenes/b").json["state"] == "new"
    assert own.post("/v1/scenes/b/render", {"view": "test:0"}).status == 409
    assert own.get("/v1/scenes/b/checkpoint").status == 404
    assert command(own, second, "pause")["state"] == "paused"
    assert command(own, first, "cancel")
    assert own.wait(third)["state"] == "succeeded"  # the paused one is passed over
    command(own, second, "resume")
    own.wait(second, ["running"])
    assert command(own, second, "cancel")
    own.wait(second, ["cancelled"])


def test_second_job_on_a_training_scene(own):
    job = train(own, "s")
    own.wait(job, ["running"])
    reply = own.post("/v1/jobs", {"type": "train", "dataset": "data", "scene": "s"})
    assert reply.status == 409 and job in reply.json["detail"]
    assert reply.json["errors"][0]["pointer"] == "#/scene"
    assert own.delete("/v1/scenes/s").status == 409
    assert own.delete("/v1/datasets/data").status == 409
    command(own, job, "cancel")


def test_path_and_evaluation_while_training(own):
    """Each shows one step; the training waits for it, and that is not on its clock."""
    job = train(own, "s", **LONG, checkpoint_interval_s=3600)
    wait_for_step(own, job, 20)
    path = own.wait(own.submit(type="path", scene="s", camera_path=PATH))
    assert path["state"] == "succeeded" and path["result"]["frames"] == 41
    evaluation = own.wait(own.submit(type="eval", scene="s", options={"views": 1}))
    steps = path["result"]["step"], evaluation["result"]["protocol"]["step"]
    assert 20 <= steps[0] < steps[1]
    wait_for_step(own, job, steps[1] + 50)
    record = own.job(job)
    assert record["state"] == "running" and record["attempt"] == 1
    assert record["progress"]["yielded_seconds"] > 0
    assert own.get("/v1/scenes/s").json["checkpoints"] == []
    command(own, job, "cancel")


def test_path_into_a_training_that_is_loading(make_daemon, photographs):
    """Loading is told as a stage. Before there is anything to render a path is a conflict."""
    daemon = make_daemon({"RIPNERF_FAKE_LOAD_MS": "20"})
    daemon.wait(daemon.upload("data", photographs))
    daemon.hold()
    job = train(daemon, "s")
    progress = wait_for(lambda: daemon.job(job)["progress"])
    assert progress["stage"] == "loading photographs" and progress["load_seconds"] > 0
    assert progress["train_seconds"] == 0 and progress["step"] == 0
    reply = daemon.post("/v1/jobs", {"type": "path", "scene": "s", "camera_path": PATH})
    assert reply.status == 409 and job in reply.json["detail"]
    daemon.let_go_on()
    wait_for_step(daemon, job, 1)
    loaded = daemon.job(job)["progress"]
    assert "stage" not in loaded and loaded["load_seconds"] >= progress["load_seconds"]
    assert daemon.wait(daemon.submit(type="path", scene="s", camera_path=PATH))["state"] == \
        "succeeded"
    command(daemon, job, "cancel")


def test_frames_of_another_step_are_not_kept(programs, photographs, tmp_path):
    """After a crash that threw the scene back a path begins anew."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_HELD_PICTURES": "4"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        job = train(daemon, "s", **LONG, checkpoint_interval_s=1000)
        wait_for_step(daemon, job, 1001)
        daemon.hold()  # at step 1000 where it begins anew
        path = daemon.submit(type="path", scene="s", camera_path=PATH)
        kept = tmp_path / "d" / "jobs" / path / "frames"
        lent = wait_for(lambda: list((tmp_path / "d").glob(f"scenes/*/frames/{path}/00003.png")))
        step = lent[0].parent / ".step"
        first = int(step.read_text())
        assert first > 1000
        for pid in daemon.runners():
            os.kill(pid, signal.SIGKILL)
        wait_for(lambda: int(step.read_text()) < first)
        daemon.let_go_on()
        record = daemon.wait(path)
        assert record["state"] == "succeeded" and record["result"]["frames"] == 41
        assert record["result"]["step"] < first  # there was no checkpoint: training began anew
        assert int((kept / ".step").read_text()) == record["result"]["step"]
        command(daemon, job, "cancel")
    finally:
        daemon.stop()


def test_a_daemon_that_dies_loses_no_training(programs, photographs, tmp_path):
    """Its runners notice, save and end."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        job = train(daemon, "s", max_steps=100000, checkpoint_interval_s=1000)
        wait_for_step(daemon, job, 300)
        assert daemon.get("/v1/scenes/s").json["checkpoints"] == []
        daemon.stop(signal.SIGKILL)
        daemon.start()
        wait_for_step(daemon, job, 1)
        assert step_of(daemon, job) >= 300
        command(daemon, job, "cancel")
    finally:
        daemon.stop()


def test_figures_outlive_the_daemon(programs, photographs, tmp_path):
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        job = train(daemon, "s", max_steps=100000, evaluate_interval_s=0.02)
        figures = f"/v1/jobs/{job}/metrics"
        wait_for(lambda: len(daemon.get(figures).json["items"]) >= 5)
        command(daemon, job, "pause")
        wait_until_saved(daemon, "s")
        before = daemon.get(figures).json["items"]
        assert [item["step"] for item in before] == sorted({item["step"] for item in before})
        assert daemon.stop() == 0
        daemon.start()
        assert daemon.get(figures).json["items"] == before
        command(daemon, job, "resume")
        wait_for(lambda: len(daemon.get(figures).json["items"]) >= len(before) + 3)
        command(daemon, job, "finish")
        daemon.wait(job)
        after = daemon.get(figures).json["items"]
        assert after[:len(before)] == before
        assert daemon.get("/v1/jobs/job_aaaaaaaaaaaa/metrics").status == 404
        assert daemon.get(f"/v1/jobs/{daemon.upload('e', photographs)}/metrics").json["items"] == []
    finally:
        daemon.stop()


def test_the_first_figure_is_not_of_the_fog(programs, photographs, tmp_path):
    """Before the first empty space is known pictures take the longest, and tell the least."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "12000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        job = train(daemon, "s", max_steps=100000)
        first, *_ = wait_for(lambda: daemon.get(f"/v1/jobs/{job}/metrics").json["items"])
        assert first["step"] >= 256 or first["train_seconds"] >= 10
        command(daemon, job, "cancel")
    finally:
        daemon.stop()


def test_figures_that_a_crash_has_undone_go(own):
    job = train(own, "s", max_steps=100000, evaluate_interval_s=0.02, checkpoint_interval_s=1000)
    figures = f"/v1/jobs/{job}/metrics"
    before = wait_for(lambda: len(items := own.get(figures).json["items"]) >= 10 and items)
    for pid in own.runners():
        os.kill(pid, signal.SIGKILL)
    after = wait_for(lambda: own.job(job)["attempt"] == 2 and (items := own.get(figures).json["items"])
                     and items[0] not in before and items)
    steps = [item["step"] for item in after]
    assert steps == sorted(set(steps)) and not [item for item in before if item in after]
    command(own, job, "cancel")


def test_figures_are_bounded(own):
    job = train(own, "s", max_steps=100000, evaluate_interval_s=1e-9)
    figures = f"/v1/jobs/{job}/metrics"
    counts = [0]

    def is_thinned():
        counts.append(len(own.get(figures).json["items"]))
        return counts[-1] < max(counts)
    wait_for(is_thinned)
    assert max(counts) <= 512
    command(own, job, "cancel")


def test_full_queue(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "2000"}, max_queued=2)
    daemon.wait(daemon.upload("data", photographs))
    jobs = [train(daemon, name) for name in "ab"]
    reply = daemon.post("/v1/jobs", {"type": "train", "dataset": "data", "scene": "c"})
    assert reply.status == 429 and int(reply.headers["Retry-After"]) > 0
    assert daemon.get("/v1/scenes/c").status == 404
    for job in jobs:
        command(daemon, job, "cancel")
        daemon.wait(job)
    assert daemon.train("c")[0]["state"] == "succeeded"


def test_two_train_at_once(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "2000"}, training_slots=2)
    daemon.wait(daemon.upload("data", photographs))
    a, b = train(daemon, "a"), train(daemon, "b")
    wait_for_step(daemon, a, 5)
    wait_for_step(daemon, b, 5)


def test_divergence(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_DIVERGE_AT": "20"})
    daemon.wait(daemon.upload("data", photographs))
    record = daemon.wait(train(daemon, "s"))
    assert record["state"] == "failed" and record["problem"]["type"] == "/problems/numeric"
    assert daemon.get("/healthz").status == 200


def test_resume_of_a_scene_that_is_loaded(programs, photographs, tmp_path):
    """Paused, restarted, rendered (a runner loads the checkpoint), resumed on that runner."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        _, straight = daemon.train("straight", max_steps=ENOUGH)
        daemon.hold()
        job = train(daemon, "s", max_steps=ENOUGH)
        wait_for_step(daemon, job, 20)
        command(daemon, job, "pause")
        wait_until_saved(daemon, "s")
        assert daemon.stop() == 0
        daemon.let_go_on()
        daemon.start()
        assert daemon.job(job)["state"] == "paused"
        assert daemon.post("/v1/scenes/s/render", {"view": "test:0"}).status == 200
        command(daemon, job, "resume")
        record = daemon.wait(job)
        assert record["result"]["parameters_sha256"] == straight["parameters_sha256"]
    finally:
        daemon.stop()


# ---- crashes --------------------------------------------------------------------------------

def test_kill_runner(own):
    _, straight = own.train("straight", max_steps=ENOUGH)
    own.hold()
    job = train(own, "s", max_steps=ENOUGH, checkpoint_interval_s=0)
    wait_for_step(own, job, 50)
    idle = own.get("/v1/scenes/straight").json["loaded"]
    assert idle
    for pid in own.runners():
        os.kill(pid, signal.SIGKILL)
    own.let_go_on()
    record = own.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2 and "problem" not in record
    states = [data["state"] for _, name, data in own.events(f"/v1/jobs/{job}/events")
              if name == "state"]
    assert states == ["queued", "running", "interrupted", "queued", "running", "succeeded"]
    assert record["result"]["parameters_sha256"] == straight["parameters_sha256"]


def test_runner_that_hangs(make_daemon, photographs):
    """A runner that says nothing is ended: its job goes on in another, no request waits for ever."""
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "2000"}, runner_timeout=HANGS_S)
    daemon.wait(daemon.upload("data", photographs))
    _, straight = daemon.train("straight", max_steps=ENOUGH)
    daemon.hold()
    job = train(daemon, "s", max_steps=ENOUGH)
    wait_for_step(daemon, job, 20)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGSTOP)
    daemon.let_go_on()
    reply = daemon.post("/v1/scenes/s/render", {"view": "test:0"})
    assert reply.status == 503 and "hangs" in reply.json["detail"], reply.body
    idle = daemon.post("/v1/scenes/straight/render", {"view": "test:0"})
    assert idle.status == 503 and int(idle.headers["Retry-After"]) > 0
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["attempt"] == 2
    assert record["result"]["parameters_sha256"] == straight["parameters_sha256"]
    states = [data["state"] for _, name, data in daemon.events(f"/v1/jobs/{job}/events")
              if name == "state"]
    assert states == ["queued", "running", "interrupted", "queued", "running", "succeeded"]
    assert daemon.post("/v1/scenes/straight/render", {"view": "test:0"}).status == 200


def test_runner_that_works_in_silence(make_daemon, photographs):
    """Long work is no hang: the runner says now and then that it is alive."""
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": "600000"}, runner_timeout=HANGS_S)
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    camera = {"world_from_camera": pose(0)[:3], "axes": "opengl", "width": 12, "height": 2 * HANGS_S,
              "fov_y_deg": 40}
    assert daemon.post("/v1/scenes/s/render", {"camera": camera}).status == 200


def test_runner_that_always_dies(programs, photographs, tmp_path):
    """Three attempts without progress, then the job has failed and says so."""
    gate = tmp_path / "gate"
    runner = tmp_path / "runner"
    runner.write_text(f"#!/bin/sh\n[ -e {gate} ] && echo out of luck >&2 && exit 7\n"
                      f"exec {programs[1]} \"$@\"\n")
    runner.chmod(0o755)
    with Daemon(programs[0], runner, tmp_path / "d") as daemon:
        daemon.wait(daemon.upload("data", photographs))
        gate.touch()
        job = train(daemon, "s")
        record = daemon.wait(job)
        assert record["state"] == "failed" and record["attempt"] == 3
        assert record["problem"]["type"] == "/problems/runner-lost"
        assert "exit code 7" in record["problem"]["detail"]
        assert "out of luck" in (tmp_path / "d" / "jobs" / job / "log").read_text()
        assert daemon.get("/v1/scenes/s").json["state"] == "failed"
        gate.unlink()
        daemon.train("t")


def test_runner_dies_in_a_render(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "0"})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    daemon.hold()
    replies = []
    thread = threading.Thread(target=lambda: replies.append(
        daemon.post("/v1/scenes/s/render", {"view": "test:0"})))
    thread.start()
    daemon.eventually(lambda: daemon.metric("renders_waiting") == 1)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGKILL)
    thread.join(PATIENCE_S)
    assert replies[0].status == 503 and int(replies[0].headers["Retry-After"]) > 0


def test_kill_daemon(programs, photographs, tmp_path):
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        _, straight = daemon.train("straight", max_steps=ENOUGH)
        paused = train(daemon, "paused")
        wait_for_step(daemon, paused, 5)
        command(daemon, paused, "pause")
        daemon.hold()
        job = train(daemon, "s", max_steps=ENOUGH, checkpoint_interval_s=0)
        waiting = train(daemon, "w", max_steps=5)
        wait_for_step(daemon, job, 50)
        runners = daemon.runners()
        daemon.stop(signal.SIGKILL)
        wait_for(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in runners),
                 said=lambda: "a runner outlives its daemon")
        daemon.let_go_on()
        daemon.start()
        record = daemon.wait(job)
        assert record["state"] == "succeeded" and record["attempt"] == 2
        assert record["result"]["parameters_sha256"] == straight["parameters_sha256"]
        assert daemon.wait(waiting)["attempt"] == 1
        assert daemon.job(paused)["state"] == "paused"
        command(daemon, paused, "finish")
        assert daemon.wait(paused)["result"]["finished_by"] == "finish"
    finally:
        daemon.stop()


def test_kill_daemon_in_an_import(programs, photographs, tmp_path):
    """The upload was acknowledged: it is there, and imported in the end."""
    held, slow = tmp_path / "held", tmp_path / "runner"
    slow.write_text(f"#!/bin/sh\nwhile [ \"$2\" = ingest ] && [ -e {held} ]; do sleep 0.1; done\n"
                    f"exec {programs[1]} \"$@\"\n")
    slow.chmod(0o755)
    daemon = Daemon(programs[0], slow, tmp_path / "d").start()
    try:
        held.touch()
        job = daemon.upload("data", photographs)
        dataset = daemon.wait(job, ["running"])["dataset"]
        daemon.stop(signal.SIGKILL)
        half = tmp_path / "d" / "datasets" / dataset / "half.png"  # as of an attempt that had begun to write
        half.parent.mkdir()
        half.write_bytes(b"x")
        held.unlink()
        daemon.start()
        record = daemon.wait(job)
        assert record["state"] == "succeeded" and record["attempt"] == 2
        assert daemon.get("/v1/datasets/data").status == 200
        assert not half.exists()
        wait_for(lambda: not list((tmp_path / "d" / "spool").iterdir()))
    finally:
        daemon.stop()


def test_scene_is_held_by_an_orphan(programs, photographs, tmp_path):
    """However long a runner of a killed daemon hangs (a new one waits 15 s for it), the job waits."""
    daemon = Daemon(*programs, tmp_path / "d", {"RIPNERF_FAKE_STEP_US": "2000"}).start()
    try:
        daemon.wait(daemon.upload("data", photographs))
        daemon.hold()
        job = train(daemon, "s", max_steps=ENOUGH)
        wait_for_step(daemon, job, 10)
        scene = daemon.get("/v1/scenes/s").json["id"]
        daemon.stop(signal.SIGKILL)
        with open(tmp_path / "d" / "scenes" / scene / "lock", "a", encoding="utf-8") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            daemon.start()
            # before, refused, now
            wait_for(lambda: daemon.log_text().count("started (field") >= 3)
            assert daemon.job(job)["state"] == "running"
        daemon.let_go_on()
        record = daemon.wait(job)
        assert record["state"] == "succeeded" and record["attempt"] == 2
    finally:
        daemon.stop()


def test_acknowledged_writes_survive(programs, tmp_path):
    """kill -9 between requests: what was answered with 2xx is there."""
    daemon = Daemon(*programs, tmp_path / "d")
    path = {**PATH, "keys": PATH["keys"][:2]}
    kept = set()
    for round_number in range(3):
        daemon.start()
        assert {p["name"] for p in daemon.get("/v1/camera-paths").json["items"]} == kept
        for i in range(4):
            name = f"p{round_number}-{i}"
            assert daemon.post("/v1/camera-paths", {"name": name, "path": path}).status == 201
            kept.add(name)
        gone = kept.pop()
        assert daemon.delete(f"/v1/camera-paths/{gone}").status == 204
        daemon.stop(signal.SIGKILL)


# ---- shutdown -------------------------------------------------------------------------------

def test_shutdown_while_a_training_loads(make_daemon, photographs):
    """Its photographs are given up, the training is not."""
    daemon = make_daemon({"RIPNERF_FAKE_LOAD_MS": "600000"})
    daemon.wait(daemon.upload("data", photographs))
    job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 3})
    daemon.eventually(lambda: (daemon.job(job)["progress"] or {}).get("load_seconds"))
    assert daemon.stop() == 0
    daemon.environment["RIPNERF_FAKE_LOAD_MS"] = "0"
    daemon.start()
    assert daemon.wait(job)["state"] == "succeeded"


def test_shutdown(make_daemon, photographs):
    """With a training job, a parked render, a stream and an upload under way."""
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "0"}, header_timeout=600)
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    daemon.hold()
    job = train(daemon, "t")
    wait_for_step(daemon, job, 1)
    replies, events = [], []
    threads = [
        threading.Thread(target=lambda: replies.append(
            daemon.post("/v1/scenes/s/render", {"view": "test:0"}))),
        threading.Thread(target=lambda: events.extend(
            name for _, name, _ in daemon.follow("/v1/events")))]
    for thread in threads:
        thread.start()
    upload = daemon.socket()
    upload.sendall(b"POST /v1/datasets?name=u HTTP/1.1\r\nHost: localhost\r\n"
                   b"Content-Type: application/x-tar\r\nContent-Length: 1000000\r\n\r\nxxx")
    daemon.eventually(lambda: daemon.metric("renders_waiting") == daemon.metric("http_streams") == 1
                      and os.listdir(os.path.join(daemon.data, "spool")))
    assert daemon.stop() == 0  # the picture, the upload and the stream would stay
    for thread in threads:
        thread.join(PATIENCE_S)
    assert replies[0].status == 503 and "state" in events
    upload.close()
    daemon.let_go_on()
    daemon.start()
    record = daemon.wait(job, ["running"])
    assert record["attempt"] == 2
    assert not [name for name in os.listdir(os.path.join(daemon.data, "spool"))]


def test_second_signal(make_daemon, photographs):
    daemon = make_daemon(drain=60)
    daemon.wait(daemon.upload("data", photographs))
    wait_for_step(daemon, train(daemon, "s"), 1)
    for pid in daemon.runners():
        os.kill(pid, signal.SIGSTOP)  # it is waited for
    process = daemon.process
    process.send_signal(signal.SIGTERM)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM


def keep_asking(daemon, stopped):
    """Opens event streams and leaves them at once, as pages do that are closed."""
    while not stopped.is_set():
        try:
            with daemon.socket() as client:
                client.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
                client.settimeout(0.05)
                client.recv(4096)
        except OSError:
            time.sleep(0.001)


def test_requests_while_it_stops(make_daemon):
    """One that came as the HTTP library stopped was once left waiting: one stop in twenty aborted."""
    for _ in range(20):
        daemon, stopped = make_daemon(), threading.Event()
        threads = [threading.Thread(target=keep_asking, args=(daemon, stopped)) for _ in range(8)]
        for thread in threads:
            thread.start()
        time.sleep(0.1)
        code = daemon.stop()
        stopped.set()
        for thread in threads:
            thread.join()
        assert code == 0
