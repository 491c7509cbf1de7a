"""What a daemon is started with: its options, its folder and address, its runner, its log."""

import json
import os
import re
import socket
import subprocess

import pytest

from support.checked import Daemon
from support.waiting import PATIENCE_S

PATH = {"axes": "opengl", "fps": 20, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": t, "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]], "fov_y_deg": 40}
                 for t in (0, 1, 2)]}


def run(programs, *words, **environment):
    return subprocess.run([programs[0], *map(str, words)], capture_output=True, text=True,
                          env={**os.environ, **environment}, timeout=PATIENCE_S, check=False)


def test_options(programs, tmp_path):
    assert "--training-slots" in run(programs, "--help").stdout
    assert run(programs, "--version").stdout.startswith("ripnerfd ")
    for words in ([], ["--data"], ["--data", tmp_path, "--nonsense", 1],
                  ["--data", tmp_path, "--listen", "0.0.0.0:0"],
                  ["--data", tmp_path, "--threads", "many"]):
        result = run(programs, *words)
        assert result.returncode == 2 and result.stderr.startswith("ripnerfd: "), words
    assert run(programs, "--data", "/proc/none").returncode == 1


def test_data_folder_in_use(programs, shared):
    result = run(programs, "--data", shared.data, "--listen", "127.0.0.1:0")
    assert result.returncode == 1 and "another ripnerfd" in result.stderr


def test_port_in_use(programs, shared, tmp_path):
    result = run(programs, "--data", tmp_path / "d", "--listen", f"127.0.0.1:{shared.port}")
    assert result.returncode == 1 and "in use" in result.stderr


@pytest.mark.parametrize("address", ["[::1]:0", "localhost:0"])
def test_other_loopback(make_daemon, address):
    assert make_daemon(listen=address).host in ("[::1]", "localhost")


def test_no_runner(programs, tmp_path):
    with Daemon(programs[0], tmp_path / "none", tmp_path / "d") as daemon:
        assert daemon.get("/readyz").status == 503
        assert daemon.get("/healthz").status == 200


def test_the_service_manager_is_told(programs, tmp_path):
    """READY once it serves, STOPPING before it ends (sd_notify)."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(path)
        manager.settimeout(PATIENCE_S)
        daemon = Daemon(*programs, tmp_path / "d", {"NOTIFY_SOCKET": path}).start()
        assert manager.recv(100) == b"READY=1"
        assert daemon.stop() == 0
        assert manager.recv(100) == b"STOPPING=1"


def test_access_is_logged(make_daemon):
    """Writes always, reads for who asks, with the trace that the caller is in; as JSON too."""
    daemon = make_daemon(log_format="json", log_level="info")
    trace = "0af7651916cd43dd8448eb211c80319c"
    reply = daemon.post("/v1/camera-paths", {"name": "a", "path": PATH},
                        headers={"traceparent": f"00-{trace}-b7ad6b7169203331-01"})
    assert reply.status == 201 and reply.headers["X-Request-Id"] == trace
    fresh = daemon.get("/v1/jobs").headers["X-Request-Id"]
    assert re.fullmatch("[0-9a-f]{32}", fresh) and fresh != trace
    assert daemon.delete('/v1/camera-paths/%22%5C').status == 404
    daemon.stop()
    lines = [json.loads(line) for line in daemon.log_text().splitlines()]
    told = [line["text"] for line in lines if line["level"] == "info"]
    assert any(re.fullmatch(rf"POST /v1/camera-paths 201 [\d.]+ ms 127.0.0.1 {trace} -", text)
               for text in told)
    assert any(text.startswith('DELETE /v1/camera-paths/"\\ 404 ') for text in told), told
    assert not any(fresh in line["text"] for line in lines)
