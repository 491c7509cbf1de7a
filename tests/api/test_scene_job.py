"""Scenes as files, as the daemon deals with them: jobs, names, datasets, what is refused."""

import pytest


def export(daemon, **options):
    job = daemon.submit(type="export", scene="ready", options={"as": "scene", **options})
    return daemon.wait(job)


def send(daemon, body, kind="application/octet-stream", **query):
    return daemon.request("POST", "/v1/scenes", body, {"Content-Type": kind}, query=query)


@pytest.fixture(name="file", scope="module")
def fixture_file(shared):
    job = export(shared)
    assert job["state"] == "succeeded", job
    reply = shared.get(f"/v1/jobs/{job['id']}/export")
    assert reply.status == 200 and len(reply.body) == job["result"]["bytes"]
    assert reply.headers["Content-Disposition"].endswith('.ripscene"')
    assert shared.get("/v1/scenes/ready/export").body == reply.body
    return reply.body


def test_it_comes_back(shared, file):
    """With its photographs, where a dataset is named, and without; under a name that is free."""
    reply = send(shared, file, name="alone")
    assert reply.status == 202 and reply.headers["Location"].startswith("/v1/jobs/")
    assert reply.json["scene_name"] == "alone" and "dataset" not in reply.json
    job = shared.wait(reply.json["id"])
    assert job["state"] == "succeeded" and job["result"] == {"scene": job["scene"]}, job
    scene = shared.get("/v1/scenes/alone").json
    assert scene["state"] == "ready" and scene["dataset"] is None and scene["viewing"]["bits"] == 4
    assert scene["id"] == job["scene"] and scene["job"] == job["id"]
    assert shared.get("/v1/scenes/alone/export").status == 404
    assert "viewing" not in shared.get("/v1/scenes/ready").json
    told = shared.get("/v1/scenes/alone/checkpoint")
    assert told.status == 200 and told.body == file
    reply = shared.post("/v1/scenes/alone/render", {"view": "test:0"})
    assert reply.status == 409 and "photographs are not here" in reply.json["detail"]
    eval_job = shared.wait(shared.submit(type="eval", scene="alone"))
    assert eval_job["state"] == "failed"
    curve = shared.wait(shared.post("/v1/scenes/alone/curve", {"views": 1}).json["id"])
    assert curve["state"] == "succeeded" and not curve["result"]["photographs"], curve
    assert "without a dataset" in eval_job["problem"]["detail"]
    assert send(shared, file, name="alone").status == 409

    reply = send(shared, file, name="compared", dataset="data")
    assert shared.wait(reply.json["id"])["state"] == "succeeded"
    assert shared.get("/v1/scenes/compared").json["dataset_name"] == "data"
    assert shared.wait(shared.submit(type="eval", scene="compared"))["state"] == "succeeded"
    effects = shared.post("/v1/scenes/compared/effects", {"seconds": 1, "seeds": 1})
    effects = shared.wait(effects.json["id"])
    assert effects["state"] == "failed" and "for viewing" in effects["problem"]["detail"]
    assert shared.delete("/v1/datasets/data").status == 409
    for name in ("alone", "compared"):
        assert shared.delete(f"/v1/scenes/{name}").status == 204


def test_what_is_refused(shared, file):
    assert send(shared, file).status == 422
    assert send(shared, file, name="").status == 422
    assert send(shared, file, name="x", max_size=3).status == 422
    assert send(shared, file, name="x", dataset="nothing").status == 404
    assert send(shared, file, name="ready").status == 409
    assert send(shared, b"", name="x").status == 422
    assert send(shared, file, "application/x-tar", name="x").status == 415
    for damaged in (file[:-9], file[:40] + bytes([file[40] ^ 1]) + file[41:], b"x", b"\0" * 4096):
        job = shared.wait(send(shared, damaged, name="x").json["id"])
        assert job["state"] == "failed" and "result" not in job
        assert "spool" not in str(job["problem"]), job
    assert shared.get("/v1/scenes/x").status == 404
    own = shared.get("/v1/scenes/ready/checkpoint").body
    job = shared.wait(send(shared, own, name="x").json["id"])
    assert job["state"] == "failed" and "checkpoint of a training" in job["problem"]["detail"]
