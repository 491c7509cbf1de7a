"""A daemon without an engine, for tests of the client alone.

It answers the documented API from memory; requests are checked against openapi.yaml. What a job
does is told by the name of its scene or dataset:

    fail    the job fails             slow    it runs until it is finished, paused or cancelled
    drop    its event stream breaks off once, in the middle
"""

import io
import itertools
import json
import random
import re
import socket
import tarfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, unquote, urlsplit

from support import contract

TERMINAL = ("succeeded", "failed", "cancelled")
PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010806000000"
    "1f15c4890000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082")
NOW = "2026-03-01T09:30:00.000Z"


class Problem(Exception):
    def __init__(self, status, slug, detail, errors=None):
        super().__init__(detail)
        self.status = status
        self.body = {"type": f"/problems/{slug}", "title": slug.replace("-", " ").capitalize(),
                     "status": status, "detail": detail}
        if errors:
            self.body["errors"] = errors


def new_id(prefix):
    return prefix + "_" + "".join(random.choice("abcdefghijklmnopqrstuvwxyz234567")
                                  for _ in range(12))


class Job:
    """A job's record and its events; a thread plays it."""

    def __init__(self, kind, name, options, **links):
        self.name = name
        self.condition = threading.Condition()
        self.events = []
        self.wanted = None
        self.dropped = "drop" not in name
        self.record = {"id": new_id("job"), "type": kind, "state": "queued", "attempt": 1,
                       "created_at": NOW, "started_at": None, "finished_at": None, **links,
                       "options": options, "progress": None}

    def emit(self, event, data):
        with self.condition:
            self.events.append((event, json.dumps(data)))
            self.condition.notify_all()

    def move(self, state, **fields):
        with self.condition:
            self.record.update(state=state, **fields)
        self.emit("state", self.record)

    def want(self, action):
        with self.condition:
            state = self.record["state"]
            if state in TERMINAL and not (action == "cancel" and state == "cancelled"):
                raise Problem(409, "conflict", f"the job is {state}")
            self.wanted = action
            self.condition.notify_all()
        if action in ("pause", "resume"):
            self.move("paused" if action == "pause" else "running")

    def wait_for_order(self):
        with self.condition:
            while self.wanted not in ("cancel", "finish"):
                self.condition.wait(0.05)
        return self.wanted

    def play(self, steps, succeed):
        if self.record["state"] == "queued":  # it was not paused first
            self.move("running", started_at=NOW)
        for event, data in steps:
            if event == "progress":
                self.record["progress"] = data
            self.emit(event, data)
            time.sleep(0.01)
        if "slow" in self.name and self.wait_for_order() == "cancel":
            self.move("cancelled", finished_at=NOW)
        elif "fail" in self.name:
            self.move("failed", finished_at=NOW,
                      problem={"type": "/problems/runner-failed", "title": "The runner failed",
                               "status": 500, "detail": "the loss is not finite"})
        else:
            result = succeed()
            self.move("succeeded", finished_at=NOW, result=result)


class FakeDaemon:
    """`with FakeDaemon() as daemon:` serves on daemon.url."""

    def __init__(self, token=None):
        self.token = token
        self.datasets, self.scenes, self.jobs, self.frames = {}, {}, {}, {}
        self.requests = []
        self.refusal = None  # a Problem that answers each POST
        self.held = None     # an answer to a path that ends so breaks off, and its connection stays
        self.away = False    # event streams break off, and connections are closed unanswered
        self.refused = 0     # how many
        self.uploads = {}  # dataset: {file: bytes}
        self.parts = {}    # upload: (size, bytes so far)
        self.cut_after = None  # a part's connection is cut once, after so many bytes
        self.stuck = False  # instead nothing more of it is taken, until the client is gone
        handler = type("Handler", (Handler,), {"daemon": self})
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self.server.daemon_threads = True
        self.server.verify_request = self.is_there
        self.url = f"http://127.0.0.1:{self.server.server_port}"

    def __enter__(self):
        threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.server.server_close()

    def is_there(self, *_):
        self.refused += self.away
        return not self.away

    def find(self, table, reference):
        for record in table.values():
            if reference in (record["id"], record.get("name")):
                return record
        raise Problem(404, "not-found", f"there is no '{reference:.64}'")

    def job(self, job_id):
        if job_id not in self.jobs:
            raise Problem(404, "not-found", f"there is no job {job_id:.64}")
        return self.jobs[job_id]

    def add_dataset(self, name):
        record = contract.example("Dataset") | {"id": new_id("ds"), "name": name}
        self.datasets[record["id"]] = record
        return record

    def add_scene(self, name, dataset, job="job_aaaaaaaaaaaa"):
        record = contract.example("Scene") | {
            "id": new_id("sc"), "name": name, "dataset": dataset["id"],
            "dataset_name": dataset["name"], "job": job}
        self.scenes[record["id"]] = record
        return record

    def start(self, job, steps, succeed):
        self.jobs[job.record["id"]] = job
        job.emit("state", job.record)
        threading.Thread(target=job.play, args=(steps, succeed), daemon=True).start()
        return job.record

    # ---- operations ----
    def begin_upload(self, request):
        contract.check("UploadRequest", request)
        self.check_name(request.get("name"))
        upload = new_id("up")
        self.parts[upload] = (request["size_bytes"], b"")
        return self.upload(upload)

    def upload(self, upload):
        if upload not in self.parts:
            raise Problem(404, "not-found", f"there is no upload {upload}")
        size, there = self.parts[upload]
        return {"id": upload, "size_bytes": size, "offset": len(there)}

    def take_part(self, upload, offset, body):
        size, there = self.parts[upload]
        assert offset <= len(there)
        self.parts[upload] = (size, there[:offset] + body)

    def import_upload(self, request):
        contract.check("DatasetRequest", request)
        size, there = self.parts.pop(request["upload"])
        assert len(there) == size
        return self.ingest({"name": request["name"], **request.get("options", {})}, there)

    def check_name(self, name):
        if any(record["name"] == name for record in self.datasets.values()):
            raise Problem(409, "conflict", f"there is a dataset '{name}' already")

    def ingest(self, query, body):
        name = query["name"]
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", name):
            raise Problem(422, "invalid", "the name is not valid",
                          [{"pointer": "#/name", "detail": "must be letters, digits, . _ -"}])
        self.check_name(name)
        with tarfile.open(fileobj=io.BytesIO(body), mode="r:") as archive:
            self.uploads[name] = {member.name: archive.extractfile(member).read()
                                  for member in archive.getmembers()}
        dataset_id = new_id("ds")
        options = {key: int(value) if str(value).isdigit() else value
                   for key, value in query.items() if key != "name"}
        contract.check("IngestOptions", options)
        job = Job("ingest", name, options, dataset=dataset_id, dataset_name=name)

        def succeed():
            self.datasets[dataset_id] = contract.example("Dataset") | {"id": dataset_id,
                                                                       "name": name}
            return {"dataset": dataset_id}

        work = [("progress", contract.example("WorkProgress") | {"done": i, "total": 4,
                                                                 "fraction": i / 4})
                for i in range(5)]
        return self.start(job, work, succeed)

    def submit(self, request):
        schema = request.get("type", "?").capitalize() + "Request"
        errors = contract.errors("JobRequest", request)
        if errors:
            raise Problem(422, "invalid", f"not a {schema}", contract.errors(schema, request))
        return getattr(self, "submit_" + request["type"])(request)

    def submit_train(self, request):
        dataset = self.find(self.datasets, request["dataset"])
        name = request["scene"]
        if any(scene["name"] == name for scene in self.scenes.values()):
            raise Problem(409, "conflict", f"there is a scene '{name}' already")
        job = Job("train", name, request.get("options", {}), dataset=dataset["id"],
                  dataset_name=dataset["name"], scene_name=name)
        scene = self.add_scene(name, dataset, job.record["id"])
        job.record["scene"] = scene["id"]
        progress = contract.example("TrainProgress")
        steps = [("progress", progress | {"step": step, "fraction": step / 400})
                 for step in (100, 200, 300)]
        steps.insert(1, ("metric", {"step": 100, "train_seconds": 3.0, "psnr": 27.5}))
        return self.start(job, steps, lambda: contract.example("TrainResult"))

    def submit_path(self, request):
        scene = self.find(self.scenes, request["scene"])
        options = request.get("options", {})
        job = Job("path", scene["name"], options, scene=scene["id"], scene_name=scene["name"],
                  dataset=scene["dataset"], dataset_name=scene["dataset_name"])
        job_id = job.record["id"]
        first, last = options.get("first", 0), options.get("last", 5)
        count = last - first + 1
        steps = []
        for i, index in enumerate(range(first, last + 1), 1):
            self.frames[job_id, index] = PNG + bytes([index])
            steps.append(("frame", {"index": index, "url": f"/v1/jobs/{job_id}/frames/{index}"}))
            steps.append(("progress", contract.example("WorkProgress")
                          | {"done": i, "total": count, "fraction": i / count}))
        return self.start(job, steps, lambda: contract.example("PathResult") | {"frames": count})

    def submit_eval(self, request):
        scene = self.find(self.scenes, request["scene"])
        job = Job("eval", scene["name"], request.get("options", {}), scene=scene["id"],
                  scene_name=scene["name"], dataset=scene["dataset"],
                  dataset_name=scene["dataset_name"])
        steps = [("progress", contract.example("WorkProgress"))]
        return self.start(job, steps, lambda: contract.example("EvalResult"))

    def submit_export(self, request):
        scene = self.find(self.scenes, request["scene"])
        job = Job("export", scene["name"], request["options"], scene=scene["id"],
                  scene_name=scene["name"])
        return self.start(job, [], lambda: {"file": "mesh.ply", "bytes": 3,
                                            "vertices": 3, "triangles": 1})

    def remove(self, table, reference):
        record = self.find(table, reference)
        if table is self.datasets and any(scene["dataset"] == record["id"]
                                          for scene in self.scenes.values()):
            raise Problem(409, "conflict", "a scene uses the dataset")
        del table[record["id"]]


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    daemon = None

    def log_message(self, *_):
        pass

    def reply(self, status, body=None, content_type="application/json", headers=()):
        data = body if isinstance(body, bytes) else json.dumps(body).encode() if body else b""
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        if data:
            self.send_header("Content-Type", content_type)
        for name, value in headers:
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(data)

    def serve(self):
        url = urlsplit(self.path)
        query = {key: values[0] for key, values in parse_qs(url.query).items()}
        parts = [unquote(part) for part in url.path.split("/")[1:]]
        daemon = self.daemon
        size = int(self.headers.get("Content-Length", 0))
        if self.command == "PATCH" and daemon.cut_after is not None:
            return self.cut(parts[-1], daemon.cut_after)
        body = self.rfile.read(size)
        daemon.requests.append((self.command, self.path, dict(self.headers), body))
        try:
            if daemon.token and self.headers.get("Authorization") != f"Bearer {daemon.token}":
                raise Problem(401, "unauthorised", "a token is missing or wrong")
            if daemon.refusal and self.command == "POST":
                raise daemon.refusal
            if daemon.held and self.path.endswith(daemon.held):
                return self.hold()
            self.route(parts, query, body)
        except Problem as problem:
            contract.check("Problem", problem.body)
            self.reply(problem.status, problem.body, "application/problem+json")
        except (BrokenPipeError, ConnectionResetError):
            pass

    def cut(self, upload, count):
        """Takes the part's first bytes, and then the line is dead."""
        self.daemon.cut_after = None
        self.daemon.take_part(upload, int(self.headers["Upload-Offset"]), self.rfile.read(count))
        self.daemon.requests.append((self.command, self.path, dict(self.headers), b""))
        self.close_connection = True
        if self.daemon.stuck:
            return self.rfile.read()
        return self.connection.shutdown(socket.SHUT_RDWR)

    def hold(self):
        """Answers the beginning of much, and no more before the client is gone."""
        self.close_connection = True
        self.send_response(200)
        self.send_header("Content-Length", str(1 << 20))
        self.end_headers()
        self.wfile.write(PNG)
        self.rfile.read(1)

    do_GET = do_POST = do_PATCH = do_DELETE = serve

    def route(self, parts, query, body):
        daemon = self.daemon
        tables = {"datasets": daemon.datasets, "scenes": daemon.scenes, "camera-paths": {}}
        match (self.command, *parts[1:]):
            case ("GET", "info"):
                self.reply(200, contract.example("Info"))
            case ("POST", "uploads"):
                self.reply(201, daemon.begin_upload(json.loads(body)))
            case ("GET", "uploads", upload):
                self.reply(200, daemon.upload(upload))
            case ("PATCH", "uploads", upload):
                daemon.take_part(upload, int(self.headers["Upload-Offset"]), body)
                self.reply(204)
            case ("DELETE", "uploads", upload):
                daemon.upload(upload)
                del daemon.parts[upload]
                self.reply(204)
            case ("POST", "datasets"):
                self.accept(daemon.import_upload(json.loads(body)))
            case ("POST", "jobs"):
                self.accept(daemon.submit(json.loads(body)))
            case ("GET", "jobs"):
                self.page([job.record for job in daemon.jobs.values()], query)
            case ("GET", "jobs", job_id):
                self.reply(200, daemon.job(job_id).record)
            case ("GET", "jobs", job_id, "events"):
                self.stream(daemon.job(job_id))
            case ("GET", "jobs", job_id, "frames"):
                self.page([{"index": index, "url": f"/v1/jobs/{job_id}/frames/{index}"}
                           for owner, index in daemon.frames if owner == job_id], query)
            case ("GET", "jobs", job_id, "frames", index):
                self.reply(200, daemon.frames[job_id, int(index)], "image/png")
            case ("GET", "jobs", job_id, "export"):
                self.reply(200, b"ply", "model/ply")
            case ("POST", "jobs", job_id, action):
                job = daemon.job(job_id)
                job.want(action)
                self.reply(200, job.record)
            case ("POST", "scenes", reference, "render"):
                self.render(daemon.find(daemon.scenes, reference), json.loads(body))
            case ("GET", ("datasets" | "scenes" | "camera-paths") as kind):
                self.page(list(tables[kind].values()), query)
            case ("GET", ("datasets" | "scenes" | "camera-paths") as kind, reference):
                self.reply(200, daemon.find(tables[kind], reference))
            case ("DELETE", ("datasets" | "scenes" | "camera-paths") as kind, reference):
                daemon.remove(tables[kind], reference)
                self.reply(204)
            case _:
                raise Problem(404, "not-found", f"there is no {self.path:.200}")

    def accept(self, record):
        self.reply(202, record, headers=[("Location", f"/v1/jobs/{record['id']}")])

    def page(self, items, query):
        """Two items a page, so that a client that forgets the cursor is found out."""
        first = int(query.get("cursor", 0))
        more = first + 2 < len(items)
        self.reply(200, {"items": items[first:first + 2],
                         "next_cursor": str(first + 2) if more else None})

    def render(self, scene, request):
        errors = contract.errors("RenderRequest", request)
        if errors:
            raise Problem(422, "invalid", "not a RenderRequest", errors)
        if request.get("view", "").endswith(":999"):
            wrong = "no such view at scale 0; the test split has test:0 to test:7"
            raise Problem(404, "not-found", f"#/view: {wrong}",
                          [{"pointer": "#/view", "detail": wrong}])
        kind = "image/jpeg" if request.get("format") == "jpeg" else "image/png"
        self.reply(200, PNG, kind, [
            ("Server-Timing", "queue;dur=0.1, render;dur=12.5, encode;dur=1.5"),
            ("X-Ripnerf-Step", str(scene["steps"])), ("X-Ripnerf-Samples", "12345")])

    def stream(self, job):
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Connection", "close")
        self.end_headers()
        self.close_connection = True
        self.wfile.write(b": hello\n\n")
        start = int(self.headers.get("Last-Event-ID", "0"))
        for number in itertools.count(start + 1):
            with job.condition:
                while len(job.events) < number:
                    if self.daemon.away:
                        return
                    job.condition.wait(0.05)
                event, data = job.events[number - 1]
            self.wfile.write(f"id: {number}\nevent: {event}\ndata: {data}\n\n".encode())
            self.wfile.flush()
            if event == "state" and json.loads(data)["state"] in TERMINAL:
                return
            if number == 4 and not job.dropped:
                job.dropped = True
                return
