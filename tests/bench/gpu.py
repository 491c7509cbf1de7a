#!/usr/bin/env python3
"""What a GPU is asked in half an hour, stage by stage; gpu.sh starts it.

    gpu.py DATA OUT [--work DIR] [--seconds 570] [--trial] [--again STAGE] [--known FILE] [--more DIR]

DATA is a scene of NeRF-synthetic, OUT gets results.json, table.md, log.txt and profile.csv, anew after
every stage. A call ends before --seconds have passed, with exit code 75 where stages are left; the next
call goes on: a stage that was done is not done again, a training goes on from its checkpoint. What that
needs is kept in --work (OUT/work), for machines that empty OUT between two calls. On another machine --known
takes the results.json of one that is gone: what was done there is not done again. --again forgets all that
is known of a stage, its checkpoint too. --more names further photographs of the scene (gpu_pack.py --beside),
by a second call, as one carries 64 MiB: `data` is done anew with both, what was trained on fewer stays as it
is, and trainings under way begin anew. Each stage has a limit
of its own; one that fails says so in the table and does not stop the others. --trial takes tiny fields
and few steps, to try the command itself where a device is slow.
"""
import argparse
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from gpu_scenes import share

HERE = Path(__file__).resolve().parent
MORE = 75  # exit code: another call goes on; of tests/bench/quality too
SKIPPED = 77  # of a test program: not on this machine
SPLITS = ("train", "val", "test")
FINAL = ("done", "failed", "absent", "out of time")
SMALL = ["planes=3", "channels=4", "levels=2", "width=16", "occupancy=16", "samples=1024", "step=0.1"]
GPU = ("name", "driver_version", "memory.total", "clocks.sm", "clocks.max.sm", "clocks.mem", "clocks.max.mem", "power.limit")
GOALS = {"step": "1.5", "step, deterministic": "", "pictures": "200", "memory": "3.0",
         "36.94": "40", "38.36": "180"}


class Failed(Exception):
    """A stage's program ended badly, or said nothing that is known."""


class OutOfTime(Exception):
    """A stage ran past its limit."""


class Absent(Exception):
    """What a stage needs is not on this machine."""


class Unfinished(Exception):
    """Another call goes on."""


class Call:
    """One call: where things lie, how long it may take, and what stages run programs with."""

    def __init__(self, given):
        self.data, self.out, self.trial = given.data.resolve(), given.out.resolve(), given.trial
        self.work = (given.work or given.out / "work").resolve()
        self.more = [folder.resolve() for folder in given.more]
        self.deadline = time.monotonic() + given.seconds
        self.stage, self.stage_end = "", 0.0  # which is under way, and when its time is over
        self.out.mkdir(parents=True, exist_ok=True)
        self.work.mkdir(parents=True, exist_ok=True)

    def left(self):
        return self.deadline - time.monotonic()

    def program(self, name):
        return HERE / "bin" / name

    def log(self):
        return self.work / f"{self.stage.replace(', ', '-').replace(' ', '-')}.log"

    def checkpoint(self):
        return self.log().with_suffix(".safetensors")

    def forget(self, stage):
        """Nothing is left of what was begun of it."""
        self.stage = stage
        self.log().unlink(missing_ok=True)
        self.checkpoint().unlink(missing_ok=True)

    def run(self, *command, codes=(0,), **environment):
        """What a program says, which is ended when its stage's time is over; its exit code after it."""
        with open(self.log(), "a", encoding="utf-8") as log:
            print("$", *command, file=log, flush=True)
            begin = log.tell()
            process = subprocess.Popen([str(part) for part in command], stdin=subprocess.DEVNULL, stdout=log,
                                       stderr=log, env=os.environ | environment, start_new_session=True)
            try:
                code = process.wait(max(0.1, self.stage_end - time.monotonic()))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                raise OutOfTime from None
        with open(self.log(), encoding="utf-8", errors="replace") as log:
            log.seek(begin)
            said = log.read()
        if code not in codes:
            last = said.strip().splitlines()[-1:] or ["nothing"]
            raise Failed(f"{Path(command[0]).name} ended with {code}: {last[0][:160]}")
        return said, code

    def said(self):
        """All that the programs of this stage have said, in this call and before."""
        return self.log().read_text(encoding="utf-8", errors="replace")


def numbers(pattern, text, *names):
    """The groups of the last match by their names."""
    found = re.findall(pattern, text, re.MULTILINE)
    if not found:
        raise Failed(f"no line says {pattern}")
    last = found[-1] if isinstance(found[-1], tuple) else (found[-1],)
    return {name: float(value) for name, value in zip(names, last)}


# ---- the machine, the data ----------------------------------------------------------------------

def machine(call):
    """Which system, which GPU, its driver and clocks; that the programs run here."""
    call.run(call.program("quality"), codes=(2,))
    found = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
             "kernel": platform.release(), "libc": "-".join(platform.libc_ver())}
    if shutil.which("nvidia-smi"):
        said, _ = call.run("nvidia-smi", f"--query-gpu={','.join(GPU)}", "--format=csv,noheader")
        found["gpu"] = dict(zip(GPU, said.strip().splitlines()[0].split(", ")))
    return found


def frames_of(folder, split):
    return json.loads((folder / f"transforms_{split}.json").read_text(encoding="utf-8"))


def gathered(call):
    """One scene of the photographs that lie in several folders, each of which has some of every split."""
    target = call.work / "photos"
    shutil.rmtree(target, ignore_errors=True)
    for split in SPLITS:
        found, document = {}, {}
        for folder in (call.data, *call.more):
            document = frames_of(folder, split)
            for frame in document["frames"]:
                name = frame["file_path"]
                found[name] = frame
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(folder / name, target / name)
        (target / f"transforms_{split}.json").write_text(
            json.dumps(document | {"frames": [found[name] for name in sorted(found)]}), encoding="utf-8")
    return target


def counts(call):
    """Of the photographs that --more names, by folder and split."""
    return [len(frames_of(folder, split)["frames"]) for folder in call.more for split in SPLITS]


def is_more(call):
    """Whether photographs are named that the data were not made of."""
    known = call.work / "photographs.json"
    return bool(call.more) and (not known.exists() or json.loads(known.read_text(encoding="utf-8")) != counts(call))


def data(call):
    """The photographs on four scales as the paper has them, and at 400 pixels as the CPU's figures."""
    views = {}
    source = gathered(call) if call.more else call.data
    for name, options in (("paper", ["scales=4", "alpha=straight"]), ("standard", ["max_size=400"])):
        target = call.work / name
        if not (target / "ready").exists():
            shutil.rmtree(target, ignore_errors=True)
            call.run(call.program("import"), source, target, *options)
            (target / "ready").touch()
    write(call.work / "photographs.json", json.dumps(counts(call)))
    with open(call.work / "standard" / "dataset.json", encoding="utf-8") as file:
        for frame in json.load(file)["frames"]:
            views[frame["split"]] = views.get(frame["split"], 0) + 1
    return {"views": views}


# ---- is it right? -------------------------------------------------------------------------------

def tests(call, program, case):
    """A test program's checks on the device, in a trial one case of them. Who has met a GPU cannot fork."""
    environment = {"CK_FORK": "no"} | ({"CK_RUN_CASE": case} if call.trial else {"RIPNERF_DEVICE_BASE": "512"})
    said, code = call.run(call.program(program), codes=(0, 1, SKIPPED), **environment)
    if code == SKIPPED:
        raise Failed(said.strip().splitlines()[-1])
    found = numbers(r"Checks: (\d+), Failures: (\d+), Errors: (\d+)", said, "checks", "failures", "errors")
    if code or not found["checks"]:
        raise Failed(f"{found}: {re.findall(r':[FE]:.*', said)[:3]}")
    return found


def sanitizer(call, tool):
    """Kernels under compute-sanitizer, a case at a time, as many as there is time for."""
    program = shutil.which("compute-sanitizer")
    if not program:
        raise Absent("compute-sanitizer is not here")
    clean, findings = [], {}
    for case in ("layout",) if call.trial else ("second", "guards", "learning", "march", "smoothing", "occupancy", "rays", "gradients", "paper"):
        try:
            said, code = call.run(program, "--tool", tool, "--error-exitcode", "9", call.program("cuda_device_test"),
                                  codes=(0, 1, 9), CK_FORK="no", CK_RUN_CASE=case)
        except OutOfTime:
            if not clean and not findings:
                raise
            break
        if code == 0:
            clean.append(case)
        else:
            findings[case] = re.findall(r"SUMMARY: (.*)", said)[-1:] or [f"exit code {code}"]
    if findings:
        raise Failed(f"{tool}: {findings}")
    return {"clean": clean}


# ---- how fast? ----------------------------------------------------------------------------------

FRAME = r"^frame \S+, {}: ([\d.]+) ms, (\d+) a second, ([\d.]+) M samples"


def step(call, *options):
    """A step by stage beside its ceilings, pictures with and without the dial, memory, loading."""
    small = [*SMALL, "base=16", "grow=0", "steps=2", "size=16", "rounds=1"] if call.trial else []
    said, _ = call.run(call.program("cuda"), call.work / "paper", "device=cuda:0", *options, *small)
    found = numbers(r"^step: ([\d.]+) ms, (\d+) samples, (\d+) rays", said, "ms", "samples", "rays")
    found |= numbers(r"^memory: ([\d.]+) MB", said, "memory_mb")
    found |= numbers(r"^loaded in ([\d.]+) ms", said, "load_ms")
    found["stages"] = {name.strip(): {"ms": float(ms), "ceiling_ms": None if ceiling == "nan" else float(ceiling)}
                       for name, ms, ceiling in re.findall(r"^(\w[\w ]{15}) +([\d.]+) +([\d.]+|-?nan) ", said,
                                                           re.MULTILINE)}
    for key, what in (("full", "full quality"), ("coarse", "twice the step"), ("half", "every second pixel")):
        found[f"picture_{key}"] = numbers(FRAME.format(what), said, "ms", "a_second", "m_samples")
    return found


# ---- how good, after how long? ------------------------------------------------------------------

SCALE = r"^test( one cone a pixel,)? mean over scales: ([\d.]+)"


def train(call, folder, *options, goals=()):
    """A training as far as this call's time goes, on from where the last one ended; then its test views."""
    checkpoint = call.checkpoint()
    before = call.said() if call.log().exists() else ""
    missing = [goal for goal in goals if f"goal {goal} dB reached" not in before]
    wall = max(1, call.stage_end - time.monotonic() - (1 if call.trial else 45))
    begin = [f"resume={checkpoint}"] if checkpoint.exists() else list(options)
    _, code = call.run(call.program("quality"), call.work / folder, "device=cuda",
                       f"test={2 if call.trial else 25}", f"save={checkpoint}", f"wall={wall:.0f}", *begin,
                       *([f"goals={','.join(missing)}", f"every={5 if call.trial else 10}"] if missing else []),
                       codes=(0, MORE))
    if code == MORE:
        raise Unfinished
    said = call.said()
    checkpoint.unlink()
    found = numbers(r"^step +(\d+) +([\d.]+) s +psnr", said, "steps", "seconds")
    found["psnr"] = {"one cone a pixel" if one else "supersampled": float(psnr)
                     for one, psnr in re.findall(SCALE, said, re.MULTILINE)}
    found["kernels"] = re.search(r"^trained with (\S+)", said, re.MULTILINE).group(1)
    found["seconds_to"] = {goal: float(s) for goal, s in
                           re.findall(r"^goal ([\d.]+) dB reached after ([\d.]+) s", said, re.MULTILINE)}
    return found


def standard(call):
    small = [*SMALL, "base=8", "grow=16", "steps=6"] if call.trial else ["time=60"]
    return train(call, "standard", "preset=standard", *small)


def paper(call, steps, goals):
    small = [*SMALL, "base=16", "rays=64", f"steps={steps // 10000}"] if call.trial else [f"steps={steps}"]
    return train(call, "paper", "preset=paper", "train_val=trainval", *small, goals=goals)


def sharing(call):
    """Two scenes of a daemon whose room on the device is enough for one and a half."""
    shutil.rmtree(call.work / "daemon", ignore_errors=True)  # of a call that cut it short
    small = {"planes": 3, "base": 16, "channels": 4, "max_time_s": 2} if call.trial else {"max_time_s": 10}
    return share(call.program("ripnerfd"), call.work / "standard", call.work / "daemon", call.log(), small,
                 2 if call.trial else 10, call.stage_end)


# ---- why? ---------------------------------------------------------------------------------------

def profile(call):
    """Every kernel of a step of the paper's configuration, by hardware counters."""
    program = shutil.which("ncu")
    if not program:
        raise Absent("ncu is not here")
    sections = ("SpeedOfLight", "Occupancy", "LaunchStats", "InstructionStats", "WarpStateStats", "MemoryWorkloadAnalysis")
    said, _ = call.run(program, "--clock-control", "none", "--csv", "--launch-skip", "600", "--launch-count", "48",
                       *(word for section in sections for word in ("--section", section)),
                       call.program("cuda"), call.work / "paper", "steps=20", "rounds=1", codes=(0, 1, 9))
    rows = [line for line in said.splitlines() if line.startswith('"')]
    if not rows:
        raise Failed("ncu printed no counters")
    (call.work / "profile.csv").write_text("\n".join(rows), encoding="utf-8")
    return {"rows": len(rows) - 1}


class Stage:
    """A name, a limit in seconds, and what it does; what goes on in the next call begins with little time."""

    def __init__(self, name, limit, run, goes_on=False):
        self.name, self.limit, self.run = name, limit, run
        self.least = 60 if goes_on else limit


# What says most comes first.
STAGES = (
    Stage("machine", 60, machine),
    Stage("data", 120, data),
    Stage("kernels", 150, lambda call: tests(call, "cuda_device_test", "smoothing")),
    Stage("device", 150, lambda call: tests(call, "device_test", "draft")),
    Stage("step", 120, step),
    Stage("standard", 150, standard, True),
    Stage("25,000 steps", 300, lambda call: paper(call, 25000, ("36.94",)), True),
    Stage("step, deterministic", 90, lambda call: step(call, "deterministic=1")),
    Stage("step, sparse", 90, lambda call: step(call, "sparse=1")),
    Stage("step, last layer on chip", 90, lambda call: step(call, "on_chip=1")),
    Stage("step, two tiles a warp", 90, lambda call: step(call, "tiles=2")),
    Stage("step of standard", 60, lambda call: step(call, "preset=standard")),
    Stage("memcheck", 150, lambda call: sanitizer(call, "memcheck")),
    Stage("racecheck", 150, lambda call: sanitizer(call, "racecheck")),
    Stage("profile", 120, profile),
    Stage("two scenes", 90, sharing),
    Stage("120,000 steps", 900, lambda call: paper(call, 120000, ("36.94", "38.36")), True),
)


# ---- what is known so far -----------------------------------------------------------------------

def ceiling(stage):
    """In milliseconds; nothing where none was counted."""
    return f"{stage['ceiling_ms']:.4f}" if stage["ceiling_ms"] else ""


def shown(name, found):
    """A stage's rows of the table: what, measured, ceiling, goal."""
    if name.startswith("step"):
        yield name, f"{found['ms']:.3f} ms", ceiling(found["stages"]["in series"]), GOALS.get(name, "")
        yield f"{name}: memory", f"{found['memory_mb'] / 1000:.2f} GB", "", GOALS["memory"] if name == "step" else ""
        for key in ("full", "coarse", "half"):
            picture = found[f"picture_{key}"]
            yield (f"{name}: pictures a second, {key}", f"{picture['a_second']:.0f}", "",
                   GOALS["pictures"] if (name, key) == ("step", "full") else "")
        for stage, times in found["stages"].items():
            yield f"{name}: {stage}", f"{times['ms']:.4f} ms", ceiling(times), ""
    elif "psnr" in found:
        yield name, f"{found['psnr']} dB after {found['seconds']:.1f} s on {found['kernels']}", "", ""
        for goal, seconds in found["seconds_to"].items():
            yield f"{name}: seconds to {goal} dB", f"{seconds:.1f}", "", GOALS.get(goal, "")
    else:
        yield name, json.dumps(found), "", ""


def table(state):
    lines = ["| what | measured | ceiling | goal |", "|---|---|---|---|"]
    for stage in STAGES:
        known = state.get(stage.name, {"state": "to do"})
        if known["state"] == "done":
            lines += ["| " + " | ".join(row) + " |" for row in shown(stage.name, known["found"])]
        else:
            lines.append(f"| {stage.name} | **{known['state']}** {known.get('why', '')} | | |")
    return "\n".join(lines) + "\n"


def write(path, text):
    """As a whole or not at all."""
    path.with_suffix(".new").write_text(text, encoding="utf-8")
    path.with_suffix(".new").replace(path)


def keep(call, state):
    """The state for the next call, and what is known for whoever reads OUT."""
    write(call.work / "results.json", json.dumps(state, indent=1))
    shutil.copyfile(call.work / "results.json", call.out / "results.json")
    write(call.out / "table.md", table(state))
    logs = [f"==== {path.stem}\n{path.read_text(errors='replace')[-200000:]}" for path in
            sorted(call.work.glob("*.log"), key=lambda path: path.stat().st_mtime)]
    write(call.out / "log.txt", "\n".join(logs))
    if (call.work / "profile.csv").exists():
        shutil.copyfile(call.work / "profile.csv", call.out / "profile.csv")


def do(call, stage, before):
    """What becomes of a stage, of which `before` is known. What a call cut short once gets another one."""
    call.stage, begin = stage.name, time.monotonic()
    limit = stage.limit * (5 if call.trial else 1)  # where a device is slow, and not alone
    call.stage_end = min(begin + limit, call.deadline - 2)
    known = {}
    try:
        known = {"state": "done", "found": stage.run(call)}
    except Unfinished:
        known = {"state": "unfinished", "why": "the next call goes on"}
    except OutOfTime:
        cut = call.stage_end - begin < limit and not before.get("cut")
        known = {"state": "unfinished", "why": "the call ended", "cut": True} if cut else \
            {"state": "out of time", "why": f"after {call.stage_end - begin:.0f} s"}
    except Absent as why:
        known = {"state": "absent", "why": str(why)}
    except (Failed, OSError, ValueError, LookupError, AttributeError, subprocess.SubprocessError) as why:
        known = {"state": "failed", "why": f"{type(why).__name__}: {why}"}
    return known | {"seconds": round(time.monotonic() - begin, 1)}


def known_elsewhere(path):
    """What another machine has done, of which nothing needs to lie on this one."""
    known = json.loads(path.read_text(encoding="utf-8"))
    return {name: stage for name, stage in known.items() if stage["state"] in FINAL and name not in ("machine", "data")}


def prepare(call, again, state):
    """Takes off `state` what is to be done anew, and off the disk what it left."""
    data_anew = "data" in again or is_more(call)
    for name in again:
        state.pop(name, None)
        call.forget(name)
    if data_anew:
        state.pop("data", None)
        for name in ("paper", "standard"):
            (call.work / name / "ready").unlink(missing_ok=True)
        for stage in STAGES:
            if state.get(stage.name, {}).get("state") == "unfinished":
                state.pop(stage.name)
                call.forget(stage.name)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--work", type=Path)
    parser.add_argument("--seconds", type=float, default=570)
    parser.add_argument("--trial", action="store_true")
    parser.add_argument("--again", action="append", default=[], metavar="STAGE", choices=[s.name for s in STAGES])
    parser.add_argument("--known", type=Path, metavar="FILE")
    parser.add_argument("--more", type=Path, action="append", default=[], metavar="DIR")
    given = parser.parse_args()
    call = Call(given)
    kept = call.work / "results.json"
    state = known_elsewhere(given.known) if given.known else {}
    if kept.exists():
        state |= json.loads(kept.read_text(encoding="utf-8"))
    prepare(call, given.again, state)
    for begun, stage in enumerate(s for s in STAGES if state.get(s.name, {}).get("state") not in FINAL):
        if begun and call.left() < 3 + (0 if call.trial else stage.least):
            continue  # the next call's
        state[stage.name] = do(call, stage, state.get(stage.name, {}))
        keep(call, state)
        print(f"{stage.name}: {state[stage.name]}", flush=True)
        if stage.name == "machine" and state["machine"]["state"] != "done":
            break
    print(table(state))
    if any(state.get(stage.name, {}).get("state") not in FINAL for stage in STAGES):
        sys.exit(MORE)
    sys.exit(any(known["state"] in ("failed", "out of time") for known in state.values()))


main()
