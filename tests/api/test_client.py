"""The client's contract, against a daemon without an engine: verbs, output, exit codes."""

import json
import os
import pty
import re
import signal
import socket
import subprocess

import pytest

from support import contract
from support.client import (CANCELLED, FAILED, INVALID, NOT_FOUND, OK, UNAUTHORISED, UNREACHABLE,
                            USAGE, Client)
from support.fake_daemon import PNG, FakeDaemon, Problem
from support.photographs import write_blank, write_blank_dataset
from support.waiting import PATIENCE_S, wait_for


@pytest.fixture
def folder(tmp_path):
    return write_blank_dataset(tmp_path / "blank")


@pytest.fixture
def scene(daemon):
    return daemon.add_scene("lego", daemon.add_dataset("lego-400"))


# ---- usage ----

@pytest.mark.parametrize("arguments", [
    [], ["fly"], ["train", "lego"], ["train", "lego", "--name"], ["datasets", "extra"],
    ["train", "lego", "--name", "x", "--planes", "5"],
    ["train", "lego", "--name", "x", "--max-time", "soon"],
    ["train", "lego", "--name", "x", "--max-steps", "0"],
    ["train", "lego", "--name", "x", "--speed", "9"],
    ["render", "lego", "-o", "a.png"], ["render", "lego", "--view", "test:0"],
    ["render", "lego", "--view", "test:0", "--camera", "c.json", "-o", "a.png"],
    ["render", "lego", "--view", "test:0", "-o", "a.gif"],
    ["render", "lego", "--view", "test:0", "--size", "4by3", "-o", "a.png"],
    ["path", "lego", "p.json"], ["path", "lego", "p.json", "--frames", "9-3", "-o", "out"],
    ["import", "somewhere"], ["rm", "job_aaaaaaaaaaaa"], ["help", "fly"],
    ["info", "--host", "ftp://127.0.0.1"], ["info", "--token-file", "missing"],
])
def test_a_wrong_command_line_is_a_usage_error(client, arguments, daemon):
    client.run(*arguments, code=USAGE)
    assert not daemon.requests


@pytest.mark.parametrize("arguments, words", [
    (["bench", "--seconds", "soon"],
     "--seconds must be a time such as 90, 60s, 10m or 1.5h"),
    (["render", "a", "--view", "test:0", "-o", "a.png", "--size", "4by3"],
     "--size must be two whole numbers, such as 800x600, each from 1 to 16384; it is '4by3'"),
    (["path", "a", "b", "-o", "c", "--frames", "9-3"],
     "--frames must be A or A-B, whole numbers with A not over B, from 0 to 99999"),
    (["eval", "a", "--views", "-3"], "--views must be a whole number from 0 to 1000000; it is '-3'"),
])
def test_a_wrong_value_is_told_in_plain_words(client, arguments, words):
    said = client.run(*arguments, code=USAGE).stderr.replace(": must", " must")
    assert words in said and "e+0" not in said


@pytest.mark.parametrize("arguments, pointer, option", [
    (["train", "lego-400", "--name", "x"], "#/scene", "--name"),
    (["train", "lego-400", "--name", "x"], "#/options/max_time_s", "--max-time"),
    (["render", "lego", "--view", "tst:0", "-o", "a.png"], "#/view", "--view"),
    (["render", "lego", "--view", "test:0", "-o", "a.jpg"], "#/format", "--out"),
    (["render", "lego", "--view", "test:0", "-o", "a.png"], "#/size/width", "--size"),
    (["render", "lego", "--view", "test:0", "-o", "a.png"], "#/optics/focus", "--focus"),
    (["render", "lego", "--view", "test:0", "-o", "a.png"], "#/within_ms", "--within"),
    (["eval", "lego", "--split", "val"], "#/options/split", "--split"),
    (["path", "lego", "kept", "-o", "out"], "#/options/last", "--frames"),
    (["path", "lego", "kept", "-o", "out"], "#/options/height", "--size"),
    (["path", "lego", "kept", "-o", "a.mp4"], "#/options/film", "--out"),
    (["path", "lego", "kept", "-o", "out"], "#/new", "#/new")])
def test_problems_name_the_option_that_was_typed(client, daemon, scene, arguments, pointer, option):
    daemon.refusal = Problem(422, "invalid", f"{pointer}: is odd",
                             [{"pointer": pointer, "detail": "is odd"}])
    assert client.run(*arguments, code=INVALID).stderr == f"ripnerf: {option}: is odd\n"
    others = [{"pointer": pointer, "detail": "is odd"}, {"pointer": "#/type", "detail": "is new"}]
    daemon.refusal = Problem(422, "invalid", "two things are wrong", others)
    assert client.run(*arguments, code=INVALID).stderr == (
        f"ripnerf: Invalid: two things are wrong\n  {option}: is odd\n  #/type: is new\n")
    told = json.loads(client.run(*arguments, "--json", code=INVALID).stderr)
    assert told["error"]["errors"] == others


@pytest.mark.parametrize("verb", [["render", "lego", "--view", "test:0", "-o", "a.png"],
                                  ["eval", "lego"], ["path", "lego", "kept", "-o", "out"],
                                  ["turntable", "lego", "-o", "t.json"]])
def test_a_budget_goes_alone(client, daemon, verb):
    said = client.run(*verb, "--render-psnr", "30", "--within", "50ms", code=USAGE).stderr
    assert said == "ripnerf: --within and --render-psnr exclude each other\n"
    said = client.run(*verb, "--quality", "0.5", "--step", "0.01", code=USAGE).stderr
    assert said.startswith("ripnerf: --quality and --step exclude each other: ")
    assert not daemon.requests


@pytest.mark.parametrize("option, value, words", [
    ("--name", "bad name/x", "must be 1 to 64 letters"), ("--name", "ds_x", "like an id"),
    ("--name", "tok_x", "like an id"), ("--split", "evry:8", "every:N"), ("--bounds", "1,2,3", "four numbers"),
    ("--up", "w", "X,Y,Z"), ("--crop", "1,2", "low corner"), ("--masks", "../m", "within")])
def test_what_import_is_told_is_checked_before_anything_is_read(client, daemon, option, value, words):
    name = () if option == "--name" else ("--name", "x")
    said = client.run("import", "nowhere", *name, option, value, code=USAGE).stderr
    assert said.startswith(f"ripnerf: {option}: ") and said.endswith(f"; it is '{value}'\n")
    assert words in said and said.count("\n") == 1 and not daemon.requests


@pytest.mark.parametrize("value", ["60sec", "0", "soon"])
def test_a_time_says_how_times_are_written(client, daemon, value):
    said = client.run("train", "a", "--name", "x", "--max-time", value, code=USAGE).stderr
    assert said.startswith("ripnerf: --max-time: must be a time such as 90, 60s, 10m or 1.5h, ")
    assert said.endswith(f"; it is '{value}'\n") and not daemon.requests


@pytest.mark.parametrize("arguments, words", [
    (["trian", "lego"], "trian: there is no such verb; did you mean train?"),
    (["help", "sceens"], "sceens: there is no such verb; did you mean scenes?"),
    (["fly"], "fly: there is no such verb; see ripnerf help"),
    (["train", "lego", "--nmae", "x"], "--nmae: there is no such option; did you mean --name?"),
    (["train", "lego", "--max-tme=5"], "--max-tme=5: there is no such option; did you mean --max-time?"),
    (["train", "lego", "--name", "x", "--effect", "exposur=off"],
     "--effect: there is no 'exposur'; did you mean exposure?"),
    (["train", "lego", "--name", "x", "--effect", "exposure"],
     "--effect: must be auto, on or off; it is ''"),
    (["jobs", "--jsn"], "--jsn: there is no such option; did you mean --json?"),
    (["jobs", "--frames", "3"], "--frames: there is no such option"),
    (["synth"], "synth: needs NAME and DIR: ripnerf synth NAME DIR"),
    (["synth", "sphere"], "synth: needs DIR: ripnerf synth NAME DIR"),
    (["train"], "train: needs DATASET: ripnerf train DATASET --name SCENE"),
    (["train", "lego"], "train: needs a name: ripnerf train lego --name lego"),
    (["import", "photos/"], "import: needs a name: ripnerf import photos/ --name photos"),
    (["import", "../a b/my film.mov"], "import: needs a name: ripnerf import '../a b/my film.mov' --name NAME"),
    (["import", "/d/walk.mov", "--max-size", "800"], "import: needs a name: ripnerf import /d/walk.mov --name walk")])
def test_what_was_meant_is_said(client, arguments, words):
    assert client.run(*arguments, code=USAGE).stderr == f"ripnerf: {words}\n"


def test_plots_are_svg_and_replace_nothing_unasked(client, daemon, scene, tmp_path):
    for name in ("c.png", "c"):
        said = client.run("curve", "lego", "--plot", name, code=USAGE).stderr
        assert said == f"ripnerf: --plot: must end in .svg; it is '{name}'\n"
    (tmp_path / "c.svg").write_text("mine")
    said = client.run("curve", "lego", "--measure", "--plot", "c.svg", code=USAGE).stderr
    assert "c.svg: is there already; --overwrite" in said and not daemon.requests
    client.run("curve", "lego", "--plot", "c.svg", "--overwrite", code=NOT_FOUND)
    assert daemon.requests and (tmp_path / "c.svg").read_text() == "mine"


def test_a_file_of_a_dataset_is_not_its_folder(client, folder, tmp_path):
    for name, meant in (("blank/transforms_train.json", "blank"), ("blank/train/r_0.png", "blank"),
                        (folder / "val" / "r_1.png", folder)):
        assert client.run("validate", name, code=INVALID).stdout == (
            f"error    {name}: is a file; give the folder: {meant}\n")
    write_blank(tmp_path / "a.png", 4, 4)
    (tmp_path / "bare").mkdir()
    write_blank(tmp_path / "bare" / "b.png", 4, 4)
    for name, meant in (("a.png", "where you are: ."), ("bare/b.png", "bare")):
        assert client.run("validate", name, code=INVALID).stdout == (
            f"error    {name}: is a file; give the folder with all photographs, perhaps {meant}\n")


def test_differences_from_the_paper_are_listed_where_asked_for(client, scene):
    told = client.json("show", "lego")["differences"]
    brief, whole = (client.run("show", "lego", *more).stdout for more in ([], ["--paper"]))
    plural = "" if len(told) == 1 else "s"
    assert f"differs from the paper in {len(told)} point{plural}: ripnerf show lego --paper" in brief
    assert told[0]["what"] not in brief and all(one["what"] in whole for one in told)


def test_errors_are_json_where_that_is_asked_for(client, daemon):
    said = json.loads(client.run("show", "nothing", "--json", code=NOT_FOUND).stderr)
    assert said["error"]["where"] == "nothing" and said["error"]["exit_code"] == NOT_FOUND
    said = json.loads(client.run("render", "a", "--json", code=USAGE).stderr)
    assert "--view" in said["error"]["detail"] and said["error"]["exit_code"] == USAGE
    said = json.loads(client.run("train", "nothing", "--name", "x", "--json", code=NOT_FOUND).stderr)
    assert said["error"]["status"] == 404


def test_bounds_that_are_given_are_the_ones_that_are_checked(client, tmp_path):
    client.run("synth", "place", "p", "--size", "32", "--views", "8")
    said = client.run("validate", "p").stdout
    assert "covers only" in said and "radius 1.5, by its layout" in said
    told = json.loads(client.run("validate", "p", "--json").stdout)
    assert told["bounds"]["radius"] == 1.5 and told["bounds"]["source"] == "layout"
    assert told["capture"] == "outdoor" and told["up"][2] > 0.99
    bounds = re.search(r"--bounds X,Y,Z,R`: (\S+) reaches", said)[1]
    said = client.run("validate", "p", "--bounds", bounds).stdout
    assert "covers only" not in said and "0 warnings" in said and "radius 1.5" not in said


def test_the_overview_fits_a_terminal(client):
    text = client.run("help").stdout
    assert client.run("help", "help").stdout == text
    assert "  paths " in text and [line for line in text.splitlines() if len(line) > 80] == []


def test_manual_pages_say_all_that_help_says(build):
    for program, page in (("client/ripnerf", "client/ripnerf.1"), ("server/ripnerfd", "client/ripnerfd.8")):
        said = subprocess.run([build / program, "--help"], check=True, capture_output=True, text=True).stdout
        options = said[re.search(r"^  -", said, re.M).start():].split("\n\n")[0]
        written = (build / page).read_text().replace("\\-", "-")
        for word in re.findall(r"\S+", options):
            assert word in written


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completions_name_every_verb_and_option(client, shell, tmp_path):
    script = client.run("completion", shell).stdout
    for word in ("turntable", "video-quality", "instant-ngp", "token-file", "ls rm convert"):
        assert word in script
    assert shell != "zsh" or "'-o[" in script
    client.run("completion", "csh", code=USAGE)
    if shell != "bash":
        return
    (tmp_path / "c.bash").write_text(script)

    def complete(*words):
        line = " ".join(f"'{word}'" for word in words)
        run = subprocess.run(
            ["bash", "-c", f"source {tmp_path}/c.bash; COMP_WORDS=({line}); "
             f"COMP_CWORD={len(words) - 1}; _ripnerf; printf '%s\\n' \"${{COMPREPLY[@]}}\""],
            capture_output=True, text=True, check=True, timeout=PATIENCE_S)
        return run.stdout.split()
    assert complete("ripnerf", "turn") == ["turntable"]
    assert complete("ripnerf", "path", "--video") == ["--video-quality"]
    assert complete("ripnerf", "path", "--codec", "") == ["h264", "av1"]
    assert "--host" in complete("ripnerf", "info", "--")
    assert complete("ripnerf", "paths", "c") == ["convert"]
    assert complete("ripnerf", "token", "") == ["make", "ls", "revoke"]
    assert complete("ripnerf", "paths", "--fr") == ["--from"]


def test_version(client, daemon):
    assert re.fullmatch(r"ripnerf \d+\.\d+\.\d+\n", client.run("--version").stdout)
    assert not daemon.requests


def test_global_options_stand_before_or_behind_the_verb(client, daemon):
    before = client.run("--host", daemon.url, "--json", "info", RIPNERF_HOST="http://127.0.0.1:1")
    behind = client.run("info", "--json", f"--host={daemon.url}", RIPNERF_HOST="http://127.0.0.1:1")
    assert json.loads(before.stdout) == json.loads(behind.stdout) == contract.example("Info")


# ---- reaching the daemon ----

def test_no_daemon(client):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        for verb in (["info"], ["jobs"], ["train", "a", "--name", "b"], ["watch", "a"],
                     ["render", "a", "--view", "test:0", "-o", "a.png"]):
            result = client.run(*verb, "--host", f"127.0.0.1:{port}", code=UNREACHABLE)
            assert "cannot be reached" in result.stderr and not result.stdout


def test_token(build, tmp_path):
    with FakeDaemon(token="secret") as daemon:
        client = Client(build / "client" / "ripnerf", tmp_path, daemon.url)
        (tmp_path / "token").write_text("secret\n")
        client.run("info", code=UNAUTHORISED)
        client.run("info", code=UNAUTHORISED, RIPNERF_TOKEN="wrong")
        client.run("info", RIPNERF_TOKEN="secret")
        client.run("info", "--token-file", "token", RIPNERF_TOKEN="wrong")


# ---- validate, import ----

def test_validate_needs_no_daemon_and_reports(client, folder, daemon):
    report = client.json("validate", folder)
    contract.check("DatasetReport", report)
    assert report["usable"] == {"train": 3, "val": 3, "test": 3} and report["errors"] == 0
    assert report["expected"] == {"seconds": 60, "memory_bytes": report["choices"][0]["memory_bytes"]}
    told = client.run("validate", folder).stdout
    assert "trained at" in told and "--scales 4" in told and "usable" in told
    assert "standard: 60.0 s and" in told and "of memory by formula; draft 15 s" in told and not daemon.requests


def test_validate_names_file_and_field(client, folder):
    (folder / "train" / "r_1.png").unlink()
    report = client.json("validate", folder, code=INVALID)
    contract.check("DatasetReport", report)
    assert report["unusable"]["train"] == 1
    assert any("r_1" in problem["where"] + problem["text"] for problem in report["problems"])
    assert "r_1" in client.run("validate", folder, code=INVALID).stdout


def test_names_in_a_dataset_cannot_command_the_terminal(client, folder):
    document = json.loads((folder / "transforms_train.json").read_text())
    document["frames"][0]["file_path"] = "r_\033[31m"
    (folder / "transforms_train.json").write_text(json.dumps(document))
    text = client.run("validate", folder, code=INVALID).stdout
    assert "r_" in text and "\033" not in text


def test_validate_of_nothing(client, tmp_path):
    assert client.json("validate", tmp_path, code=INVALID)["errors"] == 1


@pytest.mark.parametrize("verb", [["validate", "MISSING"], ["validate", "MISSING.ripscene"],
                                  ["import", "MISSING", "--name", "x"],
                                  ["import", "MISSING.ripscene", "--name", "x"],
                                  ["validate", "blank/transforms_train.json/MISSING"],
                                  ["restore", "MISSING"], ["restore", "MISSING", "new"],
                                  ["doctor", "lego", "--replay", "MISSING"]])
def test_a_local_file_that_is_missing_is_not_found(client, folder, daemon, tmp_path, verb):
    said = client.run(*verb, code=NOT_FOUND)
    assert "MISSING" in said.stderr and not said.stdout and "nothing was sent" not in said.stderr
    assert json.loads(client.run(*verb, "--json", code=NOT_FOUND).stderr)["error"]["exit_code"] == NOT_FOUND
    assert not daemon.uploads and not daemon.jobs and not (tmp_path / "new").exists()


def test_a_split_that_is_not_needed_is_told(client, folder, daemon):
    said = "info     split: the files name 3 test views; --split every:2 was not needed\n"
    assert said in client.run("validate", folder, "--split", "every:2").stdout
    assert said in client.run("import", folder, "--name", "x", "--split", "every:2").stderr
    assert "--split" not in client.run("import", folder, "--name", "y").stderr


def test_an_import_tells_what_it_found(client, folder):
    lines = client.run("import", folder, "--name", "x").stdout.splitlines()
    assert lines[1] == ("an object, turned around, bounds: centre (0, 0, 0), radius 1.5, by its layout")
    assert "error    test/r_17.png: the PNG is cut off after 1024 bytes; copy the file again" in lines


def test_import_sends_exactly_the_files_that_the_json_names(client, folder, daemon):
    dataset = client.json("import", folder, "--name", "blank", "--max-size", 8, "--scales", 2,
                          "--alpha", "straight", "--split", "every:8", "--bounds", "0,0,1,2.5")
    assert dataset["name"] == "blank"
    sent = daemon.uploads["blank"]
    splits = ("train", "val", "test")
    assert set(sent) == {f"transforms_{split}.json" for split in splits} | {
        f"{split}/r_{i}.png" for split in splits for i in range(3)}
    for name, data in sent.items():
        assert data == (folder / name).read_bytes()
    options = next(iter(daemon.jobs.values())).record["options"]
    assert options == {"max_size": 8, "scales": 2, "alpha": "straight", "split": "every:8",
                       "bounds": "0,0,1,2.5"}


def test_import_with_a_slash_and_long_names(client, tmp_path, daemon):
    deep = tmp_path / "deep"
    write_blank_dataset(deep, views=1)
    inner = "a" * 90 + "/" + "b" * 90
    (deep / inner).mkdir(parents=True)
    (deep / "train" / "r_0.png").rename(deep / inner / "r_0.png")
    document = json.loads((deep / "transforms_train.json").read_text())
    document["frames"][0]["file_path"] = inner + "/r_0"
    (deep / "transforms_train.json").write_text(json.dumps(document))
    client.run("import", f"{deep}/", "--name", "deep")
    assert inner + "/r_0.png" in daemon.uploads["deep"]


def test_import_refuses_a_dataset_with_errors_before_sending(client, folder, daemon):
    (folder / "test" / "r_2.png").write_bytes(b"no picture")
    result = client.run("import", folder, "--name", "blank", code=INVALID)
    assert "r_2" in result.stderr and "nothing was sent" in result.stderr
    assert not result.stdout
    assert not daemon.uploads and not daemon.jobs


def test_import_goes_without_bad_photographs(client, folder, daemon):
    (folder / "train" / "r_2.png").unlink()
    client.run("import", folder, "--name", "whole", code=INVALID)
    result = client.run("import", folder, "--name", "rest", "--skip-bad", "--masks", "m/a",
                        "--format", "blender", code=INVALID)
    assert "no mask" in result.stderr and "nothing was sent" in result.stderr
    client.run("import", folder, "--name", "rest", "--skip-bad", "--format", "blender")
    assert "train/r_2.png" not in daemon.uploads["rest"] and len(daemon.uploads) == 1
    assert next(iter(daemon.jobs.values())).record["options"] == {"format": "blender"}
    client.run("import", folder, "--name", "other", "--format", "bledner", code=USAGE)
    assert client.json("validate", folder, "--format", "blender", code=INVALID)["errors"] == 1


def test_import_under_a_taken_or_a_bad_name(client, folder, daemon):
    daemon.add_dataset("blank")
    assert "already" in client.run("import", folder, "--name", "blank", code=FAILED).stderr
    assert "already" in client.run("import", "nowhere", "--name", "blank", code=FAILED).stderr  # unread
    result = client.run("import", folder, "--name", "a b/ü", code=USAGE)
    assert "--name: " in result.stderr


def test_import_whose_job_fails(client, folder):
    result = client.run("import", folder, "--name", "fail", code=FAILED)
    assert "the loss is not finite" in result.stderr


# ---- lists, show, rm ----

def test_lists_follow_every_page(client, daemon):
    assert client.json("scenes") == {"items": [], "next_cursor": None}
    dataset = daemon.add_dataset("one")
    names = [f"scene-{i}" for i in range(5)]
    for name in names:
        daemon.add_scene(name, dataset)
    for name in names:
        client.run("eval", name)
    for verb, schema, count in (("datasets", "DatasetList", 1), ("scenes", "SceneList", 5),
                                ("jobs", "JobList", 5)):
        listed = client.json(verb)
        contract.check(schema, listed)
        assert len(listed["items"]) == count
        lines = client.run(verb).stdout.splitlines()
        assert len(lines) == count + 1
        assert all(item["id"] in line for item, line in zip(listed["items"], lines[1:]))


def test_show_by_name_and_by_id(client, scene, daemon):
    dataset = next(iter(daemon.datasets.values()))
    for reference, record in ((scene["id"], scene), ("lego", scene), ("lego-400", dataset),
                              (dataset["id"], dataset)):
        assert client.json("show", reference) == record
        assert record["name"] in client.run("show", reference).stdout
    text = client.run("show", "lego").stdout
    assert scene["parameters_sha256"] in text and "background" in text


def test_show_job(client, scene):
    job = client.json("train", "lego-400", "--name", "slow")["id"]
    assert client.json("show", job)["state"] in ("queued", "running")
    client.run("cancel", job)


def test_how_a_job_went_is_told(client, scene, daemon):
    """In `jobs` and in `show`: the figures of one that succeeded, the reason of one that failed."""
    result = contract.example("TrainResult")
    figures = f"{result['steps']} steps"
    client.run("train", "lego-400", "--name", "good", "--wait")
    client.run("train", "lego-400", "--name", "fail", "--wait", code=FAILED)
    client.run("eval", "good")
    ids = {line.split()[1] + line.split()[3]: line.split()[0]
           for line in client.run("jobs").stdout.splitlines()[1:]}
    lines = client.run("jobs").stdout
    for job, words in (("traingood", figures), ("trainfail", "the loss is not finite"),
                       ("evalgood", f"SSIM {contract.example('EvalResult')['ssim']:.4f}")):
        assert words in next(line for line in lines.splitlines() if ids[job] in line)
        assert words in client.run("show", ids[job]).stdout
    next(s for s in daemon.scenes.values() if s["name"] == "fail")["state"] = "failed"
    assert f"ripnerf show {ids['trainfail']}" in client.run("show", "fail").stdout


def test_an_effect_is_told_in_its_own_unit(client, scene):
    text = client.run("show", "lego").stdout
    for effect in contract.example("Scene")["effects"]:
        line = next(line for line in text.splitlines() if f" {effect['name']} " in line)
        assert effect["reason"] in line
        if "below" in effect:
            side = "at most" if effect["below"] else "over"
            assert f"(on if {side} {effect['threshold_text']})" in line
        else:
            assert "(on" not in line and "(threshold" not in line


def test_what_is_not_there(client, daemon):
    for verb in (["show", "nothing"], ["show", "sc_aaaaaaaaaaaa"], ["show", "job_aaaaaaaaaaaa"],
                 ["rm", "nothing"], ["watch", "nothing"], ["cancel", "job_aaaaaaaaaaaa"],
                 ["train", "nothing", "--name", "x"], ["eval", "nothing"],
                 ["render", "nothing", "--view", "test:0", "-o", "a.png"],
                 ["show", "../../etc"], ["show", "a b%"], ["show", "n" * 5000]):
        assert "there is no" in client.run(*verb, code=NOT_FOUND).stderr


def test_an_ambiguous_name(client, daemon):
    dataset = daemon.add_dataset("twin")
    scene = daemon.add_scene("twin", dataset)
    result = client.run("show", "twin", code=USAGE)
    assert scene["id"] in result.stderr and dataset["id"] in result.stderr
    client.run("rm", "twin", code=USAGE)
    assert client.json("show", scene["id"])["id"] == scene["id"]


def test_rm(client, scene, daemon):
    assert "uses the dataset" in client.run("rm", "lego-400", code=FAILED).stderr
    client.run("rm", scene["id"])
    client.run("rm", "lego-400")
    assert not daemon.scenes and not daemon.datasets


# ---- train and its job ----

def submitted(daemon):
    return next(json.loads(body) for command, path, _, body in daemon.requests
                if (command, path) == ("POST", "/v1/jobs"))


def test_train_sends_what_was_asked_for_and_nothing_else(client, daemon):
    daemon.add_dataset("lego")
    client.run("train", "lego", "--name", "plain")
    assert submitted(daemon) == {"type": "train", "dataset": "lego", "scene": "plain"}
    daemon.requests.clear()
    client.run("train", "lego", "--name", "full", "--preset", "draft", "--train-split", "trainval",
               "--planes", 10, "--footprint", "mip", "--max-time", "1.5m", "--max-steps", 1000,
               "--until-psnr", 33.5, "--until-plateau", "--seed", 7, "--threads", 2,
               "--device", "cpu", "--effect", "exposure=off", "--effect=split-pixels=on")
    assert submitted(daemon)["options"] == {
        "preset": "draft", "train_split": "trainval", "planes": 10, "footprint": "mip",
        "max_time_s": 90, "max_steps": 1000, "until_psnr": 33.5, "until_plateau": True, "seed": 7,
        "threads": 2, "device": "cpu", "effect_exposure": "off", "effect_split_pixels": "on"}


def test_train_wait_ends_with_one_object(client, daemon):
    daemon.add_dataset("lego")
    result = client.run("train", "lego", "--name", "a", "--wait", "--json")
    end = json.loads(result.stdout.splitlines()[-1])
    expected = contract.example("TrainResult")
    job = next(iter(daemon.jobs.values())).record
    assert end["job"] == job["id"] and end["scene"] == job["scene"]
    assert end["scene_name"] == "a" and end["state"] == "succeeded"
    for key in ("steps", "train_seconds", "samples", "psnr", "parameters_sha256"):
        assert end[key] == expected[key]


def test_train_wait_shows_progress_and_the_end(client, daemon):
    daemon.add_dataset("lego")
    result = client.run("train", "lego", "--name", "a", "--wait")
    assert "28.40 dB" in result.stderr and "\033" not in result.stderr
    assert result.stdout.startswith("scene a (sc_")


def read_terminal(ours):
    """Pieces of what was written, until nobody has it open any more."""
    try:
        while piece := os.read(ours, 65536):
            yield piece.decode()
    except OSError:
        os.close(ours)


def test_a_terminal_gets_one_line_that_is_rewritten(client, daemon):
    daemon.add_dataset("lego")
    ours, theirs = pty.openpty()
    with subprocess.Popen(client.command("train", "lego", "--name", "slow", "--wait"),
                          cwd=client.cwd, env=client.environment, stdin=subprocess.DEVNULL,
                          stdout=subprocess.DEVNULL, stderr=theirs) as waiting:
        os.close(theirs)
        text = ""
        for piece in read_terminal(ours):
            text += piece
            if "ETA" in text:
                next(iter(daemon.jobs.values())).wanted = "finish"
        assert waiting.wait(PATIENCE_S) == OK
    assert "\r\033[K[" in text and "samples/s" in text
    assert text.count("\n") == 1 and text.endswith("\n")


def test_a_failing_job(client, daemon):
    daemon.add_dataset("lego")
    result = client.run("train", "lego", "--name", "fail", "--wait", "--json", code=FAILED)
    end = json.loads(result.stdout)
    assert end["state"] == "failed" and end["steps"] == 300
    assert end["problem"]["detail"] == "the loss is not finite"
    assert "the loss is not finite" in result.stderr


def test_a_lost_connection_is_taken_up_where_it_broke(client, daemon):
    daemon.add_dataset("lego")
    client.run("train", "lego", "--name", "drop", "--wait")
    streams = [headers.get("Last-Event-ID") for _, path, headers, _ in daemon.requests
               if path.endswith("/events")]
    assert streams == [None, "4"]


def test_conflict_and_bad_value(client, scene):
    assert "already" in client.run("train", "lego-400", "--name", "lego", code=FAILED).stderr
    result = client.run("train", "lego-400", "--name", "x", "--device", "gpu", code=INVALID)
    assert result.stderr.count("--device: ") == 1


def is_followed(daemon, times=1):
    return sum(path.endswith("/events") for _, path, _, _ in daemon.requests) >= times


def test_cancel_while_someone_waits(client, daemon):
    daemon.add_dataset("lego")
    waiting = client.start("train", "lego", "--name", "slow", "--wait", "--json")
    wait_for(lambda: is_followed(daemon))
    job = next(iter(daemon.jobs))
    client.run("cancel", "slow")  # by the scene's name
    out, err = waiting.communicate(timeout=PATIENCE_S)
    assert waiting.returncode == CANCELLED, err
    assert json.loads(out)["state"] == "cancelled"
    client.run("cancel", job)  # again: no error


def test_ctrl_c_detaches_and_says_so(client, daemon):
    daemon.add_dataset("lego")
    waiting = client.start("train", "lego", "--name", "slow", "--wait")
    wait_for(lambda: is_followed(daemon))
    job = next(iter(daemon.jobs))
    waiting.send_signal(signal.SIGINT)
    _, err = waiting.communicate(timeout=PATIENCE_S)
    assert "detached" in err and f"ripnerf watch {job}" in err
    assert waiting.returncode == FAILED
    assert daemon.jobs[job].record["state"] == "running"
    watching = client.start("watch", job)
    wait_for(lambda: is_followed(daemon, 2))
    watching.send_signal(signal.SIGINT)
    watching.communicate(timeout=PATIENCE_S)
    assert watching.returncode == OK
    client.run("finish", job)


def test_pause_resume_finish(client, daemon):
    daemon.add_dataset("lego")
    job = client.json("train", "lego", "--name", "slow")["id"]
    assert client.json("pause", "slow")["state"] == "paused"
    assert client.json("resume", job)["state"] == "running"
    client.run("finish", job)
    assert "scene slow" in client.run("watch", job).stdout
    assert "succeeded" in client.run("pause", job, code=FAILED).stderr


def test_watch_json_is_a_line_an_event(client, daemon):
    daemon.add_dataset("lego")
    job = client.json("train", "lego", "--name", "a")["id"]
    events = [json.loads(line) for line in client.run("watch", job, "--json").stdout.splitlines()]
    assert [event["event"] for event in events] == [
        "state", "state", "progress", "metric", "progress", "progress", "state"]
    assert events[-1]["data"]["state"] == "succeeded"


# ---- render, path, eval ----

def test_render_writes_the_picture(client, scene, tmp_path, daemon):
    result = client.json("render", "lego", "--view", "test:12", "--size", "80x60", "--output",
                         "depth", "--tolerance", 0.05, "-o", "a.png")
    assert (tmp_path / "a.png").read_bytes() == PNG
    assert result == {"file": "a.png", "step": 2016, "render_ms": 12.5}
    assert json.loads(daemon.requests[-1][3]) == {
        "view": "test:12", "size": {"width": 80, "height": 60}, "output": "depth",
        "format": "png", "tolerance": 0.05}
    client.run("render", "lego", "--view", "test:r_12", "-o", "a.JPG")
    assert json.loads(daemon.requests[-1][3])["format"] == "jpeg"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.JPG", "a.png"]


def test_render_with_a_camera_file(client, scene, tmp_path, daemon):
    (tmp_path / "camera.json").write_text(json.dumps(contract.example("CameraFile")))
    client.run("render", "lego", "--camera", "camera.json", "-o", "a.png")
    assert json.loads(daemon.requests[-1][3])["camera"] == contract.example("CameraFile")["camera"]
    (tmp_path / "camera.json").write_text('{"camera": {"width": 5}}')
    client.run("render", "lego", "--camera", "camera.json", "-o", "b.png", code=INVALID)
    client.run("render", "lego", "--camera", "missing.json", "-o", "b.png", code=NOT_FOUND)
    assert not (tmp_path / "b.png").exists()


def test_render_that_fails_leaves_no_file(client, scene, tmp_path):
    client.run("render", "lego", "--view", "test:999", "-o", "a.png", code=NOT_FOUND)
    assert not list(tmp_path.iterdir())
    client.run("render", "lego", "--view", "test:0", "-o", "missing/a.png", code=FAILED)


@pytest.mark.parametrize("frames, expected", [([], range(6)), (["--frames", "2-4"], range(2, 5))])
def test_path_brings_the_frames_as_they_come(client, scene, tmp_path, daemon, frames, expected):
    (tmp_path / "path.json").write_text(json.dumps(contract.example("PathFile")))
    result = client.json("path", "lego", "path.json", "--size", "32x24", "--tolerance", 0.05,
                         *frames, "-o", "out/run")
    files = sorted((tmp_path / "out" / "run").iterdir())
    assert [file.name for file in files] == [f"{i:05d}.png" for i in expected]
    assert [file.read_bytes() for file in files] == [PNG + bytes([i]) for i in expected]
    assert result["frames"] == len(files) and result["folder"] == "out/run"
    assert submitted(daemon)["camera_path"] == contract.example("PathFile")["path"]
    assert submitted(daemon)["options"]["width"] == 32
    assert submitted(daemon)["options"]["tolerance"] == 0.05


def test_path_over_a_lost_connection(client, daemon, tmp_path):
    daemon.add_scene("drop", daemon.add_dataset("lego"))
    (tmp_path / "path.json").write_text(json.dumps(contract.example("PathFile")))
    client.run("path", "drop", "path.json", "-o", "out")
    assert len(list((tmp_path / "out").iterdir())) == 6
    fetched = [path for _, path, _, _ in daemon.requests if "/frames/" in path]
    assert len(fetched) == len(set(fetched)) == 6


def test_path_file_that_is_wrong(client, scene, tmp_path):
    (tmp_path / "path.json").write_text('{"path": {"axes": "opencv"}}')
    assert "path.json" in client.run("path", "lego", "path.json", "-o", "out", code=INVALID).stderr


def test_eval(client, scene, daemon):
    result = client.json("eval", "lego", "--split", "val", "--views", 4, "--scale", 1,
                         "--supersample", 2, "--tolerance", 0.03)
    assert result == contract.example("EvalResult")
    assert submitted(daemon)["options"] == {
        "split": "val", "views": 4, "scale": 1, "supersample": 2, "tolerance": 0.03}
    assert "mean" in client.run("eval", "lego").stdout
