"""Every resource of the API, against a real daemon whose runners have an engine that pretends."""

import io
import json
import shutil
import tarfile
import time
from pathlib import Path

import pytest
from PIL import Image

from support import contract
from support.checked import Daemon, make_tar
from support.photographs import pose

CAMERA = {"world_from_camera": [row[:] for row in pose(0.3)[:3]], "axes": "opengl",
          "width": 24, "height": 20, "fov_y_deg": 40}
PATH = {"axes": "opengl", "fps": 4, "interpolation": "linear", "loop": False, "width": 12, "height": 10,
        "keys": [{"time": t, "world_from_camera": pose(t)[:3], "fov_y_deg": 40}
                 for t in (0, 1, 2)]}
NOBODY = {"dataset": "ds_aaaaaaaaaaaa", "scene": "sc_aaaaaaaaaaaa", "job": "job_aaaaaaaaaaaa"}


def pointers(reply):
    return [error["pointer"] for error in reply.json.get("errors", [])]


# ---- service --------------------------------------------------------------------------------

def test_service(shared):
    assert shared.get("/healthz").json == {"status": "ok"}
    assert shared.get("/readyz").status == 200
    info = shared.get("/v1/info").json
    assert info["device"] == "cpu" and info["threads"] >= 1 and len(info["roots"]) == 1
    assert shared.get("/v1/openapi.json").json == json.loads(
        json.dumps(contract.document(), default=str))


def test_formats(shared):
    """The example is the whole answer: what stands in for the daemon elsewhere serves it."""
    example = Path(contract.__file__).resolve().parents[2] / "proto/examples/FormatList.json"
    assert shared.get("/v1/formats").json == json.loads(example.read_text(encoding="utf-8"))


def test_metrics(shared):
    shared.get("/v1/jobs/" + NOBODY["job"])
    text = shared.get("/metrics").body.decode()
    values = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(values["ripnerf_uptime_seconds"]) > 0
    assert float(values['ripnerf_http_responses_total{code="404"}']) >= 1
    assert float(values['ripnerf_job_transitions_total{state="succeeded"}']) >= 2
    assert float(values["ripnerf_http_uploads_total"]) >= 1
    assert float(values['ripnerf_nonfinite_total{kind="rays"}']) == 0
    assert float(values['ripnerf_render_milliseconds_bucket{le="+Inf"}']) == \
        float(values["ripnerf_render_milliseconds_count"])


def test_page(make_daemon, tmp_path):
    web = tmp_path / "web"
    (web / "js").mkdir(parents=True)
    (web / "index.html").write_text("<!doctype html><title>x</title>")
    (web / "js" / "app.js").write_text("export {};")
    (tmp_path / "secret.js").write_text("no")
    daemon = make_daemon(web=web)
    page = daemon.get("/")
    assert page.body.startswith(b"<!doctype") and page.type == "text/html"
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    assert page.headers["X-Content-Type-Options"] == "nosniff"
    assert daemon.get("/web/js/app.js").type == "text/javascript"
    for path in ("/web/none.js", "/web/../secret.js", "/web/%2e%2e/secret.js", "/web/js",
                 "/web/js/..%2f..%2fsecret.js", "/web/.hidden.js"):
        assert daemon.get(path).status == 404, path


# ---- datasets -------------------------------------------------------------------------------

def test_dataset_by_upload(shared):
    dataset = shared.get("/v1/datasets/data").json
    assert dataset["views"] == {"train": 6, "val": 8, "test": 4} and dataset["width"] == 16
    assert shared.get(f"/v1/datasets/{dataset['id']}").json == dataset
    listed = {key: value for key, value in dataset.items() if key != "past"}  # of the resource alone
    assert listed in shared.get("/v1/datasets").json["items"]
    cameras = shared.get("/v1/datasets/data/cameras", query={"split": "test"}).json["items"]
    assert [item["name"] for item in cameras] == ["r_0", "r_1", "r_2", "r_3"]
    assert len(shared.get("/v1/datasets/data/cameras").json["items"]) == 18
    start = shared.get("/v1/scenes/ready/start").json
    assert start == {"camera": cameras[0]["camera"], "up": pytest.approx(dataset["up"])}
    picture = shared.get("/v1/datasets/data/images/test/2")
    assert Image.open(io.BytesIO(picture.body)).size == (16, 16)
    for path in ("test/4", "val/99"):
        assert shared.get(f"/v1/datasets/data/images/{path}").status == 404
    assert shared.get("/v1/datasets/data/images/test/0", query={"scale": 1}).status == 404
    for path in ("other/0", "test/x", "test/-1"):
        assert shared.get(f"/v1/datasets/data/images/{path}").status == 422


def test_given_bounds(shared, photographs):
    """The sphere that the user names, by either way of importing, and its name."""
    sphere = {"centre": [0.5, -1, 0], "radius": 2.5, "source": "given"}
    reply = shared.post("/v1/datasets", body=make_tar(photographs),
                        query={"name": "bounded", "bounds": "0.5,-1,0,2.5"},
                        headers={"Content-Type": "application/x-tar"})
    other = shared.post("/v1/datasets", {"name": "bounded-too", "directory": str(photographs),
                                         "options": {"bounds": "0.5,-1,0,2.5"}})
    for name, job in (("bounded", reply), ("bounded-too", other)):
        assert shared.wait(job.json["id"])["state"] == "succeeded"
        assert shared.get(f"/v1/datasets/{name}").json["bounds"] == sphere
        assert shared.delete(f"/v1/datasets/{name}").status == 204


def test_dataset_by_directory(shared, photographs):
    reply = shared.post("/v1/datasets", {"name": "named", "directory": str(photographs),
                                         "options": {"scales": 2, "max_size": 12}})
    assert reply.status == 202
    job = shared.wait(reply.json["id"])
    dataset = shared.get("/v1/datasets/named").json
    assert job["result"] == {"dataset": dataset["id"]} and job["dataset"] == dataset["id"]
    assert dataset["scales"] == 2 and dataset["width"] == 12
    assert shared.get("/v1/datasets/named/images/test/0", query={"scale": 1}).status == 200
    assert shared.delete("/v1/datasets/named").status == 204
    assert shared.get("/v1/datasets/named").status == 404
    assert shared.delete("/v1/datasets/named").status == 404


@pytest.mark.parametrize("directory, status", [
    ("/etc", 403), ("/no/such/place", 403), ("relative", 422), ("{root}/none", 404),
    ("{root}/../../etc", 403), ("", 422)])
def test_directory_outside_root(shared, photographs, directory, status):
    directory = directory.format(root=photographs.parent)
    reply = shared.post("/v1/datasets", {"name": "outside", "directory": directory})
    assert reply.status == status, reply.body


@pytest.mark.parametrize("sandbox", [0, 1])
def test_links_out_of_a_directory(make_daemon, photographs, tmp_path, sandbox):
    """A folder under a root is no way to what lies elsewhere; links within it are taken."""
    data = tmp_path / "root" / "data"
    shutil.copytree(photographs, data)
    daemon = make_daemon(dataset_root=data.parent, sandbox=sandbox)
    picture = next(path for path in sorted(data.rglob("*.png")))
    elsewhere, beside = tmp_path / "root" / "elsewhere.png", picture.with_name("beside.dat")
    picture.rename(beside)
    picture.symlink_to(beside)
    job = daemon.post("/v1/datasets", {"name": "within", "directory": str(data)}).json["id"]
    assert daemon.wait(job)["state"] == "succeeded"
    beside.rename(elsewhere)
    for target in (elsewhere, elsewhere.parent):  # a file; a folder that holds a whole tree
        picture.unlink()
        picture.symlink_to(target)
        job = daemon.post("/v1/datasets", {"name": "out", "directory": str(data)}).json["id"]
        problem = daemon.wait(job)["problem"]["detail"]
        assert str(picture.relative_to(data)) in problem and "leads out" in problem


def test_no_root(make_daemon, photographs):
    reply = make_daemon().post("/v1/datasets", {"name": "x", "directory": str(photographs)})
    assert reply.status == 403 and "--dataset-root" in reply.json["detail"]


@pytest.mark.parametrize("query", [
    {}, {"name": "../x"}, {"name": "ds_x"}, {"name": "a b"}, {"name": "n", "scales": 0},
    {"name": "n", "scales": 99}, {"name": "n", "alpha": "none"}, {"name": "n", "split": "every:0"},
    {"name": "n", "max_size": "big"}, {"name": "n", "unknown": 1}, {"name": "n", "bounds": "0,0,0"},
    {"name": "n", "bounds": "0,0,0,-1"}, {"name": "n", "bounds": "0,0,0,nan"},
    {"name": "n", "bounds": "0,0,0,1" + "0" * 130}])
def test_upload_refused_by_query(shared, query):
    reply = shared.post("/v1/datasets", body=b"x" * 1000, query=query,
                        headers={"Content-Type": "application/x-tar"})
    assert reply.status == 422, reply.body


def test_a_split_that_is_not_needed_is_told(own, photographs):
    def told(name, **query):
        own.wait(own.upload(name, photographs, **query))
        record = own.get(f"/v1/datasets/{name}").json
        assert record["views"]["test"] == 4
        return [p for p in record["report"]["problems"] if "test views" in p["text"]]
    problem, = told("asked", split="every:8")
    assert problem["severity"] == "info"
    assert problem["text"] == "the files name 4 test views; --split every:8 was not needed"
    assert told("plain") == []


def test_upload_of_rubbish(shared):
    reply = shared.post("/v1/datasets", body=b"no tar at all" * 100, query={"name": "rubbish"},
                        headers={"Content-Type": "application/x-tar"})
    job = shared.wait(reply.json["id"])
    assert job["state"] == "failed" and job["problem"]["type"] == "/problems/invalid"
    assert shared.get("/v1/datasets/rubbish").status == 404


def test_dataset_conflicts(shared, photographs):
    reply = shared.post("/v1/datasets", body=b"", query={"name": "data"},
                        headers={"Content-Type": "application/x-tar"})
    assert reply.status == 409
    reply = shared.post("/v1/datasets", {"name": "data", "directory": str(photographs)})
    assert reply.status == 409 and pointers(reply) == ["#/name"]
    assert shared.delete("/v1/datasets/data").status == 409  # scene `ready` was made from it


# ---- jobs and scenes ------------------------------------------------------------------------

def test_train(shared):
    job, scene = shared.train("trained", max_steps=40, seed=7)
    assert job["result"]["steps"] == 40 == scene["steps"]
    assert job["result"]["parameters_sha256"] == scene["parameters_sha256"]
    assert job["result"]["finished_by"] == "steps" and job["options"]["seed"] == 7
    assert scene["state"] == "ready" and scene["job"] == job["id"] and scene["effects"]
    assert scene["checkpoints"][0]["step"] == 40 and scene["memory_bytes"] > 0
    assert scene in shared.get("/v1/scenes").json["items"]
    checkpoint = shared.get(f"/v1/scenes/{scene['id']}/checkpoint")
    assert len(checkpoint.body) == scene["checkpoints"][0]["size_bytes"]
    jobs = shared.get("/v1/jobs", query={"scene": "trained", "state": "succeeded",
                                         "type": "train"}).json["items"]
    assert [item["id"] for item in jobs] == [job["id"]]
    assert shared.delete("/v1/scenes/trained").status == 204
    assert shared.get("/v1/scenes/trained").status == 404
    assert shared.get(f"/v1/jobs/{job['id']}").status == 200


@pytest.mark.parametrize("change, pointer", [
    ({"scene": "../x"}, "#/scene"), ({"scene": "sc_x"}, "#/scene"), ({"scene": ""}, "#/scene"),
    ({"scene": "n" * 65}, "#/scene"), ({"scene": "tür"}, "#/scene"), ({"scene": 7}, "#/scene"),
    ({"what": 1}, "#/what"), ({"options": {"planes": 99}}, "#/options/planes"),
    ({"options": {"colour": 1}}, "#/options/colour"),
    ({"options": {"max_time_s": 0}}, "#/options/max_time_s"),
    ({"options": {"max_steps": 1.5}}, "#/options/max_steps"),
    ({"options": {"preset": "best"}}, "#/options/preset"), ({"type": "dance"}, "#/type"),
    ({"type": None}, "#/type"), ({"dataset": None}, "#/dataset")])
def test_bad_job(shared, change, pointer):
    request = {"type": "train", "dataset": "data", "scene": "never", **change}
    reply = shared.post("/v1/jobs", {k: v for k, v in request.items() if v is not None})
    assert reply.status == 422 and pointer in pointers(reply), reply.body


@pytest.mark.parametrize("body", [
    b"", b"{", b"[]", b"null", b'{"type":"train","type":"eval"}', b"\xff\xfe{}", b'{"a":1}x',
    b"[" * 5000])
def test_malformed(shared, body):
    reply = shared.post("/v1/jobs", body=body, headers={"Content-Type": "application/json"})
    assert reply.status in (400, 422) and reply.slug in ("malformed", "invalid"), reply.body


def test_unknown_things(shared):
    for path in ("/v1/jobs/" + NOBODY["job"], "/v1/jobs/x", "/v1/scenes/x", "/v1/datasets/x",
                 "/v1/scenes/" + NOBODY["scene"], "/v1/scenes/x/evaluations",
                 "/v1/scenes/x/checkpoint", "/v1/datasets/x/cameras", "/v1/camera-paths/x",
                 "/v1/jobs/x/frames", "/v1/jobs/x/frames.tar", "/v1/jobs/x/frames/0",
                 "/v1/jobs/x/events"):
        assert shared.get(path).status == 404, path
    for verb in ("pause", "resume", "finish", "cancel"):
        assert shared.post(f"/v1/jobs/{NOBODY['job']}/{verb}").status == 404
    for request in ({"type": "train", "dataset": "none", "scene": "s"},
                    {"type": "eval", "scene": "none"},
                    {"type": "path", "scene": "ready", "path": "none"}):
        assert shared.post("/v1/jobs", request).status == 404
    assert shared.get("/nothing", check=False).status == 404
    assert shared.get("/v1/jobs", query={"scene": "none"}).status == 404


def test_a_name_that_another_kind_of_thing_has_is_told(shared):
    assert shared.get("/v1/scenes/data").json["detail"].endswith(
        "there is no scene 'data', but a dataset of that name")
    assert shared.get("/v1/datasets/ready").json["detail"].endswith(
        "there is no dataset 'ready', but a scene of that name")
    assert shared.get("/v1/scenes/none").json["detail"].endswith("there is no scene 'none'")


def test_scene_name_is_taken(shared):
    reply = shared.post("/v1/jobs", {"type": "train", "dataset": "data", "scene": "ready"})
    assert reply.status == 409 and pointers(reply) == ["#/scene"]


def test_idempotency(shared):
    request = {"type": "eval", "scene": "ready", "options": {"views": 1}}
    key = {"Idempotency-Key": "once"}
    first = shared.post("/v1/jobs", request, headers=key)
    again = shared.post("/v1/jobs", request, headers=key)
    assert first.status == again.status == 202 and first.json["id"] == again.json["id"]
    assert first.headers["Location"] == again.headers["Location"]
    request["options"]["views"] = 2
    assert shared.post("/v1/jobs", request, headers=key).status == 409
    shared.wait(first.json["id"])


def test_pages(shared):
    for _ in range(3):
        shared.wait(shared.submit(type="eval", scene="ready", options={"views": 1}))
    everything = shared.get("/v1/jobs").json["items"]
    seen, cursor = [], None
    while True:
        query = {"limit": 2, **({"cursor": cursor} if cursor else {})}
        page = shared.get("/v1/jobs", query=query).json
        assert len(page["items"]) <= 2
        seen += page["items"]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert [job["id"] for job in seen] == [job["id"] for job in everything]
    for query in ({"limit": 0}, {"limit": 201}, {"limit": "x"}, {"cursor": "x"}, {"cursor": -1},
                  {"state": "dead"}, {"type": "dance"}, {"unknown": 1}, {"limit": ""}):
        assert shared.get("/v1/jobs", query=query).status == 422, query


def test_evaluation(shared):
    job = shared.wait(shared.submit(type="eval", scene="ready", options={"split": "test"}))
    assert job["result"]["views"] == 4 and job["result"]["protocol"]["split"] == "test"
    newest = shared.get("/v1/scenes/ready/evaluations").json["items"][0]
    assert newest["job"] == job["id"] and newest["result"] == job["result"]


# ---- rendering ------------------------------------------------------------------------------

def render(daemon, scene="ready", headers=None, **request):
    return daemon.post(f"/v1/scenes/{scene}/render", request, headers=headers)


def test_render(shared):
    reply = render(shared, camera=CAMERA)
    assert reply.status == 200 and reply.type == "image/png"
    assert Image.open(io.BytesIO(reply.body)).size == (24, 20)
    assert reply.headers["X-Ripnerf-Step"] == "30" and int(reply.headers["X-Ripnerf-Samples"]) > 0
    assert all(part in reply.headers["Server-Timing"] for part in ("queue;", "render;", "encode;"))
    assert reply.headers["Cache-Control"] == "no-cache"
    assert shared.get("/v1/scenes/ready").json["loaded"]
    for view in ("test:1", "test:r_1"):
        assert Image.open(io.BytesIO(render(shared, view=view).body)).size == (16, 16)
    picture = render(shared, view="test:1", size={"width": 40, "height": 30}, output="depth")
    assert Image.open(io.BytesIO(picture.body)).size == (40, 30)


def test_render_format(shared):
    accepted = {"image/jpeg": "image/jpeg", "image/png": "image/png", "*/*": "image/png",
                "image/*;q=0.8": "image/png", "image/jpeg, image/png": "image/png"}
    for accept, expected in accepted.items():
        assert render(shared, view="test:0", headers={"Accept": accept}).type == expected
    assert render(shared, view="test:0", format="jpeg").type == "image/jpeg"
    assert render(shared, view="test:0", headers={"Accept": "text/html"}).status == 406


def test_render_etag(shared):
    first, second = render(shared, view="test:0"), render(shared, view="test:0", scale=0)
    tag = first.headers["ETag"]
    assert tag == second.headers["ETag"] and not tag.startswith("W/")
    assert render(shared, view="test:1").headers["ETag"] != tag
    assert render(shared, view="test:0", format="jpeg").headers["ETag"] != tag
    renders = shared.get("/metrics").body.split(b"ripnerf_render_milliseconds_count ")[1]
    for header in (tag, f'"other", {tag}', "*"):
        reply = render(shared, view="test:0", headers={"If-None-Match": header})
        assert reply.status == 304 and reply.headers["ETag"] == tag
    assert render(shared, view="test:0", headers={"If-None-Match": '"other"'}).status == 200
    after = shared.get("/metrics").body.split(b"ripnerf_render_milliseconds_count ")[1]
    assert int(after.split()[0]) == int(renders.split()[0]) + 1


@pytest.mark.parametrize("request_body", [
    {}, {"camera": CAMERA, "view": "test:0"}, {"view": "test"}, {"view": "test:99"},
    {"view": "test:r_99"}, {"camera": {**CAMERA, "fov_y_deg": 180}}, {"view": "test:0", "x": 1},
    {"camera": {**CAMERA, "world_from_camera": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}},
    {"view": "test:0", "size": {"width": 0, "height": 1}}, {"view": "test:0", "output": "smell"},
    {"view": "test:0", "background": [2, 0, 0]}, {"camera": "front"}])
def test_bad_render(shared, request_body):
    reply = shared.post("/v1/scenes/ready/render", request_body)
    assert reply.status in (404, 422), reply.body
    assert shared.get("/healthz").status == 200


@pytest.mark.parametrize("camera, pointer", [
    ({}, "#/camera/world_from_camera"), ({**CAMERA, "width": 0}, "#/camera/width"),
    ({**CAMERA, "more": 1}, "#/camera/more"), ("front", "#/camera"),
    ({**CAMERA, "world_from_camera": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
     "#/camera/world_from_camera")])
def test_bad_camera_is_pointed_at(shared, camera, pointer):
    reply = shared.post("/v1/scenes/ready/render", {"camera": camera})
    assert reply.status == 422 and pointers(reply) == [pointer]


# However its camera is written, an equal picture has an equal tag.
def test_equal_cameras_have_one_tag(shared):
    other = {**CAMERA, "axes": "opengl" if CAMERA["axes"] == "opencv" else "opencv",
             "world_from_camera": [[row[0], -row[1], -row[2], row[3]]
                                   for row in CAMERA["world_from_camera"]]}
    tags = {render(shared, camera=camera).headers["ETag"] for camera in (CAMERA, other)}
    assert len(tags) == 1


def test_render_of_too_many_pixels(shared):
    huge = {"width": 16384, "height": 16384}
    for request, pointer in (({"view": "test:0", "size": huge}, "#/size"),
                             ({"camera": {**CAMERA, **huge}}, "#/camera")):
        reply = shared.post("/v1/scenes/ready/render", request)
        assert reply.status == 413 and pointers(reply) == [pointer]
    for request in ({"camera_path": {**PATH, **huge}}, {"camera_path": PATH, "options": huge}):
        reply = shared.post("/v1/jobs", {"type": "path", "scene": "ready", **request})
        assert reply.status == 413, reply.body
    limit = shared.get("/v1/info").json["limits"]["max_render_pixels"]
    assert limit < 16384 * 16384


def test_render_unknown(shared):
    assert render(shared, scene="nothing", view="test:0").status == 404


def test_render_while_training(own):
    job = own.submit(type="train", dataset="data", scene="busy", options={"max_steps": 100000})
    own.wait(job, ["running"])
    steps = []
    while len(steps) < 3:
        reply = render(own, scene="busy", view="test:0")
        if reply.status == 200:
            assert reply.headers["Cache-Control"] == "no-store" and "ETag" not in reply.headers
            steps.append(int(reply.headers["X-Ripnerf-Step"]))
            time.sleep(0.05)
        else:
            assert reply.status == 409
    assert steps == sorted(steps) and steps[0] < steps[2]
    assert own.get("/v1/scenes/busy").json["state"] == "training"
    assert own.post(f"/v1/jobs/{job}/cancel").status == 200
    own.wait(job, ["cancelled"])


def wait_for_loaded(daemon, names):
    daemon.eventually(lambda: names == {s["name"] for s in daemon.get("/v1/scenes").json["items"]
                                        if s["loaded"]})


def test_several_scenes(make_daemon, photographs):
    daemon = make_daemon(max_loaded=2)
    daemon.wait(daemon.upload("data", photographs))
    for name in ("a", "b", "c"):
        daemon.train(name)
    for name in ("a", "b", "c", "a"):
        def is_there():
            reply = render(daemon, scene=name, view="test:0")
            assert reply.status in (200, 503), reply.body
            return reply.status == 200
        daemon.eventually(is_there)
    wait_for_loaded(daemon, {"a", "c"})


def test_memory_limit(make_daemon, photographs):
    """Over the limit the scene that was used longest ago is unloaded, never the last one."""
    daemon = make_daemon(memory_limit="1M")
    daemon.wait(daemon.upload("data", photographs))
    for name in ("a", "b"):
        daemon.train(name)
    wait_for_loaded(daemon, {"b"})
    assert render(daemon, scene="b", view="test:0").status == 200


def test_idle_runner_ends(make_daemon, photographs):
    daemon = make_daemon(keep_alive="1s")
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("a")
    daemon.eventually(lambda: not daemon.runners())
    assert not daemon.get("/v1/scenes/a").json["loaded"]
    assert render(daemon, scene="a", view="test:0").status == 200


# ---- camera paths ---------------------------------------------------------------------------

def test_camera_paths(shared):
    reply = shared.post("/v1/camera-paths", {"name": "arc", "path": PATH})
    assert reply.status == 201
    record = reply.json
    assert reply.headers["Location"] == f"/v1/camera-paths/{record['id']}"
    assert shared.get("/v1/camera-paths/arc").json == record
    summary = {key: record[key] for key in ("id", "name", "created_at")}
    assert summary in shared.get("/v1/camera-paths").json["items"]
    assert shared.post("/v1/camera-paths", {"name": "arc", "path": PATH}).status == 409
    backwards = {**PATH, "keys": PATH["keys"][::-1]}
    for path, pointer in (({}, "#/path/width"), ({**PATH, "keys": []}, "#/path/keys"), (7, "#/path"),
                          ({**PATH, "fps": -1}, "#/path/fps"), (backwards, "#/path/keys/1/time")):
        refused = shared.post("/v1/camera-paths", {"name": "bad", "path": path})
        assert refused.status == 422 and pointers(refused) == [pointer]

    job = shared.wait(shared.submit(type="path", scene="ready", path="arc",
                                    options={"first": 2, "last": 6}))
    assert job["result"]["frames"] == 5 and job["progress"]["done"] == 5
    frames = shared.get(f"/v1/jobs/{job['id']}/frames").json
    assert [frame["index"] for frame in frames["items"]] == [2, 3, 4, 5, 6]
    assert frames["next_cursor"] is None
    page = shared.get(f"/v1/jobs/{job['id']}/frames", query={"limit": 3}).json
    rest = shared.get(f"/v1/jobs/{job['id']}/frames",
                      query={"limit": 3, "cursor": page["next_cursor"]}).json
    assert page["items"] + rest["items"] == frames["items"] and rest["next_cursor"] is None
    picture = shared.get(frames["items"][0]["url"])
    assert Image.open(io.BytesIO(picture.body)).size == (12, 10)
    with tarfile.open(fileobj=io.BytesIO(
            shared.get(f"/v1/jobs/{job['id']}/frames.tar").body)) as tar:
        assert tar.getnames() == [f"{i:05}.png" for i in range(2, 7)]
        assert tar.extractfile("00002.png").read() == picture.body
    assert shared.get(f"/v1/jobs/{job['id']}/frames/0").status == 404
    assert shared.get(f"/v1/jobs/{job['id']}/frames/x").status == 422
    assert shared.delete("/v1/camera-paths/arc").status == 204
    assert shared.delete("/v1/camera-paths/arc").status == 404


def test_inline_path(shared):
    job = shared.wait(shared.submit(type="path", scene="ready", camera_path=PATH))
    assert job["result"]["frames"] == 9
    request = {"type": "path", "scene": "ready"}
    for extra in ({}, {"path": "x", "camera_path": PATH}, {"camera_path": {"keys": []}}):
        assert shared.post("/v1/jobs", {**request, **extra}).status == 422


def test_frames_of_other_jobs(shared):
    job = shared.wait(shared.submit(type="eval", scene="ready", options={"views": 1}))["id"]
    for path in ("frames", "frames.tar", "frames/0"):
        assert shared.get(f"/v1/jobs/{job}/{path}").status == 404


# ---- events ---------------------------------------------------------------------------------

def test_events_of_a_job(shared):
    job = shared.submit(type="train", dataset="data", scene="watched", options={"max_steps": 200})
    events = shared.events(f"/v1/jobs/{job}/events")
    ids = [event[0] for event in events]
    assert ids == sorted(set(ids))
    states = [data["state"] for _, name, data in events if name == "state"]
    assert states == ["queued", "running", "succeeded"]
    assert events[-1][1] == "state" and events[-1][2]["result"]["steps"] == 200
    assert any(name == "metric" for _, name, _ in events)
    # The same again for a late reader, and only what is newer with Last-Event-ID.
    again = shared.events(f"/v1/jobs/{job}/events")
    assert again[-1] == events[-1] and again[0] == events[0]
    middle = again[len(again) // 2][0]
    rest = shared.events(f"/v1/jobs/{job}/events", {"Last-Event-ID": str(middle)})
    assert rest == [event for event in again if event[0] > middle]
    assert shared.events(f"/v1/jobs/{job}/events", {"Last-Event-ID": "nonsense"}) == again


def test_events_of_a_path(shared):
    job = shared.submit(type="path", scene="ready", camera_path=PATH)
    events = shared.events(f"/v1/jobs/{job}/events")
    assert [data["index"] for _, name, data in events if name == "frame"] == list(range(9))


def test_events_of_all(shared):
    stream = shared.follow("/v1/events")
    job = shared.submit(type="train", dataset="data", scene="all-watched",
                        options={"max_steps": 2000})
    mine = []
    for _, name, data in stream:
        if (data["id"] if name == "state" else data["job"]) == job:
            mine.append((name, data.get("state")))
        if mine and mine[-1] == ("state", "succeeded"):
            break
    stream.close()
    assert ("state", "queued") in mine and ("progress", None) in mine


def test_events_after_restart(programs, photographs, tmp_path):
    with Daemon(*programs, tmp_path / "d") as daemon:
        daemon.wait(daemon.upload("data", photographs))
        job, _ = daemon.train("a")
        last = daemon.events(f"/v1/jobs/{job['id']}/events")[-1]
    with Daemon(*programs, tmp_path / "d") as daemon:
        events = daemon.events(f"/v1/jobs/{job['id']}/events",
                               {"Last-Event-ID": str(last[0])})
        assert [(name, data["state"]) for _, name, data in events] == [("state", "succeeded")]
