"""Slow, greedy and ambiguous clients: others are served all the same, and each learns why."""

import contextlib
import math
import resource
import select
import shutil
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest

from support.photographs import pose
from support.waiting import PATIENCE_S, wait_for

SOON_S = 12  # others have waited for 15 to 70 s once
TAR = {"Content-Type": "application/x-tar"}
GET = b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\n\r\n"


@pytest.fixture(autouse=True)
def many_files():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.fixture(autouse=True)
def time_limit():
    """A daemon that does not answer fails the test, and does not keep the ones behind it waiting."""
    def over(*_):
        raise TimeoutError("the test takes longer than a quarter of an hour: something is not answered")
    before = signal.signal(signal.SIGALRM, over)
    signal.alarm(900)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def status_of(answer):
    return int(answer.split(b" ", 2)[1]) if answer else None


def answer_of(connection):
    connection.settimeout(PATIENCE_S)
    answer = b""
    try:
        while b"\r\n\r\n" not in answer and (piece := connection.recv(65536)):
            answer += piece
    except ConnectionResetError:
        pass
    return answer


def read_until_closed(connection):
    connection.settimeout(PATIENCE_S)
    try:
        while connection.recv(4096):
            pass
    except ConnectionResetError:
        pass


def is_open(connection):
    return not select.select([connection], [], [], 0)[0]


def longest_answer(daemon, seconds):
    longest, end = 0, time.monotonic() + seconds
    while time.monotonic() < end:
        begin = time.monotonic()
        assert daemon.get("/healthz").status == 200
        assert daemon.get("/v1/jobs").status == 200
        longest = max(longest, time.monotonic() - begin)
        time.sleep(0.05)
    return longest


@contextlib.contextmanager
def dripping(connections):
    """Meanwhile each of them sends a byte a second."""
    stopped = threading.Event()

    def drip():
        while not stopped.is_set():
            for connection in connections:
                with contextlib.suppress(OSError):
                    connection.send(b"x")
            stopped.wait(1)
    thread = threading.Thread(target=drip)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        thread.join()


def test_clients_that_drip_headers(make_daemon):
    """1,200 connections that send a byte of a header now and then: they make room for others, long
    before their own time is over."""
    daemon = make_daemon(header_timeout=600)
    connections = [daemon.socket() for _ in range(1200)]
    for connection in connections:
        connection.send(b"GET /v1/jobs HTTP/1.1\r\nX-Slow: ")
    with dripping(connections):
        assert longest_answer(daemon, 4) < PATIENCE_S
    for connection in connections:
        connection.close()
    assert b"ripnerf_http_evicted_total 0" not in daemon.get("/metrics").body


def test_idle_connections(make_daemon):
    daemon = make_daemon(header_timeout=600)
    connections = []
    for _ in range(3000):
        connections.append(daemon.socket())
    assert longest_answer(daemon, 2) < PATIENCE_S
    for connection in connections:
        connection.close()


def test_connections_of_one_address(make_daemon):
    """Another address finds room, however many one has opened."""
    daemon = make_daemon(max_connections=20, max_per_address=5, header_timeout=60)
    greedy = []
    for _ in range(30):
        connection = socket.create_connection((daemon.host, daemon.port),
                                              source_address=("127.0.0.9", 0))
        connection.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        greedy.append(connection)
    assert [status_of(answer_of(connection)) for connection in greedy].count(200) == 5
    assert daemon.get("/v1/jobs").status == 200
    for connection in greedy:
        connection.close()


def is_cut_off_in_its_time(make_daemon, begin):
    """A daemon with a second to wait, and whether what begins so was cut off there while one that began
    before it was still waited for, by a daemon with more time: without the option both have 10 s."""
    patient, hasty = make_daemon(header_timeout=600), make_daemon(header_timeout=1)
    with patient.socket() as before, hasty.socket() as connection:
        for one in before, connection:
            one.sendall(begin)
        with dripping([before, connection]):
            read_until_closed(connection)
            return hasty, is_open(before)


def test_header_deadline(make_daemon):
    daemon, held = is_cut_off_in_its_time(make_daemon, b"GET /v1/jobs HTTP/1.1\r\nX-Slow: ")
    assert held
    with daemon.socket() as connection:  # kept alive, it may rest for longer
        connection.sendall(GET)
        assert status_of(answer_of(connection)) == 200
        time.sleep(2.5)
        connection.sendall(GET)
        assert status_of(answer_of(connection)) == 200


def test_slow_body(make_daemon):
    _, held = is_cut_off_in_its_time(
        make_daemon, b"POST /v1/datasets?name=slow HTTP/1.1\r\nHost: localhost\r\n"
        b"Content-Type: application/x-tar\r\nContent-Length: 1000000\r\n\r\n")
    assert held


def big_path(name, keys=10000):
    """Three megabytes: more than the sockets hold."""
    turn, (c, s) = pose(0.7), (math.cos(0.5), math.sin(0.5))
    x_axis, rest = turn[0][:3], [row[:3] for row in turn[1:3]]
    world = [[c * x - s * y for x, y in zip(x_axis, rest[0])],
             [s * x + c * y for x, y in zip(x_axis, rest[0])], rest[1]]
    world = [[row[0] * c - row[1] * s, row[0] * s + row[1] * c, row[2]] for row in world]
    world = [[world[0][j] * c + world[2][j] * s for j in range(3)], world[1],
             [world[2][j] * c - world[0][j] * s for j in range(3)]]
    world = [row + [i + 1 / 3] for i, row in enumerate(world)]
    return {"name": name, "path": {
        "axes": "opengl", "fps": 1, "interpolation": "linear", "loop": False, "width": 8,
        "height": 8, "keys": [{"time": t + 1 / 3, "world_from_camera": world, "fov_y_deg": 121 / 3}
                              for t in range(keys)]}}


def stubborn(daemon, path):
    """A client that asks and does not read."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect((daemon.host, daemon.port))
    connection.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    return connection


def test_readers_that_do_not_read(make_daemon):
    """What waits for them has a limit; they are cut off, and the list of paths stays small."""
    daemon = make_daemon(header_timeout=600, answer_memory="8M")
    made = daemon.post("/v1/camera-paths", big_path("p0"))
    assert made.status == 201, made.body
    size = len(daemon.get("/v1/camera-paths/p0").body)
    assert 2_700_000 < size < 4_000_000
    for i in range(1, 3):
        assert daemon.post("/v1/camera-paths", big_path(f"p{i}")).status == 201
    listed = daemon.get("/v1/camera-paths")
    assert listed.status == 200 and len(listed.json["items"]) == 3
    assert len(listed.body) < 3 * 1000
    clients = [stubborn(daemon, "/v1/camera-paths/p0") for _ in range(8)]
    daemon.eventually(lambda: daemon.metric("http_answer_bytes") > size)
    assert daemon.metric("http_answer_bytes") <= 8 * 2**20
    assert longest_answer(daemon, 0.5) < SOON_S
    answer = daemon.get("/v1/camera-paths/p0", check=False)
    assert answer.status == 503 and "slow readers" in answer.json["detail"]
    for client in clients:
        client.close()
    wait_for(lambda: daemon.get("/v1/camera-paths/p0", check=False).status == 200)
    daemon.stop()
    daemon.options["header_timeout"] = 3
    daemon.start()
    with stubborn(daemon, "/v1/camera-paths/p0"):
        daemon.eventually(lambda: daemon.metric("http_slow_total") >= 1)


def test_refusals_of_large_uploads_arrive(make_daemon):
    """The sender is still sending when the answer comes; it is read on, so that it sees it."""
    daemon = make_daemon(max_upload=100000)
    for head, piece in ((b"Content-Length: 30000000", b"x" * 1000000),
                        (b"Transfer-Encoding: chunked", b"f4240\r\n" + b"x" * 1000000 + b"\r\n")):
        with daemon.socket() as connection:
            connection.sendall(b"POST /v1/datasets?name=a HTTP/1.1\r\nHost: localhost\r\n"
                               b"Content-Type: application/x-tar\r\n" + head + b"\r\n\r\n")
            for _ in range(30):
                connection.sendall(piece)
            answer = answer_of(connection)
            assert status_of(answer) == 413 and b"/problems/too-large" in answer, head


@pytest.mark.parametrize("count", [65, 600, 3000])
def test_many_query_arguments(shared, count):
    query = b"&".join(b"a%d=b" % i for i in range(count))
    with shared.socket() as connection:
        begin = time.monotonic()
        connection.sendall(b"GET /v1/jobs?" + query + b" HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert status_of(answer_of(connection)) in (400, 414)
        assert time.monotonic() - begin < SOON_S


@pytest.mark.parametrize("headers", [
    b"Content-Length: 2\r\nContent-Length: 2", b"Content-Length: 2\r\nContent-Length: 40",
    b"Content-Length: 2\r\nTransfer-Encoding: chunked", b"Transfer-Encoding: gzip, chunked",
    b"Content-Length: +2", b"Content-Length: 2, 2", b"Host: example.com"])
def test_ambiguous_framing(shared, headers):
    """Where a body ends is said once, or the request is refused and the connection closed."""
    with shared.socket() as connection:
        connection.sendall(b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\n"
                           b"Content-Type: application/json\r\n" + headers + b"\r\n\r\n{}")
        answer = answer_of(connection)
        assert status_of(answer) == 400 and b"\r\nconnection: close\r\n" in answer.lower()
        read_until_closed(connection)
    assert shared.get("/healthz").status == 200


def test_head_of_a_stream_sends_no_body(shared):
    with shared.socket() as connection:
        connection.sendall(b"HEAD /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = answer_of(connection)
        assert status_of(answer) == 200 and answer.endswith(b"\r\n\r\n")
        assert b"text/event-stream" in answer
        connection.settimeout(0.5)
        with pytest.raises(TimeoutError):
            connection.recv(1)
        connection.sendall(GET)
        assert status_of(answer_of(connection)) == 200


def test_last_event_id_from_the_future(shared):
    """An id that was never given out is none of ours: all is replayed."""
    job, _ = shared.train("future")
    path = f"/v1/jobs/{job['id']}/events"
    everything = shared.events(path)
    assert everything
    assert shared.events(path, {"Last-Event-ID": str(2**62)}) == everything
    assert shared.events(path, {"Last-Event-ID": str(everything[-1][0])}) == []


def test_nul_does_not_cut_ids(shared):
    assert shared.get("/v1/scenes/ready").status == 200
    for name in ("ready%00", "ready%00x"):
        assert shared.get(f"/v1/scenes/{name}", check=False).status == 404
    assert shared.get("/v1/jobs?limit=1%00x", check=False).status == 422


def test_wrong_tokens_are_counted_and_logged(make_daemon, tmp_path):
    """Guesses are limited; who has the token is served all the while."""
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "token").chmod(0o600)
    daemon = make_daemon(token_file=tmp_path / "token")
    statuses = [daemon.get("/v1/jobs", headers={"Authorization": f"Bearer wrong{i:020}"},
                           check=False).status for i in range(70)]
    assert statuses[:60] == [401] * 60 and statuses[60:] == [429] * 10
    daemon.token = "correct-horse-battery"
    assert daemon.get("/v1/jobs").status == 200
    assert daemon.logged("32 wrong tokens") and "wrong0" not in daemon.log_text()


def test_token_file_that_all_can_read(programs, tmp_path):
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "token").chmod(0o644)
    result = subprocess.run([programs[0], "--data", tmp_path / "d", "--listen", "127.0.0.1:0",
                             "--token-file", tmp_path / "token"], capture_output=True, text=True,
                            timeout=PATIENCE_S, check=False)
    assert result.returncode == 2 and "chmod 600" in result.stderr


def test_files_are_the_daemons_alone(make_daemon, photographs):
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    for path in Path(daemon.data).rglob("*"):
        assert path.stat().st_mode & 0o077 == 0, path


def test_data_folder_that_is_removed_underneath(make_daemon):
    """What can no longer be kept is not acknowledged."""
    daemon = make_daemon()
    shutil.rmtree(daemon.data)
    reply = daemon.post("/v1/camera-paths", big_path("p", 2), check=False)
    assert reply.status == 500 and "removed" in reply.json["detail"]
    for reply in (daemon.post("/v1/uploads", {"name": "a", "size_bytes": 9}, check=False),
                  daemon.post("/v1/datasets", body=b"x", query={"name": "a"}, check=False,
                              headers={"Content-Type": "application/x-tar"})):
        assert reply.status == 500 and "moved or removed" in reply.json["detail"]


def test_data_folder_that_is_moved_underneath(make_daemon, photographs):
    """Nor what would be kept elsewhere than where it is looked for; put back, it is as it was."""
    daemon = make_daemon()
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    data, elsewhere = Path(daemon.data), Path(daemon.data).with_name("elsewhere")
    train = {"type": "train", "dataset": "data", "scene": "s", "options": {"max_steps": 2}}
    writes = (("/v1/camera-paths", big_path("p", 2)), ("/v1/jobs", train),
              ("/v1/tokens", {"name": "t"}))
    data.rename(elsewhere)
    for path, body in writes:
        reply = daemon.post(path, body, check=False)
        assert reply.status == 500 and "moved or removed" in reply.json["detail"], path
    elsewhere.rename(data)
    assert [daemon.post(path, body).status for path, body in writes] == [201, 202, 201]
    assert daemon.wait(daemon.get("/v1/jobs").json["items"][0]["id"])["state"] == "succeeded"


def test_a_running_job_makes_no_data_folder_anew(make_daemon, photographs):
    """A path that begins on a loaded scene while the folder is away fails; put back, it is as it was."""
    daemon = make_daemon({"RIPNERF_FAKE_HELD_PICTURES": "0"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    data, elsewhere = Path(daemon.data), Path(daemon.data).with_name("elsewhere")
    daemon.hold()
    path = {"type": "path", "scene": "ready", "camera_path": big_path("p", 2)["path"]}
    jobs = [daemon.submit(**path) for _ in range(2)]
    daemon.eventually(lambda: daemon.job(jobs[0])["state"] == "running")
    data.rename(elsewhere)
    daemon.let_go_on()
    for job in jobs:
        assert daemon.wait(job)["state"] == "failed"
    assert not data.exists()
    elsewhere.rename(data)
    assert all(daemon.get(f"/v1/jobs/{job}/frames").status == 200 for job in jobs)
    assert daemon.wait(daemon.submit(**path))["state"] == "succeeded"


def test_uploads_have_a_common_limit(make_daemon):
    daemon = make_daemon(header_timeout=600)
    head = (b"POST /v1/datasets?name=%d HTTP/1.1\r\nHost: localhost\r\n"
            b"Content-Type: application/x-tar\r\nContent-Length: %d\r\n\r\n")
    if shutil.disk_usage(daemon.data).free < 15 * 2**30:
        with daemon.socket() as connection:
            connection.sendall(head % (99, 15 * 2**30))
            assert status_of(answer_of(connection)) == 507
    uploads = [daemon.socket() for _ in range(16)]
    for i, connection in enumerate(uploads):
        connection.sendall(head % (i, 1000) + b"x")
    wait_for(lambda: len(list(Path(daemon.data, "spool").iterdir())) == 16)
    with daemon.socket() as connection:
        connection.sendall(head % (98, 1000))
        assert status_of(answer_of(connection)) == 503
    for connection in uploads:
        connection.close()


def test_problems_are_utf8(shared):
    for path in ("/v1/scenes/%ff%fe", "/%c3%28", "/v1/jobs?%ff=1"):
        reply = shared.get(path, check=False)
        assert reply.status in (404, 422) and reply.json["detail"], path


def test_event_streams_have_a_limit(make_daemon):
    """1,000 where there is room for as many connections; one more than the limit is told so."""
    daemon = make_daemon(max_connections=2000)
    streams = [daemon.socket() for _ in range(1001)]
    for stream in streams:
        stream.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    codes = [status_of(answer_of(stream)) for stream in streams]
    assert codes.count(200) == 1000 and codes.count(503) == 1
    assert longest_answer(daemon, 0.5) < SOON_S
    for stream in streams:
        stream.close()
