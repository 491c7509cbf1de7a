"""A Slurm cluster on this machine (tests/slurm), for tests; without its packages they skip."""

import os
import re
import shutil
import subprocess
from pathlib import Path

from support.waiting import wait_for

SCRIPT = Path(__file__).resolve().parents[1] / "slurm"
PATH = os.environ["PATH"] + ":/usr/sbin"


def is_installed():
    return all(shutil.which(name, path=PATH) for name in ("munged", "slurmctld", "slurmd", "sbatch"))


class Cluster:
    def __init__(self, folder, nodes):
        self.folder, self.nodes = folder, nodes
        self.environment = {"SLURM_CONF": str(folder / "slurm.conf")}

    def script(self, *words):
        result = subprocess.run([SCRIPT, words[0], self.folder, *map(str, words[1:])], text=True,
                                capture_output=True, timeout=120, check=False)
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    def __enter__(self):
        self.script("start", self.nodes)
        return self

    def __exit__(self, *_):
        self.script("stop")

    def run(self, *words, check=True):
        """A command of Slurm's; its output."""
        result = subprocess.run(list(map(str, words)), env={**os.environ, **self.environment},
                                text=True, capture_output=True, timeout=60, check=False)
        assert result.returncode == 0 or not check, result.stdout + result.stderr
        return result.stdout

    def node(self, name, state):
        self.script("node", name, state)

    def controller(self, state):
        self.script("ctld", state)

    def jobs(self, *states):
        """Ids of the runners' jobs in these states (any without), oldest first."""
        lines = self.run("squeue", "--noheader", "--states=all", "--format=%A %T %j").splitlines()
        found = [line.split() for line in lines]
        return sorted(int(job) for job, state, name in found
                      if name.startswith("ripnerf-") and (not states or state in states))

    def field(self, job, name):
        found = re.search(rf"\b{name}=(\S*)", self.run("scontrol", "show", "job", job))
        return found and found[1]

    def wait_until_free(self):
        """Until no job is left and all nodes are up."""
        def is_free():
            idle = self.run("sinfo", "--noheader", "--Node", "--states=idle", "--partition=normal",
                            "--format=%N").split()
            return len(idle) == self.nodes and not self.run("squeue", "--noheader").strip()
        wait_for(is_free, said=lambda: self.run("squeue") + self.run("sinfo", "-N", "-l"))


def runner_of(job):
    """The process id of the runner in a Slurm job, by its script's child."""
    for line in subprocess.run(["ps", "-eo", "pid=,ppid=,args="], capture_output=True, text=True,
                               check=True).stdout.splitlines():
        pid, _, args = line.split(None, 2)
        if "--mode remote --join" in args and "sh " not in args[:8]:
            with open(f"/proc/{pid}/environ", "rb") as file:
                if f"SLURM_JOB_ID={job}\0".encode() in file.read():
                    return int(pid)
    return None


def processes_of(job):
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            if f"SLURM_JOB_ID={job}\0" in read(f"/proc/{name}/environ"):
                found.append(int(name))
        except OSError:
            continue
    assert len(found) >= 3, "script, carrier and field"
    return found


def read(path):
    with open(path, "rb") as file:
        return file.read().decode(errors="replace")


def open_files(pid):
    folder = f"/proc/{pid}/fd"
    return [os.readlink(f"{folder}/{name}") for name in os.listdir(folder)
            if os.path.lexists(f"{folder}/{name}")]
