"""The daemon's end of the runner's protocol, for tests: frames over a socketpair."""

import json
import os
import select
import socket
import struct
import subprocess
import time

from support.waiting import PATIENCE_S

TYPES = {"open": 1, "train": 2, "path": 3, "eval": 4, "ingest": 5, "pause": 6, "resume": 7,
         "finish": 8, "cancel": 9, "render": 10, "shutdown": 11, "hello": 64, "opened": 65,
         "state": 66, "progress": 67, "metric": 68, "checkpoint": 69, "frame": 70,
         "rendered": 71, "done": 72, "failed": 73, "info": 74, "incident": 75, "alive": 76,
         "grant": 12, "rest": 13, "curve": 14, "estimate": 15, "reserve": 77}
NAMES = {number: name for name, number in TYPES.items()}
HEADER = struct.Struct("<IIII")
MAGIC = 0x31574E52
JOB = "job_aaaaaaaaaaaa"


def frame(number, body, magic=MAGIC):
    return HEADER.pack(magic, number, len(body), 0) + body


class Runner:
    """A runner process. Messages are (name, content, blob); `seen` keeps all that arrived."""

    def __init__(self, program, mode, environment=None):
        ours, theirs = socket.socketpair()
        self.socket = ours
        self.seen = []
        self.process = subprocess.Popen(
            [str(program), "--mode", mode, "--fd", str(theirs.fileno())],
            pass_fds=[theirs.fileno()], env={**os.environ, **(environment or {})})
        theirs.close()
        self.data = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise

    def send(self, name, /, **content):
        self.send_all((name, content))

    def send_all(self, *messages):
        """(name, content) each: when it reads the first the last one is there too."""
        self.socket.sendall(b"".join(frame(TYPES[name], json.dumps(content).encode())
                                     for name, content in messages))

    def send_raw(self, number, body, magic=MAGIC):
        self.socket.sendall(frame(number, body, magic))

    def receive(self, timeout=PATIENCE_S):
        """The next message, or None at the end of the stream."""
        deadline = time.monotonic() + timeout
        while True:
            if len(self.data) >= HEADER.size:
                magic, number, size, blob = HEADER.unpack_from(self.data)
                assert magic == MAGIC
                end = HEADER.size + size + blob
                if len(self.data) >= end:
                    body = self.data[HEADER.size:HEADER.size + size]
                    message = (NAMES[number], json.loads(body),
                               self.data[HEADER.size + size:end])
                    self.data = self.data[end:]
                    self.seen.append(message)
                    return message
            left = deadline - time.monotonic()
            assert left > 0 and select.select([self.socket], [], [], left)[0], \
                f"nothing came; seen: {[name for name, _, _ in self.seen]}"
            try:
                piece = self.socket.recv(1 << 20)
            except ConnectionResetError:  # it ended without reading all that was sent
                return None
            if not piece:
                return None
            self.data += piece

    def wait_for(self, *names, timeout=PATIENCE_S, job=None):
        """The next message of one of these names (and job); others are passed over."""
        deadline = time.monotonic() + timeout
        while True:
            message = self.receive(deadline - time.monotonic())
            assert message is not None, f"the runner ended; waited for {names}"
            if message[0] in names and (job is None or message[1].get("job") == job):
                return message


def ingest(program, folder, source, name="d", options=None, limits=(1 << 30, 1000), job=JOB):
    """(the last message, the target folder, all messages)"""
    target, work = folder / "target", folder / "work"
    with Runner(program, "ingest") as runner:
        runner.send("ingest", job=job, name=name, source=str(source), target=str(target),
                    work=str(work), options=options or {}, max_bytes=limits[0],
                    max_entries=limits[1])
        last = runner.wait_for("done", "failed")
        assert runner.receive() is None
    assert not work.exists()
    return last, target, runner.seen


class Scene:
    """A field runner whose scene is open."""

    def __init__(self, program, folder, dataset, load=False, environment=None):
        self.runner = Runner(program, "field", environment)
        self.folder = folder
        assert self.runner.receive()[0] == "hello"
        self.runner.send("open", scene_folder=str(folder), dataset_folder=str(dataset), load=load)

    def __enter__(self):
        return self.runner.__enter__()

    def __exit__(self, *args):
        return self.runner.__exit__(*args)


def train(runner, job=JOB, **options):
    runner.send("train", job=job, options={"max_steps": 60, **options})


def checkpoints(folder):
    return sorted(path.name for path in (folder / "checkpoints").iterdir())
