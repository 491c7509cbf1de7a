"""All of axe-core's rules on every view and state of the page, light and dark, wide and on a phone.
`RIPNERF_AXE` names its file, an `axe.min.js`; without one the tests say skipped."""

import os
from pathlib import Path

import pytest
from fake_world import contract
from test_sending import choose, folder  # noqa: F401 (a fixture)
from test_stability import FILE, INCIDENT, case, examined

pytest.importorskip("selenium", reason="python3-selenium is not installed")

AXE = os.environ.get("RIPNERF_AXE")
LOOKS = [(scheme, width) for scheme in ("light", "dark") for width in (1440, 320)]
RULES = """
document.querySelectorAll('main details').forEach((e) => { e.open = true; });
const {violations} = await axe.run();
return violations.map((v) => [v.id, v.nodes.map((n) => n.html.slice(0, 160))]);
"""
CURVE = {
    "machine": "m", "device": "cpu", "kernels": "avx2", "threads": 2, "version": "0.1.0",
    "digest": None, "step": 5, "measured_at": "2026-01-01T00:00:00Z", "stale": False,
    "width": 200, "height": 200, "views": 6, "photographs": True, "seconds": 9,
    "points": [{"setting": {"tolerance": t}, "ms_median": ms, "ms_p95": ms, "psnr": psnr,
                "ssim": 0.9, "psnr_full": 40, "psnr_spread": 0.5, "rays": 1, "samples": 1}
               for t, ms, psnr in ((0.06, 8, 27.5), (0.03, 40, 30.4), (0, 200, 31.2))]}
GAIN = {"on": True, "psnr": 27.1, "psnr_without": 26.3, "gain": 0.8, "gain_spread": 0.06,
        "cost": 0.12, "picture_cost": -0.034}
EFFECTS = {
    "machine": "m", "device": "cpu", "kernels": "avx2", "threads": 2, "version": "0.1.0",
    "measured_at": "2026-01-01T00:00:00Z", "seconds": 10, "seeds": 3, "held_out": "5 views",
    "gains": [{"name": "anisotropy", **GAIN}]}


pytestmark = pytest.mark.skipif(not AXE, reason="RIPNERF_AXE names no axe.min.js")


@pytest.fixture
def finds_nothing(page):
    """finds_nothing(state) fails where a rule is broken in any look of what the page now shows."""

    def look(scheme, width):
        feature = {"name": "prefers-color-scheme", "value": scheme}
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [
            feature, {"name": "prefers-reduced-motion", "value": "reduce"}]})
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": width < 400})

    axe = Path(AXE).read_text(encoding="utf-8")

    def check(state):
        page.until(lambda: page.all("dialog[open]") or not page.all(".skeleton"), "the view")
        page.driver.execute_script(axe)
        broken = {}
        for scheme, width in LOOKS:
            look(scheme, width)
            broken[scheme, width] = page.run(RULES)
        look("light", 1440)
        assert not any(broken.values()), (state, broken)

    return check


def rich(api):
    """A scene of which everything is known, and a job of every kind."""
    world = api.world
    world.curve, world.effects = CURVE, EFFECTS
    world.incidents = [{"file": FILE, "incident": INCIDENT}]
    with world.lock:
        train = next(j for j in world.jobs if j["type"] == "train")
        train["progress"]["nonfinite"] = {"rays": 40, "steps_rejected": 0, "rollbacks": 1}
        ladder = world.job("ladder", dataset=world.datasets[0]["id"], dataset_name="sphere",
                           options={"over": "planes=3,4", "train": {"max_time_s": 15}})
        world.report = contract.example("LadderReport")
        for kind in ("scene", "mesh"):
            job = world.submit({"type": "export", "scene": "sphere-draft", "options": {"as": kind}})
            job["result"] = {"file": "scene.ripscene", "bytes": 14_200_000, "bits": 8, "views": 6,
                             "psnr": 33.5, "trained": 33.53, "loss": 0.03, "split": "test"}
            world.set_state(job, "succeeded")
    return ladder


@pytest.mark.parametrize("place", ["", "#/jobs", "#/system", "#/nothing", "#/scene/nowhere"])
def test_an_empty_daemon(page, fake, finds_nothing, place):
    page.open(fake("empty").url + place)
    page.says("connected", ".connection")
    page.find("main .panel, main .problem")
    finds_nothing(place)


@pytest.mark.parametrize("place", ["", "#/dataset/sphere", "#/scene/sphere-draft", "#/jobs", "#/system",
                                   "#/scene/sphere-paper"])
def test_a_busy_daemon(page, fake, finds_nothing, place):
    api = fake("failed")
    rich(api)
    page.open(api.url + place)
    page.find("main .panel")
    finds_nothing(place)


def test_every_job(page, fake, finds_nothing):
    api = fake("failed")
    rich(api)
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.until(lambda: len(page.all(".key")) == 8, "eight keys")
    page.type(page.field("Frames"), 3)
    page.press("Render the path")
    page.says("Camera path sphere-draft", "h1")
    with api.world.lock:
        for kind, result in (("curve", CURVE), ("effects", EFFECTS)):
            job = api.world.job(kind, scene="sphere-draft", result=result)
            api.world.set_state(job, "succeeded")
        api.world.submit({"type": "eval", "scene": "sphere-draft"})
        api.world.submit({"type": "estimate", "dataset": "sphere"})
        api.world.submit({"type": "validate"})
        api.world.doctor = examined(case("log2", 0.5, 2), case("exp", 7.0, 2))
        api.world.submit({"type": "doctor", "scene": "sphere-draft", "options": {}})
        jobs = [(job["id"], job["type"]) for job in api.world.jobs]
    for job, type in jobs:
        page.open(api.url + f"#/job/{job}")
        page.find("main .panel")
        finds_nothing(type)


def test_a_photograph_and_a_training_like_another(page, fake, finds_nothing):
    page.open(fake("busy").url + "#/dataset/sphere?like=sphere-draft")
    page.says("As sphere-draft was trained", ".like")
    finds_nothing("a training like another")
    page.all(".photo")[0].click()
    page.find(".enlarged-frame[data-state=ready]")
    finds_nothing("a photograph enlarged")


def test_the_tools_of_a_view(page, fake, finds_nothing):
    api = fake("busy")
    rich(api)
    page.open(api.url + "#/scene/sphere-draft?view=test:3")
    page.says("Photograph test:3", ".wipe-bar")
    finds_nothing("beside a photograph")
    page.open(api.url + "#/scene/sphere-draft?crop=-0.5_-0.5_-0.5_0.5_0.5_0.5")
    page.until(lambda: page.ink() > 100, "a picture")
    finds_nothing("a box")
    for output in [e.get_attribute("value") for e in page.all("select option[value=cost], "
                   "select option[value=depth]")]:
        page.driver.execute_script(
            "const o = document.querySelector(`option[value=${arguments[0]}]`).parentElement;"
            "o.value = arguments[0]; o.dispatchEvent(new Event('change'));", output)
        page.until(lambda: page.all(".stage[data-level=refined]"), "the refined picture")
        finds_nothing(output)
    page.press("Evaluate")
    page.says("30.40 dB")
    page.find(".evaluation a").click()
    page.says("By view, worst first")
    finds_nothing("an evaluation")


def test_a_path_and_its_keys(page, fake, finds_nothing):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.until(lambda: len(page.all(".key")) == 8, "eight keys")
    page.all(".key-picture")[2].click()
    page.until(lambda: page.all(".key-numbers")[0].is_displayed(), "the key in numbers")
    finds_nothing("a key in numbers")
    page.press("Clear")
    page.says("Remove all 8 keys of this path?", "dialog")
    finds_nothing("a question")


def test_the_guide(page, finds_nothing):
    guide = Path(__file__).resolve().parents[2] / "web/guide/index.html"
    page.open(guide.as_uri())
    page.find("main")
    finds_nothing("the guide")


def test_a_report(page, fake, finds_nothing, tmp_path):
    api = fake("busy")
    rich(api)
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Evaluate")
    page.says("30.40 dB")
    written = page.run("""
        const {reportOf} = await load('report.js');
        return (await reportOf('sphere-draft')).text();""")
    (tmp_path / "report.html").write_text(written, encoding="utf-8")
    page.open((tmp_path / "report.html").as_uri())
    page.find("h1")
    finds_nothing("a report")


def test_before_a_scene_is_taken_in(page, fake, finds_nothing, tmp_path):
    (tmp_path / "ball.ripscene").write_bytes(b"as it was exported")
    page.open(fake("busy").url)
    page.find(".drop")
    page.all("#file-input")[0].send_keys(str(tmp_path / "ball.ripscene"))
    page.says("A scene for viewing")
    finds_nothing("a scene's file")


def test_before_an_upload(page, fake, finds_nothing, folder):  # noqa: F811
    api = fake("empty")
    choose(page, api, folder)
    page.says("5 train", ".preview .facts")
    page.says("2 photographs cannot be read", ".problem")
    finds_nothing("a folder before it is sent")
    page.press("Upload and import")
    page.says("ball is imported.")
    finds_nothing("imported")
    page.open(api.url)
    page.press("Or a folder on the daemon’s machine")
    finds_nothing("a folder of the daemon's")


def test_without_a_daemon_and_without_a_token(page, fake, finds_nothing):
    page.open(fake("token").url)
    page.find("#token-dialog[open] #token-input")
    finds_nothing("the token is asked for")
    api = fake("busy")
    page.open(api.url)
    page.says("sphere-draft")
    api.stop()
    page.says("No connection to the daemon", "#banner")
    finds_nothing("no connection")
