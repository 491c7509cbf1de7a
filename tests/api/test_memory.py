"""A training that has too little memory: what it needs is said, and nothing else is lost."""

import pytest

from support.client import FAILED, Client
from support.daemon import Daemon

LIMIT_MIB = 200  # more than `draft` needs
SPACE_KB = 400 << 10  # the same, with libraries and stacks


@pytest.fixture(name="runner")
def fixture_runner(build, tmp_path):
    """One whose address space ends before `standard` has what it needs."""
    program = build / "server" / "ripnerf-runner"
    if any(name in program.read_bytes() for name in (b"__asan_init", b"__tsan_init")):
        pytest.skip("a sanitizer takes address space by terabytes")
    script = tmp_path / "ripnerf-runner"
    script.write_text(f'#!/bin/sh\nulimit -v {SPACE_KB}\nexec {program} "$@"\n')
    script.chmod(0o755)
    return script


def train(client, preset, code=0):
    return client.run("train", "sphere", "--name", preset, "--preset", preset, "--max-steps", 30, "--threads", 1,
                      "--wait", code=code)


def ends_in_words(build, folder, *options):
    """What a training of `standard` says beside a scene that is there, and stays as it was."""
    with Daemon(build, folder / "daemon", *options) as daemon:
        client = Client(build / "client" / "ripnerf", folder, daemon.url)
        client.run("synth", "sphere", "source", "--size", 64, "--views", 12)
        client.run("import", "source", "--name", "sphere")
        train(client, "draft")
        client.run("render", "draft", "--view", "test:0", "-o", "before.png")
        told = train(client, "standard", code=FAILED).stderr
        client.run("render", "draft", "--view", "test:0", "-o", "after.png")
        assert (folder / "before.png").read_bytes() == (folder / "after.png").read_bytes()
        daemon.kill()
        daemon.start()
        client.run("render", "draft", "--view", "test:0", "-o", "again.png")
        states = {job["options"].get("preset"): job["state"] for job in client.json("jobs")["items"]
                  if job["type"] == "train"}
    assert (folder / "before.png").read_bytes() == (folder / "again.png").read_bytes()
    assert states == {"draft": "succeeded", "standard": "failed"}
    assert "take a smaller --base, fewer --planes or a smaller --preset" in told
    return told


def test_standard_beyond_the_memory_limit(build, tmp_path):
    """It is not begun."""
    told = ends_in_words(build, tmp_path, "--memory-limit", f"{LIMIT_MIB}M")
    assert f"the limit is {LIMIT_MIB} MiB" in told and "a larger --memory-limit" in told


def test_standard_where_memory_ends(build, tmp_path, runner):
    told = ends_in_words(build, tmp_path, "--runner", runner)
    assert "out of memory; training needs" in told and "MiB in all" in told
