"""Runners on the nodes of a Slurm cluster: a real one, of tests/slurm; skipped without Slurm."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.client import Client
from support.cluster import open_files, processes_of, read, runner_of
from support.on_slurm import (NODES, PATH, begin, finish, frames, long, needs_slurm,
                              wait_for_step, write_runner)
from support.waiting import PATIENCE_S, wait_for

pytestmark = needs_slurm


# ---- what it is for ---------------------------------------------------------------------------


def test_a_training_and_a_path_on_nodes(on_slurm, slurm, undisturbed):
    daemon = on_slurm()
    assert daemon.get("/v1/info").json["executor"] == "slurm"
    job = begin(daemon)
    record = wait_for_step(daemon, job, 1)
    assert re.fullmatch(r"n[12]", record["runner"]["machine"])
    assert int(record["runner"]["slurm_job"]) in slurm.jobs("RUNNING")
    assert finish(daemon, job) == undisturbed
    assert "runner" not in daemon.job(job)
    # The runner stays for a while: pictures are made there.
    picture = daemon.post("/v1/scenes/s/render", {"view": "test:0"})
    assert picture.headers["X-Ripnerf-Machine"] == record["runner"]["machine"]
    path = daemon.submit(type="path", scene="s", camera_path=PATH)
    assert daemon.wait(path)["result"]["frames"] == 4
    assert len(daemon.get(f"/v1/jobs/{path}/frames").json["items"]) == 4
    check_traces(daemon, job, job, path)
    assert daemon.delete("/v1/scenes/s").status == 204
    wait_for(lambda: not slurm.jobs("RUNNING", "PENDING", "COMPLETING"))
    assert os.listdir(daemon.data + "/slurm") == []


def test_a_film_is_made_on_a_node(on_slurm, build, programs, tmp_path):
    """And is whole in the daemon."""
    module = build / "server/film/ripnerf-film.so"
    if not module.is_file():
        pytest.skip("built without FFmpeg's libraries")
    told = f"RIPNERF_FILM_MODULE={module}"
    runner = write_runner(tmp_path / "films", programs[1], 100, told)
    daemon = on_slurm(runner=runner, environment=dict([told.split("=")]))
    training = begin(daemon, max_steps=60)
    daemon.wait(training)
    job = daemon.submit(type="path", scene="s", camera_path=PATH, options={"film": "gif"})
    record = daemon.wait(job)
    assert record["state"] == "succeeded" and record["result"]["frames"] == 4, record
    film = daemon.get(f"/v1/jobs/{job}/film").body
    assert film.startswith(b"GIF89a") and len(film) == record["result"]["film_bytes"]
    check_traces(daemon, training, job)  # the training's runner made it


def check_traces(daemon, log_of, *jobs):
    """What the runner on its node says of each job is in the job's trace."""
    log = (Path(daemon.data) / "jobs" / log_of / "log").read_text()
    for job in jobs:
        _, trace, span, _ = daemon.job(job)["traceparent"].split("-")
        assert f"job {job}: done trace_id={trace} span_id={span}\n" in log, log


def test_what_is_asked_of_slurm(on_slurm, tmp_path):
    """Memory as the engine needs it, and a GPU where one is told of; what the daemon was told goes
    first."""
    asked = tmp_path / "asked"
    sbatch = tmp_path / "sbatch"
    sbatch.write_text(f"#!/bin/sh\necho \"$@\" >>'{asked}'\necho 'sbatch: error: no' >&2\nexit 1\n")
    sbatch.chmod(0o755)
    environment = {"RIPNERF_SBATCH": str(sbatch), "RIPNERF_FAKE_NEED_MB": "800"}

    def order(daemon, **options):
        assert daemon.wait(begin(daemon, f"s{time.monotonic_ns()}", **options))["state"] == "failed"
        return asked.read_text().splitlines()[-1]

    def megabytes(line):
        return int(re.search(r" --mem=(\d+)M ", line)[1])
    daemon = on_slurm(environment)
    line = order(daemon)
    assert 900 < megabytes(line) < 1200 and "--gpus" not in line
    assert " --gpus=1 " in order(daemon, device="cuda:0")
    daemon = on_slurm({**environment, "RIPNERF_FAKE_NEED_MB": "3000"},
                  **{"slurm-gpus": 2, "slurm-partition": "long", "slurm-account": "lab",
                     "slurm-time": "90m", "slurm-flags": "--qos=high --nice=5"})
    line = order(daemon)
    assert " --partition=long --account=lab --time=90 " in line and " --qos=high --nice=5 " in line
    assert 3300 < megabytes(line) < 3700 and " --gpus=2 " in line
    assert "--gpus" not in order(daemon, device="cpu")
    daemon = on_slurm(environment, **{"slurm-memory": "5G"})
    assert megabytes(order(daemon)) == 5000 or megabytes(order(daemon)) == 5120


def test_nothing_is_shared(on_slurm, slurm, undisturbed, tmp_path):
    """What a node reads is sent to it, once, and what it writes comes back: a training that goes on
    on another node ends in the same bytes, and a path is the one that this machine makes."""
    caches = tmp_path / "caches"
    caches.mkdir()
    daemon = on_slurm(shared=None, **{"keep-alive": "1s", "slurm-cache": caches})
    job = begin(daemon)
    record = wait_for_step(daemon, job, 400)
    machine, number = record["runner"]["machine"], record["runner"]["slurm_job"]
    for pid in processes_of(number):
        assert daemon.data not in read(f"/proc/{pid}/cmdline") + read(f"/proc/{pid}/environ")
        assert not [file for file in open_files(pid) if file.startswith(daemon.data)]
    slurm.run("scontrol", "update", f"nodename={machine}", "state=drain", "reason=test")
    try:
        slurm.run("scancel", number)
        wait_for(lambda: daemon.job(job)["attempt"] == 2)
        other = wait_for_step(daemon, job, 400)["runner"]["machine"]
        assert other != machine
        assert finish(daemon, job) == undisturbed
        assert daemon.job(job)["result"]["machine"] == f"{other} (pretended)"
        wait_for(lambda: not slurm.jobs("RUNNING", "COMPLETING"))
    finally:
        slurm.run("scontrol", "update", f"nodename={machine}", "state=resume")
    path = daemon.submit(type="path", scene="s", camera_path=PATH)
    assert daemon.wait(path)["state"] == "succeeded"
    check_traces(daemon, job, job, path)
    own = caches / f"ripnerf-{os.geteuid()}"
    assert sorted(os.listdir(own)) == ["n1", "n2"]
    wait_for(lambda: not any(os.listdir(node / "work") for node in own.iterdir()))
    assert len(daemon.get(f"/v1/jobs/{job}/metrics").json["items"]) > 0
    # Each node was sent the photographs once: the first one in the end only what is new of the scene.
    sent = wait_for(lambda: len(found := re.findall(r"carried: (\d+) bytes to", daemon.log_text())) > 2
                    and [int(size) for size in found])
    assert sent[2] < sent[0] <= sent[1], sent
    for name in ("executor", "slurm-listen", "slurm-cache", "keep-alive"):
        daemon.options.pop(name)
    daemon.stop()
    daemon.start()
    here = daemon.submit(type="path", scene="s", camera_path=PATH)
    assert daemon.wait(here)["state"] == "succeeded"
    assert len(frames(daemon, path)) == 4
    for index, frame in frames(daemon, path).items():
        assert frame.read_bytes() == frames(daemon, here)[index].read_bytes()


def test_secrets_are_not_shown(on_slurm, slurm, build, tmp_path):
    """Neither half of a secret stands in what Slurm tells of a job, on a command line or in a log,
    and only the user can read it; the script that Slurm keeps has none. Who waits is told why."""
    daemon = on_slurm(**{"slurm-flags": "--hold", "slurm-account": "lab"})
    job = begin(daemon)
    place = wait_for(lambda: waiting_place(daemon))
    wait_for(lambda: slurm.jobs("PENDING"))
    number = slurm.jobs("PENDING")[-1]
    assert oct((place / "join").stat().st_mode & 0o777) == "0o600"
    assert oct(place.stat().st_mode & 0o777) == "0o700"
    secrets = (place / "join").read_text().split()[2:]
    assert [len(secret) for secret in secrets] == [64, 64]
    shown = slurm.run("scontrol", "--details", "show", "job", number)
    shown += slurm.run("scontrol", "write", "batch_script", number, "-")
    waiting = wait_for(lambda: (record := daemon.job(job)).get("runner", {}).get("reason") == "JobHeldUser"
                       and record)
    assert waiting["state"] == "queued" and waiting["runner"]["slurm_job"] == str(number)
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://{daemon.host}:{daemon.port}")
    told = [line for line in client.run("jobs").stdout.splitlines() if job in line]
    assert len(told) == 1 and f"waits: JobHeldUser; Slurm {number}" in told[0], told
    assert slurm.field(number, "Account") == "lab"
    slurm.run("scontrol", "release", number)
    machine = wait_for_step(daemon, job, 1)["runner"]["machine"]
    assert re.search(rf"\bon {machine} \(Slurm {number}\)", client.run("jobs").stdout)
    assert re.search(rf"{machine} +{number} +{job} ", client.run("info").stdout)
    assert not (place / "join").exists()
    shown += slurm.run("scontrol", "--details", "show", "job", number)
    pid = runner_of(number)
    for name in ("cmdline", "environ"):
        with open(f"/proc/{pid}/{name}", "rb") as file:
            shown += file.read().decode()
    shown += daemon.log_text() + (place / "script").read_text()
    for file in os.listdir(slurm.folder):
        if file.endswith((".log", ".out")):
            shown += (slurm.folder / file).read_text(errors="replace")
    assert str(place) in shown
    assert not any(secret in shown for secret in secrets)
    daemon.post(f"/v1/jobs/{job}/cancel")


def waiting_place(daemon):
    folder = Path(daemon.data) / "slurm"
    found = [place for place in folder.iterdir() if (place / "join").exists()]
    return found[0] if found else None


def address_of(daemon):
    host, port = re.search(r"runners connect to (\S+):(\d+)", daemon.log_text()).groups()
    return host, int(port)


def greet(daemon, text):
    """What a connection that says this is answered with."""
    with socket.create_connection(address_of(daemon), timeout=PATIENCE_S) as connection:
        connection.sendall(text.encode().ljust(192, b"\0"))
        return connection.recv(64)


def test_a_wrong_secret_is_refused(on_slurm, slurm):
    """And logged without it; so is a right one that was used before."""
    daemon = on_slurm(**{"slurm-flags": "--begin=now+60"})
    job = begin(daemon)
    place = wait_for(lambda: waiting_place(daemon))
    secret, answer = (place / "join").read_text().split()[2:]
    wrong = "ab" * 32
    assert greet(daemon, f"RNJ1 {place.name} {wrong} n1") == b""
    assert greet(daemon, f"RNJ1 rabcdef {secret} n1") == b""
    assert greet(daemon, "GET / HTTP/1.1") == b""
    assert greet(daemon, f"RNJ1 {place.name} {secret} n1") == answer.encode()
    assert greet(daemon, f"RNJ1 {place.name} {secret} n1") == b""
    log = daemon.log_text()
    for said in ("from 127.0.0.1 is refused: the secret is wrong", "no runner's greeting",
                 "a runner that nobody waits for"):
        assert said in log
    assert wrong not in log and secret not in log and answer not in log
    daemon.post(f"/v1/jobs/{job}/cancel")


OTHER_VERSION = """#!{python}
import socket, struct, sys, json
folder = sys.argv[sys.argv.index("--join") + 1]
host, port, said, heard = open(folder + "/join").read().split()
link = socket.create_connection((host, int(port)))
link.sendall(f"RNJ1 {{folder.rsplit('/', 1)[1]}} {{said}} n1".encode().ljust(192, b"\\0"))
assert link.recv(64, socket.MSG_WAITALL).decode() == heard
hello = json.dumps(dict(version="9.8.7", protocol=99, mode="field", pid=1)).encode()
link.sendall(struct.pack("<IIII", 0x31574E52, 64, len(hello), 0) + hello)
link.recv(4096)
"""


def test_a_runner_of_another_version(on_slurm, programs, slurm, tmp_path):
    """Both sides refuse: the daemon here; the runner in test_runner.py."""
    other = tmp_path / "other"
    other.write_text(f"#!/bin/sh\ncase $* in *remote*) exec {tmp_path}/other.py \"$@\";; esac\n"
                     f"exec '{programs[1]}' \"$@\"\n")
    (tmp_path / "other.py").write_text(OTHER_VERSION.format(python=sys.executable))
    for name in ("other", "other.py"):
        (tmp_path / name).chmod(0o755)
    daemon = on_slurm(runner=other)
    problem = daemon.wait(begin(daemon))["problem"]
    version = daemon.get("/v1/info").json["version"]
    assert re.search(rf"runner on n[12] is version 9\.8\.7 \(protocol 99, mode field\), the daemon "
                     rf"{re.escape(version)} \(protocol \d+\): install the same", problem["detail"])


# ---- what is wrong with how it was set up -----------------------------------------------------


def refusal(programs, folder, environment, **options):
    words = [str(programs[0]), "--data", str(folder / "data"), "--listen", "127.0.0.1:0",
             "--runner", str(programs[1]), "--executor", "slurm"]
    for name, value in options.items():
        words += [f"--{name}", str(value)]
    result = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
                            env={**os.environ, **environment})
    assert result.returncode != 0
    return result.stderr


def test_what_the_daemon_does_not_start_with(programs, slurm, tmp_path):
    (tmp_path / "shared").mkdir()
    shared = tmp_path / "shared"
    said = refusal(programs, tmp_path, {"RIPNERF_SBATCH": "/nowhere/sbatch"}, shared=tmp_path)
    assert "sbatch is not installed here: apt-get install slurm-client munge" in said
    assert "--executor local" in said
    assert "is not in the shared folder" in \
        refusal(programs, tmp_path, slurm.environment, shared=shared)
    assert "No such file" in refusal(programs, tmp_path, slurm.environment, shared="/nowhere")
    assert "is not HOST:PORT" in refusal(programs, tmp_path, slurm.environment, shared=tmp_path,
                                         **{"slurm-listen": "head"})


def test_a_partition_that_does_not_exist(on_slurm):
    daemon = on_slurm(**{"slurm-partition": "nowhere"})
    problem = daemon.wait(begin(daemon))["problem"]
    assert "invalid partition" in problem["detail"].lower(), problem


def test_a_folder_that_is_not_shared(on_slurm, slurm):
    """The node does not see it: here because it is taken away before the job begins."""
    daemon = on_slurm(**{"slurm-flags": "--begin=now+3"})
    job = begin(daemon)
    place = wait_for(lambda: waiting_place(daemon))
    wait_for(lambda: slurm.jobs("PENDING"))
    shutil.move(place, place.parent.parent / "elsewhere")
    problem = daemon.wait(job)["problem"]
    assert re.search(r"/slurm is not there on n[12] \(Slurm job \d+\): --shared must be a folder "
                     "that all nodes see at the same path", problem["detail"])


def test_a_runner_that_is_not_on_the_nodes(on_slurm, programs, tmp_path):
    gone = write_runner(tmp_path / "gone", programs[1], 100)
    daemon = on_slurm(runner=gone, **{"slurm-flags": "--begin=now+2"})
    gone.unlink()
    problem = daemon.wait(begin(daemon))["problem"]
    assert re.search(r"gone is not there on n[12]", problem["detail"])


# ---- what goes wrong while it runs ------------------------------------------------------------


def test_cancelled_by_the_administrator(on_slurm, slurm, undisturbed):
    """While it waits and while it runs: it is asked for again, and ends in the same bytes."""
    daemon = on_slurm(**{"slurm-flags": "--begin=now+1"})
    job = begin(daemon)
    slurm.run("scancel", wait_for(lambda: slurm.jobs("PENDING"))[-1])
    record = wait_for_step(daemon, job, 400)
    slurm.run("scancel", record["runner"]["slurm_job"])
    wait_for(lambda: daemon.job(job)["attempt"] == 2)
    assert finish(daemon, job) == undisturbed
    assert re.search(r"Slurm job \d+ on n[12]: CANCELLED", daemon.log_text())


@long
def test_the_time_limit(on_slurm, slurm, undisturbed):
    """What Slurm sends before it: the runner saves, and another goes on from there."""
    daemon = on_slurm()
    job = begin(daemon, checkpoint_interval_s=3600)
    record = wait_for_step(daemon, job, 400)
    slurm.run("scancel", "--batch", "--signal=TERM", record["runner"]["slurm_job"])
    # Nothing but the signal has saved: it goes on from at least there.
    again = wait_for(lambda: daemon.job(job)["attempt"] == 2 and daemon.job(job)["progress"])
    assert again["step"] >= record["progress"]["step"]
    assert finish(daemon, job) == undisturbed


@long
def test_a_time_limit_that_runs_out(on_slurm, slurm, programs, undisturbed, tmp_path):
    """Slurm's own clock, whose shortest limit is a minute: a training of two goes on in another job,
    from what the runner saved when it was warned."""
    daemon = on_slurm(runner=write_runner(tmp_path / "slower", programs[1], 50000), **{"slurm-time": "60s"})
    job = begin(daemon, checkpoint_interval_s=3600)
    first = wait_for_step(daemon, job, 10)["runner"]["slurm_job"]
    assert slurm.field(first, "TimeLimit") == "00:01:00"
    again = wait_for(lambda: daemon.job(job)["attempt"] == 2 and daemon.job(job)["progress"])
    assert again["step"] > 100
    assert finish(daemon, job, 240) == undisturbed


@long
def test_preempted_and_requeued(on_slurm, slurm, undisturbed):
    """By jobs of a partition that goes first, and by the administrator."""
    daemon = on_slurm()
    job = begin(daemon)
    wait_for_step(daemon, job, 300)
    urgent = slurm.run("sbatch", "--parsable", "--partition=urgent", f"--nodes={NODES}",
                       "--exclusive", "--output=/dev/null", "--wrap=sleep 1", "--chdir=/").strip()
    wait_for(lambda: daemon.job(job)["attempt"] == 2)
    assert "PREEMPTED" in daemon.log_text()
    slurm.run("scancel", urgent, check=False)
    record = wait_for_step(daemon, job, 600)
    number = record["runner"]["slurm_job"]
    slurm.run("scontrol", "update", f"jobid={number}", "requeue=1")
    slurm.run("scontrol", "requeue", number)
    wait_for(lambda: daemon.job(job)["attempt"] == 3)
    assert finish(daemon, job) == undisturbed


@long
def test_a_lost_node(on_slurm, slurm, undisturbed):
    """Its slurmd ends; its runner does not, and must not write any more."""
    daemon = on_slurm()
    job = begin(daemon)
    record = wait_for_step(daemon, job, 300)
    machine, number = record["runner"]["machine"], record["runner"]["slurm_job"]
    pid = runner_of(number)
    try:
        slurm.node(machine, "down")
        wait_for(lambda: daemon.job(job)["attempt"] == 2)
        assert "NODE_FAIL" in daemon.log_text()
        again = wait_for_step(daemon, job, record["progress"]["step"])
        assert again["runner"]["machine"] != machine
        wait_for(lambda: not os.path.exists(f"/proc/{pid}"))
    finally:
        slurm.node(machine, "up")
    assert finish(daemon, job) == undisturbed


def test_a_runner_that_comes_back_writes_nothing(on_slurm, slurm, undisturbed):
    """It stopped, was given up, and could not be killed, for its node did not answer; another trained
    on. What it does when it wakes is lost."""
    daemon = on_slurm(**{"runner-timeout": "2s"})
    job = begin(daemon)
    record = wait_for_step(daemon, job, 300)
    machine, number = record["runner"]["machine"], record["runner"]["slurm_job"]
    pid = runner_of(number)
    os.kill(pid, signal.SIGSTOP)
    try:
        slurm.run("scontrol", "update", f"nodename={machine}", "state=drain", "reason=test")
        slurm.node(machine, "down")
        wait_for(lambda: daemon.job(job)["attempt"] == 2)
        again = wait_for_step(daemon, job, 300)
        assert again["runner"]["machine"] != machine
        log = Path(daemon.data) / "jobs" / job / "log"
        before = log.read_text()
    finally:
        os.kill(pid, signal.SIGCONT)
        slurm.node(machine, "up")
        slurm.run("scontrol", "update", f"nodename={machine}", "state=resume")
    wait_for(lambda: not os.path.exists(f"/proc/{pid}"))
    assert "No such file or directory" in log.read_text().removeprefix(before)
    assert finish(daemon, job) == undisturbed


def test_a_daemon_that_is_started_anew(on_slurm, slurm, undisturbed):
    """It finds the jobs of the one before: one that runs and one that waits keep their places."""
    daemon = on_slurm()
    job = begin(daemon)
    record = wait_for_step(daemon, job, 400)
    daemon.options["slurm-flags"] = "--begin=now+600"
    for how in (signal.SIGKILL, signal.SIGTERM):
        daemon.stop(how)
        daemon.start()
        again = wait_for_step(daemon, job, record["progress"]["step"])
        assert again["runner"]["slurm_job"] == record["runner"]["slurm_job"]
        record = again
    other = begin(daemon, "t")
    waiting = wait_for(lambda: slurm.jobs("PENDING"))
    daemon.stop(signal.SIGKILL)
    daemon.start()
    wait_for(lambda: daemon.job(other).get("runner", {}).get("slurm_job") == str(waiting[0]))
    assert finish(daemon, job) == undisturbed
    slurm.run("scontrol", "update", f"jobid={waiting[0]}", "starttime=now")
    assert finish(daemon, other) == undisturbed
    assert len(slurm.jobs()) >= 2 and slurm.jobs()[-1] == waiting[0]


@long
def test_a_controller_that_is_away(on_slurm, slurm, programs, undisturbed, tmp_path):
    """For two minutes: runners go on without it, and what is submitted waits for it."""
    runner = write_runner(tmp_path / "slower", programs[1], 75000)
    daemon = on_slurm(runner=runner)
    job = begin(daemon)
    wait_for_step(daemon, job, 100)
    write_runner(runner, programs[1], 100)  # of what begins later
    began = time.monotonic()
    slurm.controller("down")
    try:
        other = begin(daemon, "t")
        wait_for_step(daemon, job, 1700, 240)
        assert time.monotonic() - began > 120
        assert daemon.job(other)["state"] == "queued"
        assert daemon.job(job)["attempt"] == 1
    finally:
        slurm.controller("up")
    assert finish(daemon, job) == undisturbed
    assert finish(daemon, other) == undisturbed


@long
def test_a_queue_that_is_closed(on_slurm, slurm, undisturbed):
    """What slurmctld refuses for the moment is asked for again."""
    daemon = on_slurm()
    slurm.run("scontrol", "update", "partitionname=normal", "state=drain")
    try:
        job = begin(daemon)
        record = wait_for(lambda: (record := daemon.job(job)).get("runner", {}).get("reason", "")
                          .startswith("sbatch") and record)
        assert record["state"] == "queued" and "inactive or drain" in record["runner"]["reason"]
    finally:
        slurm.run("scontrol", "update", "partitionname=normal", "state=up")
    assert finish(daemon, job) == undisturbed


def wait_until_refused(daemon, job, word):
    wait_for(lambda: "takes no more jobs: " in daemon.job(job).get("runner", {}).get("reason", ""))
    record = daemon.job(job)
    assert record["state"] == "queued" and word in record["runner"]["reason"], record


def test_a_queue_that_has_enough_of_one_user(on_slurm, tmp_path, programs):
    """A limit of accounting, which needs a database that this cluster lacks: its words, pretended."""
    sbatch = tmp_path / "sbatch"
    failed = "sbatch: error: Batch job submission failed: Job violates accounting/QOS policy (job " \
             "submit limit, user's size and/or time limits)"
    sbatch.write_text(f"#!/bin/sh\necho 'sbatch: error: '$(cat '{tmp_path}/why') >&2\n"
                      f"echo \"{failed}\" >&2\nexit 1\n")
    sbatch.chmod(0o755)
    (tmp_path / "why").write_text("QOSMaxSubmitJobPerUserLimit")
    daemon = on_slurm({"RIPNERF_SBATCH": str(sbatch)})
    job = begin(daemon)
    wait_until_refused(daemon, job, "QOSMaxSubmitJobPerUserLimit")
    daemon.post(f"/v1/jobs/{job}/cancel")
    # What is too large for its account is refused for good.
    (tmp_path / "why").write_text("QOSMaxMemoryPerJob")
    assert "accounting/QOS policy" in daemon.wait(begin(daemon, "t"))["problem"]["detail"]


@long
def test_a_queue_that_is_full(on_slurm, slurm, undisturbed):
    """slurmctld takes no more jobs: sbatch would try it again for minutes, and nobody be heard."""
    daemon = on_slurm()
    first = begin(daemon)
    wait_for_step(daemon, first, 100)
    kept = len(slurm.run("squeue", "--noheader", "--states=all").splitlines())
    config = slurm.folder / "slurm.conf"
    usual = config.read_text()
    try:
        config.write_text(f"{usual}MaxJobCount={kept}\n")
        slurm.controller("down")
        slurm.controller("up")
        second = begin(daemon, "t")
        wait_until_refused(daemon, second, "sleeping and retrying")
        assert finish(daemon, first) == undisturbed
        assert daemon.job(second)["state"] == "queued"
    finally:
        config.write_text(usual)
        slurm.controller("down")
        slurm.controller("up")
    assert finish(daemon, second) == undisturbed


def test_a_node_without_the_kernel_set(on_slurm):
    """All runners use the daemon's, since bytes differ between sets."""
    daemon = on_slurm({"RIPNERF_FAKE_KERNELS": "wide"})
    assert daemon.get("/v1/info").json["kernels"] == "wide"
    problem = daemon.wait(begin(daemon))["problem"]
    assert re.search(r"no kernel set wide", problem["detail"]), problem


@long
def test_an_idle_runner_makes_room(on_slurm, slurm, undisturbed):
    """It stays for pictures only as long as no job waits in the queue."""
    cores = NODES * os.cpu_count()
    for _ in range(cores - 1):
        slurm.run("sbatch", "--parsable", "--ntasks=1", "--chdir=/", "--output=/dev/null",
                  "--wrap=sleep 60")
    daemon = on_slurm()
    assert finish(daemon, begin(daemon, max_steps=60))
    assert finish(daemon, begin(daemon, "t")) == undisturbed
