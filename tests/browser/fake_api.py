"""A stand-in for the daemon's interface, in memory, for the page's states.

By hand: fake_api.py [PORT [SCENARIO]].

It answers what the page asks, in the shapes of proto/openapi.yaml, trains at ten times the speed
of a clock, and draws a banded ball so that a camera's motion shows. Scenarios: empty, busy, failed,
token, bare.
"""

import io
import json
import re
import sys
import tarfile
import threading
import time
import urllib.parse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from fake_pictures import draw
from fake_world import OVER, Refusal, World, contract, now

WEB = Path(__file__).resolve().parents[2] / "web"
FORMATS = WEB.parent / "proto/examples/FormatList.json"
INFO = WEB.parent / "proto/examples/Info.json"
CSP = (
    "default-src 'self'; img-src 'self' blob:; media-src 'self' blob:; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = 65536

    def log_message(self, *_):
        pass

    def reply(self, status, body, kind="application/json", headers=()):
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for key, value in (
            ("Content-Type", kind),
            ("Content-Length", len(data)),
            ("Cache-Control", "no-store"),
            *headers,
        ):
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
        size = int(self.headers.get("Content-Length") or 0)
        if (self.command == "PATCH"
                and int(self.headers["Upload-Offset"]) < self.server.world.line_dead_below
                and url.path.rsplit("/", 1)[1] not in self.server.world.looked_at):
            size = 1000  # so much arrives, and the line is dead
            self.close_connection = True
        self.body = self.rfile.read(size)
        path = urllib.parse.unquote(url.path)
        try:
            if path == "/" or path.startswith("/web/"):
                self.page(path)
            elif (
                self.server.world.token
                and self.headers.get("Authorization") != f"Bearer {self.server.world.token}"
            ):
                raise Refusal(401, "Unauthorised", "A token is missing or wrong.")
            else:
                self.route(path)
        except Refusal as refusal:
            self.reply(refusal.status, refusal.body, "application/problem+json")
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True

    do_GET = do_POST = do_PATCH = do_DELETE = answer

    def json_body(self, schema):
        """The request's JSON if it fits the API document; without a schema, a job."""
        body = json.loads(self.body)
        schema = (
            schema
            or {"train": "TrainRequest", "path": "PathRequest", "eval": "EvalRequest",
                "estimate": "EstimateRequest", "doctor": "DoctorRequest",
                "validate": "ValidateRequest"}[body["type"]]
        )
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

    def formats(self, world):
        self.reply(200, json.loads(FORMATS.read_text(encoding="utf-8")))

    def info(self, world):
        self.reply(
            200,
            {
                "version": "0.1.0",
                "device": "cpu",
                "device_name": "AMD EPYC 9654",
                "kernels": "avx512",
                "available_kernels": ["generic", "avx2", "avx512"],
                "threads": 2,
                "films": world.films,
                "uptime_s": 4211.0,
                "memory_limit_bytes": 8 << 30,
                "roots": [],
                "effects": json.loads(INFO.read_text(encoding="utf-8"))["effects"],
                "you": {"id": None, "name": None, "scope": "admin", "scene": None, "job": None,
                        "created_at": None, "expires_at": None, "max_jobs": 0, "max_bytes": 0,
                        "open_jobs": 0, "bytes": 0},
                "limits": {
                    "max_body_bytes": 1 << 20,
                    "max_upload_bytes": 32 << 30,
                    "max_upload_entries": 100000,
                    "max_queued_jobs": 64,
                    "max_training_jobs": 1,
                    "max_render_pixels": 67108864,
                    "max_scenes_loaded": 4,
                },
            },
        )

    def lists(self, world, what):
        with world.lock:
            items = {
                "datasets": world.datasets,
                "scenes": world.scenes,
                "jobs": world.jobs,
                "camera-paths": world.paths,
            }[what]
            if what == "camera-paths":
                items = [{key: item[key] for key in ("id", "name", "created_at")}
                         for item in items]
            self.items(items)

    def one(self, world, what, key):
        with world.lock:
            items = {
                "datasets": world.datasets,
                "scenes": world.scenes,
                "jobs": world.jobs,
                "camera-paths": world.paths,
            }[what]
            item = world.find(items, key, what[:-1])
            if self.command == "DELETE":
                items.remove(item)
                self.reply(204, b"")
            else:
                self.reply(200, item)

    def points(self, _world, _key):
        items = [[0.1 * i, 0.2 * j, 0.05 * (i + j), 40 * i, 40 * j, 120] for i in range(6) for j in range(5)]
        self.reply(200, {"count": 31, "items": items})

    def cameras(self, world, _key):
        self.reply(200, {"items": world.cameras()})

    def photo(self, world, _key, split, index):
        views = world.cameras()
        found = next(item for item in views if (item["split"], item["index"]) == (split, int(index)))
        self.reply(200, draw(found["camera"]), "image/png")

    def begin_upload(self, world):
        body = self.json_body("UploadRequest")
        with world.lock:
            if any(item["name"] == body.get("name") for item in world.datasets):
                raise Refusal(409, "Conflict", "That name is taken.",
                              [{"pointer": "#/name", "detail": "there is a dataset of that name"}])
            upload = world.new_id("up")
            world.uploads[upload] = (body["size_bytes"], b"")
            if "name" not in body:  # to be looked at, not kept
                world.looked_at.add(upload)
        self.reply(201, {"id": upload, "size_bytes": body["size_bytes"], "offset": 0})

    def upload(self, world, key):
        with world.lock:
            if key not in world.uploads:
                raise Refusal(404, "Not found", "There is no such upload.")
            size, there = world.uploads[key]
            if self.command == "DELETE":
                del world.uploads[key]
                self.reply(204, b"")
            elif self.command == "PATCH":
                at = int(self.headers["Upload-Offset"])
                world.uploads[key] = (size, there[:at] + self.body + there[at + len(self.body):])
                if key not in world.looked_at:
                    world.parts.append((at, len(self.body)))
                if self.close_connection:
                    return
                self.reply(204, b"")
            else:
                self.reply(200, {"id": key, "size_bytes": size, "offset": len(there)})

    def add_dataset(self, world):
        with world.lock:
            body = self.json_body("DatasetRequest")
            if "upload" not in body:
                raise Refusal(
                    403,
                    "Forbidden",
                    "The daemon was started without --dataset-root.",
                    [{"pointer": "#/directory", "detail": "no folder of this machine may be read"}],
                )
            _, there = world.uploads.pop(body["upload"])
            with tarfile.open(fileobj=io.BytesIO(there)) as tar:
                entries = [(member.name, member.size) for member in tar]
            self.reply(202, world.ingest(body["name"], entries, body.get("options", {})))

    def submit(self, world):
        with world.lock:
            self.reply(202, world.submit(self.json_body(None)))

    def act(self, world, key, verb):
        with world.lock:
            answer = world.act(world.find(world.jobs, key, "job"), verb)
            self.reply(200 if answer["id"] == key else 202, answer)

    def render(self, world, key):
        with world.lock:
            scene = world.find(world.scenes, key, "scene")
            if not scene["steps"] and not world.untrained:
                raise Refusal(409, "Conflict", "The scene has no parameters yet.")
        body = self.json_body("RenderRequest")
        world.on_render(body)
        camera = body.get("camera") or {**world.view(body["view"]), **body["size"]}
        started = time.perf_counter()
        picture = draw(
            camera, body.get("output", "rgb"), min(1, 0.35 + scene["train_seconds"] / 30)
        )
        spent = 1000 * (time.perf_counter() - started)
        self.reply(
            200,
            picture,
            "image/png",
            [
                ("Server-Timing", f"queue;dur={world.waited_ms}, render;dur={spent:.2f}, encode;dur=1.1"),
                ("X-Ripnerf-Step", scene["steps"]),
                *([("X-Ripnerf-At", body["at"])] if "at" in body else []),
                *([("X-Ripnerf-Scale", HEAT[body["output"]])] if body.get("output") in HEAT else []),
                ("X-Ripnerf-Samples", camera["width"] * camera["height"] * 14),
                *self.budget(body, world.waited_ms + spent + 1.1),
            ],
        )

    @staticmethod
    def budget(body, spent):
        if "within_ms" not in body:
            return []
        return [("X-Ripnerf-Asked-Ms", body["within_ms"]), ("X-Ripnerf-Spent-Ms", f"{spent:.1f}"),
                ("X-Ripnerf-Setting", "tolerance=0.03"), ("X-Ripnerf-Curve", "measured"),
                ("X-Ripnerf-Expected-Psnr", "30.4"), ("X-Ripnerf-Expected-Spread", "0.52"),
                ("X-Ripnerf-Late", str(int(spent > body["within_ms"])))]

    def convert_path(self, _world):
        """This program's own format alone; tests/api has the others."""
        body = self.json_body("PathConversionRequest")
        if "path" in body:
            self.reply(200, {"format": body["to"], "file": json.dumps({"path": body["path"]})})
            return
        if "of a training" in body["file"] and "space" not in body:
            raise Refusal(422, "Invalid", "", [{"pointer": "#/space", "detail": "must be given"}])
        try:
            self.reply(200, {"format": "ripnerf", "path": json.loads(body["file"])["path"]})
        except (ValueError, KeyError) as error:
            why = "is no camera path that is known"
            raise Refusal(422, "Invalid", f"#/file: {why}",
                          [{"pointer": "#/file", "detail": why}]) from error

    def take_scene(self, world):
        with world.lock:
            if any(item["name"] == self.query["name"] for item in world.scenes):
                raise Refusal(409, "Conflict", "That name is taken.",
                              [{"pointer": "#/name", "detail": "there is a scene of that name"}])
            world.uploaded.append(self.body)
            self.reply(202, world.job("ingest", scene=world.new_id("sc"),
                                      scene_name=self.query["name"]))

    def curve(self, world, _key):
        if not world.curve:
            raise Refusal(404, "Not found", "the curve was not measured yet")
        self.reply(200, world.curve)

    def effects(self, world, _key):
        if not world.effects:
            raise Refusal(404, "Not found", "it was not measured yet")
        self.reply(200, world.effects)

    def incidents(self, world, _key):
        self.reply(200, {"count": len(world.incidents), "items": world.incidents})

    def report(self, world, _key):
        if not world.report:
            raise Refusal(404, "Not found", "the ladder has not begun yet")
        self.reply(200, world.report)

    def evaluations(self, world, key):
        with world.lock:
            scene = world.find(world.scenes, key, "scene")
            self.items(
                [
                    {k: v for k, v in item.items() if k != "scene"}
                    for item in world.evaluations
                    if item["scene"] == scene["id"]
                ]
            )

    def metrics(self, world, key):
        with world.lock:
            self.items([data for _, job, kind, data in world.events if (job, kind) == (key, "metric")])

    def frames(self, world, key):
        with world.lock:
            self.items(
                [
                    {"index": i, "url": f"/v1/jobs/{key}/frames/{i}"}
                    for i in world.frames.get(key, {})
                ]
            )

    def frame(self, world, key, index):
        with world.lock:
            data = world.frames.get(key, {}).get(int(index))
        if data is None:
            raise Refusal(404, "Not found", f"Frame {index} is not there yet.")
        self.reply(200, data, "image/png")

    def film(self, world, key):
        with world.lock:
            job = world.find(world.jobs, key, "job")
            if "result" not in job or "film" not in job["result"]:
                raise Refusal(404, "Not found", "the job has no film (yet)")
            data = world.frames[key][0]
        self.reply(200, data, "image/gif")

    def path_of_job(self, world, key):
        if not world.routes.get(key):
            raise Refusal(404, "Not found", "a job without a camera path")
        self.reply(200, world.routes[key])

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
            self.server.streams += 1
        try:
            self.follow(world, key)
        finally:
            with world.lock:
                self.server.streams -= 1

    def follow(self, world, key):
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
                body = (
                    {"job": job, "progress": data} if key is None and kind == "progress" else data
                )
                self.wfile.write(
                    f"id: {number}\nevent: {kind}\ndata: {json.dumps(body)}\n\n".encode()
                )
                if key and kind == "state" and data["state"] in OVER:
                    self.wfile.flush()
                    return
            if not fresh:
                self.wfile.write(b": still here\n\n")
            self.wfile.flush()


HEAT = {"cost": "0 50 samples", "level": "0 7 levels", "footprint": "0 0.02 units"}
ID = "([A-Za-z0-9._-]+)"
ROUTES = [
    (r"GET /v1/info", "info"),
    (r"GET /v1/formats", "formats"),
    (r"GET /v1/(datasets|scenes|jobs|camera-paths)", "lists"),
    (rf"(?:GET|DELETE) /v1/(datasets|scenes|jobs|camera-paths)/{ID}", "one"),
    (rf"GET /v1/datasets/{ID}/cameras", "cameras"),
    (rf"GET /v1/datasets/{ID}/points", "points"),
    (rf"GET /v1/datasets/{ID}/images/(train|val|test)/(\d+)", "photo"),
    (r"POST /v1/datasets", "add_dataset"),
    (r"POST /v1/uploads", "begin_upload"),
    (rf"(?:GET|PATCH|DELETE) /v1/uploads/{ID}", "upload"),
    (r"POST /v1/jobs", "submit"),
    (rf"POST /v1/jobs/{ID}/(pause|resume|finish|cancel)", "act"),
    (r"POST /v1/scenes", "take_scene"),
    (rf"POST /v1/scenes/{ID}/render", "render"),
    (rf"GET /v1/scenes/{ID}/evaluations", "evaluations"),
    (rf"GET /v1/scenes/{ID}/curve", "curve"),
    (rf"GET /v1/scenes/{ID}/effects", "effects"),
    (rf"GET /v1/scenes/{ID}/incidents", "incidents"),
    (rf"GET /v1/jobs/{ID}/metrics", "metrics"),
    (rf"GET /v1/jobs/{ID}/report", "report"),
    (rf"GET /v1/jobs/{ID}/frames", "frames"),
    (rf"GET /v1/jobs/{ID}/film", "film"),
    (rf"GET /v1/jobs/{ID}/camera-path", "path_of_job"),
    (rf"GET /v1/jobs/{ID}/frames/(\d+)", "frame"),
    (rf"GET /v1/jobs/{ID}/frames\.tar", "frames_tar"),
    (r"POST /v1/camera-paths", "keep_path"),
    (r"POST /v1/camera-paths/convert", "convert_path"),
    (rf"GET /v1/jobs/{ID}/events", "events"),
    (r"GET /v1/events", "events"),
]


class FakeApi(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, port=0, scenario="busy"):
        super().__init__(("127.0.0.1", port), Handler)
        self.world = World(scenario)
        self.stopping = False
        self.streams = 0  # of events, that someone reads
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
    api = FakeApi(
        int(sys.argv[1]) if len(sys.argv) > 1 else 7400,
        sys.argv[2] if len(sys.argv) > 2 else "busy",
    )
    print(api.url, flush=True)
    threading.Event().wait()
