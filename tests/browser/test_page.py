"""The page against ripnerfd: submit a dataset, train, orbit meanwhile, record a path, get frames.

Once with the pretending engine, once with the real one on a small synthetic dataset.
RIPNERF_SHOTS names a folder for screenshots on the way.
"""

import os
import re
import subprocess
import tarfile

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402

@pytest.fixture(scope="session")
def sphere(build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("synth") / "sphere"
    subprocess.run(
        [build / "client/ripnerf", "synth", "sphere", folder, "--size", "64", "--views", "16"],
        check=True,
        capture_output=True,
        timeout=120,
    )
    return folder


def shoot(page, name):
    folder = os.environ.get("RIPNERF_SHOTS")
    if folder:
        page.driver.save_screenshot(os.path.join(folder, f"{name}.png"))


def upload(page, folder):
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says("views: 16 train")
    page.type(page.field("Name"), "ball")
    page.press("Upload and import")
    page.says("ball is imported.")
    page.press("Look at it and train")
    page.says("What the import found")
    page.until(lambda: page.all(".photos .thumb[data-state=ready]"), "a photograph")


def test_what_sends_a_dataset_stays_where_it_is_while_that_is_looked_at(page, daemon, sphere):
    """Looking takes jobs of the daemon's; what they add to the page does not move the button."""
    page.open(daemon("tests/support/ripnerf-runner-fake").url)
    page.find(".drop")
    page.run("""
window.tops = new Set(); window.sawJob = false;
const look = () => {
  const button = document.querySelector('form .sending button.primary');
  if (button) window.tops.add(button.getBoundingClientRect().top);
  requestAnimationFrame(look);
};
look();
const box = [...document.querySelectorAll('section')].find(
    (e) => e.textContent.startsWith('Under way'));
new MutationObserver(() => window.sawJob = true).observe(box, {attributeFilter: ['hidden']});""")
    page.all("#folder-input")[0].send_keys(str(sphere))
    page.says("32 photographs looked at")
    page.says("What the import found")
    page.until(lambda: page.run("return window.sawJob;"), "a job that is under way")
    page.until(lambda: "Under way" not in page.text("main"), "the jobs' end")
    assert len(page.run("return [...window.tops];")) == 1


def train(page, limits):
    for label in ("Time", "Steps"):
        page.type(page.field(label), limits.get(label, ""))
    page.press("draft")
    page.press("Start training")
    page.says("training", ".page-head .chip")
    page.until(lambda: page.all(".chart .last"), "a point on the chart")


def shown_psnr(page):
    found = re.search(r"([\d.]+) dB", page.text(".stats"))
    return found and float(found.group(1))


def orbit(page):
    """Turns the scene while it trains: coarse pictures while moving, a refined one when still."""
    stage = page.until(lambda: page.ink() > 30 and page.find(".stage"), "a picture")
    page.until(lambda: stage.get_attribute("data-level") == "refined", "a refined picture")
    levels = page.watch_levels()
    hand = ActionChains(page.driver).click_and_hold(stage)
    for _ in range(5):
        hand.move_by_offset(25, 4)
    hand.perform()
    page.until(lambda: "coarse" in levels(), "a coarse picture")
    ActionChains(page.driver).release().perform()
    page.until(lambda: levels()[-1] == "refined", "a refined picture")
    assert re.search(r"step [\d\u202f]+ .* rendering .* samples", page.text(".hud"))


def record(page, keys):
    stage = page.find(".stage")
    for number in range(keys):
        if number:
            ActionChains(page.driver).click_and_hold(stage).move_by_offset(
                40, 0
            ).release().perform()
        page.press("Record key")
    page.until(lambda: len(page.all(".key")) == keys, f"{keys} keys")
    page.until(
        lambda: len([image for image in page.all(".key img") if image.is_displayed()]) == keys,
        "their pictures",
    )


def render_path(page, downloads, width, height, frames_per_second, expected):
    for label, value in (("Width", width), ("Height", height), ("Frames", frames_per_second)):
        page.type(page.field(label), value)
    page.says(f"{expected} frames of {width} × {height}")
    shoot(page, "keys")
    page.press("Render the path")
    page.until(lambda: page.ink("canvas.frame") > 30, "the first frame")
    shoot(page, "frames")
    page.says("succeeded", ".page-head .chip")
    page.until(lambda: len(page.all(".cells span[data-there]")) == expected, "all frames")
    if page.all("video"):  # the film is shown in place of its frames, which can be chosen
        page.press("frames")
    before = page.text(".player output")
    page.press("Play")
    page.until(lambda: page.text(".player output") != before, "the next frame")
    downloads.clear()
    page.press("Download")
    with tarfile.open(downloads.saved(page, "*.tar")) as tar:
        pictures = [member for member in tar.getmembers() if member.name.endswith(".png")]
        assert len(pictures) == expected
        assert tar.extractfile(pictures[0]).read(8) == b"\x89PNG\r\n\x1a\n"


def test_whole_path_with_the_pretending_engine(page, daemon, sphere, downloads):
    server = daemon("tests/support/ripnerf-runner-fake", {"RIPNERF_FAKE_STEP_US": "2000"})
    page.open(server.url)
    page.says("From photographs to a scene")
    upload(page, sphere)
    train(page, {"Time": 3600})  # ended by Finish, however long the way there takes
    orbit(page)
    page.press("Pause")
    page.says("paused", ".page-head .chip")
    page.press("Resume")
    page.says("training", ".page-head .chip")
    record(page, 3)
    page.press("Finish")
    page.says("ready", ".page-head .chip")
    page.says("finished by hand")
    render_path(page, downloads, 48, 32, 4, 9)
    page.open(server.url)
    page.says("ball", ".card-name")
    assert page.complaints() == []


def test_a_second_scene_of_the_same_name_is_refused_at_its_field(page, daemon, sphere):
    server = daemon("tests/support/ripnerf-runner-fake", {"RIPNERF_FAKE_STEP_US": "2000"})
    page.open(server.url)
    upload(page, sphere)
    train(page, {"Time": 3600})
    page.open(server.url + "#/dataset/ball")
    page.type(page.field("Scene’s name"), "ball")
    page.press("Start training")
    page.says("ball", ".problem")
    page.type(page.field("Scene’s name"), "no spaces here")
    page.press("Start training")
    page.until(
        lambda: page.field("Scene’s name").get_attribute("aria-invalid") == "true",
        "the field marked",
    )


def test_token_and_a_killed_daemon(page, daemon, sphere, tmp_path):
    """A token travels with every request; training goes on after kill -9, and the page shows it."""
    (tmp_path / "token").write_text("a-token-of-this-test\n")
    (tmp_path / "token").chmod(0o600)
    options = {
        "environment": {"RIPNERF_FAKE_STEP_US": "2000"},
        "options": ["--token-file", tmp_path / "token"],
    }
    server = daemon("tests/support/ripnerf-runner-fake", **options)
    page.open(server.url)
    page.type(page.find("#token-input"), "a-token-of-this-test")
    page.press("Use it")
    upload(page, sphere)
    train(page, {"Time": 3600})  # ended by Finish, however long the way there takes
    page.until(lambda: page.ink() > 30, "a picture")
    points = page.until(lambda: len(page.all(".chart .dot")), "a point on the curve")
    server.process.kill()
    server.process.wait()
    page.says("No connection to the daemon.", "#banner")
    daemon(
        "tests/support/ripnerf-runner-fake",
        **options,
        port=server.url.rstrip("/").rsplit(":", 1)[1],
    )
    page.says("connected", ".connection")
    page.until(lambda: not any(e.is_displayed() for e in page.all("#banner")), "the banner gone")
    page.says("training", ".page-head .chip")
    page.until(lambda: len(page.all(".chart .dot")) >= points, "the curve after the restart")
    page.press("Finish")
    page.says("ready", ".page-head .chip")
    page.says("finished by hand")


def test_whole_path_with_the_real_engine(page, daemon, sphere, downloads):
    server = daemon()
    page.open(server.url)
    upload(page, sphere)
    shoot(page, "dataset")
    train(page, {"Time": 600})
    shoot(page, "training")
    orbit(page)
    shoot(page, "orbited")
    record(page, 3)
    page.until(lambda: (shown_psnr(page) or 0) > 18, "a good picture")
    points = len(page.all(".chart .dot"))
    page.driver.refresh()
    page.until(lambda: len(page.all(".chart .dot")) >= points, "the curve after a reload")
    page.press("Finish")
    page.says("ready", ".page-head .chip")
    assert shown_psnr(page) > 18
    page.until(lambda: len(page.all(".effect")) >= 4, "the effects")
    shoot(page, "ready")
    render_path(page, downloads, 64, 64, 3, 7)
    assert page.complaints() == []
