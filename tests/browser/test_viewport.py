"""The tools of a scene's view: what is laid over it, what lies under a point, pictures to keep."""

import threading

import pytest
from fake_api import Refusal
from support.waiting import PATIENCE_S

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from PIL import Image  # noqa: E402
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from test_page_paths import measured  # noqa: E402


@pytest.fixture
def asked(scene):
    bodies = []
    scene.api.world.on_render = bodies.append
    return bodies


def camera(page):
    """Where the camera stands, as a key that is recorded and taken back tells."""
    page.run("document.querySelector('.stage').dispatchEvent("
             "new KeyboardEvent('keydown', {key: 'k', bubbles: true}));")
    page.until(lambda: page.all(".key"), "a key")
    pose = page.path()["keys"][0]["pose"]
    page.press("Undo")
    page.until(lambda: not page.all(".key"), "no key")
    return pose


def choose(page, value):
    page.run("const s = document.querySelector('#rival'); s.value = args[0];"
             "s.dispatchEvent(new Event('change'));", value)


def test_another_scene_or_an_earlier_moment_is_laid_over_the_view(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = api.world.train({"dataset": "sphere", "scene": "other", "options": {"max_time_s": 1}})
        api.world.set_state(job, "running")
        while job["state"] == "running":
            api.world.advance(job, 0.1)
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    before = camera(page)
    choose(page, job["scene"])
    page.says("other", ".wipe-bar label")
    line = page.find(".wipe-line")
    clip = "return document.querySelector('.wipe img').style.clipPath;"
    assert "50%" in page.run(clip)
    ActionChains(page.driver).click_and_hold(line).move_by_offset(60, 0).release().perform()
    page.until(lambda: "50%" not in page.run(clip), "the line to move")
    assert camera(page) == before  # and the camera did not turn
    page.press("Blink")
    page.until(lambda: page.all(".wipe img.away"), "the rendering alone")
    page.until(lambda: not page.all(".wipe img.away"), "the other alone")
    laid = "return document.querySelector('.wipe img').src;"
    first = page.run(laid)
    page.run("document.getElementById('rival').dispatchEvent(new Event('change'));")
    page.until(lambda: page.run(laid) not in ("", first), "the picture to be laid anew")
    page.until(lambda: page.all(".wipe img.away"), "that to blink too")
    page.press("Blink")
    assert page.find(".wipe-line").is_displayed()
    asked = []
    api.world.on_render = asked.append
    choose(page, "at:3.75")
    page.says("After 3.8 s", ".wipe-bar label")
    assert [body for body in asked if body.get("at") == 3.75]
    assert page.complaints() == []


def test_what_is_laid_over_the_view_says_that_it_comes_or_why_not(scene):
    rendered = threading.Event()

    def look(body):
        if body.get("at") == 3.75 and not rendered.wait(PATIENCE_S):
            raise Refusal(503, "Unavailable", "the test forgot it")
        if body.get("at") == 7.5:
            raise Refusal(409, "Conflict", "what was kept of it is damaged")

    scene.api.world.on_render = look
    scene.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False})
    tools = "return document.querySelector('.viewport-tools').clientHeight;"
    before = scene.run(tools)
    choose(scene, "at:3.75")
    scene.says("Rendering the scene as it was after 3.8 s", ".viewport [role=status]")
    assert scene.run(tools) == before  # nothing jumps under the pointer
    rendered.set()
    scene.says("After 3.8 s", ".wipe-bar label")
    scene.until(lambda: not scene.text(".beside"), "nothing more to wait for")
    choose(scene, "at:7.5")
    scene.says("After 7.5 s is not shown: what was kept of it is damaged", ".viewport [role=status]")
    assert not scene.find(".viewport").find_elements("css selector", ".wipe:not([hidden])")
    choose(scene, "")
    scene.until(lambda: not scene.text(".beside"), "nothing to say")


def show(page, output):
    page.run("const o = document.querySelector(`.viewport-tools input[value=${args[0]}]`); o.checked = true;"
             "o.dispatchEvent(new Event('change', {bubbles: true}));", output)


def test_nothing_of_colours_is_laid_over_a_map(page, fake):
    """Neither a photograph nor another moment; both are back with the colours, and a view's button asks for these."""
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    laid = ".wipe:not([hidden])"
    choose(page, "at:3.75")
    page.says("After 3.8 s", ".wipe-bar label")
    show(page, "cost")
    page.says("After 3.8 s is laid over colours alone", ".viewport [role=status]")
    page.find(".legend .heat-bar")
    assert not page.all(laid)
    show(page, "rgb")
    page.says("After 3.8 s", ".wipe-bar label")
    choose(page, "")
    pick = "const s = document.querySelector('#view-pick'); s.value = args[0]; s.dispatchEvent(new Event('change'));"
    page.run(pick, "2")
    page.says("Photograph", ".wipe-bar label")
    show(page, "depth")
    page.until(lambda: not page.all(laid), "the map alone")
    asked = []
    api.world.on_render = asked.append
    page.run(pick, "3")
    page.until(lambda: any(body["output"] == "depth" for body in asked), "the depth from there")
    assert not page.all(laid) and not [body for body in asked if "view" in body]
    show(page, "rgb")
    page.says("Photograph", ".wipe-bar label")
    assert page.complaints() == []


def test_a_photograph_stands_in_until_the_first_picture_is_there(page, fake):
    api = fake("busy")
    coarse, refined = threading.Event(), threading.Event()
    api.world.on_render = lambda body: (refined if body["format"] == "png" else coarse).wait(PATIENCE_S)
    page.open(api.url + "#/scene/sphere-draft")
    page.says("A photograph, until the first picture is there", ".cover-note")
    page.until(lambda: page.run("return document.querySelector('.first').naturalWidth;"), "it")
    coarse.set()
    page.find(".stage[data-level=coarse]")
    page.until(lambda: not page.all(".first") and not page.find(".stage").find_element(
        "css selector", ".cover-note").is_displayed(), "nothing over the picture")
    refined.set()
    page.find(".stage[data-level=refined]")
    assert page.complaints() == []


def test_a_picture_is_waited_for_with_the_daemon(page, fake):
    """Until it is back, and then for what it renders; what says so stands clear of the picture's figures."""
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.says("refined", ".hud")
    api.stop()
    page.find(".stage").send_keys(Keys.ARROW_LEFT)
    page.says("The daemon does not answer", ".cover-note")
    apart = "return args.map((css) => document.querySelector(css).getBoundingClientRect().toJSON());"
    note, figures = page.run(apart, ".cover-note", ".hud")
    assert note["bottom"] <= figures["top"]
    rendered = threading.Event()
    again = fake("busy", api.server_address[1])
    again.world.on_render = lambda _: rendered.wait(PATIENCE_S)
    page.says("The daemon is back", ".cover-note")
    rendered.set()
    page.until(lambda: not page.find(".stage").find_elements("css selector", ".cover-note:not([hidden])"), "a picture")
    assert page.complaints() == []


def test_a_double_click_looks_at_what_is_there(scene, asked):
    """The depth at that point is asked for, from where the camera stands."""
    pose = camera(scene)
    scene.double_click(scene.find(".stage"), 90, 0)
    there = scene.until(lambda: next((body["camera"]["world_from_camera"] for body in asked
                                      if body.get("output") == "depth"), None), "its depth")
    assert [row[3] for row in there] == pytest.approx([row[3] for row in pose], abs=1e-4)
    turned = sum(a[2] * b[2] for a, b in zip(there, pose))
    assert 0.7 < turned < 0.999
    assert sum(a[2] * b[0] for a, b in zip(there, pose)) > 0.05  # to the right


def test_so_does_a_double_tap(scene, asked):
    box = scene.run("const r = document.querySelector('.stage').getBoundingClientRect();"
                    "return {x: r.left + 0.4 * r.width, y: r.top + r.height / 2};")
    scene.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        for _ in range(2):
            for kind, points in (("touchStart", [box]), ("touchEnd", [])):
                scene.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        scene.until(lambda: [body for body in asked if body.get("output") == "depth"], "the depth there")
    finally:
        scene.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def test_fingers_are_told_what_they_do(scene):
    """Where there is no mouse and, as a rule, no keyboard."""
    told = "return [...document.querySelectorAll('.help')].map((e) => e.checkVisibility());"
    assert scene.run(told) == [False, True]
    scene.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        scene.until(lambda: scene.run(told) == [True, False], "what fingers do")
    finally:
        scene.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def test_pictures_and_links_are_kept(scene, asked, downloads):
    downloads.clear()
    scene.press("Exact size")
    for label, value in (("Width, pixels", 70), ("Height, pixels", 50)):
        scene.type(scene.find(f"[aria-label='{label}']"), value)
    scene.press("Save")
    with Image.open(downloads.saved(scene, "sphere-draft-70x50*.png")) as picture:
        assert picture.size == (70, 50)
    scene.run("navigator.clipboard.writeText = async (words) => { window.copied = words; };")
    scene.press("Copy link")
    link = scene.until(lambda: scene.run("return window.copied;"), "the link")
    assert link.startswith(scene.api.url) and "#/scene/sphere-draft?camera=" in link
    scene.run("Element.prototype.requestFullscreen = async function () { window.filled = this.className; };")
    scene.press("Full screen")
    assert scene.run("return window.filled;") == "viewport"


def test_the_picture_is_put_on_the_page_without_blending(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.find(".stage[data-level=refined]")
    assert not page.run(
        "return document.querySelector('.picture').getContext('2d').getContextAttributes().alpha;")


def test_a_link_that_cannot_be_copied_is_shown(scene):
    """A page over plain HTTP from another machine has no clipboard."""
    scene.run("Object.defineProperty(navigator, 'clipboard', {value: undefined});")
    scene.press("Copy link")
    words = scene.find("dialog input[readonly]").get_attribute("value")
    assert words.startswith(scene.api.url) and "#/scene/sphere-draft?camera=" in words
    chosen = "const e = document.activeElement; return e.value.slice(e.selectionStart, e.selectionEnd);"
    assert scene.run(chosen) == words  # Ctrl C takes it
    scene.press("Close")
    scene.until(lambda: not scene.all("dialog input[readonly]"), "the dialog closed")


def test_the_worst_views_of_an_evaluation_are_looked_at_beside_their_photographs(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = api.world.submit({"type": "eval", "scene": "sphere-draft", "options": {}})
        api.world.set_state(job, "running")
        while job["state"] == "running":
            api.world.advance(job, 1)
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: [e.text for e in page.all(".worst button")] == [
        "test:0 29.0 dB", "test:1 29.4 dB", "test:2 29.8 dB"], "the worst views, the worst one first")
    page.press("test:1 29.4 dB")
    page.says("Photograph test:1", ".wipe-bar label")
    assert page.complaints() == []


CUT_OFF = """
const wide = document.documentElement.clientWidth;
const words = (e) => `${e.tagName} ${e.className} ${e.textContent.slice(0, 30)}`;
const outside = [...document.querySelectorAll('.wipe-bar *')].filter((e) => {
  const {left, right} = e.getBoundingClientRect();
  return left < 0 || right > wide;
});
const narrow = [...document.querySelectorAll('.qualities label')].filter(
    (e) => e.scrollWidth > e.clientWidth + 1);
const over = [...document.querySelectorAll('.effect strong')].filter((e) => {
  const range = document.createRange();
  range.selectNodeContents(e);
  const number = e.closest('.effect').querySelector('.number').getBoundingClientRect();
  return range.getBoundingClientRect().right > number.left;
});
return [...outside, ...narrow, ...over].map(words);"""


@pytest.mark.parametrize("width", [320, 390])
def test_on_a_phone_nothing_is_cut_off(page, fake, width):
    """Not what closes a comparison, nor a path's time and accuracy, nor an effect's name, nor what a picture shows."""
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": width, "height": 700, "deviceScaleFactor": 2, "mobile": True})
    api = fake("busy")
    api.world.curve = measured((0.12, 20, 30.5), (0.03, 120, 31.1), (0, 400, 31.2))
    api.world.scenes[0]["effects"][0]["number_text"] = "0.0619 megapixels a second"
    page.open(api.url + "#/scene/sphere-draft?view=test:3")
    page.says("Photograph test:3", ".wipe-bar label")
    page.press("Whole turn")
    page.says("30.5 dB", ".qualities")
    assert page.run(CUT_OFF) == []
    assert page.run("return [...document.querySelectorAll('.segments')]"
                    ".filter((row) => row.scrollWidth > row.clientWidth).map((row) => row.innerText);") == []
    label, close, lane = page.run(
        "return args.map((css) => document.querySelector(css).getBoundingClientRect().toJSON());",
        ".wipe-bar label", ".wipe-bar [aria-label='Close the comparison']", ".lane")
    assert close["top"] < label["bottom"] and close["left"] >= label["right"] - 1  # no line of its own
    assert lane["width"] > 200  # eight keys stand apart
    page.press("×")
    page.until(lambda: not page.all(".wipe:not([hidden])"), "the comparison closed")
    page.says("refined", ".hud")
    one, line = page.run(
        "const hud = document.querySelector('.hud'); const line = parseFloat(getComputedStyle(hud).lineHeight);"
        "return [hud.clientHeight, line];")
    assert one < 2 * line  # its figures stand in one line
    assert "step" in page.text(".hud") and "samples" not in page.text(".hud")
