"""A real ripnerfd on a free port, its output kept."""

import os
import re
import signal
import subprocess
import urllib.request

from support.waiting import PATIENCE_S, wait_for


class Daemon:
    """`with Daemon(build, folder) as daemon:` serves on daemon.url what lies in `folder`."""

    def __init__(self, build, folder, *options):
        self.folder, self.options = folder, [str(option) for option in options]
        self.program = str(build / "server" / "ripnerfd")
        self.log = folder.parent / f"{folder.name}.log"
        self.port = 0

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.stop()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def start(self):
        """Starts it; a second start takes the port of the first."""
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                [self.program, "--data", str(self.folder), "--listen",
                 f"127.0.0.1:{self.port}", *self.options],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True)
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)", line)
        assert found, f"{line!r}\n{self.log.read_text()}"
        self.port = int(found.group(1))
        self.wait_until(self.is_ready)

    def is_ready(self):
        try:
            with urllib.request.urlopen(self.url + "/readyz", timeout=PATIENCE_S) as reply:
                return reply.status == 200
        except OSError:
            return False

    def metric(self, name):
        """A counter or gauge of /metrics."""
        with urllib.request.urlopen(self.url + "/metrics", timeout=PATIENCE_S) as reply:
            return float(re.search(rf"^ripnerf_{name} (\S+)$", reply.read().decode(), re.MULTILINE)[1])

    def wait_until(self, condition):
        wait_for(condition, said=lambda: self.log.read_text()[-4000:])

    def stop(self):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(PATIENCE_S) == 0, self.log.read_text()[-4000:]

    def kill(self):
        """As a crash: no chance to save anything."""
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def runners(self):
        """Process ids of its runners."""
        children = subprocess.run(["ps", "-o", "pid=,comm=", "--ppid", str(self.process.pid)],
                                  capture_output=True, text=True, check=False).stdout
        return [int(line.split()[0]) for line in children.splitlines() if "ripnerf-runner" in line]

    def kill_runners(self):
        for pid in self.runners():
            os.kill(pid, signal.SIGKILL)
