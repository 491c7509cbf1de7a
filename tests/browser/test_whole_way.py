"""From a folder of photographs to a film on the disk, by keyboard alone, and over a line that loses
requests.

RIPNERF_WHOLE_WAY names a capture of your own (with poses) to go the way with. RIPNERF_LOSSY=full has
the line wait 3 s for each request and lose 1 %, as is promised; without it waits are shorter and
losses more frequent, so that the test takes seconds.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from PIL import Image  # noqa: E402
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support.lossy import LossyLine  # noqa: E402

OWN = os.environ.get("RIPNERF_WHOLE_WAY")
FULL = os.environ.get("RIPNERF_LOSSY") == "full"


@pytest.fixture(scope="session")
def capture(build, tmp_path_factory):
    """A folder as a phone's app leaves it: JPEGs in images/, transforms.json, and things of its own."""
    if OWN:
        return Path(OWN)
    made = tmp_path_factory.mktemp("made") / "place"
    subprocess.run([build / "client/ripnerf", "synth", "place", made, "--size", "32", "--views", "12"],
                   check=True, capture_output=True, timeout=120)
    root = tmp_path_factory.mktemp("capture") / "living room"
    (root / "images").mkdir(parents=True)
    document = json.loads((made / "transforms_train.json").read_text())
    f = 16 / math.tan(document["camera_angle_x"] / 2)
    frames = []
    for i, frame in enumerate(document["frames"]):
        name = f"images/frame_{i:05}.jpg"
        Image.open(made / (frame["file_path"] + ".png")).convert("RGB").save(root / name, quality=95)
        frames.append({"file_path": name, "transform_matrix": frame["transform_matrix"]})
    (root / "transforms.json").write_text(json.dumps(
        {"camera_model": "OPENCV", "fl_x": f, "fl_y": f, "cx": 16, "cy": 16, "w": 32, "h": 32,
         "k1": 0, "k2": 0, "p1": 0, "p2": 0, "frames": frames}))
    (root / ".DS_Store").write_bytes(b"\0")
    (root / "notes.txt").write_text("taken on a rainy day")
    return root


class Keyboard:
    """What is done with keys alone: Tab goes on until what is meant has the focus."""

    def __init__(self, page):
        self.page = page

    def send(self, *keys, held=None):
        chain = ActionChains(self.page.driver)
        if held:
            chain.key_down(held)
        chain.send_keys(*keys)
        if held:
            chain.key_up(held)
        chain.perform()

    def reach(self, script, describe):
        """Tabs until `script`, a condition on the focused element `e`, holds; a few steps at a time,
        and back where they went too far."""
        self.page.driver.execute_script(f"""
            const holds = (e) => Boolean({script});
            window.tabbed = [holds(document.activeElement)];
            window.untab?.abort();
            window.untab = new AbortController();
            addEventListener('focusin', (event) => tabbed.push(holds(event.target)),
                             {{signal: untab.signal}});""")
        for _ in range(40):
            passed = self.page.driver.execute_script("return window.tabbed;")
            for _ in range(9 * (True in passed)):  # fewer are enough but where the page ended
                if self.page.driver.execute_script(
                        f"const e = document.activeElement; return Boolean({script});"):
                    return
                self.send(Keys.TAB, held=Keys.SHIFT)
            self.page.driver.execute_script("window.tabbed = [];")
            self.send(*[Keys.TAB] * 8)
        pytest.fail(f"320 steps of Tab do not reach {describe}")

    def press(self, words):
        self.page.button(words)  # it is there, and can be used
        self.reach(f"e.textContent.trim() === {json.dumps(words)}", words)
        self.send(Keys.ENTER)

    def field(self, label):
        self.page.field(label)
        self.reach(f"[...(e.labels ?? [])].some((l) => l.textContent === {json.dumps(label)})", label)

    def type(self, label, words):
        self.field(label)
        self.send("a", held=Keys.CONTROL)
        self.send(str(words))


def take_in(page, keys, folder):
    page.find(".drop")
    # What a file dialog, which is the system's own, leaves behind.
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says("to send")
    keys.type("Name", "room")
    keys.press("Upload and import")
    page.says("room is imported.")
    keys.press("Look at it and train")
    page.says("What the import found")


def train(page, keys, seconds, steps=None):
    """For so long, or for so many steps: what a busy machine does in a few seconds is a fog."""
    keys.reach("e.type === 'radio' && e.labels[0].textContent === 'standard'", "the presets")
    keys.send(Keys.ARROW_LEFT)  # draft
    keys.type("Time", seconds)
    if steps:
        keys.type("Steps", steps)
    keys.press("Start training")
    page.says("succeeded: ", wait_s=1200)  # that it trains may be over by the first look


def look_around(page, keys):
    page.until(lambda: page.ink() > 30 and page.all(".stage[data-level=refined]"), "a picture")
    keys.reach("e.classList.contains('stage')", "the picture")
    before = page.driver.current_url
    keys.send(*[Keys.ARROW_LEFT] * 4, "k")
    page.until(lambda: len(page.all(".key")) == 1, "a key")
    keys.send(*[Keys.ARROW_LEFT] * 4, "k")
    page.until(lambda: len(page.all(".key")) == 2, "two keys")
    page.until(lambda: page.driver.current_url != before, "the camera in the address")


def make_film(page, keys, downloads, made, ending):
    for label, value in (("Width", 64), ("Height", 48), ("Frames", 4)):
        keys.type(label, value)
    keys.field("Made into")
    keys.send(made)
    keys.press("Render the path")
    page.says("succeeded", ".page-head .chip")
    page.until(lambda: page.all("video.film, img.film"), "the film")
    for old in downloads.folder.glob(f"room*{ending}"):
        old.unlink()
    keys.press("Save film")
    return downloads.saved(page, f"room*{ending}").read_bytes()


def test_from_a_folder_to_a_film_by_keyboard(page, daemon, build, capture, downloads):
    if not (build / "server/film/ripnerf-film.so").is_file():
        pytest.skip("built without FFmpeg's libraries")
    server = daemon()
    keys = Keyboard(page)
    page.open(server.url)
    take_in(page, keys, capture)
    train(page, keys, *((60,) if OWN else (3600, 200)))
    look_around(page, keys)
    film = make_film(page, keys, downloads, "film, MP4 H", ".mp4")
    assert film[4:8] == b"ftyp" and b"avc1" in film
    assert page.complaints() == []


def test_the_way_over_a_line_that_is_slow_and_loses_requests(page, daemon, build, capture, downloads):
    latency_s, lost = (3, 0.01) if FULL else (0.02, 0.015)
    server = daemon("tests/support/ripnerf-runner-fake", {"RIPNERF_FAKE_STEP_US": "2000"})
    keys = Keyboard(page)
    with LossyLine(int(server.url.rstrip("/").rsplit(":", 1)[1]), latency_s, lost) as line:
        page.open(f"http://127.0.0.1:{line.port}/")
        page.find(".drop", 300)
        take_in(page, keys, capture)
        train(page, keys, *((30,) if FULL else (3600, 1000)))
        look_around(page, keys)
        for label, value in (("Width", 64), ("Height", 48), ("Frames", 4)):
            keys.type(label, value)
        keys.press("Render the path")
        page.says("succeeded", ".page-head .chip", wait_s=300)
        page.until(lambda: page.ink("canvas.frame") > 0, "a frame", 300)
        assert line.cut > 0 and line.requests > 60


def test_the_page_loads_where_every_twentieth_request_is_lost(page, daemon):
    """A part that was lost is asked for again, and the others are not: else it would seldom be whole."""
    server = daemon()
    page.driver.execute_cdp_cmd("Network.clearBrowserCache", {})
    with LossyLine(int(server.url.rstrip("/").rsplit(":", 1)[1]), 0, 0.05) as line:
        page.open(f"http://127.0.0.1:{line.port}/")
        page.find(".drop", 120)
        assert line.cut > 1
