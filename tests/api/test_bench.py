"""`ripnerf bench`: figures of this machine, without a daemon."""

import json
import math

import pytest

from support.client import OK, USAGE, Client

STAGES = ["rays", "march", "encode", "mlp forward", "composite", "mlp backward", "scatter",
          "optimiser", "occupancy"]
MACHINE = {"cpu", "cores", "load_average", "fma_gmacs", "bf16_dot_gmacs", "amx_bf16_gmacs",
           "amx_bf16_l1_gmacs", "array_mb", "random_line_ns", "stream_gbs"}
STAGE = {"name", "unit", "operations", "bytes", "ceiling", "limit", "measured", "ratio", "error",
         "passed"}


@pytest.fixture(scope="module")
def client(build, tmp_path_factory):
    return Client(build / "client" / "ripnerf", tmp_path_factory.mktemp("bench"),
                  "http://127.0.0.1:1")


def bench(client, folder, *options):
    result = client.run("bench", "--json", "--seconds", 1, *options, code=OK, TMPDIR=str(folder))
    assert not list(folder.iterdir()), "the temporary folder stays behind"
    return json.loads(result.stdout)


def check_machine(machine):
    assert set(machine) == MACHINE
    assert machine["cpu"] and machine["cores"] >= 1
    assert machine["array_mb"] == [1, 8, 32, 512]
    for name in ("random_line_ns", "stream_gbs"):
        assert all(math.isfinite(value) and value > 0 for value in machine[name])
    assert machine["fma_gmacs"] > 0
    for name in ("bf16_dot_gmacs", "amx_bf16_gmacs", "amx_bf16_l1_gmacs"):
        assert machine[name] is None or machine[name] > 0


def check_stage(stage):
    assert set(stage) == STAGE
    assert stage["passed"], stage
    assert stage["unit"].endswith("/s")
    assert stage["operations"] > 0 and stage["bytes"] >= 0
    assert stage["ceiling"] > 0 and stage["measured"] > 0
    assert stage["limit"] in ("fma", "bf16 dot", "amx", "memory")
    assert stage["ratio"] == pytest.approx(stage["measured"] / stage["ceiling"], rel=1e-6)


def check_report(report, kernels=None):
    assert set(report) == {"machine", "kernels", "preset", "threads", "stages", "step", "frame"}
    check_machine(report["machine"])
    assert [stage["name"] for stage in report["stages"]] == STAGES
    for stage in report["stages"]:
        check_stage(stage)
    assert kernels in (None, report["kernels"])
    assert set(report["step"]) == {"ms", "samples", "rays", "samples_per_second_per_core",
                                   "ceiling_ms", "ratio"}
    assert all(value > 0 for value in report["step"].values())
    assert set(report["frame"]) == {"width", "height", "ms", "samples"}
    assert report["frame"]["width"] == report["frame"]["height"]
    assert report["frame"]["width"] in (50, 100, 200, 400)
    assert report["frame"]["ms"] > 0 and report["frame"]["samples"] > 0


@pytest.fixture(scope="module")
def usual(client, tmp_path_factory):
    """What `bench` says without further wishes."""
    return bench(client, tmp_path_factory.mktemp("tmp"))


def test_every_figure_is_there(usual):
    check_report(usual)


def test_the_plain_kernels_pass_their_checks(client, tmp_path):
    report = bench(client, tmp_path, "--kernels", "generic", "--threads", 1)
    check_report(report, "generic")
    assert report["threads"] == 1


def test_every_kernel_set_passes_its_checks(client, usual, tmp_path):
    machine = usual["machine"]
    for kernels, unit, figure in (("avx512bf16", "bf16 dot", "bf16_dot_gmacs"),
                                  ("amx", "amx", "amx_bf16_l1_gmacs")):
        if machine[figure] is None:  # the machine has no such set: tried, and refused
            client.run("bench", "--kernels", kernels, code=USAGE, TMPDIR=str(tmp_path))
            continue
        report = bench(client, tmp_path, "--kernels", kernels, "--threads", 1)
        check_report(report, kernels)
        limits = {stage["name"]: stage["limit"] for stage in report["stages"]}
        assert limits["mlp forward"] == limits["mlp backward"] == unit


def test_the_table_names_every_stage(client, tmp_path):
    text = client.run("bench", "--seconds", 1, "--preset", "draft", TMPDIR=str(tmp_path)).stdout
    assert "preset draft" in text
    for name in STAGES:
        assert f"\n{name} " in text


def test_unknown_kernels_are_refused(client, tmp_path):
    result = client.run("bench", "--kernels", "mmx", code=USAGE, TMPDIR=str(tmp_path))
    assert "mmx" in result.stderr and not result.stdout
    said = client.run("bench", "--kernels", "mmx", "--json", code=USAGE, TMPDIR=str(tmp_path))
    error = json.loads(said.stderr)["error"]
    assert "mmx" in error["detail"] and error["exit_code"] == USAGE and not said.stdout
    assert not list(tmp_path.iterdir())
