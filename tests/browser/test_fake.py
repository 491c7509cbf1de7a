"""The stand-in answers in the shapes of the API document: the states shown are real ones."""

import json
import urllib.request

import pytest
from support import contract
from support.waiting import wait_for


def get(api, path):
    with urllib.request.urlopen(api.url + path) as reply:
        return json.load(reply)


def submit(api, body):
    request = urllib.request.Request(
        api.url + "v1/jobs", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request) as reply:
        return json.load(reply)


def test_answers_conform(fake):
    api = fake("failed")
    contract.check("Info", get(api, "v1/info"))
    path = contract.example("CameraPath")
    path["keys"] = path["keys"][:1]
    done = [
        submit(api, {"type": "eval", "scene": "sphere-draft"}),
        submit(api, {"type": "path", "scene": "sphere-draft", "camera_path": path}),
    ]
    wait_for(lambda: all(get(api, f"v1/jobs/{job['id']}")["state"] == "succeeded" for job in done))
    for what, schema in (
        ("datasets", "DatasetList"),
        ("scenes", "SceneList"),
        ("jobs", "JobList"),
        ("datasets/sphere/cameras", "DatasetCameraList"),
        ("datasets/sphere/points", "DatasetPointList"),
        (f"jobs/{done[1]['id']}/frames", "FrameList"),
        ("scenes/sphere-draft/evaluations", "EvaluationList"),
    ):
        answer = get(api, f"v1/{what}")
        assert answer["items"], what
        contract.check(schema, answer)


def test_refusals_conform(fake):
    api = fake("empty")
    with pytest.raises(urllib.error.HTTPError) as refused:
        get(api, "v1/scenes/nowhere")
    contract.check("Problem", json.load(refused.value))
