"""Links: a page opened with a token in its fragment shows one thing, and nothing else is asked. Tokens: what one
may not is not offered."""

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
    environment = {**os.environ, "RIPNERF_HOST": url}

    def run(*words, token="a-token-of-this-test"):
        done = subprocess.run([build / "client/ripnerf", *words], text=True,
                              env={**environment, "RIPNERF_TOKEN": token},
                              cwd=tmp_path, capture_output=True, timeout=PATIENCE_S, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()
    run.url = url
    run.folder = tmp_path
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
    assert "R resets." in words and "records a key" not in words
    assert not page.run("return document.getElementById('token-dialog').open;")
    for hash in ("#/", "#/jobs"):
        page.run(f"location.hash = {hash!r};")
        page.says("You came by a link to one scene, ball, to look at and no more.")
        assert "No datasets" not in page.find("main").text and "No jobs" not in page.find("main").text
    page.press("Look at it")
    page.says("refined", ".hud")
    assert refusals(page) == [] and page.complaints() == []
    client("token", "revoke", "guest")
    token = link.split("#t=")[1].split("/")[0]
    request = urllib.request.Request(client.url + "/v1/info",
                                     headers={"Authorization": f"Bearer {token}"})
    with pytest.raises(urllib.error.HTTPError, match="401"):
        urllib.request.urlopen(request)
    page.says("This link is good no longer", "#token-dialog")
    page.says("Whoever sent it can make another.", "#token-dialog")


def test_a_link_opens_the_pictures_of_a_path(page, client, tmp_path):
    (tmp_path / "p.json").write_text(json.dumps({"path": PATH}))
    client("path", "ball", "p.json", "-o", "frames")
    job = next(job["id"] for job in json.loads(client("jobs", "--json"))["items"]
               if job["type"] == "path")
    page.open(client("token", "make", "film", "--job", job))
    page.says("frame 2", ".player")
    assert "Cancel" not in page.find("main").text and page.complaints() == []
    page.run("location.hash = '#/';")
    page.says("You came by a link to one camera path, ball, to look at and no more.")
    page.press("See its pictures")
    page.says("frame 2", ".player")


def begins_at(page):
    """The pose of the picture that Reset leads to."""
    page.says("refined", ".hud")
    page.run("const ask = window.fetch; window.asked = [];"
             "window.fetch = (url, what) => {"
             " if (String(url).endsWith('/render')) window.asked.push(JSON.parse(what.body).camera.world_from_camera);"
             " return ask(url, what); };")
    page.press("Reset")
    return page.until(lambda: page.run("return window.asked[0];"), "a picture")


def test_a_link_begins_where_the_photographs_do(page, client):
    """And with their up: from elsewhere nothing of a place may be seen, and a shared camera is another."""
    client("import", "photos", "--name", "tilted-data", "--up", "y")
    client("train", "tilted-data", "--name", "tilted", "--max-steps", "20", "--wait")
    page.open(client("token", "make", "guest", "--scene", "tilted"))
    as_guest = begins_at(page)
    page.run("localStorage.clear(); sessionStorage.clear();")
    page.open(f"{client.url}/#t=a-token-of-this-test/scene/tilted")
    page.says("Parameters")
    assert as_guest == begins_at(page) and as_guest[1][1] < 0  # down is not along the given up


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


def refusals(page):
    return page.run("return performance.getEntriesByType('resource')"
                    ".filter((entry) => entry.responseStatus === 403).map((entry) => entry.name);")


def open_with(page, client, token, scope):
    page.open(f"{client.url}/#t={token}/")
    page.says(scope, "#scope")


def offered(page, places):
    """What buttons and labels say in these places, each read once it says its landmark."""
    words = set()
    for place, landmark in places.items():
        page.run(f"location.hash = {place!r};")
        page.says(landmark)
        page.run("for (const more of document.querySelectorAll('main details')) more.open = true;")
        words |= {e.text.strip() for e in page.all("main button, main a.button, main label") if e.is_displayed()}
        assert refusals(page) == [], place
    return words


def places_of(client):
    """Every view, and what it says once it is there."""
    job = {one["type"]: one["id"] for one in json.loads(client("jobs", "--json"))["items"]}
    return {"#/": "On disk", "#/dataset/data": "Pixel’s footprint", "#/scene/ball": "Parameters",
            "#/jobs": "succeeded", "#/system": "Forget the token", f"#/job/{job['eval']}": "By view, worst first",
            f"#/job/{job['train']}": "Asked for", f"#/job/{job['ingest']}": "Asked for"}


LOOKING = {"all", "training", "paths", "evaluations", "imports", "train 8", "val 8", "test 8", "Download checkpoint",
           "Forget the token", ""}  # what changes only what is shown, and what is fetched


def test_what_a_token_may_not_is_not_offered(page, client):
    client("eval", "ball", "--split", "test")
    open_with(page, client, client("token", "make", "reader", "--scope", "read"), "read-only")
    assert offered(page, places_of(client)) == LOOKING
    open_with(page, client, client("token", "make", "artist", "--scope", "render"), "render only")
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": 360, "height": 700, "deviceScaleFactor": 2, "mobile": True})
    assert page.run("return document.documentElement.scrollWidth;") == 360
    page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    words = offered(page, places_of(client))
    assert {"Record key", "Render the path", "Evaluate", "Run the doctor", "Mesh, .ply"} < words
    assert not {"Start training", "Choose a folder", "Train…", "Share", "Delete"} & words
    assert page.complaints() == []


def test_what_others_made_is_not_offered_to_be_changed(page, client):
    """A job to be stopped and a scene to be deleted: to who made it, and to no other."""
    anna, ben = (client("token", "make", name, "--scope", "train") for name in ("anna", "ben"))
    client("train", "data", "--name", "hers", "--max-steps", "100000000", token=anna)
    client("train", "data", "--name", "waits", "--max-steps", "20", token=ben)
    for token, own in ((anna, "hers"), (ben, "waits"), ("a-token-of-this-test", None)):
        page.open(f"{client.url}/#t={token}/jobs")
        for scene in ("hers", "waits"):
            page.says(scene, ".job-row")
            row = next(e for e in page.all(".job-row") if f"Training {scene}" == e.text.split("\n")[0])
            assert ("Cancel" in row.text) == (own in (scene, None)), (own, row.text)
        page.run("location.hash = '#/scene/ball';")
        page.says("Parameters")
        assert ("Delete" in page.text("[aria-label=Record]")) == (own is None)
        page.run("location.hash = '#/dataset/data';")
        page.says("Start training")
        assert ("Delete" in page.text("[aria-label=About]")) == (own is None)
        assert refusals(page) == []
    client("cancel", json.loads(client("jobs", "--json"))["items"][1]["id"])
