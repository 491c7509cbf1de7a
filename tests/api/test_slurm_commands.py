"""Slurm's commands, played by scripts: what sbatch is told, and a node that is this machine. No cluster is needed."""

import json
import os
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from support.client import Client
from support.curves import write_curve
from support.on_slurm import PATH
from support.photographs import write_dataset
from support.waiting import PATIENCE_S, wait_for

COLUMNS = "printf '%-20s%-20s%-16s%-64s%-128s\\n'"
NOTES = {"sbatch": "printf '%s\\n' \"$@\" >words.new; mv words.new words; echo 7",
         "squeue": COLUMNS + " 7 PENDING 0:0 '' Priority", "scancel": ":"}
# A job is a process whose name is its number.
RUNS = {"sbatch": "for script; do :; done; setsid sh $script </dev/null >/dev/null 2>&1 & echo >job-$!; echo $!",
        "squeue": "for job in job-*; do state=COMPLETED; job=${job#job-}\n"
                  "grep -q '^State:.[^ZX]' /proc/$job/status 2>/dev/null && state=RUNNING\n"
                  + COLUMNS + " $job $state 0:0 n1 None; done",
        "scancel": "kill $2 2>/dev/null"}
OPTIONS = {"executor": "slurm", "slurm-listen": "127.0.0.1:0"}


def write_commands(folder, commands):
    folder.mkdir()
    for name, text in commands.items():
        (folder / name).write_text(f"#!/bin/sh\ncd {folder} || exit\n{text}\n")
        (folder / name).chmod(0o755)
    return {f"RIPNERF_{name.upper()}": str(folder / name) for name in commands}


def test_sbatch_is_told_all_that_was_asked_for(make_daemon, photographs, tmp_path):
    """Every option at once, and thirty flags."""
    flags = [f"--comment={i}" for i in range(30)]
    options = OPTIONS | {"slurm-partition": "long", "slurm-account": "lab", "slurm-time": "90m", "slurm-gpus": 2,
                         "slurm-memory": "1G", "threads": 3, "slurm-flags": " ".join(flags)}
    daemon = make_daemon(write_commands(tmp_path / "bin", NOTES), shared=tmp_path, **options)
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    job = daemon.submit(type="train", dataset="data", scene="s", options={"max_steps": 9})
    words = wait_for(lambda: (tmp_path / "bin" / "words").exists()
                     and (tmp_path / "bin" / "words").read_text().splitlines())
    expected = {"--nodes=1", "--partition=long", "--account=lab", "--time=90", "--gpus=2", "--mem=1024M",
                "--cpus-per-task=3", "--signal=B:TERM@60", *flags}
    assert expected < set(words) and any(word.startswith("--job-name=ripnerf-sc_") for word in words)
    assert words[-1].endswith("/script") and os.path.isabs(words[-1])
    wait_for(lambda: daemon.job(job).get("runner", {}).get("reason") == "Priority")
    daemon.post(f"/v1/jobs/{job}/cancel")
    assert daemon.wait(job)["state"] == "cancelled"


def test_too_many_flags_are_refused(programs, tmp_path):
    result = subprocess.run(
        [programs[0], "--data", tmp_path / "d", "--listen", "127.0.0.1:0", "--executor", "slurm",
         "--slurm-flags", "--x " * 33], capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        env=os.environ | write_commands(tmp_path / "bin", NOTES))
    assert result.returncode != 0 and "slurm-flags: more than 32 flags of sbatch" in result.stderr


def test_frames_of_every_format_come_with_their_events(make_daemon, photographs, build, tmp_path):
    """Nothing is shared: a frame is there when the daemon tells of it, whatever it is called."""
    daemon = make_daemon(write_commands(tmp_path / "bin", RUNS), **OPTIONS, **{"slurm-cache": tmp_path})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("s", max_steps=20)
    (tmp_path / "path.json").write_text(json.dumps({"path": PATH}))
    client = Client(build / "client" / "ripnerf", tmp_path, f"http://127.0.0.1:{daemon.port}")
    for name, ending in (("jpeg", "jpg"), ("png16", "png")):
        client.run("path", "s", "path.json", "-o", name, "--format", name)
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == [
            f"{i:05}.{ending}" for i in range(4)]


@pytest.mark.parametrize("kind, more, options, last", [("path", {"camera_path": {**PATH, "fps": 100}}, {}, 150),
                                                       ("eval", {}, {"split": "val"}, 99)])
def test_parts_are_made_as_the_budget_was_resolved_once(make_daemon, tmp_path, kind, more, options, last):
    """A node that helps makes its part, from the end on, by the setting that was recorded, though the curve says
    another when it comes: every second row of eight, of 50 ms. The first seven pictures were to see which one takes
    the most and how long; in full it is too long."""
    commands = write_commands(tmp_path / "bin", RUNS)
    daemon = make_daemon(commands | {"RIPNERF_FAKE_ROW_US": "50000", "RIPNERF_FAKE_HELD_PICTURES": "7"},
                         shared=tmp_path, **OPTIONS)
    folder = write_dataset(tmp_path / "many", size=8, train=2, val=100, test=1)
    assert daemon.wait(daemon.upload("data", folder))["state"] == "succeeded"
    daemon.train("s", max_steps=20)
    write_curve(daemon, {"subsample": 2})
    daemon.hold()
    job = daemon.submit(type=kind, scene="s", options={"within_ms": 300, **options}, **more)
    became = {"within_ms": 300, "subsample": 2}
    daemon.eventually(lambda: became.items() <= daemon.job(job)["options"].items())
    write_curve(daemon, {"subsample": 8})
    daemon.let_go_on()

    def made():
        return {int(file.stem): file for file in Path(daemon.data).glob(f"scenes/*/frames/{job}/*.*")
                if file.stem.isdigit()}
    daemon.eventually(lambda: {0, last} <= made().keys())
    for file in (made()[0], made()[last]):
        if kind == "path":
            assert len(set(Image.open(file).convert("RGB").getchannel("R").getdata())) == 4
        else:
            assert json.loads(file.read_text())["render_ms"] >= 200
    assert became.items() <= daemon.job(job)["options"].items()
    daemon.post(f"/v1/jobs/{job}/cancel")
    assert daemon.wait(job)["state"] == "cancelled"
