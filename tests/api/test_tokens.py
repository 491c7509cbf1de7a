"""Tokens: scopes, links, quotas, rates; their secrets are on no disk and in no log."""

import json
from pathlib import Path

import pytest

OWN = "correct-horse-battery"


@pytest.fixture
def guarded(make_daemon, tmp_path, photographs):
    """A daemon with a token of its own, dataset `data` and scene `ready`, and as(token) for it."""
    (tmp_path / "token").write_text(OWN + "\n")
    (tmp_path / "token").chmod(0o600)
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "100"}, token_file=tmp_path / "token")
    daemon.token = OWN
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    return daemon


def make(daemon, name, code=201, **request):
    reply = daemon.post("/v1/tokens", {"name": name, **request})
    assert reply.status == code, reply.body
    return reply.json


def asked(daemon, token, method, path, *arguments, **options):
    return daemon.request(method, path, *arguments, **options,
                          headers={"Authorization": f"Bearer {token}"}).status


RENDER = {"view": "test:0", "size": {"width": 8, "height": 8}}
TRAIN = {"type": "train", "dataset": "data", "scene": "x", "options": {"max_steps": 5}}
EVAL = {"type": "eval", "scene": "ready", "options": {"split": "test"}}


def test_scopes_hold_each_other(guarded):
    """What each scope may, and that the next one is needed for the rest."""
    tokens = {scope: make(guarded, scope, scope=scope)["token"]
              for scope in ("read", "render", "train", "admin")}
    for token in tokens.values():
        assert asked(guarded, token, "GET", "/v1/scenes") == 200
    rest = [("render", "/v1/scenes/ready/render", RENDER, 200), ("render", "/v1/jobs", EVAL, 202),
            ("train", "/v1/jobs", TRAIN, 202), ("admin", "/v1/tokens", {"name": "t"}, 201)]
    scopes = list(tokens)
    for needed, path, body, code in rest:
        for scope in scopes:
            enough = scopes.index(scope) >= scopes.index(needed)
            body = {**body, "scene": f"by-{scope}"} if body is TRAIN or "dataset" in body else body
            body = {**body, "name": f"t-{scope}"} if "name" in body else body
            status = asked(guarded, tokens[scope], "POST", path, json_body=body)
            assert status == (code if enough else 403), (scope, path, status)
    assert asked(guarded, tokens["train"], "GET", "/v1/backup") == 403
    assert asked(guarded, tokens["admin"], "GET", "/v1/backup") == 200
    reply = guarded.get("/v1/info", headers={"Authorization": f"Bearer {tokens['render']}"})
    assert reply.json["you"]["name"] == "render" and reply.json["you"]["scope"] == "render"
    reply = guarded.post("/v1/jobs", TRAIN, headers={"Authorization": f"Bearer {tokens['read']}"})
    assert "scope read" in reply.json["detail"] and "scope render" in reply.json["detail"]


def test_only_the_maker_or_an_admin_changes_a_thing(guarded):
    anna, ben = (make(guarded, name, scope="train")["token"] for name in ("anna", "ben"))
    reply = guarded.post("/v1/jobs", {**TRAIN, "options": {"max_steps": 10**7}},
                         headers={"Authorization": f"Bearer {anna}"})
    job = reply.json["id"]
    assert asked(guarded, ben, "POST", f"/v1/jobs/{job}/cancel") == 403
    assert asked(guarded, ben, "DELETE", "/v1/datasets/data") == 403
    assert asked(guarded, ben, "DELETE", "/v1/scenes/ready") == 403
    assert asked(guarded, anna, "POST", f"/v1/jobs/{job}/cancel") == 200
    guarded.wait(job)
    assert asked(guarded, ben, "DELETE", "/v1/scenes/x") == 403
    assert asked(guarded, anna, "DELETE", "/v1/scenes/x") == 204
    assert guarded.delete("/v1/scenes/ready").status == 204


def test_a_token_has_keys_of_its_own(guarded):
    """Who sends another token's key, or asks for its upload once more, learns nothing of either."""
    anna, ben = (make(guarded, name, scope="train")["token"] for name in ("anna", "ben"))

    def ask(token, path, body, key="once"):
        return guarded.post(path, body, headers={"Authorization": f"Bearer {token}", "Idempotency-Key": key})

    other = {**EVAL, "options": {"split": "test", "views": 1}}
    first = [ask(token, "/v1/jobs", body) for token, body in ((anna, EVAL), (ben, other), (OWN, EVAL))]
    jobs = [reply.json["id"] for reply in first]
    assert len(set(jobs)) == 3, [reply.body for reply in first]
    assert [ask(token, "/v1/jobs", body).json["id"]
            for token, body in ((anna, EVAL), (ben, other), (OWN, EVAL))] == jobs
    refused = ask(ben, "/v1/jobs", EVAL)
    assert refused.status == 409 and jobs[1] in refused.json["detail"] and jobs[0] not in refused.json["detail"]

    upload = guarded.post("/v1/uploads", {"size_bytes": 1024}).json["id"]
    part = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    assert guarded.request("PATCH", f"/v1/uploads/{upload}", bytes(1024), part).status == 204
    wanted = {"name": "sent", "upload": upload}
    sent = ask(anna, "/v1/datasets", wanted)
    assert sent.status == 202 and ask(anna, "/v1/datasets", wanted).json["id"] == sent.json["id"]
    assert ask(ben, "/v1/datasets", wanted).status == 404
    assert ask(anna, "/v1/jobs", EVAL, key=upload).status == 202
    for job in (*jobs, sent.json["id"]):
        guarded.wait(job)


def test_a_link_shows_one_thing(guarded):
    """A scene at any camera, or a path's pictures; not its photographs, not another scene."""
    guarded.train("other")
    scene = guarded.get("/v1/scenes/ready").json
    link = make(guarded, "link", scene="ready")
    assert link["scene"] == scene["id"] and link["scope"] == "read"
    token = link["token"]
    for reference in ("ready", scene["id"]):
        assert asked(guarded, token, "GET", f"/v1/scenes/{reference}") == 200
        assert asked(guarded, token, "GET", f"/v1/scenes/{reference}/start") == 200
        assert asked(guarded, token, "POST", f"/v1/scenes/{reference}/render", json_body=RENDER) == 200
    for method, path, body in (
            ("GET", "/v1/scenes", None), ("GET", "/v1/scenes/other", None),
            ("POST", "/v1/scenes/other/render", RENDER), ("GET", "/v1/datasets", None),
            ("GET", "/v1/datasets/data/images/test/0", None), ("GET", "/v1/jobs", None),
            ("GET", f"/v1/jobs/{scene['job']}", None), ("GET", "/v1/events", None),
            ("GET", "/v1/scenes/ready/checkpoint", None), ("GET", "/metrics", None),
            ("POST", "/v1/jobs", EVAL), ("DELETE", "/v1/scenes/ready", None),
            ("GET", "/v1/tokens", None), ("POST", "/v1/tokens", {"name": "more"})):
        assert asked(guarded, token, method, path, json_body=body) == 403, (method, path)
    info = guarded.get("/v1/info", headers={"Authorization": f"Bearer {token}"}).json
    assert info["you"]["scene"] == scene["id"] and info["roots"] == []
    path = guarded.submit(type="path", scene="ready", camera_path=PATH)
    guarded.wait(path)
    film = make(guarded, "film", job=path)["token"]
    assert asked(guarded, film, "GET", f"/v1/jobs/{path}/frames") == 200
    assert asked(guarded, film, "GET", f"/v1/jobs/{path}/frames/0") == 200
    assert asked(guarded, film, "GET", "/v1/scenes/ready") == 403
    assert asked(guarded, film, "GET", f"/v1/jobs/{scene['job']}") == 403


PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": t, "fov_y_deg": 40, "world_from_camera":
                  [[1, 0, 0, t], [0, 1, 0, 0], [0, 0, 1, 4]]} for t in (0, 1)]}


def test_tokens_end(guarded):
    """Revoked and expired ones are refused, also after a restart; the store has digests alone."""
    kept, gone = make(guarded, "kept"), make(guarded, "gone")
    short = make(guarded, "short", expires_s=1)
    make(guarded, "kept", code=409)
    assert guarded.delete("/v1/tokens/gone").status == 204
    guarded.eventually(lambda: asked(guarded, short["token"], "GET", "/v1/scenes") == 401)
    guarded.stop()
    guarded.start()
    assert asked(guarded, kept["token"], "GET", "/v1/scenes") == 200
    assert asked(guarded, gone["token"], "GET", "/v1/scenes") == 401
    reply = guarded.get("/v1/scenes", headers={"Authorization": f"Bearer {short['token']}"})
    assert reply.status == 401 and "expired" in reply.json["detail"]
    listed = guarded.get("/v1/tokens").json["items"]
    assert [item["name"] for item in listed] == ["short", "kept"]
    assert not any("token" in item for item in listed)
    guarded.stop()
    secrets = [item["token"].encode() for item in (kept, gone, short)] + [OWN.encode()]
    stored = b"".join(path.read_bytes() for path in Path(guarded.data).rglob("*")
                      if path.is_file()) + guarded.log_text().encode()
    assert not any(secret in stored for secret in secrets)


def watched(daemon, token):
    """A connection with an open stream of events, and that."""
    connection = daemon.connect()
    connection.request("GET", "/v1/events", headers={"Authorization": f"Bearer {token}"})
    return connection, connection.getresponse()


def test_an_open_stream_ends_with_its_token(guarded):
    """Of what happens once it is revoked nothing is told any more, on what was opened before either."""
    connection, stream = watched(guarded, make(guarded, "watcher", scope="read")["token"])
    assert stream.status == 200
    while stream.readline() != b": beat\n":  # the past before it
        pass
    assert guarded.delete("/v1/tokens/watcher").status == 204
    guarded.train("later")
    for line in stream:  # to its end, which the next event or heartbeat is
        assert b"event:" not in line, line
    connection.close()


def test_an_open_stream_ends_when_its_token_expires(guarded):
    """Whether it was opened in time is up to the machine: a token that was too short is followed by a longer one."""
    for expires_s in (1, 4, 16, 64):
        token = make(guarded, f"for-{expires_s}", scope="read", expires_s=expires_s)["token"]
        connection, stream = watched(guarded, token)
        if stream.status == 200:
            break
        connection.close()
    assert stream.status == 200
    guarded.eventually(lambda: asked(guarded, token, "GET", "/v1/scenes") == 401)
    record, _ = guarded.train("later")
    for line in stream:
        assert record["id"].encode() not in line, line
    connection.close()


def test_quota_of_jobs(guarded):
    token = make(guarded, "anna", scope="train", max_jobs=2)["token"]
    codes = [asked(guarded, token, "POST", "/v1/jobs", json_body={
        **TRAIN, "scene": f"s{i}", "options": {"max_steps": 1000000}}) for i in range(3)]
    assert codes == [202, 202, 429]
    assert guarded.post("/v1/jobs", {**TRAIN, "scene": "mine"}).status == 202
    assert next(item for item in guarded.get("/v1/tokens").json["items"])["open_jobs"] == 2
    for job in guarded.get("/v1/jobs").json["items"]:
        if job["state"] in ("queued", "running"):
            guarded.post(f"/v1/jobs/{job['id']}/cancel")


def test_quota_of_disk(guarded, photographs):
    """What a token's jobs made counts; an upload beyond it is refused, and after a deletion not."""
    token = make(guarded, "anna", scope="train", max_bytes=60000)["token"]
    owner, guarded.token = guarded.token, token
    size = guarded.get("/v1/datasets/data").json["size_bytes"]
    assert 1000 < size < 60000, size
    assert guarded.wait(guarded.upload("mine", photographs))["state"] == "succeeded"
    you = guarded.get("/v1/info").json["you"]
    assert you["bytes"] == guarded.get("/v1/datasets/mine").json["size_bytes"] <= you["max_bytes"]
    reply = guarded.request("POST", "/v1/datasets", body=b"x" * 60001, query={"name": "more"},
                            headers={"Content-Type": "application/x-tar"})
    assert reply.status == 413
    assert guarded.delete("/v1/datasets/mine").status == 204
    assert guarded.get("/v1/info").json["you"]["bytes"] == 0
    guarded.token = owner


def test_rate(make_daemon):
    """More than --max-rate of one token is told to wait; another one is served."""
    daemon = make_daemon(max_rate=1)
    one, two = (make(daemon, name)["token"] for name in ("one", "two"))
    codes = [asked(daemon, one, "GET", "/v1/scenes") for _ in range(30)]
    assert codes[:2] == [200] * 2 and codes.count(429) > 10
    assert asked(daemon, two, "GET", "/v1/scenes") == 200
    assert daemon.get("/v1/scenes").status == 200
    daemon.eventually(lambda: asked(daemon, one, "GET", "/v1/scenes") == 200)


def test_writes_tell_who_wrote(guarded):
    token = make(guarded, "anna", scope="train")["token"]
    assert asked(guarded, token, "POST", "/v1/jobs", json_body=TRAIN) == 202
    line = guarded.logged("anna.*POST /v1/jobs 202|POST /v1/jobs 202.*anna")
    assert "127.0.0.1" in line
    assert token not in guarded.log_text()


def test_writes_are_audited(make_daemon, tmp_path):
    """One line each, whatever the log tells: who, from where, what, and what came of it. It grows over
    starts, and a path cannot make a line of its own."""
    (tmp_path / "token").write_text(OWN + "\n")
    (tmp_path / "token").chmod(0o600)
    audit = tmp_path / "audit"
    daemon = make_daemon(token_file=tmp_path / "token", audit=audit, log_level="error")
    daemon.token = OWN
    made = make(daemon, "anna", scope="render")
    reply = daemon.request("DELETE", "/v1/camera-paths/%0A%22%5C", headers={
        "Authorization": f"Bearer {made['token']}"})
    assert asked(daemon, made["token"], "POST", "/v1/jobs", json_body=TRAIN) == 403
    assert asked(daemon, "rnt_wrong", "DELETE", "/v1/scenes/ready") == 401
    assert asked(daemon, made["token"], "GET", "/v1/scenes") == 200
    daemon.stop()
    daemon.start()
    assert daemon.delete(f"/v1/tokens/{made['id']}").status == 204
    daemon.stop()
    text = audit.read_text(encoding="utf-8")
    assert audit.stat().st_mode & 0o777 == 0o600 and OWN not in text and made["token"] not in text
    lines = [json.loads(line) for line in text.splitlines()]
    assert [(line["verb"], line["path"], line["status"], line.get("token")) for line in lines] == [
        ("POST", "/v1/tokens", 201, "owner"), ("DELETE", '/v1/camera-paths/\n"\\', 404, "anna"),
        ("POST", "/v1/jobs", 403, "anna"), ("DELETE", "/v1/scenes/ready", 401, None),
        ("DELETE", f"/v1/tokens/{made['id']}", 204, "owner")]
    assert lines[1]["request"] == reply.headers["X-Request-Id"]
    assert lines[1]["token_id"] == made["id"] and lines[1]["address"] == "127.0.0.1"
    assert all(line["time"].endswith("Z") for line in lines)


def test_a_wrong_token_counts_where_none_is_needed(shared):
    reply = shared.get("/v1/scenes", headers={"Authorization": "Bearer rnt_wrong"})
    assert reply.status == 401 and "not one of this daemon's" in reply.json["detail"]
    assert asked(shared, "rnt_wrong", "GET", "/healthz") == 200


@pytest.mark.parametrize("request_, pointer", [
    ({"name": "a", "scope": "all"}, "#/scope"), ({"name": "a", "scene": "ready", "scope": "admin"},
                                               "#/scope"),
    ({"name": "tok_x"}, "#/name"), ({"name": "a", "expires_s": 0}, "#/expires_s"), ({}, "#/name")])
def test_bad_token_requests(shared, request_, pointer):
    reply = shared.post("/v1/tokens", request_)
    assert reply.status == 422 and pointer in {item["pointer"] for item in reply.json["errors"]}
