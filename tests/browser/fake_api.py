"""A stand-in for the daemon's interface, in memory, for the page's states: fake_api.py [PORT [SCENARIO]].

It answers what the page asks, in the shapes of proto/openapi.yaml, trains at ten times the speed
of a clock, and draws a banded ball so that a camera's motion shows. Scenarios: empty, busy, failed,
token, bare.
"""

import io
import json
import math
import re
import struct
import sys
import tarfile
import threading
import time
import urllib.parse
import zlib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support import contract  # noqa: E402

WEB = Path(__file__).resolve().parents[2] / "web"
CSP = ("default-src 'self'; img-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; "
       "frame-ancestors 'none'")
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
OVER = ("succeeded", "failed", "cancelled")


def png(pixels):
    """8-bit RGB or 16-bit grey (height, width[, 3]) as PNG bytes."""
    height, width = pixels.shape[:2]
    wide = pixels.dtype == np.uint16
    raw = pixels.astype(">u2" if wide else "u1").reshape(height, -1)
    body = b"".join(b"\0" + row.tobytes() for row in raw)

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 16 if wide else 8, 0 if wide else 2, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(body, 1))
            + chunk(b"IEND", b""))


def draw(camera, output="rgb", sharp=1.0):
    """A banded unit ball and a striped floor as the camera sees them."""
    width, height = camera["width"], camera["height"]
    pose = np.array(camera["world_from_camera"], float)[:3]
    if camera["axes"] == "opengl":
        pose[:, 1:3] *= -1
    focal = 0.5 * height / math.tan(math.radians(camera["fov_y_deg"]) / 2)
    x, y = np.meshgrid((np.arange(width) + 0.5 - width / 2) / focal, (np.arange(height) + 0.5 - height / 2) / focal)
    rays = x[..., None] * pose[:, 0] + y[..., None] * pose[:, 1] + pose[:, 2]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    eye = pose[:, 3]
    colour = np.ones((height, width, 3))
    depth = np.zeros((height, width))
    with np.errstate(all="ignore"):
        floor = (-0.8 - eye[2]) / rays[..., 2]
        ground = eye + floor[..., None] * rays
        on = (floor > 0) & (np.hypot(ground[..., 0], ground[..., 1]) < 1.4)
        stripes = 0.5 + 0.5 * np.sign(np.sin(8 * ground[..., 0]) * np.sin(8 * ground[..., 1]))
        colour[on] = (0.55 + 0.3 * stripes[on])[:, None] * np.array([0.75, 0.8, 0.9])
        depth[on] = floor[on]
        b = rays @ eye
        root = b * b - (eye @ eye - 0.7)
        near = -b - np.sqrt(root)
        hit = (root > 0) & (near > 0)
        point = eye + near[..., None] * rays
        band = 0.5 + 0.5 * np.tanh(6 * np.sin(7 * point[..., 2] + 2 * np.arctan2(point[..., 1], point[..., 0])))
        light = np.clip(point @ np.array([0.4, -0.5, 0.76]), 0, 1)[..., None] * 0.7 + 0.35
        skin = band[..., None] * np.array([0.95, 0.6, 0.2]) + (1 - band[..., None]) * np.array([0.16, 0.42, 0.7])
        colour[hit] = (skin * light)[hit]
        depth[hit] = near[hit]
    if output == "depth":
        return png((depth * 1000).astype(np.uint16))
    if output == "alpha":
        return png(np.repeat(((depth > 0) * 255).astype(np.uint8)[..., None], 3, axis=2))
    colour = sharp * colour + (1 - sharp) * np.random.default_rng(1).random((height, width, 1))
    return png((np.clip(colour, 0, 1) * 255).astype(np.uint8))


def ring(count, elevation=0.5):
    """Poses around the ball, OpenGL axes."""
    poses = []
    for i in range(count):
        a = 2 * math.pi * i / count
        out = np.array([math.cos(a) * math.cos(elevation), math.sin(a) * math.cos(elevation), math.sin(elevation)])
        right = np.cross([0, 0, 1], out)
        right /= np.linalg.norm(right)
        poses.append(np.column_stack([right, np.cross(out, right), out, 3.6 * out]).tolist())
    return poses


def now():
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


class Refusal(Exception):
    def __init__(self, status, title, detail, errors=()):
        super().__init__(detail)
        self.status, self.body = status, {"type": "/problems/" + title.lower().replace(" ", "-"), "title": title,
                                          "status": status, "detail": detail, "errors": list(errors)}


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
        self.uploads = []
        if scenario != "empty":
            self.add_dataset("sphere")
        if scenario in ("busy", "failed", "token"):
            with self.lock:
                self.populate()
        threading.Thread(target=self.live, daemon=True).start()

    def new_id(self, prefix):
        self.serial += 1
        digits = "abcdefghijklmnopqrstuvwxyz234567"
        return f"{prefix}_{'a' * 9}" + "".join(digits[self.serial >> shift & 31] for shift in (10, 5, 0))

    def populate(self):
        done = self.train({"dataset": "sphere", "scene": "sphere-draft", "options": {"preset": "draft", "max_time_s": 30}})
        self.set_state(done, "running")
        while done["state"] == "running":
            self.advance(done, 0.1)
        if self.scenario == "failed":
            bad = self.train({"dataset": "sphere", "scene": "sphere-paper", "options": {"preset": "paper"}})
            bad["progress"] = self.train_progress(bad, 0.4)
            bad["problem"] = {"type": "/problems/no-memory", "title": "Out of memory", "status": 500,
                              "detail": "The runner asked for 9.1 GiB and was refused 3 times without progress.",
                              "errors": [{"pointer": "#/options/base", "detail": "512 needs 9.1 GiB with 10 planes; 256 needs 2.4 GiB"}]}
            self.set_state(bad, "failed")

    # -- records --
    def find(self, items, key, kind):
        for item in items:
            if key in (item["id"], item.get("name")):
                return item
        raise Refusal(404, "Not found", f"There is no {kind} {key}.")

    def add_dataset(self, name):
        self.datasets.append({
            "id": self.new_id("ds"), "name": name, "created_at": now(), "state": "ready", "views": {"train": 24, "val": 8, "test": 8},
            "scales": 1, "frames": 40, "width": 200, "height": 200, "has_alpha": True, "bounds": {"centre": [0, 0, 0], "radius": 1.5, "source": "layout"},
            "footprint": {"min": 0.0071, "max": 0.0074}, "size_bytes": 2_340_000, "premultiplied": True,
            "report": {"layout": "blender", "usable": {"train": 24, "val": 8, "test": 8}, "unusable": {"train": 0, "val": 0, "test": 0}, "scales": 1,
                       "footprint": {"min": 0.0071, "max": 0.0074}, "camera_distance": {"min": 3.6, "max": 3.6}, "looking_at_bounds": 1.0, "with_alpha": 40,
                       "width": {"min": 200, "max": 200}, "height": {"min": 200, "max": 200}, "errors": 0, "warnings": 1, "dropped": 0,
                       "problems": [{"severity": "warning", "where": "transforms_val.json#/frames/3/rotation", "text": "unknown field, ignored"}]}})

    def cameras(self):
        sizes = {"train": 24, "val": 8, "test": 8}
        return [{"split": split, "index": i, "name": f"r_{i}", "scale": 0,
                 "camera": {"world_from_camera": pose, "axes": "opengl", "width": 200, "height": 200, "fov_y_deg": 40.0}}
                for split, count in sizes.items() for i, pose in enumerate(ring(count))]

    def job(self, kind, **fields):
        job = {"id": self.new_id("job"), "type": kind, "state": "queued", "attempt": 1, "created_at": now(), "started_at": None,
               "finished_at": None, "options": {}, "progress": None, **fields}
        self.jobs.insert(0, job)
        self.emit(job, "state", job)
        return job

    def train(self, body):
        dataset = self.find(self.datasets, body["dataset"], "dataset")
        if any(scene["name"] == body["scene"] for scene in self.scenes):
            raise Refusal(409, "Conflict", f"The scene {body['scene']} exists.", [{"pointer": "#/scene", "detail": "this name is taken"}])
        options = {"preset": "standard", **body.get("options", {})}
        planes = options.get("planes", 3)
        scene = {"id": self.new_id("sc"), "name": body["scene"], "dataset": dataset["id"], "dataset_name": dataset["name"], "created_at": now(), "state": "new",
                 "job": "", "steps": 0, "train_seconds": 0, "psnr": None, "parameters_sha256": None, "bounds": dataset["bounds"], "loaded": True,
                 "held_out": "8 evenly spaced views of the validation split", "checkpoints": [], "memory_bytes": 412_000_000, "kernels": "avx512",
                 "config": {**contract.example("Scene")["config"], "preset": options["preset"], "planes": planes, "footprint": options.get("footprint", "rip")},
                 "differences": [{"what": "3 planes instead of 10", "measured": "+1.2 dB at 60 s (lego 400)"}, {"what": "one colour network a ray", "measured": "+0.4 dB"}],
                 "effects": [{"name": "background", "on": True, "decided": True, "number": 0.62, "threshold": 0.01, "reason": "62 % of pixels are transparent"},
                             {"name": "scale-pyramid", "on": False, "decided": True, "number": 1.04, "threshold": 1.5, "reason": "footprints differ by a factor of 1.04 only"},
                             {"name": "anisotropy", "on": True, "decided": True, "number": 3.1, "threshold": 1.5, "reason": "95th percentile of the footprints' axis ratio"},
                             {"name": "view-dependence", "on": True, "decided": False, "number": None, "threshold": 0.02, "reason": "measured after 200 steps"}]}
        job = self.job("train", dataset=dataset["id"], dataset_name=dataset["name"], scene=scene["id"], scene_name=scene["name"], options=options)
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
            scene["state"] = {"running": "training", "paused": "paused", "queued": "new", "failed": "failed"}.get(state, "ready")
        self.emit(job, "state", job)

    # -- time --
    def live(self):
        while True:
            time.sleep(0.1)
            with self.lock:
                training = [job for job in self.jobs if job["type"] == "train" and job["state"] == "running"]
                for job in reversed(self.jobs):
                    if job["state"] == "queued" and (job["type"] != "train" or not training):
                        self.set_state(job, "running")
                        break
                for job in self.jobs:
                    if job["state"] == "running":
                        self.advance(job, 0.1)

    def train_progress(self, job, seconds):
        limit = job["options"].get("max_time_s", 0)
        step = int(180 * seconds)
        return {"step": step, "max_steps": 0, "train_seconds": round(seconds, 2), "max_seconds": limit, "load_seconds": 0.4, "evaluate_seconds": 0.1 * seconds,
                "paused_seconds": 0, "yielded_seconds": 0.03 * seconds, "loss": 0.02 / (1 + seconds), "rays_per_second": 161_000, "samples_per_second": 3_120_000,
                "samples": int(3_120_000 * seconds), "level_samples": [8_000, 2_400, 300, 12], "psnr": None, "psnr_step": None,
                "nonfinite": {"rays": 0, "steps_rejected": 0, "rollbacks": 0}, "eta_seconds": limit - seconds if limit else None,
                "fraction": min(1, seconds / limit) if limit else None, "evaluating_first": False}

    def advance(self, job, dt):
        getattr(self, "advance_" + job["type"])(job, dt)

    def advance_train(self, job, dt):
        before = job["progress"]
        seconds = (before["train_seconds"] if before else 0) + 10 * dt
        progress = self.train_progress(job, seconds)
        progress["psnr"], progress["psnr_step"] = (before or {}).get("psnr"), (before or {}).get("psnr_step")
        scene = self.find(self.scenes, job["scene"], "scene")
        if int(seconds / 3) != int((seconds - 10 * dt) / 3) or seconds == 10 * dt:
            progress["psnr"] = round(33.5 - 16 / (1 + 0.25 * seconds) + 0.15 * math.sin(seconds), 3)
            progress["psnr_step"] = progress["step"]
            self.emit(job, "metric", {"step": progress["step"], "train_seconds": seconds, "psnr": progress["psnr"]})
            scene["checkpoints"] = [{"step": progress["step"], "size_bytes": 9_437_184, "created_at": now()}, *scene["checkpoints"]][:3]
        job["progress"] = progress
        scene.update(steps=progress["step"], train_seconds=progress["train_seconds"], psnr=progress["psnr"], parameters_sha256="5f" * 32)
        self.emit(job, "progress", progress)
        limit = job["options"].get("max_time_s")
        if limit and seconds >= limit:
            self.end_train(job, "time")

    def end_train(self, job, why):
        p = job["progress"]
        job["result"] = {"steps": p["step"], "train_seconds": p["train_seconds"], "samples": p["samples"], "psnr": p["psnr"], "parameters_sha256": "5f" * 32, "finished_by": why}
        self.set_state(job, "succeeded")

    def work(self, job, total, rate, dt):
        done = self.done[job["id"]] = min(total, self.done.get(job["id"], 0) + rate * dt)
        job["progress"] = {"done": int(done), "total": total, "fraction": done / total, "eta_seconds": (total - done) / rate}
        self.emit(job, "progress", job["progress"])
        return int(done)

    def advance_ingest(self, job, dt):
        if self.work(job, 40, 30, dt) == 40:
            self.add_dataset(job["dataset_name"])
            self.datasets[-1]["id"] = job["dataset"]
            job["result"] = {"dataset": job["dataset"]}
            self.set_state(job, "succeeded")

    def advance_path(self, job, dt):
        path = self.routes[job["id"]]
        keys = path["keys"]
        total = max(1, int((keys[-1]["time"] - keys[0]["time"]) * path["fps"]) + 1)
        done = self.work(job, total, 12, dt)
        frames = self.frames.setdefault(job["id"], {})
        for i in range(len(frames), done):
            key = keys[min(len(keys) - 1, i * len(keys) // total)]
            frames[i] = draw({**key, "axes": path["axes"], "width": path["width"], "height": path["height"]})
            self.emit(job, "frame", {"index": i, "url": f"/v1/jobs/{job['id']}/frames/{i}"})
        if done == total:
            job["result"] = {"frames": total, "width": path["width"], "height": path["height"], "render_ms_median": 83.0}
            self.set_state(job, "succeeded")

    def advance_eval(self, job, dt):
        if self.work(job, 8, 4, dt) == 8:
            views = [{"name": f"r_{i}", "index": i, "scale": 0, "psnr": 29.0 + 0.4 * i, "ssim": 0.95, "render_ms": 80.0 + i} for i in range(8)]
            job["result"] = {"psnr": 30.4, "ssim": 0.9512, "views": 8, "psnr_spread": 0.92, "ssim_spread": 0.004, "per_view": views, "render_ms_median": 84.0,
                             "scales": [{"scale": 0, "psnr": 30.4, "ssim": 0.9512}],
                             "protocol": {"split": "test", "background": [1, 1, 1], "downscale": "premultiplied", "rounding": "8 bit", "seed": 1, "train_split": "train",
                                          "step": 5400, "version": "0.1.0", "device": "cpu", "kernels": "avx512", "threads": 2}}
            self.evaluations.insert(0, {"job": job["id"], "scene": job["scene"], "finished_at": now(), "options": job["options"], "result": job["result"]})
            self.set_state(job, "succeeded")

    # -- requests --
    def submit(self, body):
        if body["type"] == "train":
            return self.train(body)
        scene = self.find(self.scenes, body["scene"], "scene")
        job = self.job(body["type"], scene=scene["id"], scene_name=scene["name"], options=body.get("options", {}))
        self.routes[job["id"]] = body.get("camera_path")
        return job

    def act(self, job, verb):
        target = {"pause": ("running", "queued"), "resume": ("paused",), "finish": ("running", "paused"), "cancel": ("queued", "running", "paused", "cancelled", "interrupted")}[verb]
        if job["state"] not in target:
            raise Refusal(409, "Conflict", f"The job is {job['state']}.")
        if verb == "finish":
            self.end_train(job, "finish")
        elif job["state"] != "cancelled":
            self.set_state(job, {"pause": "paused", "resume": "running", "cancel": "cancelled"}[verb])
        return job

    def ingest(self, name, entries):
        if any(item["name"] == name for item in self.datasets):
            raise Refusal(409, "Conflict", f"The dataset {name} exists.", [{"pointer": "#/name", "detail": "this name is taken"}])
        self.uploads.append(entries)
        return self.job("ingest", dataset=self.new_id("ds"), dataset_name=name)


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = 65536

    def log_message(self, *_):
        pass

    def reply(self, status, body, kind="application/json", headers=()):
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for key, value in (("Content-Type", kind), ("Content-Length", len(data)), ("Cache-Control", "no-store"), *headers):
            self.send_header(key, str(value))
        self.end_headers()
        self.wfile.write(data)
        self.wfile.flush()

    def answer(self):
        if self.server.stopping:
            self.close_connection = True
            return
        url = urllib.parse.urlsplit(self.path)
        self.query = dict(urllib.parse.parse_qsl(url.query))
        self.body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        path = urllib.parse.unquote(url.path)
        try:
            if path == "/" or path.startswith("/web/"):
                self.page(path)
            elif self.server.world.token and self.headers.get("Authorization") != f"Bearer {self.server.world.token}":
                raise Refusal(401, "Unauthorised", "A token is missing or wrong.")
            else:
                self.route(path)
        except Refusal as refusal:
            self.reply(refusal.status, refusal.body, "application/problem+json")
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True

    do_GET = do_POST = do_DELETE = answer

    def json_body(self, schema):
        """The request's JSON, refused where it does not fit the API document; without a schema, a job."""
        body = json.loads(self.body)
        schema = schema or {"train": "TrainRequest", "path": "PathRequest", "eval": "EvalRequest"}[body["type"]]
        errors = contract.errors(schema, body)
        if errors:
            raise Refusal(422, "Invalid", "A value is wrong.", errors)
        return body

    def page(self, path):
        file = WEB / ("index.html" if path == "/" else path.removeprefix("/web/"))
        if not file.is_file():
            raise Refusal(404, "Not found", path)
        self.reply(200, file.read_bytes(), TYPES[file.suffix], [("Content-Security-Policy", CSP)])

    def route(self, path):
        for pattern, name in ROUTES:
            match = re.fullmatch(pattern, f"{self.command} {path}")
            if match:
                return getattr(self, name)(self.server.world, *match.groups())
        raise Refusal(404, "Not found", path)

    def items(self, items):
        self.reply(200, {"items": items, "next_cursor": None})

    def info(self, world):
        self.reply(200, {"version": "0.1.0", "device": "cpu", "device_name": "AMD EPYC 9654", "kernels": "avx512", "available_kernels": ["generic", "avx2", "avx512"],
                         "threads": 2, "uptime_s": 4211.0, "memory_limit_bytes": 8 << 30, "roots": [],
                         "limits": {"max_body_bytes": 1 << 20, "max_upload_bytes": 32 << 30, "max_upload_entries": 100000, "max_queued_jobs": 64,
                                    "max_training_jobs": 1, "max_render_pixels": 67108864, "max_scenes_loaded": 4}})

    def lists(self, world, what):
        with world.lock:
            items = {"datasets": world.datasets, "scenes": world.scenes, "jobs": world.jobs, "camera-paths": world.paths}[what]
            self.items(items)

    def one(self, world, what, key):
        with world.lock:
            items = {"datasets": world.datasets, "scenes": world.scenes, "jobs": world.jobs, "camera-paths": world.paths}[what]
            item = world.find(items, key, what[:-1])
            if self.command == "DELETE":
                items.remove(item)
                self.reply(204, b"")
            else:
                self.reply(200, item)

    def cameras(self, world, _key):
        self.reply(200, {"items": world.cameras()})

    def photo(self, world, _key, split, index):
        found = [item for item in world.cameras() if item["split"] == split][int(index)]
        self.reply(200, draw(found["camera"]), "image/png")

    def add_dataset(self, world):
        with world.lock:
            if self.headers["Content-Type"] != "application/x-tar":
                self.json_body("DatasetRequest")
                raise Refusal(403, "Forbidden", "The daemon was started without --dataset-root.", [{"pointer": "#/directory", "detail": "no folder of this machine may be read"}])
            with tarfile.open(fileobj=io.BytesIO(self.body)) as tar:
                entries = [(member.name, member.size) for member in tar]
            self.reply(202, world.ingest(self.query["name"], entries))

    def submit(self, world):
        with world.lock:
            self.reply(202, world.submit(self.json_body(None)))

    def act(self, world, key, verb):
        with world.lock:
            self.reply(200, world.act(world.find(world.jobs, key, "job"), verb))

    def render(self, world, key):
        with world.lock:
            scene = world.find(world.scenes, key, "scene")
            if not scene["steps"]:
                raise Refusal(409, "Conflict", "The scene has no parameters yet.")
        body = self.json_body("RenderRequest")
        camera = body.get("camera") or {**world.cameras()[0]["camera"], **body["size"]}
        started = time.perf_counter()
        picture = draw(camera, body.get("output", "rgb"), min(1, 0.35 + scene["train_seconds"] / 30))
        spent = 1000 * (time.perf_counter() - started)
        self.reply(200, picture, "image/png", [("Server-Timing", f"queue;dur=0.2, render;dur={spent:.2f}, encode;dur=1.1"),
                                               ("X-Ripnerf-Step", scene["steps"]), ("X-Ripnerf-Samples", camera["width"] * camera["height"] * 14)])

    def evaluations(self, world, key):
        with world.lock:
            scene = world.find(world.scenes, key, "scene")
            self.items([{k: v for k, v in item.items() if k != "scene"} for item in world.evaluations if item["scene"] == scene["id"]])

    def frames(self, world, key):
        with world.lock:
            self.items([{"index": i, "url": f"/v1/jobs/{key}/frames/{i}"} for i in world.frames.get(key, {})])

    def frame(self, world, key, index):
        with world.lock:
            data = world.frames.get(key, {}).get(int(index))
        if data is None:
            raise Refusal(404, "Not found", f"Frame {index} is not there yet.")
        self.reply(200, data, "image/png")

    def frames_tar(self, world, key):
        out = io.BytesIO()
        with world.lock, tarfile.open(fileobj=out, mode="w") as tar:
            for index, data in world.frames.get(key, {}).items():
                member = tarfile.TarInfo(f"{index:05d}.png")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))
        self.reply(200, out.getvalue(), "application/x-tar")

    def keep_path(self, world):
        body = self.json_body("CameraPathRequest")
        with world.lock:
            record = {"id": world.new_id("path"), "created_at": now(), **body}
            world.paths.insert(0, record)
            self.reply(201, record)

    def events(self, world, key=None):
        """A stream from the first event on (one job), or from now (all of them)."""
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        self.close_connection = True
        with world.lock:
            at = 0 if key else len(world.events)
        while not self.server.stopping:
            with world.lock:
                if at == len(world.events):
                    world.news.wait(0.5)
                fresh, at = world.events[at:], len(world.events)
            for number, job, kind, data in fresh:
                if key not in (None, job) or key is None and kind in ("metric", "frame"):
                    continue
                body = {"job": job, "progress": data} if key is None and kind == "progress" else data
                self.wfile.write(f"id: {number}\nevent: {kind}\ndata: {json.dumps(body)}\n\n".encode())
                if key and kind == "state" and data["state"] in OVER:
                    self.wfile.flush()
                    return
            if not fresh:
                self.wfile.write(b": still here\n\n")
            self.wfile.flush()


ID = "([A-Za-z0-9._-]+)"
ROUTES = [
    (r"GET /v1/info", "info"), (r"GET /v1/(datasets|scenes|jobs|camera-paths)", "lists"),
    (rf"(?:GET|DELETE) /v1/(datasets|scenes|jobs|camera-paths)/{ID}", "one"), (rf"GET /v1/datasets/{ID}/cameras", "cameras"),
    (rf"GET /v1/datasets/{ID}/images/(train|val|test)/(\d+)", "photo"), (r"POST /v1/datasets", "add_dataset"), (r"POST /v1/jobs", "submit"),
    (rf"POST /v1/jobs/{ID}/(pause|resume|finish|cancel)", "act"), (rf"POST /v1/scenes/{ID}/render", "render"),
    (rf"GET /v1/scenes/{ID}/evaluations", "evaluations"), (rf"GET /v1/jobs/{ID}/frames", "frames"), (rf"GET /v1/jobs/{ID}/frames/(\d+)", "frame"),
    (rf"GET /v1/jobs/{ID}/frames\.tar", "frames_tar"), (r"POST /v1/camera-paths", "keep_path"), (rf"GET /v1/jobs/{ID}/events", "events"), (r"GET /v1/events", "events"),
]


class FakeApi(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, port=0, scenario="busy"):
        super().__init__(("127.0.0.1", port), Handler)
        self.world = World(scenario)
        self.stopping = False
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_address[1]}/"

    def stop(self):
        self.stopping = True
        self.shutdown()
        self.server_close()

    def handle_error(self, request, client_address):
        pass  # a browser that leaves is no error


if __name__ == "__main__":
    api = FakeApi(int(sys.argv[1]) if len(sys.argv) > 1 else 7400, sys.argv[2] if len(sys.argv) > 2 else "busy")
    print(api.url, flush=True)
    threading.Event().wait()
