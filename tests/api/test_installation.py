"""What an installation consists of: proxies' configurations, the list of linked libraries."""

import http.client
import json
import os
import shutil
import socket
import ssl
import subprocess
import time
from pathlib import Path

import pytest

from support.waiting import PATIENCE_S, wait_for

ROOT = Path(__file__).resolve().parents[2]


def test_libraries_are_listed(build):
    """Every library that a program needs is in the list, with its package and version."""
    programs = [build / "server/ripnerfd", build / "server/ripnerf-runner", build / "client/ripnerf"]
    listed = json.loads(subprocess.run([ROOT / ".ci/debian/sbom", *programs], capture_output=True,
                                       text=True, check=True).stdout)
    assert listed["bomFormat"] == "CycloneDX"
    named = {item["name"]: item for item in listed["components"]}
    for package in ("libmicrohttpd12", "libsqlite3-0", "libjansson4", "libarchive13", "libcurl4",
                    "libc6"):
        assert named[package]["purl"] == f"pkg:deb/debian/{package}@{named[package]['version']}"


def start_with_socket(build, folder, passed, listen):
    """As systemd starts a service for a connection: the socket is descriptor 3."""
    return subprocess.Popen(
        ["sh", "-c", 'LISTEN_PID=$$ LISTEN_FDS=1 exec "$@"', "sh", build / "server/ripnerfd", "--data",
         folder, "--listen", listen, "--runner", build / "tests/support/ripnerf-runner-fake"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, close_fds=False,
        preexec_fn=lambda: os.dup2(passed.fileno(), 3, inheritable=True))


def test_the_service_managers_socket(build, tmp_path):
    """It is served on, whoever connected before the daemon was there; one of another address, where a
    token would be needed, is refused."""
    with socket.create_server(("127.0.0.1", 0)) as passed:
        port = passed.getsockname()[1]
        early = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        early.request("GET", "/healthz")
        process = start_with_socket(build, tmp_path / "d", passed, "127.0.0.1:1")
        assert early.getresponse().status == 200
        assert process.stdout.readline() == f"ripnerfd: listening on http://127.0.0.1:{port}\n"
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
        process.communicate()
        refused = start_with_socket(build, tmp_path / "d", passed, "127.0.0.2:1")
        assert refused.wait(PATIENCE_S) == 2 and "another address than 127.0.0.2" in refused.communicate()[1]


def test_systemds_own_activation(build, tmp_path):
    """The daemon is started by its first visitor, whom it serves."""
    if not shutil.which("systemd-socket-activate"):
        pytest.skip("systemd is not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        ["systemd-socket-activate", "-l", f"127.0.0.1:{port}", build / "server/ripnerfd", "--data",
         tmp_path / "d", "--listen", "127.0.0.1:1", "--runner", build / "tests/support/ripnerf-runner-fake"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_for(lambda: is_open(port))
        visitor = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        visitor.request("GET", "/healthz")
        assert visitor.getresponse().status == 200
    finally:
        process.terminate()
        assert process.wait(PATIENCE_S) == 0, process.communicate()[1]
    process.communicate()


def test_systemd_takes_the_units(tmp_path):
    if not shutil.which("systemd-analyze"):
        pytest.skip("systemd is not installed")
    for name in ("ripnerfd.service", "ripnerfd.socket"):
        unit = (ROOT / ".ci/debian" / name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(unit.replace("/usr/bin/ripnerfd", "/bin/true"))
    units = [tmp_path / "ripnerfd.service", tmp_path / "ripnerfd.socket"]
    said = subprocess.run(["systemd-analyze", "verify", "--man=no", *units], capture_output=True,
                          text=True, check=False)
    assert said.returncode == 0 and "ripnerfd" not in said.stderr, said.stderr


def run_nginx(site, tmp_path, port):
    site = site.replace("/etc/ssl/certs/scenes.example.pem", str(tmp_path / "certificate"))
    site = site.replace("/etc/ssl/private/scenes.example.key", str(tmp_path / "key"))
    site = site.replace("listen 443 ssl", f"listen 127.0.0.1:{port} ssl")
    (tmp_path / "site").write_text(f"pid {tmp_path}/pid;\nerror_log stderr;\ndaemon off;\nevents {{}}\n"
                                   f"http {{\naccess_log off;\n{site}}}\n")
    return ["nginx", "-c", tmp_path / "site"]


def run_caddy(site, tmp_path, port):
    # A certificate of its own, where Caddy would ask for one.
    site = site.replace("scenes.example {", f"https://scenes.example:{port} {{\n"
                                            f"\ttls {tmp_path}/certificate {tmp_path}/key", 1)
    (tmp_path / "site").write_text("{\n\tadmin off\n\tgrace_period 1s\n\tauto_https disable_redirects\n"
                                   f"\tdefault_sni scenes.example\n}}\n{site}")
    return ["caddy", "run", "--config", tmp_path / "site", "--adapter", "caddyfile"]


@pytest.fixture(params=[("nginx", "nginx.conf", run_nginx), ("caddy", "Caddyfile", run_caddy)],
                ids=["nginx", "caddy"])
def proxy(request, make_daemon, tmp_path):
    """A daemon with a token behind a proxy, as .ci/proxy has it: (host, a connection)."""
    name, file, command = request.param
    if not shutil.which(name):
        pytest.skip(f"{name} is not installed")
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt",
                    "ec_paramgen_curve:prime256v1", "-nodes", "-subj", "/CN=scenes.example",
                    "-addext", "subjectAltName=DNS:scenes.example",
                    "-keyout", tmp_path / "key", "-out", tmp_path / "certificate"], check=True,
                   capture_output=True)
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "token").chmod(0o600)
    daemon = make_daemon(token_file=tmp_path / "token")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    site = (ROOT / ".ci/proxy" / file).read_text(encoding="utf-8")
    assert "127.0.0.1:7373" in site
    words = command(site.replace("127.0.0.1:7373", f"127.0.0.1:{daemon.port}"), tmp_path, port)
    with open(tmp_path / "log", "w", encoding="utf-8") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log, env={**os.environ, "HOME": str(tmp_path)})
    insecure = ssl.create_default_context()
    insecure.check_hostname, insecure.verify_mode = False, ssl.CERT_NONE
    try:
        wait_for(lambda: process.poll() is not None or is_open(port))
        assert process.poll() is None, (tmp_path / "log").read_text()
        yield f"scenes.example:{port}", http.client.HTTPSConnection("127.0.0.1", port, timeout=PATIENCE_S,
                                                                   context=insecure)
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def is_open(port):
    with socket.socket() as trial:
        return trial.connect_ex(("127.0.0.1", port)) == 0


def test_a_proxy_in_front(proxy):
    """Requests, writes of its own page, and events as they come, through the proxy."""
    host, connection = proxy
    headers = {"Host": host, "Authorization": "Bearer correct-horse-battery"}
    def ask(method, path, body=None, **more):
        connection.request(method, path, body, {**headers, **more})
        return connection.getresponse()
    reply = ask("GET", "/v1/jobs")
    assert reply.status == 200 and reply.read() and "Strict-Transport-Security" in reply.headers
    body = b'{"name": "guest"}'
    json_type = {"Content-Type": "application/json"}
    reply = ask("POST", "/v1/tokens", body, Origin=f"https://{host}", **json_type)
    assert reply.status == 201 and reply.read()
    reply = ask("POST", "/v1/tokens", body, Origin="https://evil.example", **json_type)
    assert reply.status == 403 and reply.read()
    connection.close()  # a proxy may, after a refusal before the body's end
    begin = time.monotonic()
    events = ask("GET", "/v1/events")
    assert events.read1(100).startswith(b":") and time.monotonic() - begin < 15  # before a heartbeat


def test_caddy_takes_the_configuration():
    if not shutil.which("caddy"):
        pytest.skip("caddy is not installed")
    tested = subprocess.run(["caddy", "validate", "--config", ROOT / ".ci/proxy/Caddyfile",
                             "--adapter", "caddyfile"], capture_output=True, text=True, check=False)
    assert tested.returncode == 0, tested.stderr
