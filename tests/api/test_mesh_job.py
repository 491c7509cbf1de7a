"""Meshes as jobs: what is written, what is served, what is refused."""

import struct


def wait(daemon, **options):
    job = daemon.submit(type="export", scene="ready", options=options)
    return daemon.wait(job)


def test_a_mesh_is_made_and_served(shared):
    job = wait(shared, cells=8)
    assert job["state"] == "succeeded" and job["result"]["file"] == "mesh.ply", job
    reply = shared.get(f"/v1/jobs/{job['id']}/export")
    assert reply.status == 200 and len(reply.body) == job["result"]["bytes"]
    header, body = reply.body.split(b"end_header\n", 1)
    vertices, triangles = job["result"]["vertices"], job["result"]["triangles"]
    assert f"element vertex {vertices}\n".encode() in header and triangles > 100
    assert len(body) == 15 * vertices + 13 * triangles
    assert max(struct.unpack_from("<B3i", body, 15 * vertices + 13 * i)[1:][k]
               for i in range(triangles) for k in range(3)) == vertices - 1
    assert reply.headers["Content-Disposition"].endswith('.ply"')
    job = wait(shared, cells=8, format="obj", level=0.6)
    reply = shared.get(f"/v1/jobs/{job['id']}/export")
    assert reply.headers["Content-Type"].startswith("model/obj")
    assert reply.body.count(b"\nf ") == job["result"]["triangles"]


def test_what_is_refused(shared):
    job = wait(shared, crop=[0, 0, 0, -1, 1, 1])
    assert job["state"] == "failed" and "crop" in job["problem"]["errors"][0]["pointer"], job
    assert shared.get(f"/v1/jobs/{job['id']}/export").status == 404
    for options in ({"cells": 7}, {"cells": 1025}, {"level": 0}, {"format": "stl"}, {"as": "points"},
                    {"crop": [1, 2, 3]}, {"max_bytes": 9}, {"max_loss": 1},
                    {"as": "scene", "cells": 9}, {"as": "scene", "format": "obj"},
                    {"as": "scene", "max_bytes": 0}, {"as": "scene", "max_loss": -1}):
        body = {"type": "export", "scene": "ready", "options": options}
        assert shared.post("/v1/jobs", body).status == 422, options
    assert shared.post("/v1/jobs", {"type": "export", "scene": "nobody"}).status == 404
    train = shared.get("/v1/scenes/ready").json["job"]
    assert shared.get(f"/v1/jobs/{train}/export").status == 404
