"""The records behind the stand-in's interface, and the passing of their time."""

import json
import math
import sys
import threading
import time
from pathlib import Path

from fake_pictures import draw, ring

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support import contract  # noqa: E402

OVER = ("succeeded", "failed", "cancelled")


def now():
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


class Refusal(Exception):
    def __init__(self, status, title, detail, errors=()):
        super().__init__(detail)
        self.status, self.body = status, {
            "type": "/problems/" + title.lower().replace(" ", "-"),
            "title": title,
            "status": status,
            "detail": detail,
            "errors": list(errors),
        }


class World:
    """All records; every method is called with the lock held."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.token = "secret" if scenario == "token" else None
        self.lock = threading.RLock()
        self.news = threading.Condition(self.lock)
        self.datasets, self.scenes, self.jobs, self.paths, self.evaluations = [], [], [], [], []
        self.events = []  # (id, job id, type, data)
        self.frames, self.done, self.routes = {}, {}, {}  # by job id; routes are the camera paths
        self.serial = 0
        self.missing = set()  # views that could not be used: (split, index)
        self.uploaded = []  # the files of each dataset, or a scene's bytes
        self.uploads, self.parts, self.line_dead_below = {}, [], 0
        self.centre = [0, 0, 0]  # of the bounds that a validation finds
        self.untrained = False  # a scene of no steps is rendered all the same
        self.curve = None  # of every scene
        self.films = True  # whether the module that makes them is installed
        self.effects = None  # likewise: what they bring
        self.report = None  # of every ladder
        self.incidents = []  # of every scene
        self.looked_at = set()  # uploads that are only looked at
        self.fails = {}  # by type of job: the problem that it ends with
        self.doctor = None  # what examining any scene results in
        self.on_render = lambda body: None
        self.waited_ms = 0.2  # by every picture, as it is told
        if scenario != "empty":
            self.add_dataset("sphere")
        if scenario in ("busy", "failed", "token"):
            with self.lock:
                self.populate()
        threading.Thread(target=self.live, daemon=True).start()

    def new_id(self, prefix):
        self.serial += 1
        digits = "abcdefghijklmnopqrstuvwxyz234567"
        return f"{prefix}_{'a' * 9}" + "".join(
            digits[self.serial >> shift & 31] for shift in (10, 5, 0)
        )

    def populate(self):
        done = self.train(
            {
                "dataset": "sphere",
                "scene": "sphere-draft",
                "options": {"preset": "draft", "max_time_s": 30},
            }
        )
        self.set_state(done, "running")
        while done["state"] == "running":
            self.advance(done, 0.1)
        if self.scenario == "failed":
            bad = self.train(
                {"dataset": "sphere", "scene": "sphere-paper", "options": {"preset": "paper"}}
            )
            bad["progress"] = self.train_progress(bad, 0.4)
            bad["problem"] = {
                "type": "/problems/no-memory",
                "title": "Out of memory",
                "status": 500,
                "detail": "The runner asked for 9.1 GiB and was refused 3 times without progress.",
                "errors": [
                    {
                        "pointer": "#/options/base",
                        "detail": "512 needs 9.1 GiB with 10 planes; 256 needs 2.4 GiB",
                    }
                ],
            }
            self.set_state(bad, "failed")

    # -- records --
    def find(self, items, key, kind):
        for item in items:
            if key in (item["id"], item.get("name")):
                return item
        raise Refusal(404, "Not found", f"There is no {kind} {key}.")

    def add_dataset(self, name):
        self.datasets.append(
            {
                "id": self.new_id("ds"),
                "name": name,
                "created_at": now(),
                "state": "ready",
                "views": {"train": 24, "val": 8, "test": 8},
                "scales": 1,
                "frames": 40,
                "width": 200,
                "height": 200,
                "has_alpha": True,
                "bounds": {"centre": [0, 0, 0], "radius": 1.5, "source": "layout"},
                "footprint": {"min": 0.0071, "max": 0.0074},
                "size_bytes": 2_340_000,
                "premultiplied": True,
                "past": {"trainings": 3, "seconds": 66.4, "memory_bytes": 410_000_000},
                "report": {
                    "layout": "blender",
                    "usable": {"train": 24, "val": 8, "test": 8},
                    "unusable": {"train": 0, "val": 0, "test": 0},
                    "scales": 1,
                    "footprint": {"min": 0.0071, "max": 0.0074},
                    "camera_distance": {"min": 3.6, "max": 3.6},
                    "looking_at_bounds": 1.0,
                    "with_alpha": 40,
                    "width": {"min": 200, "max": 200},
                    "height": {"min": 200, "max": 200},
                    "expected": {"seconds": 60, "memory_bytes": 336_400_000},
                    "errors": 0,
                    "warnings": 1,
                    "dropped": 0,
                    "problems": [
                        {
                            "severity": "warning",
                            "where": "transforms_val.json#/frames/3/rotation",
                            "text": "unknown field, ignored",
                        }
                    ],
                },
            }
        )

    def cameras(self):
        sizes = {"train": 24, "val": 8, "test": 8}
        return [
            {
                "split": split,
                "index": i,
                "name": f"r_{i}",
                "scale": 0,
                "camera": {
                    "world_from_camera": pose,
                    "axes": "opengl",
                    "width": 200,
                    "height": 200,
                    "fov_y_deg": 40.0,
                },
            }
            for split, count in sizes.items()
            for i, pose in enumerate(ring(count))
            if (split, i) not in self.missing
        ]

    def view(self, name):
        for item in self.cameras():
            if f"{item['split']}:{item['index']}" == name:
                return item["camera"]
        raise Refusal(404, "Not found", f"There is no view {name}.")

    def job(self, kind, **fields):
        job = {
            "id": self.new_id("job"),
            "type": kind,
            "state": "queued",
            "attempt": 1,
            "created_at": now(),
            "started_at": None,
            "finished_at": None,
            "options": {},
            "progress": None,
            **fields,
        }
        self.jobs.insert(0, job)
        self.emit(job, "state", job)
        return job

    def train(self, body):
        dataset = self.find(self.datasets, body["dataset"], "dataset")
        if any(scene["name"] == body["scene"] for scene in self.scenes):
            raise Refusal(
                409,
                "Conflict",
                f"The scene {body['scene']} exists.",
                [{"pointer": "#/scene", "detail": "this name is taken"}],
            )
        options = {"preset": "standard", **body.get("options", {})}
        planes = options.get("planes", 3)
        scene = {
            "id": self.new_id("sc"),
            "name": body["scene"],
            "dataset": dataset["id"],
            "dataset_name": dataset["name"],
            "created_at": now(),
            "state": "new",
            "job": "",
            "steps": 0,
            "train_seconds": 0,
            "psnr": None,
            "parameters_sha256": None,
            "bounds": dataset["bounds"],
            "loaded": True,
            "held_out": "8 evenly spaced views of the validation split",
            "checkpoints": [],
            "marks": [],
            "memory_bytes": 412_000_000,
            "kernels": "avx512",
            "config": {
                **contract.example("Scene")["config"],
                "preset": options["preset"],
                "planes": planes,
                "footprint": options.get("footprint", "rip"),
            },
            "differences": contract.example("Scene")["differences"],
            "effects": contract.example("Scene")["effects"],
        }
        job = self.job(
            "train",
            dataset=dataset["id"],
            dataset_name=dataset["name"],
            scene=scene["id"],
            scene_name=scene["name"],
            options=options,
        )
        scene["job"] = job["id"]
        self.scenes.insert(0, scene)
        return job

    def emit(self, job, kind, data):
        self.events.append((len(self.events) + 1, job["id"], kind, json.loads(json.dumps(data))))
        self.news.notify_all()

    def set_state(self, job, state):
        job["state"] = state
        if state == "running" and not job["started_at"]:
            job["started_at"] = now()
        if state in OVER:
            job["finished_at"] = now()
        if job["type"] == "train":
            scene = self.find(self.scenes, job["scene"], "scene")
            scene["state"] = {
                "running": "training",
                "paused": "paused",
                "queued": "new",
                "failed": "failed",
            }.get(state, "ready")
        self.emit(job, "state", job)

    # -- time --
    def live(self):
        while True:
            time.sleep(0.1)
            with self.lock:
                training = [
                    job for job in self.jobs if job["type"] == "train" and job["state"] == "running"
                ]
                for job in reversed(self.jobs):
                    waits = job.get("runner", {}).get("reason")  # for a cluster
                    if (
                        job["state"] == "queued"
                        and not waits
                        and (job["type"] != "train" or not training)
                    ):
                        self.set_state(job, "running")
                        break
                for job in self.jobs:
                    if job["state"] == "running":
                        self.advance(job, 0.1)

    def train_progress(self, job, seconds):
        limit = job["options"].get("max_time_s", 0)
        step = int(180 * seconds)
        return {
            "step": step,
            "max_steps": 0,
            "train_seconds": round(seconds, 2),
            "max_seconds": limit,
            "load_seconds": 0.4,
            "evaluate_seconds": 0.1 * seconds,
            "paused_seconds": 0,
            "yielded_seconds": 0.03 * seconds,
            "loss": 0.02 / (1 + seconds),
            "rays_per_second": 161_000,
            "samples_per_second": 3_120_000,
            "samples": int(3_120_000 * seconds),
            "level_samples": [8_000, 2_400, 300, 12],
            "psnr": None,
            "psnr_step": None,
            "nonfinite": {"rays": 0, "steps_rejected": 0, "rollbacks": 0},
            "eta_seconds": limit - seconds if limit else None,
            "fraction": min(1, seconds / limit) if limit else None,
            "evaluating_first": False,
            "evaluating": False,
        }

    def advance(self, job, dt):
        if job["type"] in self.fails:
            job["problem"] = self.fails[job["type"]]
            self.set_state(job, "failed")
        else:
            getattr(self, "advance_" + job["type"])(job, dt)

    def advance_train(self, job, dt):
        before = job["progress"]
        seconds = (before["train_seconds"] if before else 0) + 10 * dt
        progress = self.train_progress(job, seconds)
        progress["psnr"], progress["psnr_step"] = (before or {}).get("psnr"), (before or {}).get(
            "psnr_step"
        )
        scene = self.find(self.scenes, job["scene"], "scene")
        if int(seconds / 3) != int((seconds - 10 * dt) / 3) or seconds == 10 * dt:
            progress["psnr"] = round(33.5 - 16 / (1 + 0.25 * seconds) + 0.15 * math.sin(seconds), 3)
            progress["psnr_step"] = progress["step"]
            self.emit(
                job,
                "metric",
                {"step": progress["step"], "train_seconds": seconds, "psnr": progress["psnr"]},
            )
            scene["checkpoints"] = [
                {"step": progress["step"], "size_bytes": 9_437_184, "created_at": now()},
                *scene["checkpoints"],
            ][:3]
        job["progress"] = progress
        mark = 3.75 * 2 ** len(scene["marks"])
        if seconds >= mark:
            scene["marks"] = [*scene["marks"], {"train_seconds": mark, "step": int(40 * mark),
                                                "size_bytes": 1 << 20}]
        scene.update(
            steps=progress["step"],
            train_seconds=progress["train_seconds"],
            psnr=progress["psnr"],
            parameters_sha256="5f" * 32,
        )
        self.emit(job, "progress", progress)
        limit = job["options"].get("max_time_s")
        if limit and seconds >= limit:
            self.end_train(job, "time")

    def end_train(self, job, why):
        p = job["progress"]
        job["result"] = {
            "steps": p["step"],
            "train_seconds": p["train_seconds"],
            "samples": p["samples"],
            "psnr": p["psnr"],
            "parameters_sha256": "5f" * 32,
            "finished_by": why,
        }
        self.set_state(job, "succeeded")

    def work(self, job, total, rate, dt):
        done = self.done[job["id"]] = min(total, self.done.get(job["id"], 0) + rate * dt)
        job["progress"] = {
            "done": int(done),
            "total": total,
            "nonfinite": {"rays": 0, "steps_rejected": 0, "rollbacks": 0},
            "fraction": done / total,
            "eta_seconds": (total - done) / rate,
        }
        self.emit(job, "progress", job["progress"])
        return int(done)

    def advance_ingest(self, job, dt):
        if self.work(job, 40, 30, dt) == 40 and "scene" in job:  # one that came as a file
            self.scenes.insert(0, {**self.scenes[0], "id": job["scene"], "name": job["scene_name"],
                                   "job": job["id"], "dataset": None, "dataset_name": None})
            job["result"] = {"scene": job["scene"]}
            self.set_state(job, "succeeded")
        elif self.done[job["id"]] == 40:
            self.add_dataset(job["dataset_name"])
            self.datasets[-1]["id"] = job["dataset"]
            job["result"] = {"dataset": job["dataset"]}
            self.set_state(job, "succeeded")

    def advance_validate(self, job, dt):
        """What the options ask for; the files are those of the upload that is five of a ring."""
        if self.work(job, 4, 20, dt) < 4:
            return
        every = int(job["options"].get("split", "every:0").split(":")[-1])
        size = job["options"].get("max_size", 20)
        views = [{"split": "test" if every and i % every == 0 else "train",
                  "file": f"train/r_{i}.png",
                  "camera": {"world_from_camera": pose, "axes": "opengl", "width": size,
                             "height": size, "fov_y_deg": 40}} for i, pose in enumerate(ring(5))]
        views[1]["mask"] = "masks/r_1.png"
        tests = sum(view["split"] == "test" for view in views)
        job["result"] = {
            "report": contract.example("DatasetReport"), "up": [0, 0, 1], "items": views,
            "scales": job["options"].get("scales", 1),
            "views": {"train": 5 - tests, "val": 0, "test": tests},
            "bounds": {"centre": self.centre, "radius": 1.5, "source": "layout"}}
        self.set_state(job, "succeeded")

    def advance_doctor(self, job, dt):
        if self.doctor:
            job["result"] = self.doctor
            self.set_state(job, "succeeded")

    def advance_ladder(self, job, dt):
        """Its trainings take as long as a test wants."""

    def advance_estimate(self, job, dt):
        if self.work(job, 12, 24, dt) == 12:
            job["result"] = contract.example("Estimate")
            self.set_state(job, "succeeded")

    def advance_path(self, job, dt):
        path = self.routes[job["id"]]
        keys = path["keys"]
        total = max(1, int((keys[-1]["time"] - keys[0]["time"]) * path["fps"]) + 1)
        done = self.work(job, total, 12, dt)
        frames = self.frames.setdefault(job["id"], {})
        for i in range(len(frames), done):
            key = keys[min(len(keys) - 1, i * len(keys) // total)]
            frames[i] = draw(
                {**key, "axes": path["axes"], "width": path["width"], "height": path["height"]}
            )
            self.emit(job, "frame", {"index": i, "url": f"/v1/jobs/{job['id']}/frames/{i}"})
        if done == total:
            job["result"] = {
                "frames": total,
                "width": path["width"],
                "height": path["height"],
                "step": 1234,
                "render_ms_median": 83.0,
            }
            if "quality" in job["options"]:
                job["result"] |= {"setting": "stop=0.1,tolerance=0.03", "expected_psnr": 30.4,
                                  "expected_spread": 0.92}
            if "film" in job["options"]:
                job["result"] |= {"film": "film.gif", "film_bytes": len(frames[0])}
            self.set_state(job, "succeeded")

    def advance_eval(self, job, dt):
        if self.work(job, 8, 4, dt) == 8:
            views = [
                {
                    "name": f"r_{i}",
                    "index": i,
                    "scale": 0,
                    "psnr": 29.0 + 0.4 * i,
                    "ssim": 0.95,
                    "render_ms": 80.0 + i,
                }
                for i in range(8)
            ]
            job["result"] = {
                "psnr": 30.4,
                "ssim": 0.9512,
                "views": 8,
                "psnr_spread": 0.92,
                "ssim_spread": 0.004,
                "per_view": views,
                "render_ms_median": 84.0,
                "scales": [{"scale": 0, "psnr": 30.4, "ssim": 0.9512, "render_ms": 84.0}],
                "protocol": {
                    "split": "test",
                    "background": [1, 1, 1],
                    "downscale": "premultiplied",
                    "rounding": "8 bit",
                    "seed": 1,
                    "train_split": "train",
                    "step": 5400,
                    "version": "0.1.0",
                    "device": "cpu",
                    "kernels": "avx512",
                    "threads": 2,
                },
            }
            self.evaluations.insert(
                0,
                {
                    "job": job["id"],
                    "scene": job["scene"],
                    "finished_at": now(),
                    "options": job["options"],
                    "result": job["result"],
                },
            )
            self.set_state(job, "succeeded")

    # -- requests --
    def submit(self, body):
        if body["type"] == "train":
            return self.train(body)
        if body["type"] == "estimate":
            dataset = self.find(self.datasets, body["dataset"], "dataset")
            return self.job("estimate", dataset=dataset["id"], dataset_name=dataset["name"],
                            options=body.get("options", {}))
        if body["type"] == "validate":
            return self.job("validate", options=body.get("options", {}))
        scene = self.find(self.scenes, body["scene"], "scene")
        path = body.get("camera_path")
        facts = {key: path[key] for key in ("fps", "width", "height") if key in path} if path else {}
        job = self.job(
            body["type"],
            scene=scene["id"],
            scene_name=scene["name"],
            options={**facts, **body.get("options", {})},
        )
        self.routes[job["id"]] = body.get("camera_path")
        return job

    def go_on(self, job):
        """Another job, with the frames that a path job which has ended made."""
        again = self.job("path", **{key: job[key] for key in ("scene", "scene_name", "options")})
        self.routes[again["id"]] = self.routes[job["id"]]
        self.frames[again["id"]] = dict(self.frames.get(job["id"], {}))
        self.done[again["id"]] = len(self.frames[again["id"]])
        return again

    def act(self, job, verb):
        if verb == "resume" and job["type"] == "path" and job["state"] in ("failed", "cancelled"):
            return self.go_on(job)
        target = {
            "pause": ("running", "queued"),
            "resume": ("paused",),
            "finish": ("running", "paused"),
            "cancel": ("queued", "running", "paused", "cancelled", "interrupted"),
        }[verb]
        if job["state"] not in target:
            raise Refusal(409, "Conflict", f"The job is {job['state']}.")
        if verb == "finish":
            self.end_train(job, "finish")
        elif job["state"] != "cancelled":
            self.set_state(
                job, {"pause": "paused", "resume": "running", "cancel": "cancelled"}[verb]
            )
        return job

    def ingest(self, name, entries, options):
        if any(item["name"] == name for item in self.datasets):
            raise Refusal(
                409,
                "Conflict",
                f"The dataset {name} exists.",
                [{"pointer": "#/name", "detail": "this name is taken"}],
            )
        self.uploaded.append(entries)
        return self.job("ingest", dataset=self.new_id("ds"), dataset_name=name, options=options)
