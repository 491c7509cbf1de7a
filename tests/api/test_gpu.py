"""tests/bench/gpu.sh from its packing to its table, on the emulated device; and that `quality` never
measures the CPU in a device's name."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.client import Client

BENCH = Path(__file__).resolve().parents[1] / "bench"
SMALL = ["preset=paper", "planes=3", "channels=4", "base=16", "levels=2", "width=16", "occupancy=16",
         "samples=1024", "rays=64", "step=0.1", "deterministic=1"]
# What stands for a driver's and CUDA's tools: the sanitizer runs what it is given, the profiler prints a counter.
TOOLS = {"nvidia-smi": "echo 'A GPU, 580.1, 9 MiB, 345 MHz, 1980 MHz, 3201 MHz, 3201 MHz, 700.00 W'",
         "compute-sanitizer": 'shift 4; exec "$@"',
         "ncu": 'echo \'"Kernel Name","Metric Value"\'; echo \'"rn_forward_kernel","1"\''}


@pytest.fixture(scope="module")
def module(build):
    found = build / "tests" / "ops" / "ripnerf-cuda-emulated.so"
    if not found.is_file():
        pytest.skip("the emulator was not built: it needs a C++ compiler")
    return found


@pytest.fixture(scope="module")
def scene(build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gpu")
    client = Client(build / "client" / "ripnerf", folder, "http://127.0.0.1:1")
    client.run("synth", "sphere", "source", "--size", 16, "--views", 8)
    return folder / "source"


@pytest.fixture(scope="module")
def kit(build, module, scene):
    target = scene.parent / "kit"
    subprocess.run([sys.executable, BENCH / "gpu_pack.py", build, scene, target, "--module", module,
                    "--test", "2", "--val", "2", "--most", "14"], check=True)
    return target


def quality(build, module, scene, *options):
    return subprocess.run([build / "tests" / "bench" / "quality", scene, *SMALL, *options], text=True,
                          capture_output=True, check=False, timeout=300,
                          env=os.environ | {"RIPNERF_CUDA_MODULE": str(module)})


def test_the_whole_command(kit, tmp_path):
    """Two calls: what the first had no time for, the second does; nothing is done twice, nor by a third on
    another machine."""
    for name, script in TOOLS.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
        (tmp_path / name).chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    environment.pop("RIPNERF_CUDA_MODULE")  # the kit's own
    command = [kit / "gpu.sh", kit / "photos", tmp_path / "out", "--work", tmp_path / "work", "--trial"]
    first = subprocess.run([*command, "--seconds", "20"], text=True, capture_output=True, check=False,
                           env=environment)
    assert first.returncode == 75, first.stdout + first.stderr
    begun = json.loads((tmp_path / "out" / "results.json").read_text())
    assert begun["machine"]["state"] == "done" and "120,000 steps" not in begun, begun
    shutil.rmtree(tmp_path / "out")
    second = subprocess.run([*command, "--seconds", "3000"], text=True, capture_output=True, check=False,
                            env=environment)
    known = json.loads((tmp_path / "out" / "results.json").read_text())
    assert second.returncode == 0, second.stdout + (tmp_path / "out" / "log.txt").read_text()[-4000:]
    assert len(known) == 17 and {stage["state"] for stage in known.values()} == {"done"}, known
    assert known["machine"] == begun["machine"]
    assert known["machine"]["found"]["gpu"]["clocks.max.sm"] == "1980 MHz"
    assert known["data"]["found"]["views"] == {"train": 8, "val": 2, "test": 2}
    assert known["step"]["found"]["ms"] > 0 and "forward" in known["step"]["found"]["stages"]
    assert known["120,000 steps"]["found"]["steps"] == 12
    assert known["120,000 steps"]["found"]["kernels"].startswith("sm_")
    assert known["two scenes"]["found"]["made_room"] >= 3
    table = (tmp_path / "out" / "table.md").read_text()
    assert re.search(r"\| step \| [\d.]+ ms \|.*\| 1.5 \|", table), table
    assert re.search(r"\| step: rays \| [\d.]+ ms \|  \|  \|", table), table
    assert (tmp_path / "out" / "profile.csv").read_text().startswith('"Kernel Name"')
    shutil.rmtree(tmp_path / "work")
    third = subprocess.run([*command, "--known", tmp_path / "out" / "results.json"], text=True, capture_output=True,
                           check=False, env=environment)
    elsewhere = json.loads((tmp_path / "out" / "results.json").read_text())
    assert third.returncode == 0, third.stdout + third.stderr
    assert len(elsewhere) == 17 and elsewhere["step"] == known["step"], elsewhere
    assert [line.split(":")[0] for line in third.stdout.splitlines() if not line.startswith("|")] == ["machine", "data", ""]


def test_a_device_that_is_not_there_is_an_error(build, module, scene):
    gone = quality(build, "/nowhere/ripnerf-cuda.so", scene, "device=cuda", "steps=2")
    assert gone.returncode == 1 and "not installed" in gone.stderr, gone
    wide = quality(build, module, scene, "device=cuda", "steps=2", "width=144")
    assert wide.returncode == 1 and "widths up to 128" in wide.stderr, wide
    narrow = quality(build, module, scene, "device=cuda", "steps=2", "memory=1e5")
    assert narrow.returncode == 1 and "of which 0 MiB may be used" in narrow.stderr, narrow


def test_a_training_goes_on(build, module, scene, tmp_path):
    """wall= ends it after its first block; what goes on from there is what was never interrupted."""
    whole = quality(build, module, scene, "device=cuda", "steps=20", "test=2", "goals=1,99")
    assert whole.returncode == 0 and "trained with sm_80" in whole.stdout, whole
    assert "goal 1.00 dB reached" in whole.stdout and "goal 99.00" not in whole.stdout
    saved = f"save={tmp_path}/c"
    begun = quality(build, module, scene, "device=cuda", "steps=20", "wall=0.01", saved)
    assert begun.returncode == 75 and "unfinished after 16 steps" in begun.stdout, begun
    ended = quality(build, module, scene, "device=cuda", f"resume={tmp_path}/c", saved)
    digest = re.compile(r"parameters \w+")
    assert digest.search(ended.stdout).group(0) == digest.search(whole.stdout).group(0)


# What stands for the programs: a training that the first call has no time for, and says so as `quality` does.
STAND_INS = {"import": """
import json, pathlib, sys
target = pathlib.Path(sys.argv[2])
target.mkdir()
(target / "dataset.json").write_text(json.dumps({"frames": [{"split": "train"}]}))
""", "quality": """
import pathlib, sys
given = dict(word.split("=", 1) for word in sys.argv[2:])
if not given:
    sys.exit(2)
print("asked", *sorted(name + "=" + given[name] for name in given if name not in ("save", "resume", "wall")))
if "resume" not in given:
    pathlib.Path(given["save"]).write_text("half")
    print("goal 36.94 dB reached after 90.0 s")
    sys.exit(75)
assert pathlib.Path(given["resume"]).read_text() == "half" and given["save"] == given["resume"]
print("goal 38.36 dB reached after 170.0 s\\nstep 120000 200.0 s psnr 30\\ntrained with sm_90")
print("test mean over scales: 38.40")
"""}


def test_a_stage_goes_on_in_the_next_call(tmp_path):
    """The longest training takes several calls: each goes on from the checkpoint of the one before, and seeks
    the goals alone that are left."""
    for name in ("gpu.py", "gpu_scenes.py"):
        shutil.copy(BENCH / name, tmp_path / name)
    (tmp_path / "bin").mkdir()
    for name, script in STAND_INS.items():
        (tmp_path / "bin" / name).write_text(f"#!{sys.executable}{script}")
        (tmp_path / "bin" / name).chmod(0o755)
    stages = re.findall(r'Stage\("([^"]+)"', (BENCH / "gpu.py").read_text())
    (tmp_path / "known.json").write_text(json.dumps(
        {name: {"state": "absent"} for name in stages if name != "120,000 steps"}))
    ended = [subprocess.run([sys.executable, tmp_path / "gpu.py", tmp_path, tmp_path / "out", "--known",
                             tmp_path / "known.json"], text=True, capture_output=True, check=False) for _ in range(3)]
    assert [call.returncode for call in ended] == [75, 0, 0], ended
    known = json.loads((tmp_path / "out" / "results.json").read_text())["120,000 steps"]
    assert known["state"] == "done", known
    assert known["found"]["seconds_to"] == {"36.94": 90, "38.36": 170}
    asked = re.findall(r"^asked (.*)", (tmp_path / "out" / "log.txt").read_text(), re.MULTILINE)
    assert len(asked) == 2 and "steps=120000" in asked[0] and "train_val=trainval" in asked[0], asked
    assert "goals=36.94,38.36" in asked[0] and "goals=38.36" in asked[1] and "steps=" not in asked[1], asked
    assert not list((tmp_path / "out" / "work").glob("*.safetensors"))


def test_what_a_second_call_carries(kit, build, scene, tmp_path):
    """The views that the first kit has not, without programs: both together are the scene's."""
    subprocess.run([sys.executable, BENCH / "gpu_pack.py", build, scene, tmp_path / "more", "--beside", kit,
                    "--test", "99", "--val", "99"], check=True)
    assert [path.name for path in (tmp_path / "more").iterdir()] == ["photos"]
    for split in ("train", "val", "test"):
        stems = [[Path(frame["file_path"]).stem for frame in json.loads(
            (folder / f"transforms_{split}.json").read_text())["frames"]]
            for folder in (scene, kit / "photos", tmp_path / "more" / "photos")]
        assert sorted(stems[1] + stems[2]) == sorted(stems[0]), (split, stems)
        assert bool(stems[2]) == (split != "train"), stems
        assert all((tmp_path / "more" / "photos" / split / f"{stem}.webp").is_file() for stem in stems[2])


def test_the_table_has_what_was_counted():
    """The machine code in cuda.md is that of gpu_code.json, with which the test `cuda machine code` compares."""
    counted = json.loads((BENCH / "gpu_code.json").read_text())
    table = (BENCH / "cuda.md").read_text().split("| kernel | registers ")[1].split("\n\n")[0]
    head, _, *rows = ("| kernel | registers " + table).splitlines()
    names = [cell.strip() for cell in head.strip("|").split("|")]
    for row in rows:
        cells = dict(zip(names, (cell.strip() for cell in row.strip("|").split("|"))))
        kernel = re.sub(r"^\w+", lambda name: f"rn_{name.group(0)}_kernel", cells.pop("kernel"))
        assert cells == {name: str(counted[kernel][name]) for name in cells}, kernel
    assert len(rows) > 20


def test_kernels_that_grew_or_are_others(build, tmp_path):
    module, counted = build / "server" / "engine" / "cuda" / "ripnerf-cuda.so", tmp_path / "counted.json"
    if not module.is_file():
        pytest.skip("this build has no CUDA kernels")

    def compare(*options):
        return subprocess.run([sys.executable, BENCH / "gpu_code.py", module, *options], text=True,
                              capture_output=True, check=False)
    assert compare("--json", counted).returncode == 0
    kernels = json.loads(counted.read_text())
    assert compare("--before", counted).returncode == 0
    name = next(name for name, kernel in kernels.items() if kernel["registers"] > 32)
    smaller = {**kernels, name: {**kernels[name], "registers": 32}}
    fewer = {other: kernel for other, kernel in kernels.items() if other != name}
    for known, why in ((smaller, "grew"), (fewer, "only one of both"), ({**kernels, "rn_gone": {}}, "only one of both")):
        counted.write_text(json.dumps(known))
        ended = compare("--before", counted)
        assert ended.returncode == 1 and why in ended.stderr, ended.stderr
        assert compare("--before", counted, "--report").returncode == 0
