"""Clients that misbehave: each is answered in time or dropped, and the daemon goes on serving."""

import os
import signal
import socket
import subprocess
import threading
import time

import pytest

from support.photographs import write_dataset
from support.waiting import PATIENCE_S, wait_for

TAR = {"Content-Type": "application/x-tar"}


def exchange(daemon, text, close=False, timeout=PATIENCE_S):
    """Raw bytes in, all bytes out until the daemon closes or has answered."""
    with daemon.socket() as connection:
        connection.settimeout(timeout)
        connection.sendall(text)
        if close:
            connection.shutdown(socket.SHUT_WR)
        answer = b""
        try:
            while piece := connection.recv(65536):
                answer += piece
                if b"\r\n\r\n" in answer and not close:
                    break
        except (TimeoutError, ConnectionResetError):
            pass
        return answer


def status_of(answer):
    return int(answer.split(b" ", 2)[1]) if answer else None


def spool(daemon):
    return os.listdir(os.path.join(daemon.data, "spool"))


def test_methods(shared):
    for method in ("PUT", "PATCH", "OPTIONS", "TRACE"):
        reply = shared.request(method, "/v1/jobs", check=False)
        assert reply.status == 405 and reply.headers["Allow"] == "GET, HEAD, POST", method
    reply = shared.request("POST", "/v1/info", check=False)
    assert reply.status == 405 and reply.headers["Allow"] == "GET, HEAD"
    head = shared.request("HEAD", "/v1/info", check=False)
    assert head.status == 200 and head.body == b"" and int(head.headers["Content-Length"]) > 0


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:7373", "", "10.0.0.1"])
def test_foreign_host(shared, host):
    assert shared.get("/v1/jobs", headers={"Host": host}, check=False).status == 403
    reply = shared.post("/v1/jobs", {}, headers={"Host": host})
    assert reply.status == 403 and reply.slug == "forbidden"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:1"])
def test_foreign_origin(shared, origin):
    for method, path in (("POST", "/v1/jobs"), ("DELETE", "/v1/scenes/ready"),
                         ("POST", "/v1/jobs/job_aaaaaaaaaaaa/cancel")):
        reply = shared.request(method, path, body=b"", headers={"Origin": origin})
        assert reply.status == 403, path
    own_origin = {"Origin": f"http://{shared.host}:{shared.port}"}
    assert shared.post("/v1/jobs/job_aaaaaaaaaaaa/cancel", headers=own_origin).status == 404


def test_token(make_daemon, tmp_path):
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "token").chmod(0o600)
    daemon = make_daemon(token_file=tmp_path / "token", listen="0.0.0.0:0")
    for headers in ({}, {"Authorization": "Bearer wrong-horse-battery"},
                    {"Authorization": "Basic correct-horse-battery"}):
        reply = daemon.get("/v1/jobs", headers=headers)
        assert reply.status == 401 and reply.headers["WWW-Authenticate"] == "Bearer"
        assert daemon.get("/metrics", headers=headers).status == 401
        assert daemon.post("/v1/jobs", {}, headers=headers).status == 401
    assert daemon.get("/healthz").status == daemon.get("/readyz").status == 200
    daemon.token = "correct-horse-battery"
    assert daemon.get("/v1/jobs").status == 200
    assert daemon.get("/v1/jobs", headers={"Host": "scenes.example"}).status == 200


def test_content_type(shared):
    for content_type in ("text/plain", "application/x-www-form-urlencoded", "application/jsonx"):
        reply = shared.request("POST", "/v1/jobs", body=b"{}",
                               headers={"Content-Type": content_type})
        assert reply.status == 415 and reply.slug == "media-type"


def test_large_body_is_refused_early(shared):
    head = (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Content-Length: 50000000\r\n\r\n")
    answer = exchange(shared, head + b"x" * 1000)  # the rest never comes
    assert status_of(answer) == 413 and b"/problems/too-large" in answer


def test_large_chunked_body(shared):
    """No length to refuse by: read up to the limit, then cut off."""
    head = (b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            b"Transfer-Encoding: chunked\r\n\r\n")
    chunk = b"10000\r\n" + b"x" * 65536 + b"\r\n"
    with shared.socket() as connection:
        connection.sendall(head)
        with pytest.raises((ConnectionResetError, BrokenPipeError)):
            for _ in range(4000):
                connection.sendall(chunk)
    with shared.socket() as connection:
        connection.sendall(head)
        for _ in range(400):  # it is told why before it is cut off
            connection.sendall(chunk)
        answer = connection.recv(65536)
        assert status_of(answer) == 413 and b"/problems/too-large" in answer
    assert shared.get("/healthz").status == 200


def test_body_where_none_belongs(shared):
    reply = shared.post("/v1/jobs/job_aaaaaaaaaaaa/cancel", {"now": True}, check=False)
    assert reply.status == 413


def test_upload_over_limit(make_daemon):
    daemon = make_daemon(max_upload=100000)
    reply = daemon.post("/v1/datasets", body=b"x" * 100001, query={"name": "a"}, headers=TAR)
    assert reply.status == 413
    connection = daemon.connect()
    pieces = (b"x" * 60000 for _ in range(3))
    connection.request("POST", "/v1/datasets?name=a", pieces, TAR, encode_chunked=True)
    assert connection.getresponse().status == 413
    connection.close()
    wait_for(lambda: not spool(daemon))


def test_upload_cut_off(shared):
    before = len(shared.get("/v1/jobs").json["items"])
    head = (b"POST /v1/datasets?name=cut HTTP/1.1\r\nHost: localhost\r\n"
            b"Content-Type: application/x-tar\r\nContent-Length: 1000000\r\n\r\n")
    with shared.socket() as connection:
        connection.sendall(head + b"x" * 100000)
        wait_for(lambda: any(name.startswith("upload-") for name in spool(shared)))
    wait_for(lambda: not spool(shared))
    assert len(shared.get("/v1/jobs").json["items"]) == before


def test_oversized_header(shared):
    answer = exchange(shared, b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nX-Much: " +
                      b"x" * 100000 + b"\r\n\r\n")
    assert status_of(answer) in (413, 431, None)
    answer = exchange(shared, b"GET /" + b"x" * 100000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert status_of(answer) in (414, 413, 431, None)
    assert shared.get("/healthz").status == 200


def test_rubbish(shared):
    for text in (b"\0\1\2\3" * 100, b"GET\r\n\r\n", b"\r\n" * 50, b"GET / HTTP/9.9\r\n\r\n",
                 b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n"):
        exchange(shared, text, close=True, timeout=3)
        assert shared.get("/healthz").status == 200


def test_names_in_paths(shared):
    for name in ("..", "%2e%2e%2f", "a%00b", "%ff", "' OR 1=1 --".replace(" ", "%20"), "x" * 300):
        for kind in ("scenes", "datasets", "camera-paths", "jobs"):
            assert shared.get(f"/v1/{kind}/{name}", check=False).status == 404, name


def test_slow_header_does_not_block(make_daemon):
    daemon = make_daemon(header_timeout=600)
    idle = [daemon.socket() for _ in range(20)]
    for connection in idle:
        connection.sendall(b"GET /v1/jobs HT")
    assert daemon.get("/v1/jobs").status == 200
    for connection in idle:  # all are there still: it has not waited for one to be cut off
        connection.sendall(b"TP/1.1\r\nHost: localhost\r\n\r\n")
        assert status_of(connection.recv(100)) == 200
        connection.close()


def test_too_many_connections(make_daemon):
    daemon = make_daemon(max_connections=10)
    idle = [daemon.socket() for _ in range(12)]  # these make room
    assert daemon.get("/v1/jobs").status == 200
    for connection in idle:
        connection.close()
    streams = [daemon.socket() for _ in range(10)]  # these do not
    for connection in streams:
        connection.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert status_of(connection.recv(100)) == 200
    reply = daemon.get("/v1/jobs", check=False)
    assert reply.status == 503 and reply.slug == "busy" and int(reply.headers["Retry-After"]) > 0
    assert daemon.get("/healthz").status == 200 and daemon.get("/readyz").status == 200
    for connection in streams:
        connection.close()
    wait_for(lambda: daemon.get("/v1/jobs", check=False).status == 200)


def test_too_many_renders(make_daemon, photographs):
    """Beyond what may wait the answer is 503, at once; the others get their picture."""
    daemon = make_daemon()
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    statuses = []

    def ask(number):
        statuses.append(daemon.post("/v1/scenes/s/render", {
            "view": "test:0", "background": [number / 100, 0, 0],
            "size": {"width": 2, "height": 2}}).status)
    runners = daemon.runners()
    for pid in runners:
        os.kill(pid, signal.SIGSTOP)  # no picture comes before all are asked for
    threads = [threading.Thread(target=ask, args=(i,)) for i in range(80)]
    for thread in threads:
        thread.start()
    wait_for(lambda: len(statuses) == 16)
    for pid in runners:
        os.kill(pid, signal.SIGCONT)
    for thread in threads:
        thread.join(PATIENCE_S)
    assert statuses == [503] * 16 + [200] * 64


def test_equal_renders_share(make_daemon, photographs):
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": "30000"})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    bodies = []
    threads = [threading.Thread(target=lambda: bodies.append(
        daemon.post("/v1/scenes/s/render", {"view": "test:0"}).body)) for _ in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert len(set(bodies)) == 1
    count = daemon.get("/metrics").body.split(b"\nripnerf_render_milliseconds_count ")[1].split()[0]
    assert int(count) < 10


def test_client_leaves_a_render(make_daemon, photographs):
    """The runner stops working for a client that has gone."""
    daemon = make_daemon({"RIPNERF_FAKE_ROW_US": "500000"})
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("s", max_steps=2)
    body = b'{"view":"test:0","size":{"width":500,"height":500}}'
    with daemon.socket() as connection:
        connection.sendall(b"POST /v1/scenes/s/render HTTP/1.1\r\nHost: localhost\r\n"
                           b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n"
                           % len(body) + body)
        daemon.eventually(lambda: daemon.metric("renders_waiting") == 1)
    daemon.eventually(lambda: daemon.metric("renders_cancelled_total") == 1)
    reply = daemon.post("/v1/scenes/s/render",  # long before 500 rows are there
                        {"view": "test:0", "size": {"width": 1, "height": 1}})
    assert reply.status == 200


def test_slow_stream_reader(own):
    """A reader that takes nothing neither blocks the job nor makes the daemon grow."""
    job = own.submit(type="train", dataset="data", scene="s",
                     options={"max_steps": 1500, "evaluate_interval_s": 0.01})
    with own.socket() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert own.wait(job)["state"] == "succeeded"
    assert own.get("/healthz").status == 200


def test_streams_come_and_go(own):
    job = own.submit(type="train", dataset="data", scene="s", options={"max_steps": 100000})
    for _ in range(30):
        with own.socket() as connection:
            connection.sendall(
                f"GET /v1/jobs/{job}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            connection.recv(100)
    own.eventually(lambda: own.metric("http_streams") == 0)
    assert own.job(job)["state"] == "running"


def test_idle_streams_cost_nothing(own):
    streams = [own.socket() for _ in range(10)]
    for connection in streams:
        connection.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert connection.recv(100)
    time.sleep(0.5)

    def cpu():
        with open(f"/proc/{own.process.pid}/stat", encoding="utf-8") as file:
            fields = file.read().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    before = cpu()
    time.sleep(2)
    assert cpu() - before < 0.2
    for connection in streams:
        connection.close()


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "small"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(folder)],
                             capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("a tmpfs cannot be mounted here")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def fill_up(filler):
    with pytest.raises(OSError), open(filler, "ab", buffering=0) as file:
        while True:
            file.write(b"x" * 4096)
    return True


def test_full_disk(make_daemon, small_disk, tmp_path):
    """Writes fail with 507, reads go on, and it heals."""
    data = small_disk / "d"
    link = tmp_path / "d0"
    data.mkdir()
    link.symlink_to(data)
    daemon = make_daemon()
    daemon.wait(daemon.upload("data", write_dataset(tmp_path / "photographs")))
    filler = small_disk / "filler"
    fill_up(filler)
    reply = daemon.post("/v1/datasets", body=b"x" * 500000, query={"name": "b"}, headers=TAR)
    assert reply.status == 507 and reply.slug == "no-space", reply.body
    reply = daemon.post("/v1/jobs", {"type": "train", "dataset": "data", "scene": "s"})
    assert reply.status == 507, reply.body
    assert daemon.get("/v1/datasets/data").status == 200
    assert daemon.get("/v1/jobs").status == 200
    assert daemon.get("/v1/scenes/s").status == 404
    # What the daemon has tidied away meanwhile is filled too.
    daemon.eventually(lambda: fill_up(filler) and daemon.get("/readyz").status == 503)
    filler.unlink()
    assert daemon.get("/readyz").status == 200
    assert daemon.train("s", max_steps=5)[0]["state"] == "succeeded"
