"""Work that a Slurm cluster's nodes share: pictures, ladders, ranks, paths, evaluations, curves."""

import os
import re
import signal
import time
from pathlib import Path

import pytest

from support.checked import Daemon
from support.cluster import processes_of, read
from support.on_slurm import (NODES, PATH, begin, finish, frames, long, needs_slurm,
                              wait_for_step, write_runner)
from support.waiting import wait_for

pytestmark = needs_slurm


# ---- pictures ---------------------------------------------------------------------------------


@long
def test_a_picture_does_not_wait_for_a_long_queue(on_slurm, slurm):
    """The machine of the daemon makes it, and the answer says so."""
    daemon = on_slurm(**{"keep-alive": "1s"})
    finish(daemon, begin(daemon))
    wait_for(lambda: not slurm.jobs("RUNNING", "PENDING", "COMPLETING"))
    blocker = slurm.run("sbatch", "--parsable", f"--nodes={NODES}", "--exclusive", "--chdir=/",
                        "--output=/dev/null", "--wrap=sleep 60").strip()
    wait_for(lambda: slurm.field(blocker, "JobState") == "RUNNING")
    picture = daemon.post("/v1/scenes/s/render", {"view": "test:0"})
    assert picture.status == 200
    assert re.match(r"the daemon's; Slurm: (Resources|Priority|Nodes required.*|queued)",
                    picture.headers["X-Ripnerf-Machine"])
    slurm.run("scancel", blocker)
    # A job that is asked for then goes to a node.
    path = daemon.submit(type="path", scene="s", camera_path=PATH)
    wait_for(lambda: daemon.job(path).get("runner"))
    assert daemon.wait(path)["state"] == "succeeded"


def table_of(daemon, **options):
    """A ladder's trainings, of each of its cells what does not depend on the machine, and machines."""
    job = daemon.submit(type="ladder", dataset="data",
                        options={"over": "planes=3,4", "seeds": 2, "views": 2, "moments": 0, "keep": True,
                                 "train": {"max_steps": 300}, **options})
    record = daemon.wait(job)
    assert record["state"] == "succeeded", record
    ladder = daemon.get(f"/v1/jobs/{job}/report", query={"format": "json"}).json["ladder"]
    cells = ladder["cells"]
    trained = [daemon.job(cell["train_job"]) for cell in cells]
    return trained, [(cell["label"], cell["seed"], cell["psnr"], cell["ssim"],
                      job["result"]["parameters_sha256"]) for cell, job in zip(cells, trained)], \
        set(ladder["machine"].split("; "))


def test_a_ladder_over_several_runners(on_slurm, programs, slurm, photographs, tmp_path):
    """Its trainings run at once, as the cluster has room, and are what one machine makes."""
    daemon = on_slurm()
    trained, table, machines = table_of(daemon)
    assert {job["result"]["machine"] for job in trained} <= machines
    assert machines <= {"n1 (pretended)", "n2 (pretended)"}, machines
    spans = [(job["started_at"], job["finished_at"]) for job in trained]
    assert any(a < d and c < b for i, (a, b) in enumerate(spans) for c, d in spans[:i]), spans
    with Daemon(*programs, tmp_path / "alone", {"RIPNERF_FAKE_STEP_US": "100"}) as alone:
        assert alone.wait(alone.upload("data", photographs))["state"] == "succeeded"
        assert table_of(alone)[1:] == (table, {"pretended"})


def has_mpi(build):
    return (build / "server" / "engine" / "mpi" / "ripnerf-mpi.so").is_file()


def over_two_nodes(on_slurm, build, programs, photographs, tmp_path, meanwhile, afterwards=lambda _: None,
                   **more):
    """The parameters of a training by two nodes, and of the same by this machine."""
    if not has_mpi(build):
        pytest.skip("the MPI module was not built: apt-get install libopenmpi-dev")
    real = build / "server" / "ripnerf-runner"
    options = {"preset": "draft", "threads": 1, "device": "cpu", **more}
    daemon = on_slurm(runner=real, **{"keep-alive": "1s"})
    job = daemon.submit(type="train", dataset="data", scene="s", options={**options, "ranks": 2})
    meanwhile(daemon, job)
    together = finish(daemon, job, 150)
    afterwards(daemon)
    options["kernels"] = daemon.get("/v1/info").json["kernels"]
    with Daemon(programs[0], real, tmp_path / "alone") as alone:
        assert alone.wait(alone.upload("data", photographs))["state"] == "succeeded"
        return together, alone.train("s", **options)[0]["result"]["parameters_sha256"]


def test_one_training_over_two_nodes(on_slurm, build, programs, slurm, photographs, tmp_path):
    """Each node computes half of every step: the bytes are one machine's. What its effects bring is
    measured by one node."""
    def look(daemon, job):
        number = wait_for(lambda: daemon.job(job).get("runner", {}).get("slurm_job"))
        assert slurm.field(number, "NumNodes") in ("2", "2-2")  # that it has, or waits for

    def measure(daemon):
        wait_for(lambda: not slurm.jobs("RUNNING"))
        job = daemon.post("/v1/scenes/s/effects", {"seconds": 1, "seeds": 1}).json["id"]
        number = wait_for(lambda: daemon.job(job).get("runner", {}).get("slurm_job"))
        assert slurm.field(number, "NumNodes") in ("1", "1-1")
        daemon.post(f"/v1/jobs/{job}/cancel")
    together, alone = over_two_nodes(on_slurm, build, programs, photographs, tmp_path, look, measure,
                                     max_steps=12)
    assert together == alone


@long
def test_two_nodes_of_which_one_is_lost(on_slurm, build, programs, slurm, photographs, tmp_path):
    """Rank 1 is killed, then all of it is cancelled: it goes on from the last checkpoint."""
    def kill(daemon, job):
        number = wait_for_step(daemon, job, 20)["runner"]["slurm_job"]
        ranks = [pid for pid in processes_of(number) if "--ranks" in read(f"/proc/{pid}/cmdline")
                 and "SLURM_PROCID=1\0" in read(f"/proc/{pid}/environ")]
        os.kill(ranks[-1], signal.SIGKILL)
        wait_for(lambda: daemon.job(job)["attempt"] == 2)
        slurm.run("scancel", wait_for_step(daemon, job, 60)["runner"]["slurm_job"])
        wait_for(lambda: daemon.job(job)["attempt"] == 3)
    together, alone = over_two_nodes(on_slurm, build, programs, photographs, tmp_path, kill, max_steps=300,
                                     checkpoint_interval_s=0.5)
    assert together == alone


def test_ranks_need_a_cluster_that_shares(on_slurm, programs, photographs, tmp_path):
    for daemon in (on_slurm(shared=None), Daemon(*programs, tmp_path / "alone").start()):
        daemon.wait(daemon.upload("data2", photographs))
        reply = daemon.post("/v1/jobs", {"type": "train", "dataset": "data2", "scene": "r",
                                         "options": {"ranks": 2}})
        assert reply.status == 422 and "--shared" in reply.body.decode(), reply.body
        assert reply.json["errors"][0]["pointer"] == "#/options/ranks"
        daemon.stop()


@long
def test_ranks_without_their_module(on_slurm):
    """The pretending engine has none: the job fails with what is to be installed."""
    daemon = on_slurm()
    record = daemon.wait(begin(daemon, ranks=2))
    assert record["state"] == "failed"
    assert "libopenmpi-dev" in record["problem"]["detail"], record["problem"]


@long
def test_a_path_over_several_runners(on_slurm, slurm, programs, tmp_path):
    """The frames, each told of once, and the film's order are what one runner makes; a runner that
    helps and is lost costs nothing but its time."""
    slow = write_runner(tmp_path / "slow", programs[1], 100, "RIPNERF_FAKE_ROW_US=100000")
    daemon = on_slurm(runner=slow, environment={"RIPNERF_FAKE_ROW_US": "100000"})
    daemon.wait(begin(daemon, max_steps=60))
    path = daemon.submit(type="path", scene="s", camera_path={**PATH, "fps": 50})  # 76 of 0.8 s
    helper = wait_for(lambda: [job for job in slurm.jobs("RUNNING")
                               if str(job) != daemon.job(path)["runner"]["slurm_job"]])[0]
    wait_for(lambda: 75 in frames(daemon, path))  # from the end on
    assert 60 not in frames(daemon, path)
    slurm.run("scancel", helper)
    record = daemon.wait(path)
    assert record["state"] == "succeeded" and record["attempt"] == 1, record
    told = [data["index"] for _, name, data in daemon.events(f"/v1/jobs/{path}/events")
            if name == "frame"]
    assert sorted(told) == list(range(76))
    alone = daemon.submit(type="path", scene="s", camera_path={**PATH, "fps": 50},
                          options={"first": 60, "last": 75})
    assert daemon.wait(alone)["state"] == "succeeded"
    for index in range(60, 76):
        assert frames(daemon, path)[index].read_bytes() == frames(daemon, alone)[index].read_bytes()
    wait_for(lambda: len(slurm.jobs("RUNNING")) == 1)


@long
def test_an_evaluation_over_several_runners(on_slurm, slurm, programs, tmp_path):
    """The scores are what one runner makes, whoever makes them."""
    slow = write_runner(tmp_path / "slow", programs[1], 100, "RIPNERF_FAKE_ROW_US=250000")
    daemon = on_slurm(runner=slow, environment={"RIPNERF_FAKE_ROW_US": "250000"})
    daemon.wait(begin(daemon, max_steps=60))
    job = daemon.submit(type="eval", scene="s", options={"split": "val"})
    helper = wait_for(lambda: [other for other in slurm.jobs("RUNNING")
                               if str(other) != daemon.job(job)["runner"]["slurm_job"]])
    assert helper
    together = daemon.wait(job)
    assert together["state"] == "succeeded" and together["attempt"] == 1, together
    views = together["result"]["per_view"]
    assert not list(Path(daemon.data).glob(f"scenes/*/frames/{job}"))
    for name in ("executor", "slurm-listen", "shared"):
        daemon.options.pop(name)
    daemon.stop()
    daemon.runner, daemon.environment = str(programs[1]), os.environ
    daemon.start()
    alone = daemon.wait(daemon.submit(type="eval", scene="s", options={"split": "val"}))
    for view in (*views, *alone["result"]["per_view"]):
        view.pop("render_ms")
    assert views == alone["result"]["per_view"]


@long
def test_a_curve_is_of_one_machine(on_slurm, slurm, programs, tmp_path):
    """On another node it begins anew: times of two machines are no curve."""
    slow = write_runner(tmp_path / "slow", programs[1], 100, "RIPNERF_FAKE_ROW_US=3000")
    daemon = on_slurm(runner=slow, **{"keep-alive": "1s"})
    daemon.wait(begin(daemon, max_steps=60))
    job = daemon.post("/v1/scenes/s/curve", {"views": 1}).json["id"]
    wait_for(lambda: list(Path(daemon.data).glob("scenes/*/curve.part")))
    record = daemon.job(job)["runner"]
    slurm.run("scontrol", "update", f"nodename={record['machine']}", "state=drain", "reason=test")
    try:
        slurm.run("scancel", record["slurm_job"])
        wait_for(lambda: daemon.job(job)["attempt"] == 2)
        done = daemon.wait(job)
    finally:
        slurm.run("scontrol", "update", f"nodename={record['machine']}", "state=resume")
    assert done["state"] == "succeeded", done
    log = "".join(log.read_text() for log in Path(daemon.data).glob("jobs/*/log"))
    assert re.search(rf"measured on {record['machine']}, .* on n[12], scalar, it begins anew", log), log
