"""Ctrl-C and a reader that leaves: what the client leaves behind, what it says, and its exit code."""

import ctypes
import io
import json
import os
import resource
import shlex
import signal
import subprocess
import tarfile
from pathlib import Path

import pytest

from support import contract
from support.client import CANCELLED, FAILED, NOT_FOUND, UNREACHABLE, USAGE
from support.photographs import write_blank_dataset
from support.waiting import PATIENCE_S, wait_for


def end(process, code):
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == code, out + err
    return err


def is_asked(daemon, tail):
    return any(path.endswith(tail) for _, path, _, _ in daemon.requests)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_backup_that_is_interrupted_leaves_nothing(client, daemon, tmp_path, number):
    daemon.held = "/backup"
    process = client.start("backup", "all.tar")
    partial = tmp_path / "all.tar.partial"
    wait_for(lambda: partial.exists() and partial.stat().st_size)
    process.send_signal(number)
    assert "was interrupted" in end(process, CANCELLED)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_upload_that_is_interrupted_leaves_nothing(client, daemon, tmp_path, number):
    """Neither before nor in its import does the daemon keep what nobody can go on with."""
    if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("SIGHUP is ignored here, as under nohup")
    write_blank_dataset(tmp_path / "blank")
    daemon.cut_after, daemon.stuck = 100, True
    process = client.start("import", "blank", "--name", "blank")
    wait_for(lambda: any(method == "PATCH" for method, *_ in daemon.requests))
    assert len(daemon.parts) == 1
    process.send_signal(number)
    assert end(process, CANCELLED).endswith("ripnerf: the upload: was interrupted\n")
    assert not daemon.parts and not daemon.jobs
    daemon.held = "/datasets"  # it is whole, and its import is not answered
    process = client.start("import", "blank", "--name", "blank", "--json")
    wait_for(lambda: is_asked(daemon, "/datasets"))
    process.send_signal(number)
    assert json.loads(end(process, CANCELLED))["error"]["exit_code"] == CANCELLED
    assert not daemon.parts and not daemon.jobs


def test_what_nohup_starts_is_not_interrupted_by_its_terminal(client, daemon, tmp_path):
    write_blank_dataset(tmp_path / "blank")
    daemon.cut_after, daemon.stuck = 100, True
    process = subprocess.Popen(client.command("import", "blank", "--name", "blank"), cwd=tmp_path,
                               env=client.environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                               preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    wait_for(lambda: any(method == "PATCH" for method, *_ in daemon.requests))
    assert not takes(process, signal.SIGHUP) and takes(process, signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    end(process, CANCELLED)


def test_an_upload_that_cannot_be_taken_back_is_told_of(client, daemon, tmp_path):
    write_blank_dataset(tmp_path / "blank")
    daemon.cut_after, daemon.stuck = 100, True
    process = client.start("import", "blank", "--name", "blank")
    wait_for(lambda: any(method == "PATCH" for method, *_ in daemon.requests))
    daemon.away = True
    process.send_signal(signal.SIGINT)
    assert f"stays in the daemon for a day ({next(iter(daemon.parts))})" in end(process, CANCELLED)


@pytest.fixture
def slow_archive(tmp_path):
    """A backup that comes through a pipe."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        info = tarfile.TarInfo("ripnerf.db")
        info.size = 1 << 20
        tar.addfile(info, io.BytesIO(bytes(info.size)))
    os.mkfifo(tmp_path / "all.tar")
    return file.getvalue()


def begin_restore(client, tmp_path, beginning):
    process = client.start("restore", "all.tar", "new")
    pipe = open(tmp_path / "all.tar", "wb", buffering=0)
    pipe.write(beginning)
    wait_for((tmp_path / "new.partial" / ("ripnerf.db" if beginning else "")).exists)
    return process, pipe


def takes(process, number):
    """Whether the process still takes a signal itself."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return int(caught.split()[1], 16) >> (number - 1) & 1


def test_a_restore_that_is_interrupted_leaves_nothing(client, slow_archive, tmp_path):
    process, pipe = begin_restore(client, tmp_path, slow_archive[:200000])
    process.send_signal(signal.SIGINT)
    wait_for(lambda: not takes(process, signal.SIGINT))
    with pipe:
        try:
            pipe.write(slow_archive[200000:600000])
        except BrokenPipeError:
            pass  # it is gone already
    end(process, CANCELLED)
    assert [file.name for file in tmp_path.iterdir()] == ["all.tar"]


def test_a_second_interrupt_ends_at_once(client, slow_archive, tmp_path):
    process, pipe = begin_restore(client, tmp_path, b"")
    with pipe:
        process.send_signal(signal.SIGINT)
        wait_for(lambda: not takes(process, signal.SIGINT))
        assert process.poll() is None  # it waits for what does not come
        process.send_signal(signal.SIGINT)
        end(process, -signal.SIGINT)


@pytest.mark.parametrize("options", [(), ("--json",)])
@pytest.mark.parametrize("out, held, code, words", [
    ("film.mp4", "/film", CANCELLED, "was interrupted"),  # the job has ended
    ("frames", "/frames/2", FAILED, "goes on")])
def test_what_is_brought_can_be_interrupted(client, daemon, tmp_path, out, held, code, words, options):
    daemon.add_scene("slow" if out == "frames" else "lego", daemon.add_dataset("lego"))
    (tmp_path / "p.json").write_text(json.dumps(contract.example("PathFile")))
    daemon.held = held
    process = client.start("path", "slow" if out == "frames" else "lego", "p.json", "-o", out, *options)
    wait_for(lambda: is_asked(daemon, held))
    process.send_signal(signal.SIGINT)
    err = end(process, code)
    assert words in err
    if options:
        *_, last = map(json.loads, err.splitlines())
        assert ("--resume" in last["detached"]["detail"] if out == "frames"
                else last["error"]["exit_code"] == code)
    else:
        assert "--resume" in err
    left = sorted(str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*") if file.is_file())
    assert left == {"film.mp4": ["film.mp4.job", "p.json"],
                    "frames": ["frames/.ripnerf-job", "frames/00000.png", "frames/00001.png",
                               "p.json"]}[out]


def test_a_watch_that_nobody_reads_ends(client, daemon):
    daemon.add_dataset("lego")
    job = client.json("train", "lego", "--name", "slow")["id"]
    process = client.start("watch", job, "--json")
    assert json.loads(process.stdout.readline())["event"] == "state"
    process.stdout.close()

    def has_left():
        daemon.job(job).emit("progress", contract.example("TrainProgress"))
        return process.poll() is not None

    wait_for(has_left)
    assert process.returncode == FAILED
    assert json.loads(process.stderr.read())["error"]["where"] == "standard output"
    client.run("cancel", job)


def test_photographs_that_were_not_all_made_are_taken_back(client, tmp_path):
    (tmp_path / "there").mkdir()
    for name, extra in (("new", ()), ("there", ("--capture",))):
        process = client.start("synth", "sphere", name, "--size", 64, "--views", 10000, *extra)
        wait_for(lambda name=name: list((tmp_path / name).rglob("*.png")))
        process.send_signal(signal.SIGINT)
        assert "cancelled" in end(process, CANCELLED)
    assert [str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")] == ["there"]

    def leave_no_room():  # for a file of more than 4 kB
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    said = subprocess.run(client.command("synth", "sphere", "new", "--size", 200, "--views", 3),
                          cwd=tmp_path, capture_output=True, text=True, check=False,
                          env=client.environment, restore_signals=False, preexec_fn=leave_no_room)
    assert said.returncode == FAILED and "File too large" in said.stderr
    assert not (tmp_path / "new").exists()


def test_what_has_no_place_is_not_asked_for(client, daemon, tmp_path):
    """Nothing is computed for a folder that may not be written; what a full disk cannot take is cancelled."""
    daemon.add_scene("slow", daemon.add_dataset("lego"))
    (tmp_path / "p.json").write_text(json.dumps(contract.example("PathFile")))
    (tmp_path / "closed").mkdir(mode=0o555)
    (tmp_path / "closed-too").mkdir()
    (tmp_path / "closed-too").chmod(0o222)  # the umask takes from mkdir's

    def give_up_rights():  # root's, of writing where nobody may
        libc = ctypes.CDLL(None)
        for capability in (1, 2):
            libc.prctl(24, capability, 0, 0, 0)

    def leave_no_room():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    def fails(prepare, *words):
        said = subprocess.run(client.command(*words), cwd=tmp_path, capture_output=True, text=True, check=False,
                              env=client.environment, restore_signals=False, preexec_fn=prepare)
        assert said.returncode == FAILED, said.stderr
        return said.stderr

    for words in (("path", "slow", "p.json", "-o", "closed/f.gif"), ("path", "slow", "p.json", "-o", "closed"),
                  ("path", "slow", "p.json", "-o", "closed/new"), ("turntable", "slow", "-o", "closed/f.gif"),
                  ("render", "slow", "--view", "test:0", "-o", "closed/p.png"),
                  ("render", "slow", "--view", "test:0", "-o", "closed-too/p.png"),
                  ("export", "slow", "--as", "mesh", "-o", "closed/m.ply")):
        said = fails(give_up_rights, *words)
        assert "closed" in said and "Permission denied" in said
    assert not any(method == "POST" for method, *_ in daemon.requests) and not daemon.jobs
    said = fails(leave_no_room, "path", "slow", "p.json", "-o", "frames")
    (job, made), = daemon.jobs.items()
    assert "File too large" in said and f"{job} is cancelled" in said
    wait_for(lambda: made.record["state"] == "cancelled")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["closed", "closed-too", "p.json"]


def test_folders_that_nothing_comes_into_are_taken_back(client, daemon, tmp_path):
    (tmp_path / "p.json").write_text(json.dumps(contract.example("PathFile")))
    (tmp_path / "there").mkdir()
    for out in ("new/deep//frames/", tmp_path / "there/new/deep", f"deep/{'x' * 300}"):
        client.run("path", "none", "p.json", "-o", out, code=FAILED if "xx" in str(out) else NOT_FOUND)
        assert sorted(path.name for path in tmp_path.rglob("*")) == ["p.json", "there"]


def train_slowly(client, daemon, *options):
    """A client that waits for a training, and its job."""
    daemon.add_dataset("lego")
    process = client.start("train", "lego", "--name", "slow", "--wait", *options)
    wait_for(lambda: is_asked(daemon, "/events"))
    return process, next(iter(daemon.jobs))


def test_detaching_is_a_line_of_json(client, daemon):
    process, job = train_slowly(client, daemon, "--json")
    process.send_signal(signal.SIGINT)
    said = json.loads(end(process, FAILED))["detached"]
    assert said["job"] == job and f"ripnerf watch {job}" in said["detail"]


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_who_gives_up_on_a_lost_daemon_says_how_to_come_back(client, daemon, clock, options):
    client.environment |= clock.environment
    process, job = train_slowly(client, daemon, *options)
    daemon.away = True
    wait_for(lambda: daemon.refused > 1)  # the first one is noted when the second one comes
    clock.set(0, uptime_s=61)
    err = end(process, UNREACHABLE)
    assert "cannot be reached" in err and f"ripnerf watch {job}" in err
    if options:
        error, left = map(json.loads, err.splitlines())
        assert error["error"]["exit_code"] == UNREACHABLE and left["detached"]["job"] == job


def test_an_export_that_was_left_is_brought(client, daemon, tmp_path):
    daemon.add_scene("slow", daemon.add_dataset("lego"))
    process = client.start("export", "slow", "--as", "mesh", "-o", "a b.ply")
    wait_for(lambda: is_asked(daemon, "/events"))
    process.send_signal(signal.SIGINT)
    said = end(process, FAILED)
    program, *again = shlex.split(said[said.index("ripnerf export job_"):])
    assert program == "ripnerf" and not (tmp_path / "a b.ply").exists()
    client.run("finish", again[1])
    assert "3 vertices" in client.run(*again).stdout
    assert (tmp_path / "a b.ply").read_bytes() == b"ply"
    for wrong, words in ((["-o", "a.obj"], "use .ply"), (["-o", "b.ply", "--cells", 8], "-o and"),
                         (["-o", "a b.ply"], "--overwrite")):
        assert words in client.run("export", again[1], *wrong, code=USAGE).stderr
    job = client.json("train", "lego", "--name", "other")["id"]
    assert "of type train" in client.run("export", job, "-o", "b.ply", code=USAGE).stderr
