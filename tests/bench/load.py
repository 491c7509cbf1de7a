#!/usr/bin/python3
"""load.py BUILD: how the daemon answers under load, on this machine as it is now.

Status requests while a scene trains on all cores, requests a second over kept connections, many
open connections, many event streams; each with the daemon's memory. One table on standard output.
"""

import argparse
import os
import resource
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.checked import Daemon  # noqa: E402

STATUS = ("/healthz", "/v1/jobs", "/v1/scenes")


def memory_mb(pid):
    for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return 0.0


def quantiles(times):
    cut = statistics.quantiles(times, n=1000)
    return f"p50 {cut[499]:.1f} ms, p99 {cut[989]:.1f} ms, worst {max(times):.1f} ms"


def ask_for(daemon, seconds, paths=STATUS):
    """Milliseconds of each answer, one connection, one request after the other."""
    times, end = [], time.monotonic() + seconds
    connection = daemon.connect()
    while time.monotonic() < end:
        for path in paths:
            begin = time.monotonic()
            connection.request("GET", path)
            reply = connection.getresponse()
            reply.read()
            assert reply.status == 200, reply.status
            times.append(1000 * (time.monotonic() - begin))
        time.sleep(0.002)
    connection.close()
    return times


def pipeline_free(address, seconds, count, results):
    """Requests over `count` kept connections: one out on each, the next when it is answered."""
    request = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
    sockets = [socket.create_connection(address) for _ in range(count)]
    done, end = 0, time.monotonic() + seconds
    for each in sockets:
        each.sendall(request)
    while time.monotonic() < end:
        for each in sockets:
            if not each.recv(4096):
                raise ConnectionError("closed")
            each.sendall(request)
            done += 1
    for each in sockets:
        each.close()
    results.append(done)


def cpu_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def row(what, figure):
    print(f"| {what} | {figure} |", flush=True)


def measure_training(build, folder, seconds):
    client = [str(build / "client/ripnerf")]
    subprocess.run([*client, "synth", "sphere", "photos", "--size", "100", "--views", "24"],
                   cwd=folder, check=True, stdout=subprocess.DEVNULL)
    with Daemon(build / "server/ripnerfd", build / "server/ripnerf-runner", folder / "trains",
                dataset_root=folder) as daemon:
        daemon.environment["RIPNERF_HOST"] = f"http://{daemon.host}:{daemon.port}"
        subprocess.run([*client, "import", "photos", "--name", "data"], cwd=folder, check=True,
                       env=daemon.environment, stdout=subprocess.DEVNULL)
        row("status requests, nothing else to do", quantiles(ask_for(daemon, seconds)))
        job = daemon.submit(type="train", dataset="data", scene="s",
                            options={"preset": "standard", "max_time_s": 600})
        daemon.wait(job, ["running"])
        time.sleep(3)
        row("status requests while a scene trains on all cores", quantiles(ask_for(daemon, seconds)))
        daemon.post(f"/v1/jobs/{job}/cancel")
        daemon.wait(job)


def measure_rate(daemon, seconds):
    results, before = [], cpu_seconds(daemon.process.pid)
    pipeline_free((daemon.host, daemon.port), seconds, 32, results)
    used = cpu_seconds(daemon.process.pid) - before
    row("requests a second over 32 kept connections, one client of Python",
        f"{results[0] / seconds:.0f}; the daemon took {1e6 * used / results[0]:.0f} CPU us for each")


def measure_connections(daemon, count):
    before = memory_mb(daemon.process.pid)
    begin = time.monotonic()
    connections = [socket.create_connection((daemon.host, daemon.port), timeout=30)
                   for _ in range(count)]
    opened = time.monotonic() - begin
    times = ask_for(daemon, 2, ("/healthz",))
    row(f"{count} open connections", f"{opened:.1f} s to open, then {quantiles(times)}; "
        f"{memory_mb(daemon.process.pid) - before:.0f} MB more")
    for connection in connections:
        connection.close()


def measure_streams(daemon, count):
    before, streams = memory_mb(daemon.process.pid), []
    for _ in range(count):
        stream = socket.create_connection((daemon.host, daemon.port), timeout=30)
        stream.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        streams.append(stream)
    answers = [stream.recv(4096).split(b" ", 2)[1] for stream in streams]
    times = ask_for(daemon, 2, ("/healthz",))
    row(f"{count} event streams", f"{answers.count(b'200')} of them served; {quantiles(times)}; "
        f"{memory_mb(daemon.process.pid) - before:.0f} MB more")
    for stream in streams:
        stream.close()


def main():
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("build", type=Path)
    options.add_argument("--seconds", type=float, default=10)
    given = options.parse_args()
    build = given.build.resolve()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    print(f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores\n\n| what | figure |\n|---|---|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measure_training(build, folder, given.seconds)
        with Daemon(build / "server/ripnerfd", build / "tests/support/ripnerf-runner-fake",
                    folder / "rests", max_connections=10000, header_timeout=60) as daemon:
            measure_rate(daemon, given.seconds)
            measure_connections(daemon, 9999)  # and the one that asks
            measure_streams(daemon, 1000)
    print(f"\nload {os.getloadavg()[0]:.1f} at the end")


if __name__ == "__main__":
    main()
