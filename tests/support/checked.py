"""A real ripnerfd on a free port, and a client that checks every exchange with openapi.yaml."""

import http.client
import io
import json
import os
import re
import signal
import socket
import subprocess
import tarfile
from pathlib import Path
from urllib.parse import urlencode

from support import contract
from support.waiting import PATIENCE_S, wait_for

TERMINAL = ("succeeded", "failed", "cancelled")
exercised = set()  # operationIds seen in this session


def operations():
    for path, item in contract.document()["paths"].items():
        for method, operation in item.items():
            if method in ("get", "post", "delete", "patch"):
                yield method.upper(), path, operation


def find_operation(method, path):
    for candidate, template, operation in sorted(operations(), key=lambda o: o[1].count("{")):
        pattern = re.sub(r"\{file\}", ".+", template)
        pattern = re.sub(r"\{[a-z]+\}", "[^/]+", pattern).replace(".tar", r"\.tar")
        if candidate == method and re.fullmatch(pattern, path):
            return operation
    return None


def resolve(node):
    while "$ref" in node:
        target = contract.document()
        for part in node["$ref"][2:].split("/"):
            target = target[part]
        node = target
    return node


class Reply:
    def __init__(self, status, headers, body):
        self.status, self.headers, self.body = status, headers, body

    @property
    def json(self):
        return json.loads(self.body)

    @property
    def type(self):
        return (self.headers.get("Content-Type") or "").split(";")[0]

    @property
    def slug(self):
        return self.json["type"].removeprefix("/problems/")


def check_exchange(method, path, reply):
    """The status, type and body are what the document says of this operation."""
    operation = find_operation(method, path)
    if operation is None:
        return
    exercised.add(operation["operationId"])
    assert str(reply.status) in operation["responses"], \
        f"{method} {path} answers {reply.status}, which is not documented: {reply.body[:300]}"
    content = resolve(operation["responses"][str(reply.status)]).get("content")
    if not content:
        assert reply.body == b""
        return
    assert reply.type in content or "*/*" in content, f"{method} {path}: {reply.type}"
    if reply.type.endswith("json") and "application/octet-stream" not in content:
        schema = dict(content[reply.type]["schema"])
        resolver = contract.jsonschema.RefResolver.from_schema(contract.document())
        contract.jsonschema.Draft202012Validator(schema, resolver=resolver).validate(reply.json)


class Daemon:
    """`program`: ripnerfd; `runner`: the runner it starts. Options are flags: threads=1."""

    def __init__(self, program, runner, data, environment=None, **options):
        self.program, self.runner, self.data = str(program), str(runner), str(data)
        self.held = Path(f"{data}.held")
        self.environment = {**os.environ, "RIPNERF_FAKE_HOLD": str(self.held), **(environment or {})}
        self.options = options
        self.flags = []
        self.token = None
        self.process = None
        self.log = str(data) + ".log"

    def start(self):
        words = [self.program, "--data", self.data, "--runner", self.runner, *self.flags]
        options = {"listen": "127.0.0.1:0", "drain": 3, "log-level": "debug", "curve-after": 0,
                   "header_timeout": PATIENCE_S, **self.options}
        for name, value in options.items():
            for item in value if isinstance(value, list) else [value]:
                words += [f"--{name.replace('_', '-')}", str(item)]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True,
                                        stderr=open(self.log, "a", encoding="utf-8"),
                                        env=self.environment)
        line = self.process.stdout.readline()
        match = re.fullmatch(r"ripnerfd: listening on http://(.+):(\d+)\n", line)
        assert match, f"{line!r}\n{self.log_text()}"
        self.host, self.port = match[1], int(match[2])
        self.wait_for_device()
        return self

    def wait_for_device(self):
        def is_known():
            try:
                return b"examined" not in self.get("/readyz", check=False).body
            except OSError:
                return True
        wait_for(is_known)

    def stop(self, how=signal.SIGTERM, timeout=PATIENCE_S):
        if self.process is None:
            return None
        if self.process.poll() is None:
            self.process.send_signal(how)
        code = self.process.wait(timeout)
        self.process.stdout.close()
        self.process = None
        return code

    def __enter__(self):
        return self.start()

    def __exit__(self, *_):
        if self.process is not None and self.process.poll() is not None:
            raise AssertionError(f"the daemon ended by itself: {self.log_text()[-2000:]}")
        self.stop()

    def hold(self):
        """What its runners do stands still at a known place (fake_engine.c), until it is let go on."""
        self.held.touch()

    def let_go_on(self):
        self.held.unlink()

    def log_text(self):
        with open(self.log, encoding="utf-8") as file:
            return file.read()

    def logged(self, pattern):
        """The first line that matches, once it is there: a request is logged after its answer."""
        return self.eventually(
            lambda: re.search(f"^.*(?:{pattern}).*$", self.log_text(), re.MULTILINE))[0]

    def metric(self, name):
        """A counter or gauge of /metrics."""
        return float(re.search(rf"^ripnerf_{name} (\S+)$", self.get("/metrics").body.decode(), re.MULTILINE)[1])

    # ---- requests ----

    def connect(self):
        return http.client.HTTPConnection(self.host, self.port, timeout=PATIENCE_S)

    def request(self, method, path, body=None, headers=None, json_body=None, query=None,
                check=True):
        headers = dict(headers or {})
        if json_body is not None:
            body = json.dumps(json_body)
            headers.setdefault("Content-Type", "application/json")
        if self.token and "Authorization" not in headers:
            headers["Authorization"] = f"Bearer {self.token}"
        connection = self.connect()
        try:
            connection.request(method, path + ("?" + urlencode(query) if query else ""), body,
                               headers)
            response = connection.getresponse()
            reply = Reply(response.status, response.headers, response.read())
        finally:
            connection.close()
        if check:
            check_exchange(method, path, reply)
        return reply

    def get(self, path, **arguments):
        return self.request("GET", path, **arguments)

    def post(self, path, json_body=None, **arguments):
        return self.request("POST", path, json_body=json_body, **arguments)

    def delete(self, path, **arguments):
        return self.request("DELETE", path, **arguments)

    def socket(self):
        return socket.create_connection((self.host, self.port), timeout=PATIENCE_S)

    # ---- what tests do again and again ----

    def job(self, job):
        reply = self.get(f"/v1/jobs/{job}")
        assert reply.status == 200, reply.body
        return reply.json

    def wait(self, job, states=TERMINAL, timeout=PATIENCE_S):
        """Its record, once it is in one of these states: one that it stays in, or it may be missed."""
        def reached():
            record = self.job(job)
            assert record["state"] in states or record["state"] not in TERMINAL, record
            return record["state"] in states and record
        return wait_for(reached, timeout, lambda: f"{self.job(job)}\n{self.log_text()[-3000:]}")

    def eventually(self, what):
        """The first true value of what()."""
        return wait_for(what, said=lambda: self.log_text()[-3000:])

    def submit(self, **request):
        reply = self.post("/v1/jobs", request)
        assert reply.status == 202, reply.body
        assert reply.headers["Location"] == f"/v1/jobs/{reply.json['id']}"
        return reply.json["id"]

    def upload(self, name, folder, **query):
        reply = self.post("/v1/datasets", body=make_tar(folder), query={"name": name, **query},
                          headers={"Content-Type": "application/x-tar"})
        assert reply.status == 202, reply.body
        return reply.json["id"]

    def train(self, scene, dataset="data", **options):
        """A trained scene: (the job's record, the scene's)."""
        job = self.submit(type="train", dataset=dataset, scene=scene,
                          options={"max_steps": 30, **options})
        record = self.wait(job)
        assert record["state"] == "succeeded", record
        return record, self.get(f"/v1/scenes/{scene}").json

    def events(self, path, headers=None, count=None):
        """Events until the stream ends (or `count` of them): [(id, name, data)]."""
        return list(self.follow(path, headers, count))

    def follow(self, path, headers=None, count=None):
        connection = self.connect()
        try:
            connection.request("GET", path, headers=headers or {})
            response = connection.getresponse()
            check_exchange("GET", path, Reply(response.status, response.headers, b""))
            assert response.status == 200, response.read()
            seen, event = 0, {}
            for line in response:
                line = line.decode().rstrip("\n")
                if line == "" and "event" in event:
                    data = json.loads(event["data"])
                    check_event(path, event["event"], data)
                    yield int(event["id"]), event["event"], data
                    event, seen = {}, seen + 1
                    if seen == count:
                        return
                elif line and not line.startswith(":"):
                    key, value = line.split(": ", 1)
                    event[key] = value
        finally:
            connection.close()

    def runners(self):
        """Process ids of the daemon's runners."""
        found = []
        for name in os.listdir("/proc"):
            try:
                with open(f"/proc/{name}/stat", encoding="utf-8") as file:
                    fields = file.read().rsplit(")", 1)[1].split()
            except (OSError, IndexError):
                continue
            if name.isdigit() and int(fields[1]) == self.process.pid and fields[0] != "Z":
                found.append(int(name))
        return found


def check_event(path, name, data):
    if name == "state":
        contract.check("Job", data)
    elif name == "progress":
        contract.check("JobProgressEvent" if path == "/v1/events" else "Progress", data)
    elif name == "metric":
        contract.check("MetricEvent", data)
    elif name == "incident":
        contract.check("IncidentEvent", data)
    else:
        assert name == "frame"
        contract.check("Frame", data)


def make_tar(folder):
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        tar.add(folder, arcname=".")
    return archive.getvalue()


def tar_of(files):
    """A tar of files that lie nowhere: bytes by name."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))
    return archive.getvalue()
