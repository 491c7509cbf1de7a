"""Daemons on a cluster of tests/slurm, as fixtures, and what their tests do with them.

RIPNERF_SLURM=all runs those too that wait for Slurm's own clocks.
"""

import os
from pathlib import Path

import pytest

from support import cluster
from support.checked import Daemon
from support.waiting import PATIENCE_S, wait_for

needs_slurm = pytest.mark.skipif(not cluster.is_installed(),
                                 reason="Slurm is not installed: apt-get install slurm-wlm munge")
long = pytest.mark.skipif(os.environ.get("RIPNERF_SLURM") != "all",
                          reason="takes long: RIPNERF_SLURM=all runs it")
NODES = 2
STEPS = 2000
PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": time_s, "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]],
                  "fov_y_deg": 40} for time_s in (0, 1.5)]}
OPTIONS = {"max_steps": STEPS, "checkpoint_interval_s": 0.3}


@pytest.fixture(scope="session")
def slurm(tmp_path_factory):
    with cluster.Cluster(tmp_path_factory.mktemp("cluster"), NODES) as made:
        yield made


@pytest.fixture(scope="session")
def slow_runner(programs, tmp_path_factory):
    """Nodes see nothing of the daemon's environment: a step takes its time by a script."""
    return write_runner(tmp_path_factory.mktemp("runner") / "runner", programs[1], 1000)


def hold_of(runner):
    """While this file is there trainings wait half way, however long what is done to them takes."""
    return Path(runner).with_name("hold")


def write_runner(path, program, step_us, more=""):
    path.write_text(f"#!/bin/sh\nexport RIPNERF_FAKE_STEP_US={step_us} RIPNERF_FAKE_HOLD='{hold_of(path)}' {more}\n"
                    f"exec '{program}' \"$@\"\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def on_slurm(programs, slurm, slow_runner, photographs, tmp_path):
    """on_slurm(**options): a daemon on the cluster, with dataset `data`."""
    made = []

    def start(environment=None, runner=slow_runner, **options):
        shared = tmp_path / "shared"
        shared.mkdir(exist_ok=True)
        options = {"executor": "slurm", "shared": shared, "slurm-listen": "127.0.0.1:0", **options}
        # On this machine the runner is told by variables, on the nodes by its script.
        daemon = Daemon(programs[0], runner, shared / f"d{len(made)}",
                        {**slurm.environment, "RIPNERF_FAKE_STEP_US": "1000", **(environment or {})},
                        **{name: value for name, value in options.items() if value is not None})
        hold_of(slow_runner).touch()
        made.append(daemon.start())
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        return daemon
    yield start
    for daemon in made:
        daemon.stop()
    slurm.run("scancel", f"--user={os.geteuid()}", check=False)
    slurm.wait_until_free()


@pytest.fixture(scope="session")
def undisturbed(programs, photographs, tmp_path_factory):
    """The parameters that the training ends with on one machine."""
    data = tmp_path_factory.mktemp("local") / "data"
    with Daemon(*programs, data, {"RIPNERF_FAKE_STEP_US": "100"}) as daemon:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        return daemon.train("s", **OPTIONS)[0]["result"]["parameters_sha256"]


def begin(daemon, scene="s", **options):
    return daemon.submit(type="train", dataset="data", scene=scene, options={**OPTIONS, **options})


def wait_for_step(daemon, job, step, seconds=PATIENCE_S):
    def reached():
        record = daemon.job(job)
        assert record["state"] in ("queued", "running", "interrupted"), record
        progress = record["progress"]
        return progress and progress["step"] >= step and record["state"] == "running" and record
    return wait_for(reached, seconds)


def finish(daemon, job, seconds=PATIENCE_S):
    """Lets it go on to its end."""
    hold_of(daemon.runner).unlink(missing_ok=True)
    record = daemon.wait(job, timeout=seconds)
    assert record["state"] == "succeeded", record
    return record["result"]["parameters_sha256"]


def frames(daemon, job):
    """The files of its frames by their numbers, wherever they lie at the moment."""
    return {int(file.stem): file for file in Path(daemon.data).glob(f"**/{job}/**/*.png")
            if file.stem.isdigit()}
