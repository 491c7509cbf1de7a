"""What the programs say of their own command lines: errors as JSON, words and options that mean nothing."""

import json
import re
import subprocess

import pytest

from support import contract
from support.client import FAILED, INVALID, NOT_FOUND, USAGE
from support.photographs import write_blank_dataset
from support.waiting import PATIENCE_S


@pytest.fixture
def scene_job(client, daemon):
    daemon.add_dataset("lego")
    return client.json("train", "lego", "--name", "a")["id"]


def wide_lines(text):
    return [line for line in text.splitlines() if len(line) > 80]


def test_help_fits_a_terminal_for_every_verb(client, build):
    verbs = set(re.findall(r"^  ([a-z]+) ", client.run("help").stdout, re.M))
    assert {"train", "curve", "ladder", "completion"} < verbs
    for verb in verbs - {"help"}:
        text = client.run("help", verb).stdout
        assert text.startswith(f"usage: ripnerf {verb}") and "--json" in text
        assert client.run(verb, "--help").stdout == text and wide_lines(text) == []
    daemon = subprocess.run([build / "server/ripnerfd", "--help"], check=True, capture_output=True, text=True)
    assert "--slurm-path-runners N" in daemon.stdout and wide_lines(daemon.stdout) == []


@pytest.mark.parametrize("arguments, code, word", [
    (["fly"], USAGE, "no such verb"), (["train", "lego", "--speed", "9"], USAGE, "no such option"),
    (["train"], USAGE, "needs DATASET"), (["show", ""], USAGE, "empty"),
    (["render", "lego", "--view", "test:0", "-o", "nowhere/a.png"], FAILED, "nowhere/a.png"),
    (["import", "blank", "--name", "lego"], FAILED, "choose another name"),
    (["import", "broken", "--name", "x"], INVALID, "r_1"),
    (["path", "lego", "none.json", "-o", "out"], NOT_FOUND, "none.json")])
def test_every_error_is_one_object_where_json_is_asked_for(client, daemon, tmp_path, arguments, code, word):
    daemon.add_scene("lego", daemon.add_dataset("lego"))
    write_blank_dataset(tmp_path / "blank")
    (write_blank_dataset(tmp_path / "broken") / "train" / "r_1.png").write_text("")
    said = client.run(*arguments, "--json", code=code)
    error = json.loads(said.stderr)["error"]
    assert word in json.dumps(error) and said.stdout == ""
    assert error.get("exit_code", code) == code


@pytest.mark.parametrize("verb", [["show"], ["rm"], ["watch"], ["curve"], ["effects"], ["export", "-o", "a.ply"]])
def test_a_name_may_be_empty_or_long(client, daemon, verb):
    assert "an argument is empty\n" in client.run(*verb, "", code=USAGE).stderr and not daemon.requests
    assert "there is no" in client.run(*verb, "x" * 5000, code=NOT_FOUND).stderr


@pytest.mark.parametrize("arguments, words", [
    (["curve", "a", "--views", "3"], "--views: says nothing without --measure"),
    (["curve", "a", "--overwrite"], "--overwrite: says nothing without --plot"),
    (["effects", "a", "--seeds", "2"], "--seeds: says nothing without --measure"),
    (["ladder", "job_a", "--max-steps", "9"], "--max-steps: says nothing without --over"),
    (["ladder", "job_a", "--keep"], "--keep: says nothing without --over"),
    (["path", "a", "b", "-o", "c", "--codec", "av1"], "--codec: is of an .mp4; OUT is c"),
    (["path", "a", "b", "-o", "c.webm", "--codec", "av1"], "--codec: is of an .mp4; OUT is c.webm"),
    (["path", "a", "b", "-o", "c", "--video-quality", "9"], "--video-quality: is of a film; OUT is c"),
    (["path", "a", "b", "-o", "c", "--jpeg-quality", "9"], "--jpeg-quality: is of --format jpeg"),
    (["turntable", "a", "-o", "c.json", "--frames", "1-2"], "--frames: is of pictures; c.json is a camera path"),
    (["turntable", "a", "-o", "c.json", "--quality", "3"], "--quality: is of pictures; c.json is a camera path"),
    (["paths", "ls", "--fov", "40"], "--fov: is of paths convert"),
    (["token", "ls", "--scope", "read"], "--scope: is of token make"),
    (["token", "make", "x" * 65], f"NAME: is too long; it is '{'x' * 65}'"),
    (["token", "make", "x", "--job", "y" * 65], f"--job: is too long; it is '{'y' * 65}'"),
    (["train", "a", "--name", "b", "--kernels", "k" * 99], f"--kernels: is too long; it is '{'k' * 99}'"),
])
def test_what_would_be_ignored_is_refused(client, daemon, tmp_path, arguments, words):
    assert client.run(*arguments, code=USAGE).stderr == f"ripnerf: {words}\n"
    assert not daemon.requests and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments, words", [
    (["hlep"], "hlep: there is no such verb; did you mean help?"),
    (["train", "a", "--name", "b", "--planes", "7"],
     "--planes: 7 planes belong to no Platonic solid; use 3, 4, 6 or 10"),
    (["synth", "cube", "d"], 'cube: no synthetic scene "cube"; there are sphere, '),
    (["synth", "sphere", "d", "--movers", "2"], '--movers: nobody can stand about in "sphere"; '),
    (["train", "a", "--name", "b", "--effect", "foo=on"], "--effect: there is no 'foo'; there is background, "),
    (["doctor", "--seed", "x"], "--seed: must be a whole number from 0 to 9007199254740991; it is 'x'\n"),
    (["info", "--host", "http://"], "http://: is not an http or https URL, such as http://127.0.0.1:"),
    (["info", "--host", "http://127.0.0.1:99999"], "http://127.0.0.1:99999: is not an http or https URL"),
    (["info", "--host", "box:web"], "box:web: is not an http or https URL, such as http://127.0.0.1:"),
])
def test_what_is_wrong_is_named_with_its_remedy(client, daemon, tmp_path, arguments, words):
    assert client.run(*arguments, code=USAGE).stderr.startswith(f"ripnerf: {words}")
    assert not daemon.requests and list(tmp_path.iterdir()) == []


def test_no_verb_is_an_error_in_json(client):
    error = json.loads(client.run("--json", code=USAGE).stderr)["error"]
    assert error == {"where": "ripnerf", "detail": "needs a verb; see ripnerf help", "exit_code": USAGE}
    assert "usage: ripnerf" in client.run(code=USAGE).stdout


def test_a_file_that_was_made_is_a_result_in_json(client, tmp_path):
    (tmp_path / "in.json").write_text(json.dumps(contract.example("PathFile")))
    convert = ("paths", "convert", "in.json")
    made = client.json(*convert, "out.json", "--to", "nerfstudio")
    assert made == {"file": "out.json", "bytes": (tmp_path / "out.json").stat().st_size}
    assert "cannot create" in client.run(*convert, "nowhere/out.json", code=FAILED).stderr


@pytest.mark.parametrize("arguments, code", [
    (["path", "lego", "none.json"], NOT_FOUND), (["path", "none", "in.json"], NOT_FOUND),
    (["turntable", "none"], NOT_FOUND)])
def test_what_fails_leaves_no_folder(client, daemon, tmp_path, arguments, code):
    daemon.add_scene("lego", daemon.add_dataset("lego"))
    (tmp_path / "in.json").write_text(json.dumps(contract.example("PathFile")))
    client.run(*arguments, "-o", "out", code=code)
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    client.run(*arguments, "-o", "out", code=code)
    assert (tmp_path / "out").exists()


@pytest.mark.parametrize("options, words", [
    (["--data", ""], "data: give a folder with --data DIR"),
    (["--data", "nowhere", "--scrub"], "nowhere: there is no data folder of ripnerfd: nothing was checked"),
    (["--data", "d", "--web", "nowhere"], "web: there is no nowhere/index.html; leave --web out")])
def test_the_daemon_does_not_begin_with_what_is_not_there(build, tmp_path, options, words):
    run = subprocess.run([build / "server/ripnerfd", "--listen", "127.0.0.1:0", *options], cwd=tmp_path,
                         capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert run.returncode in (1, 2) and run.stderr.startswith(f"ripnerfd: {words}") and run.stdout == ""


def test_what_is_printed_without_an_output_goes_nowhere_else(client, daemon, scene_job):
    """Its descriptor is not the next socket's."""
    command = " ".join(client.command("watch", scene_job, "--json"))
    run = subprocess.run(["sh", "-c", f"exec {command} >&-"], env=client.environment, stdin=subprocess.DEVNULL,
                         stderr=subprocess.PIPE, text=True, timeout=PATIENCE_S, check=False)
    assert run.returncode == FAILED and "cannot be written" in run.stderr
