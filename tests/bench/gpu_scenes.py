"""Two scenes of a daemon on one GPU: trained side by side, then rendered in turn with room for one of them."""
import json
import os
import re
import signal
import statistics
import subprocess
import time
import urllib.error
import urllib.request


class Daemon:
    """`with Daemon(program, folder, log, options) as daemon:` serves what lies in `folder`."""

    def __init__(self, program, folder, log, *options):
        self.log = open(log, "a", encoding="utf-8")
        # A stage has its own limit, and a step of the emulator may take minutes on a busy machine.
        patient = ("--runner-timeout", "1h")
        self.process = subprocess.Popen([program, "--data", folder, "--listen", "127.0.0.1:0", *patient, *options],
                                        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=self.log, text=True)
        found = re.search(r"http://127\.0\.0\.1:\d+", self.process.stdout.readline())
        self.url = found.group(0) if found else ""

    def __enter__(self):
        if not self.url:
            raise ValueError("the daemon did not start")
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.log.close()

    def ask(self, path, body=None):
        request = urllib.request.Request(self.url + path, json.dumps(body).encode() if body else None,
                                         {"Content-Type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=120) as reply:
                return reply.read()
        except urllib.error.HTTPError as error:
            raise ValueError(f"{path}: {error}: {error.read().decode(errors='replace')[:300]}") from error

    def metric(self, name):
        found = re.search(rf"^ripnerf_{name} (\S+)$", self.ask("/metrics").decode(), re.MULTILINE)
        return int(float(found.group(1)))

    def train(self, scene, options):
        body = {"type": "train", "dataset": "photos", "scene": scene,
                "options": {"preset": "draft", "device": "cuda:0"} | options}
        return json.loads(self.ask("/v1/jobs", body))["id"]

    def wait(self, job, end):
        """Until the job has ended well."""
        while True:
            known = json.loads(self.ask(f"/v1/jobs/{job}"))
            if known["state"] == "succeeded":
                return
            if known["state"] in ("failed", "cancelled") or time.monotonic() > end:
                raise ValueError(f"{job} is {known['state']}: {known.get('error')}")
            time.sleep(0.1)

    def picture(self, scene):
        """(the picture, milliseconds until it came)"""
        begin = time.monotonic()
        png = self.ask(f"/v1/scenes/{scene}/render", {"view": "test:0"})
        return png, 1e3 * (time.monotonic() - begin)


def share(program, dataset, folder, log, options, views, end):
    """What sharing costs: milliseconds of pictures of a scene that is there, and of one that has to come
    back; `views` of each."""
    client = program.with_name("ripnerf")
    with Daemon(program, folder, log) as daemon:
        imported = subprocess.run([client, "import", dataset, "--name", "photos"], check=False, capture_output=True,
                                  text=True, env=os.environ | {"RIPNERF_HOST": daemon.url},
                                  timeout=max(1, end - time.monotonic()))
        if imported.returncode:
            raise ValueError(f"import ended with {imported.returncode}: {imported.stderr.strip()[-300:]}")
        jobs = [daemon.train(scene, options) for scene in ("a", "b")]
        for job in jobs:
            daemon.wait(job, end)
    with Daemon(program, folder, log) as daemon:
        pictures = {"a": daemon.picture("a")[0]}
        each = daemon.metric("gpu_memory_bytes")
        pictures["b"] = daemon.picture("b")[0]
        there = [daemon.picture(scene)[1] for scene in "ab" * views]
    with Daemon(program, folder, log, "--gpu-memory", str(each * 3 // 2)) as daemon:
        daemon.picture("a")
        back = []
        for scene in "ba" * views:
            png, ms = daemon.picture(scene)
            if png != pictures[scene]:
                raise ValueError(f"scene {scene} gives another picture after it came back")
            back.append(ms)
        rested = daemon.metric("scenes_rested_total")
    if each == 0 or rested < 2 * views - 1:
        raise ValueError(f"{each} bytes on the device, {rested} scenes made room")
    return {"bytes_each": each, "there_ms": round(statistics.median(there), 1),
            "back_ms": round(statistics.median(back), 1), "made_room": rested}
