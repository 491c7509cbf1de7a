"""What a picture by a deadline needed to its last byte, from the socket to the next picture's reserve."""

import json
import sys
import time

import pytest

from support.checked import Daemon
from support.photographs import pose, write_dataset
from support.wire import Scene, ingest, train

CAMERA = {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
          "width": 24, "height": 20, "fov_y_deg": 40}
ASKED_MS = 60000  # never late, however busy the machine
LARGE = 24 << 20  # more than the sockets of both ends hold
AWAY_MS, FIRST_MS = 0.3, 1.5  # server/runner/field/pace.c
# Stands between the daemon and its runner, notes what goes by, and makes pictures' files LARGE.
RELAY = """#!{python}
import json, os, socket, struct, subprocess, sys, threading, time
if "field" not in sys.argv:
    os.execv({real!r}, [{real!r}, *sys.argv[1:]])
HEADER = struct.Struct("<IIII")
at = sys.argv.index("--fd") + 1
daemon = socket.socket(fileno=int(sys.argv[at]))
ours, theirs = socket.socketpair()
words = [*sys.argv[1:at], str(theirs.fileno()), *sys.argv[at + 1:]]
runner = subprocess.Popen([{real!r}, *words], pass_fds=[theirs.fileno()])
theirs.close()

def note(**what):
    with open({log!r}, "a", encoding="utf-8") as log:
        log.write(json.dumps({{**what, "ns": time.monotonic_ns()}}) + "\\n")

def pass_on(source, sink):
    with source.makefile("rb") as stream:
        while len(head := stream.read(HEADER.size)) == HEADER.size:
            magic, number, size, blob = HEADER.unpack(head)
            body, more = stream.read(size), stream.read(blob)
            if number == 10:
                note(asked=json.loads(body).get("needed_ms"))
            if number == 71:
                more = bytes({large})
                note(kept=json.loads(body)["kept_ms"])
            sink.sendall(HEADER.pack(magic, number, len(body), len(more)) + body + more)
    sink.shutdown(socket.SHUT_WR)

threading.Thread(target=pass_on, args=(daemon, ours), daemon=True).start()
try:
    pass_on(ours, daemon)
except OSError:
    pass
sys.exit(runner.wait())
"""


def answer(connection, body, pause_s):
    """Reads it after a pause, when its first byte is there; when that was over, nanoseconds."""
    content = json.dumps(body).encode()
    connection.sendall(b"POST /v1/scenes/ready/render HTTP/1.1\r\nHost: localhost\r\n"
                       b"Content-Type: application/json\r\n"
                       b"Content-Length: %d\r\n\r\n" % len(content) + content)
    with connection.makefile("rb", buffering=0) as stream:
        first = stream.read(1)
        time.sleep(pause_s)
        over_ns = time.monotonic_ns()
        while b"\r\n\r\n" not in first:
            first += stream.read(1) or pytest.fail(f"the answer ends: {first}")
        assert first.startswith(b"HTTP/1.1 200 "), first
        left = LARGE
        while left > 0:
            left -= len(stream.read(left)) or pytest.fail(f"{left} bytes of the answer are missing")
    return over_ns


def test_the_next_picture_knows_when_the_last_byte_went(programs, photographs, tmp_path):
    """Not when the file was made: a slow reader's answer needed as long as he took."""
    relay, log = tmp_path / "relay", tmp_path / "log"
    relay.write_text(RELAY.format(python=sys.executable, real=str(programs[1]), log=str(log),
                                  large=LARGE), encoding="utf-8")
    relay.chmod(0o755)
    daemon = Daemon(programs[0], relay, tmp_path / "d").start()
    try:
        assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
        daemon.train("ready")
        body = {"camera": CAMERA, "format": "png", "within_ms": ASKED_MS}
        with daemon.socket() as connection:
            sent_ns = time.monotonic_ns()
            over_ns = answer(connection, body, 0.5)
            answer(connection, body, 0)
    finally:
        daemon.stop()
    first, made, second, _ = map(json.loads, log.read_text(encoding="utf-8").splitlines())
    assert first["asked"] is None
    # The request arrived between what was sent here and what the runner got; the last byte went
    # after the pause, and before the next request came.
    least = made["kept"] - ASKED_MS + (over_ns - first["ns"]) / 1e6
    most = made["kept"] - ASKED_MS + (second["ns"] - sent_ns) / 1e6
    assert least <= second["asked"] <= most


@pytest.fixture(name="scene")
def fixture_scene(build, tmp_path):
    program = build / "tests" / "support" / "ripnerf-runner-fake"
    last, dataset, _ = ingest(program, tmp_path, write_dataset(tmp_path / "source"))
    assert last[0] == "done", last
    with Scene(program, tmp_path / "scene", dataset) as runner:
        train(runner)
        runner.wait_for("done")
        yield runner


def test_what_pictures_needed_is_kept_of_the_next_ones_time(scene):
    """As much as the neediest one, told with a later one; a deadline that is over leaves nothing else."""
    def kept(**needed):
        over_ns = time.monotonic_ns() - 10 ** 10
        scene.send("render", request=1, deadline_ns=over_ns, **needed,
                   render={"camera": CAMERA, "format": "png", "within_ms": 1000})
        name, content, _ = scene.wait_for("rendered", "failed")
        assert name == "rendered", content
        return content["kept_ms"]

    assert kept() == pytest.approx(FIRST_MS + AWAY_MS)
    assert kept(needed_ms=7) == pytest.approx(7 + AWAY_MS)
    assert kept() == pytest.approx(7 + AWAY_MS)
    assert kept(needed_ms=5) == pytest.approx(7 + AWAY_MS)
    assert kept(needed_ms=900) == pytest.approx(300)  # most of the time is for the picture
