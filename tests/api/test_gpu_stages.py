"""What tests/bench/gpu.py keeps between its calls, with shell scripts for programs: no device, no time."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"
# Each call of `quality` counts itself; it needs N calls for N of the file `needs`, and reaches its goals after as
# many seconds as it was called. `import` writes down which photographs it was given.
QUALITY = """#!/bin/sh
[ $# -gt 0 ] || exit 2
here=$(dirname "$0")
calls=$(($(cat "$here/calls") + 1))
echo $calls >"$here/calls"
for option; do
    case $option in
    save=*) checkpoint=${option#save=} ;;
    resume=*) echo "resumed" ;;
    goals=*) echo "goal ${option#goals=} dB reached after $calls s" ;;
    esac
done
echo begun >"$checkpoint"
[ $calls -ge $(cat "$here/needs") ] || exit 75
echo "trained with sm_90"
echo "step    25000     70.6 s  psnr 36.0"
echo "test mean over scales: 36.06"
"""
IMPORT = """#!/usr/bin/env python3
import json, sys
from pathlib import Path
source, target = Path(sys.argv[1]), Path(sys.argv[2])
target.mkdir()
frames = [{"split": split, "file": frame["file_path"]} for split in ("train", "val", "test")
          for frame in json.loads((source / f"transforms_{split}.json").read_text())["frames"]
          if (source / frame["file_path"]).is_file()]
(target / "dataset.json").write_text(json.dumps({"frames": frames}))
"""
OTHERS = ("kernels", "device", "step", "standard", "step, deterministic", "step, sparse", "step, last layer on chip", "step, two tiles a warp", "step of standard", "memcheck",
          "racecheck", "profile", "two scenes", "120,000 steps")


def photographs(folder, **views):
    """A scene with some views of each split, by their numbers."""
    for split, numbers in views.items():
        (folder / split).mkdir(parents=True)
        frames = [{"file_path": f"./{split}/r_{number}.webp"} for number in numbers]
        for frame in frames:
            (folder / frame["file_path"]).write_text("a picture")
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    return folder


@pytest.fixture
def stages(tmp_path):
    """stages(OPTION...): a call of gpu.py that has the data and the 25,000 steps to do; (exit code, results)."""
    kit = tmp_path / "kit"
    (kit / "bin").mkdir(parents=True)
    for script in ("gpu.py", "gpu_scenes.py"):
        shutil.copy2(BENCH / script, kit)
    for name, text in (("quality", QUALITY), ("import", IMPORT), ("calls", "0"), ("needs", "1")):
        (kit / "bin" / name).write_text(text)
        (kit / "bin" / name).chmod(0o755)
    photos = photographs(tmp_path / "photos", train=[0, 1], val=[0], test=[0])
    (tmp_path / "known.json").write_text(json.dumps({name: {"state": "absent", "why": ""} for name in OTHERS}))

    def call(*options):
        ended = subprocess.run([sys.executable, kit / "gpu.py", photos, tmp_path / "out", "--known",
                                tmp_path / "known.json", *options], text=True, capture_output=True, check=False)
        assert ended.returncode in (0, 75), ended.stderr
        return ended.returncode, json.loads((tmp_path / "out" / "results.json").read_text())
    call.needs = kit / "bin" / "needs"
    call.log = tmp_path / "out" / "work" / "25,000-steps.log"
    return call


def test_a_stage_anew_forgets_what_it_said(stages):
    """Its seconds are those of the new training, not of the one before, and no checkpoint of that is gone on from."""
    code, known = stages()
    assert code == 0 and known["25,000 steps"]["found"]["seconds_to"] == {"36.94": 1}, known
    stages.needs.write_text("3")
    code, known = stages("--again", "25,000 steps")
    assert code == 75 and known["25,000 steps"]["state"] == "unfinished"
    code, known = stages("--again", "25,000 steps")
    assert code == 0 and known["25,000 steps"]["found"]["seconds_to"] == {"36.94": 3}, known
    assert "resumed" not in stages.log.read_text()


def test_what_is_unfinished_goes_on(stages):
    stages.needs.write_text("2")
    assert stages()[0] == 75
    code, known = stages()
    assert code == 0 and known["25,000 steps"]["found"]["seconds_to"] == {"36.94": 1}, known
    assert "resumed" in stages.log.read_text()


def test_photographs_by_a_second_call(stages, tmp_path):
    """They join those of the first: what is trained from then on has both, once they are there without being told again."""
    more = photographs(tmp_path / "more", train=[], val=[1, 2], test=[3, 1, 2])
    stages.needs.write_text("2")
    code, known = stages()
    assert code == 75 and known["data"]["found"]["views"] == {"train": 2, "val": 1, "test": 1}
    code, known = stages("--more", more)
    assert code == 0 and known["data"]["found"]["views"] == {"train": 2, "val": 3, "test": 4}, known
    assert known["25,000 steps"]["state"] == "done" and "resumed" not in stages.log.read_text()
    taken = tmp_path / "out" / "work" / "paper" / "ready"
    begun = taken.stat().st_mtime_ns
    for options in ((), ("--more", more)):
        code, known = stages(*options)
        assert code == 0 and known["data"]["found"]["views"] == {"train": 2, "val": 3, "test": 4}
        assert taken.stat().st_mtime_ns == begun
    code, known = stages("--more", more, "--again", "data")
    assert code == 0 and taken.stat().st_mtime_ns > begun


def test_a_stage_that_there_is_not(stages):
    with pytest.raises(AssertionError, match="invalid choice"):
        stages("--again", "25000 steps")
