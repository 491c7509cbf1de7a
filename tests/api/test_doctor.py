"""`ripnerf doctor`: the quick numerics cases, and a scene's own cameras and parameters."""

import json
import math
import struct
import subprocess

import pytest

from support import checked
from support.client import INVALID, NOT_FOUND, OK, UNREACHABLE, USAGE, Client
from support.daemon import Daemon

CASE = {"name", "kernels", "worst", "bound", "unit", "passed", "skipped", "where"}
EVERY_SET = {"exp", "opacity, 1 - exp(-x)", "log2", "frustum moments", "AdamW",
             "ripmap and its adjoint"}
FLOAT64 = {"IEEE arithmetic as stated", "frustum moments", "projected variance",
           "weights and rest sum to 1"}
SCENE = {"the scene's parameters", "the scene's occupancy", "directions of the scene's rays",
         "the scene's rays", "largest ripmap level of these rays"}
SCENE_SETS = {"colours of the scene's rays", "opacities of the scene's rays"}


@pytest.fixture(scope="module")
def daemon(build, tmp_path_factory):
    with Daemon(build, tmp_path_factory.mktemp("data") / "daemon") as running:
        yield running


@pytest.fixture(scope="module")
def client(build, daemon, tmp_path_factory):
    client = Client(build / "client" / "ripnerf", tmp_path_factory.mktemp("client"), daemon.url)
    client.run("synth", "sphere", "source", "--size", 32, "--views", 12)
    client.json("import", "source", "--name", "sphere", "--scales", 2)
    client.run("train", "sphere", "--name", "ball", "--preset", "draft", "--max-steps", 60,
               "--threads", 1, "--wait")
    return client


@pytest.fixture
def alone(build, tmp_path):
    """A client whose daemon does not answer."""
    return Client(build / "client" / "ripnerf", tmp_path, "http://127.0.0.1:1")


def report_of(result):
    report = json.loads(result.stdout)
    assert set(report) == {"passed", "seed", "kernels", "cases"}
    for case in report["cases"]:
        assert set(case) == CASE and case["where"]
        if not case["skipped"]:
            assert case["bound"] is None or case["passed"] == (case["worst"] <= case["bound"]), case
    return report


def names(report, kernels):
    return {case["name"] for case in report["cases"] if case["kernels"] == kernels}


def test_the_machine_alone_needs_no_daemon(alone, tmp_path):
    report = report_of(alone.run("doctor", "--json", "--seed", 7, TMPDIR=str(tmp_path)))
    assert report["passed"] and report["seed"] == 7
    sets = report["kernels"].split(",")
    assert "generic" in sets and names(report, "") == FLOAT64
    for name in sets:
        assert names(report, name) == EVERY_SET
    skipped = [case for case in report["cases"] if case["skipped"]]
    assert all(not case["passed"] and case["worst"] is None for case in skipped)
    if "cuda" not in sets:
        assert [case["kernels"] for case in skipped] == ["cuda"]
    again = report_of(alone.run("doctor", "--json", "--seed", 7, TMPDIR=str(tmp_path)))
    assert again == report


def test_the_table_has_result_number_and_bound(alone):
    lines = alone.run("doctor").stdout.splitlines()
    assert lines[0].split() == ["RESULT", "CASE", "KERNELS", "NUMBER", "BOUND", "UNIT", "WHERE"]
    (line,) = [line for line in lines if " exp " in line and " generic " in line]
    fields = line.split()
    assert fields[0] == "pass" and 0 < float(fields[3]) < float(fields[4]) == 2
    assert lines[-1].split(",")[1] == " 0 failed"


def test_a_scene_on_every_kernel_set(client, tmp_path):
    report = report_of(client.run("doctor", "ball", "--json", TMPDIR=str(tmp_path)))
    assert report["passed"], [case for case in report["cases"] if not case["passed"]]
    assert names(report, "") == FLOAT64 | SCENE
    for kernels in report["kernels"].split(","):
        assert names(report, kernels) == EVERY_SET | SCENE_SETS
    worst = {case["name"]: case["worst"] for case in report["cases"] if case["kernels"] == "generic"}
    assert 0 < worst["colours of the scene's rays"] < 1e-3  # fp32 is not float64
    assert not list(tmp_path.iterdir()), "the temporary folder stays behind"


def incident(parameter=None):
    """A record of rays through the middle, with the parameter at fault."""
    ray = {"id": 0, "fault": "colour", "split": "train", "index": 0, "scale": 0, "x": 1, "y": 1,
           "origin": [0.02, 0.01, -1], "direction": [0, 0, 1], "target": [1, 1, 1], "near": 2,
           "length": 2, "radius": 1e-3, "weight": 1, "stride": 1}
    parameters = [] if parameter is None else [{"index": parameter, "value": "nan"}]
    return {"kind": "rollback", "step": 5, "seed": 1, "rate": 0.001, "nonfinite_rays": 1,
            "nonfinite_parameters": len(parameters), "march_step": 0.01, "background": [1, 1, 1],
            "kernels": "generic", "rays": [ray], "parameters": parameters}


def replay(client, tmp_path, record, code=OK):
    (tmp_path / "record.json").write_text(json.dumps(record))
    return client.run("doctor", "ball", "--json", "--replay", str(tmp_path / "record.json"),
                      code=code)


def test_an_incident_is_replayed(client, tmp_path):
    scene = client.json("show", "ball")["config"]
    features, width = scene["planes"] * scene["channels"], scene["width"]
    last = features * width + (scene["base_layers"] - 1) * width ** 2  # layer of the networks
    at = features * scene["base"] ** 2 + last + 5
    report = report_of(replay(client, tmp_path, incident(at)))
    cases = {(case["name"], case["kernels"]): case for case in report["cases"]}
    for kernels in report["kernels"].split(","):
        now = cases["replayed rays, the parameters as they are", kernels]
        again = cases["replayed rays that do not repeat the incident", kernels]
        assert now["passed"] and now["worst"] == 0 and again["bound"] is None
        assert again["worst"] == 0, again  # with the recorded NaN in its place the ray is wild


def test_a_record_of_another_scene_is_refused(client, tmp_path):
    result = replay(client, tmp_path, incident(10**12), INVALID)
    assert "more parameters" in result.stderr


@pytest.mark.parametrize("spoil, what", [
    (lambda record: record.pop("rays"), "#/rays"),
    (lambda record: record["rays"][0].update(stride=9), "#/rays/0/stride"),
    (lambda record: record.update(march_step=0), "#/march_step"),
    (lambda record: record.update(more=1), "#/more")])
def test_a_wrong_record_is_named(client, tmp_path, spoil, what):
    record = incident()
    spoil(record)
    error = json.loads(replay(client, tmp_path, record, INVALID).stderr)["error"]
    assert error["where"].endswith(f"record.json{what}") and error["exit_code"] == INVALID


def test_a_checkpoint_with_a_spoilt_number_does_not_pass(build, client, daemon, tmp_path):
    (path,) = sorted(daemon.folder.glob("scenes/*/checkpoints/*.safetensors"))[-1:]
    content = bytearray(path.read_bytes())
    (header,) = struct.unpack_from("<Q", content)
    struct.pack_into("<f", content, 8 + header + 4000, math.nan)
    (tmp_path / "spoilt.safetensors").write_bytes(content)
    result = subprocess.run([build / "server" / "ripnerf-runner", "--mode", "doctor",
                             "--checkpoint", tmp_path / "spoilt.safetensors"],
                            capture_output=True, text=True, check=False)
    assert result.returncode == 1 and "non-finite" in result.stderr


def test_what_is_missing_is_said(client, alone, tmp_path):
    assert "nothing" in client.run("doctor", "nothing", code=NOT_FOUND).stderr
    assert "needs the scene" in alone.run("doctor", "--replay", "x", code=USAGE).stderr
    assert alone.run("doctor", "ball", code=UNREACHABLE, TMPDIR=str(tmp_path)).stderr
    assert not list(tmp_path.iterdir())
    assert client.run("doctor", "ball", "--replay", str(tmp_path / "no"), code=NOT_FOUND).stderr
    assert client.run("doctor", "ball", TMPDIR="/nowhere", code=NOT_FOUND).stderr


# ---- the same as a job ----

@pytest.fixture
def api(client, daemon):
    """The daemon with the trained ball, its answers held against the contract."""
    there = checked.Daemon("", "", daemon.folder)
    there.host, there.port, there.log = "127.0.0.1", int(daemon.url.rsplit(":", 1)[1]), daemon.log
    return there


def job_of(api, **options):
    job = api.wait(api.submit(type="doctor", scene="ball", options=options))
    assert job["state"] == "succeeded", job
    return job["result"]


def test_a_doctor_job_finds_what_the_client_finds(client, api, tmp_path):
    report = job_of(api, seed=11)
    assert report["passed"] and report["seed"] == 11
    told = report_of(client.run("doctor", "ball", "--json", "--seed", 11, TMPDIR=str(tmp_path)))
    assert {(c["name"], c["kernels"]) for c in report["cases"]} == {
        (c["name"], c["kernels"]) for c in told["cases"]}
    same = [(a, b) for a in report["cases"] for b in told["cases"]
            if (a["name"], a["kernels"]) == (b["name"], b["kernels"]) and a["kernels"] != "cuda"]
    assert all(a == b for a, b in same), [(a, b) for a, b in same if a != b]


def test_incidents_are_listed_and_a_job_replays_one(client, daemon, api):
    assert api.get("/v1/scenes/ball/incidents").json == {"count": 0, "items": []}
    scene = client.json("show", "ball")
    folder = daemon.folder / "scenes" / scene["id"] / "incidents"
    folder.mkdir()
    for step in (5, 6, 30):
        record = {**incident(), "kind": "rays", "step": step}
        (folder / f"step-{step:09d}-rays.json").write_text(json.dumps(record))
    (folder / "step-000000031-rays.json").write_text("{}")
    (folder / "notes.txt").write_text("")
    listed = api.get("/v1/scenes/ball/incidents").json
    assert listed["count"] == 4
    assert [item["incident"]["step"] for item in listed["items"]] == [30, 6, 5]
    assert listed["items"][1]["file"] == "incidents/step-000000006-rays.json"
    assert listed["items"][1]["incident"]["rays"][0]["near"] == 2
    report = job_of(api, incident="incidents/step-000000006-rays.json")
    assert any(case["name"] == "replayed rays, the parameters as they are"
               for case in report["cases"])
    assert api.get("/v1/scenes/nothing/incidents").status == 404


def test_what_a_doctor_job_cannot_take(api):
    def refused(options, scene="ball"):
        return api.post("/v1/jobs", {"type": "doctor", "scene": scene, "options": options})

    for file in ("../../secret", "incidents/../x.json", "incidents/step-1-rays.json/x",
                 "/etc/passwd", "incidents/step--rays.json", "incidents/step-1-other.json"):
        reply = refused({"incident": file})
        assert reply.status == 422 and reply.json["errors"][0]["pointer"] == "#/options/incident"
    assert refused({"seed": -1}).status == 422 and refused({}, "nobody").status == 404
    job = api.wait(refused({"incident": "incidents/step-000000099-rays.json"}).json["id"])
    assert job["state"] == "failed" and "step-000000099" in json.dumps(job["problem"]), job
