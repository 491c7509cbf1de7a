"""Traces (W3C Trace Context): from a request through daemon and runner to what both log."""

import json
import re
from pathlib import Path

from support.checked import make_tar

CALLER = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00"
OTHER = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01"
PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": time_s, "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]],
                  "fov_y_deg": 40} for time_s in (0, 1)]}


def ids(traceparent):
    return re.fullmatch("00-([0-9a-f]{32})-([0-9a-f]{16})-[0-9a-f]{2}", traceparent).groups()


def ask(daemon, traceparent, **request):
    reply = daemon.post("/v1/jobs", request, headers={"traceparent": traceparent} if traceparent else {})
    assert reply.status == 202, reply.body
    return reply, reply.json["id"]


def told_by_runner(daemon, log_of, job):
    """Of the lines about a job in a runner's log, the traces."""
    text = (Path(daemon.data) / "jobs" / log_of / "log").read_text()
    lines = [line for line in text.splitlines() if f"job {job}: " in line]
    assert lines, text
    return {re.search(r" trace_id=([0-9a-f]{32}) span_id=([0-9a-f]{16})$", line).groups() for line in lines}


def told_by_daemon(daemon, start):
    """Of the daemon's lines that begin so, the ids; a sanitizer has lines of its own there."""
    lines = [json.loads(line) for line in daemon.log_text().splitlines() if line.startswith("{")]
    return {(line.get("trace_id"), line.get("span_id")) for line in lines if line["text"].startswith(start)}


def test_a_job_is_in_the_trace_of_its_request(make_daemon, photographs):
    daemon = make_daemon(log_format="json")
    reply = daemon.post("/v1/datasets", body=make_tar(photographs), query={"name": "data"},
                        headers={"Content-Type": "application/x-tar", "traceparent": OTHER})
    record = daemon.wait(reply.json["id"])
    assert told_by_runner(daemon, record["id"], record["id"]) == {ids(record["traceparent"])}
    assert ids(record["traceparent"])[0] == ids(OTHER)[0]

    reply, train = ask(daemon, CALLER, type="train", dataset="data", scene="s", options={"max_steps": 30})
    assert reply.headers["X-Request-Id"] == ids(CALLER)[0]
    record = daemon.wait(train)
    own = ids(record["traceparent"])
    assert own[0] == ids(CALLER)[0] and own[1] != ids(CALLER)[1] and record["traceparent"].endswith("-00")
    assert told_by_runner(daemon, train, train) == {own}
    assert told_by_daemon(daemon, f"job {train}: ") == {own}
    spans = daemon.eventually(lambda: told_by_daemon(daemon, "POST /v1/jobs "))  # told after its answer
    assert {trace for trace, _ in spans} == {own[0]} and own not in spans

    # The same runner, in another trace; and in one of its own, which no caller has named.
    reply, path = ask(daemon, OTHER, type="path", scene="s", camera_path=PATH)
    record = daemon.wait(path)
    assert ids(record["traceparent"])[0] == ids(OTHER)[0]
    assert told_by_runner(daemon, train, path) == {ids(record["traceparent"])}
    for wrong in (None, "00-00000000000000000000000000000000-b7ad6b7169203331-01", "x"):
        reply, job = ask(daemon, wrong, type="eval", scene="s", options={"split": "test"})
        record = daemon.wait(job)
        trace, _ = ids(record["traceparent"])
        assert trace == reply.headers["X-Request-Id"] and trace.strip("0")
        assert told_by_runner(daemon, train, job) == {ids(record["traceparent"])}
    daemon.stop()
    daemon.start()
    assert ids(daemon.job(train)["traceparent"]) == own
