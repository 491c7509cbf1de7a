"""Links: a page opened with a token in its fragment shows one thing, and nothing else is asked."""

import json
import os
import re
import subprocess
import urllib.error
import urllib.request

import pytest
from support.waiting import PATIENCE_S

pytest.importorskip("selenium", reason="python3-selenium is not installed")

PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 16,
        "height": 16, "keys": [{"time": t, "fov_y_deg": 40, "world_from_camera":
                                [[1, 0, 0, t], [0, 1, 0, 0], [0, 0, 1, 4]]} for t in (0, 1)]}


@pytest.fixture
def client(build, tmp_path):
    """A daemon with a scene `ball`, and run(*words) of the client beside it."""
    (tmp_path / "token").write_text("a-token-of-this-test\n")
    (tmp_path / "token").chmod(0o600)
    process = subprocess.Popen(
        [build / "server/ripnerfd", "--data", tmp_path / "data", "--listen", "127.0.0.1:0",
         "--token-file", tmp_path / "token", "--curve-after", "0", "--runner",
         build / "tests/support/ripnerf-runner-fake"], stdout=subprocess.PIPE,
        stderr=open(tmp_path / "log", "w", encoding="utf-8"), text=True)
    url = re.search(r"http://\S+", process.stdout.readline())[0]
    environment = {**os.environ, "RIPNERF_HOST": url, "RIPNERF_TOKEN": "a-token-of-this-test"}

    def run(*words):
        done = subprocess.run([build / "client/ripnerf", *words], env=environment, text=True,
                              cwd=tmp_path, capture_output=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()
    run.url = url
    run("synth", "sphere", "photos", "--size", "32", "--views", "8")
    run("import", "photos", "--name", "data")
    run("train", "data", "--name", "ball", "--max-steps", "20", "--wait")
    yield run
    process.terminate()
    process.wait(PATIENCE_S)
    process.stdout.close()


def test_a_link_opens_a_scene_and_nothing_else(page, client):
    link = client("token", "make", "guest", "--scene", "ball")
    assert link.startswith(client.url + "/#t=rnt_")
    page.open(link)
    page.says("refined", ".hud")
    page.says("ball", "h1")
    address = page.run("return location.href;")
    assert "rnt_" not in address and "/scene/" in address
    assert page.run("return performance.getEntriesByType('resource')"
                    ".filter((entry) => entry.name.includes('rnt_')).length;") == 0
    words = page.find("main").text
    assert "Field of view" in words and "Train" not in words and "Record key" not in words
    assert not page.run("return document.getElementById('token-dialog').open;")
    assert page.complaints() == []
    client("token", "revoke", "guest")
    token = link.split("#t=")[1].split("/")[0]
    request = urllib.request.Request(client.url + "/v1/info",
                                     headers={"Authorization": f"Bearer {token}"})
    with pytest.raises(urllib.error.HTTPError, match="401"):
        urllib.request.urlopen(request)


def test_a_link_opens_the_pictures_of_a_path(page, client, tmp_path):
    (tmp_path / "p.json").write_text(json.dumps({"path": PATH}))
    client("path", "ball", "p.json", "-o", "frames")
    job = next(job["id"] for job in json.loads(client("jobs", "--json"))["items"]
               if job["type"] == "path")
    page.open(client("token", "make", "film", "--job", job))
    page.says("frame 2", ".player")
    assert "Cancel" not in page.find("main").text and page.complaints() == []


def test_the_page_makes_a_link(page, client):
    page.open(client.url)
    page.type(page.find("#token-input"), "a-token-of-this-test")
    page.press("Use it")
    page.run("location.hash = '#/scene/ball';")
    page.says("refined", ".hud")
    page.press("Crop")
    page.find("#crop-on").click()
    page.run("navigator.clipboard.writeText = async (words) => { window.copied = words; };")
    page.press("Share")
    copied = page.until(lambda: page.run("return window.copied ?? '';"), "a link")
    assert re.match(re.escape(client.url) + r"/#t=rnt_\w{32}/scene/sc_\w{12}\?camera=\S+&crop=", copied)
    assert "link-ball-" in client("token", "ls")
    page.open(copied)
    page.says("refined", ".hud")
    assert page.find("#crop-on").is_selected()  # who follows it sees what was shared
