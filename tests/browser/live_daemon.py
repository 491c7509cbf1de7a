"""A ripnerfd of a test's own, for the page."""

import os
import re
import signal
import subprocess

from support.waiting import PATIENCE_S, wait_for

LISTENING = re.compile(r"listening on (http://\S+)")


class Daemon:
    def __init__(self, build, folder, runner, environment=None, options=(), port=0):
        self.arguments = [
            build / "server/ripnerfd",
            "--data",
            folder,
            "--listen",
            f"127.0.0.1:{port}",
            *options,
            *(["--runner", build / runner] if runner else []),
        ]
        self.log = folder.with_suffix(".log")
        self.environment = {**os.environ, **(environment or {})}
        with open(self.log, "w", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                self.arguments, stdout=log, stderr=subprocess.STDOUT, env=self.environment
            )
        self.url = self.wait_for_address()

    def wait_for_address(self):
        def log():
            return self.log.read_text(encoding="utf-8")

        def listening():
            assert self.process.poll() is None, log()
            return LISTENING.search(log())

        return wait_for(listening, said=log).group(1) + "/"

    def stop(self):
        if self.process.poll() is not None:
            return self.process.returncode
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
