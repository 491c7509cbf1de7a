"""Camera paths on the page: keys in numbers and on the timeline, undo, ready-made paths, what is
kept, films; and what moves the camera."""

import json
import math
import subprocess

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402


def choose(page, name):
    page.driver.execute_script(
        "const s = document.querySelector('[aria-label=\"Ready-made paths\"]');"
        "s.value = arguments[0]; s.dispatchEvent(new Event('change'));",
        name,
    )


@pytest.mark.parametrize("name, keys", [
    ("orbit", 8), ("arc", 5), ("spiral", 13), ("dolly-zoom", 9), ("photographs", 24)])
def test_ready_made_paths_are_ones_that_the_daemon_takes(scene, name, keys):
    choose(scene, name)
    scene.until(lambda: len(scene.all(".key")) == keys, f"{keys} keys")
    assert scene.button("Render the path")
    scene.press("Render the path")
    scene.says("Camera path sphere-draft", "h1")  # the stand-in checks it against the contract


def test_a_turn_goes_no_farther_than_the_photographs(page, fake):
    """Of a capture from one side: over what it shows and back, and the daemon takes that path."""
    api = fake("busy")
    every = api.world.cameras()
    api.world.cameras = lambda: [view for view in every if view["split"] != "train" or view["index"] < 7]
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Swing")
    page.until(lambda: len(page.all(".key")) == 16, "sixteen keys")
    yaws = [math.degrees(math.atan2(*(key["pose"][axis][3] for axis in (1, 0)))) for key in page.path()["keys"]]
    assert min(yaws) == pytest.approx(0, abs=0.1) and max(yaws) == pytest.approx(90, abs=0.1)  # 6 of 24 steps
    assert max(abs(b - a) for a, b in zip(yaws, yaws[1:] + yaws[:1])) < 20
    page.press("Render the path")
    page.says("Camera path sphere-draft", "h1")


def test_undo_and_redo_take_back_every_change(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.all(".key")[3].find_element("css selector", "[aria-label='Delete key']").click()
    scene.until(lambda: len(scene.all(".key")) == 7, "seven keys")
    scene.press("Undo")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight again")
    scene.press("Undo")
    scene.says("No keys yet")
    scene.press("Redo")
    scene.press("Redo")
    scene.until(lambda: len(scene.all(".key")) == 7, "seven again")
    scene.run("document.activeElement.blur();")
    ActionChains(scene.driver).key_down(Keys.CONTROL).send_keys("z").key_up(Keys.CONTROL).perform()
    scene.until(lambda: len(scene.all(".key")) == 8, "eight by the keyboard")


def test_clear_asks(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.press("Clear")
    scene.says("Remove all 8 keys of this path?", "dialog")
    scene.press("Keep")
    assert len(scene.all(".key")) == 8
    scene.press("Clear")
    scene.press("Remove")
    scene.says("No keys yet")


def test_another_ready_made_path_asks(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.press("Whole turn")
    scene.says("Replace the keys of this path?", "dialog")


def test_a_key_that_is_recorded_is_in_sight_among_many(scene):
    choose(scene, "photographs")
    scene.until(lambda: len(scene.all(".key")) == 24, "24 keys")
    scene.find(".stage").send_keys("k")
    seen = scene.until(lambda: len(scene.all(".key")) == 25 and scene.run("""
        const strip = document.querySelector('.keys');
        const room = strip.getBoundingClientRect();
        return [...strip.children].map((key) => key.getBoundingClientRect())
            .map(({left, right}) => left >= room.left - 1 && right <= room.right + 1);"""), "a key more")
    assert seen[-1] and not seen[0]


def test_the_picture_is_in_sight_with_the_timeline(scene):
    """Of a path that is scrubbed or played: in a window of 1000 pixels, and on the whole screen."""
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".mark")) == 8, "eight marks")
    scene.driver.execute_script("document.querySelector('.stage').scrollIntoView();")
    parts = "return args.map((css) => document.querySelector(css).getBoundingClientRect().bottom)"
    stage, lane, play = scene.run(parts, ".stage", ".viewport .lane", ".viewport .reel button")
    assert stage < min(lane, play) and max(lane, play) < scene.run("return innerHeight;")


def times(page):
    return [key["time"] for key in page.path()["keys"]]


def test_a_path_is_made_as_long_as_is_asked(scene):
    assert not scene.field("Length").is_enabled()
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    assert scene.field("Length").get_attribute("value") == "6"
    scene.type(scene.field("Length"), "12")
    assert times(scene) == pytest.approx([1.5 * i for i in range(8)])  # a round, closed after the last key
    scene.says("288 frames")
    scene.press("Undo")
    scene.until(lambda: times(scene)[-1] == pytest.approx(5.25), "what it was")
    assert scene.field("Length").get_attribute("value") == "6"


def test_a_key_in_numbers(scene):
    scene.find(".stage").send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 1, "a key")
    scene.all(".key-picture")[0].click()
    field = scene.find("#key-x")
    scene.type(field, "1.25")
    field.send_keys(Keys.TAB)
    scene.type(scene.find("#key-roll"), "30")
    scene.find("#key-roll").send_keys(Keys.TAB)
    pose = scene.path()["keys"][0]["pose"]
    assert pose[0][3] == pytest.approx(1.25)
    angles = scene.run(
        "return (await load('orbit.js')).anglesOfPose(args[0], [0, 0, 1]);", pose)
    assert angles["roll"] == pytest.approx(math.radians(30), abs=1e-3)
    scene.type(scene.find("#key-focal"), "50")  # the photographer's usual lens
    scene.find("#key-focal").send_keys(Keys.TAB)
    key = scene.path()["keys"][0]
    assert key["fovDeg"] == pytest.approx(2 * math.degrees(math.atan(12 / 50)))
    assert key["pose"] == [pytest.approx(row, abs=1e-3) for row in pose]
    scene.type(scene.find("#key-fovDeg"), "90")
    scene.find("#key-fovDeg").send_keys(Keys.TAB)
    scene.until(lambda: scene.find("#key-focal").get_attribute("value") == "12", "its focal length")


def eye_of(key):
    return [row[3] for row in key["pose"]]


def test_a_key_takes_the_view(scene):
    """By the button and by U; the others stay, and it is one step back."""
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    stage = scene.find(".stage")
    stage.send_keys("u")  # none is chosen
    before = scene.path()["keys"]
    scene.all(".key-picture")[2].click()
    scene.until(lambda: scene.all(".key-numbers")[0].is_displayed(), "the key in numbers")
    stage.send_keys(Keys.ARROW_LEFT * 3, "+")
    assert scene.path()["keys"][2]["pose"] == before[2]["pose"]  # to look elsewhere changes no key
    scene.press("Take this view")
    after = scene.path()["keys"]
    assert math.dist(eye_of(after[2]), eye_of(before[2])) > 0.2
    assert [i for i in range(8) if after[i]["pose"] != before[i]["pose"]] == [2]
    assert after[2]["time"] == before[2]["time"]
    stage.send_keys(Keys.ARROW_LEFT, "u")
    moved = scene.path()["keys"][2]["pose"]
    assert moved != after[2]["pose"]
    stage.send_keys("k")  # what is recorded stands where the key now does
    assert scene.path()["keys"][8]["pose"] == moved
    for count, pose in ((8, moved), (8, after[2]["pose"]), (8, before[2]["pose"])):
        scene.press("Undo")
        keys = scene.path()["keys"]
        assert len(keys) == count and keys[2]["pose"] == pose


# Where a camera's eye is drawn on the stage, pixels from its middle.
DRAWN = """
const {projector} = await load('views/overlay.js');
const {orbitOfWord, poseOfOrbit} = await load('orbit.js');
const orbit = orbitOfWord(args[0], [0, 0, 1]);
const {clientWidth: w, clientHeight: h} = document.querySelector('.stage');
return args[1].map((eye) => {
  const at = projector(poseOfOrbit(orbit), orbit.fovDeg, w, h)(eye);
  return at && [at[0] - w / 2, at[1] - h / 2];
});"""


def test_drawn_cameras_lead_to_their_key_and_photograph(page, fake):
    """From above, where all stand apart: the path is drawn, a click on a camera goes there, and a drag
    over one turns the view."""
    camera = "0_0_0_9_0_1.3_60"
    api = fake("busy")

    def above():
        page.open(api.url + f"#/scene/sphere-draft?camera={camera}")
        page.until(lambda: page.ink() > 100, "a picture")
        return page.find(".stage")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    assert page.ink("canvas.overlay") == 0
    page.press("Whole turn")
    page.until(lambda: len(page.all(".key")) == 8, "eight keys")
    keys = page.path()["keys"]
    stage = above()
    page.until(lambda: page.ink("canvas.overlay") > 0, "the path over the picture")

    def at(eye):
        return page.run(DRAWN, camera, [eye])[0]

    def chosen():
        return [i for i, key in enumerate(page.all(".key")) if key.get_attribute("data-selected") == "true"]

    def click(x, y):
        page.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", stage)
        ActionChains(page.driver).move_to_element_with_offset(stage, round(x), round(y)).click().perform()
    x, y = at(eye_of(keys[5]))
    ActionChains(page.driver).move_to_element_with_offset(stage, round(x), round(y)).click_and_hold(
        ).move_by_offset(40, 0).move_by_offset(-40, 0).release().perform()
    click(0, 0)
    assert chosen() == []
    click(x, y)
    page.until(lambda: chosen() == [5], "the sixth key")
    stage = above()
    page.press("Clear")
    page.press("Remove")
    page.until(lambda: not page.all(".key"), "no path")
    page.find("#show-cameras").click()
    page.until(lambda: page.ink("canvas.overlay") > 0, "the photographs' cameras")
    views = page.run("return (await (await fetch('v1/datasets/sphere/cameras')).json()).items;")
    item = next(v for v in views if (v["split"], v["index"]) == ("train", 7))
    click(*at([row[3] for row in item["camera"]["world_from_camera"]]))
    page.says("Photograph train:7", ".wipe-bar label")
    assert page.complaints() == []


def test_the_scrubber_moves_along_and_a_key_is_made_there(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.driver.execute_script(
        "const s = document.querySelector('.scrub'); s.value = 1.1;"
        "s.dispatchEvent(new Event('input'));")
    scene.says("1.10 s", ".clock")
    scene.press("Key here")
    scene.until(lambda: len(scene.all(".key")) == 9, "nine keys")
    keys = scene.path()["keys"]
    assert keys[2]["time"] == pytest.approx(1.1)
    eyes = [[row[3] for row in key["pose"]] for key in keys]
    radius = [sum(x * x for x in eye) for eye in eyes]
    assert radius[2] == pytest.approx(radius[0], rel=1e-3)  # on the circle, not on its chord


def test_the_path_is_kept_in_the_daemon_and_found_again(scene):
    scene.press("Whole turn")
    scene.says("kept in the daemon as sphere-draft.path", ".kept")
    record = scene.api.world.paths[0]
    assert record["name"] == "sphere-draft.path" and len(record["path"]["keys"]) == 8
    scene.run("sessionStorage.clear();")
    scene.driver.refresh()
    scene.until(lambda: len(scene.all(".key")) == 8, "the kept path")
    scene.says("as it was kept in the daemon", ".kept")


def test_a_path_is_kept_that_was_made_just_before_the_scene_is_left(scene):
    scene.run("""
document.querySelector('.stage').dispatchEvent(new KeyboardEvent('keydown', {key: 'k', bubbles: true}));
location.hash = '#/jobs';""")
    scene.until(lambda: scene.api.world.paths, "the path in the daemon")
    assert len(scene.api.world.paths[0]["path"]["keys"]) == 1


# Presses Preview with frames of the test's own: where the scrubber stands after each of them.
WITH_FRAMES = """
const real = [requestAnimationFrame, cancelAnimationFrame];
let [clock, serial, waiting] = [1000, 0, new Map()];
const put = ([ask, cancel]) => {
  window.requestAnimationFrame = ask;
  window.cancelAnimationFrame = cancel;
};
const frame = (ms) => {
  clock += ms;
  const due = [...waiting.values()];
  waiting.clear();
  for (const call of due) call(clock);
};
put([(call) => (waiting.set(++serial, call), serial), (id) => waiting.delete(id)]);
const button = [...document.querySelectorAll('button')].find((b) => b.textContent === 'Preview');
button.click();
const seen = args[0].map((ms) => (frame(ms), Number(document.querySelector('.scrub').value)));
button.click();
frame(0);
put(real);
return seen;"""


def test_preview_goes_at_the_paths_own_speed(scene):
    """A second of frames is a second of the path, over the end of a loop of 6 s, too."""
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    seen = scene.run(WITH_FRAMES, [0, 40, 500, 1000, 16, 4000, 1000])
    assert seen == pytest.approx([0, 0.04, 0.54, 1.54, 1.556, 5.556, 0.556], abs=1e-6)
    scene.press("Preview")
    at = "return Number(document.querySelector('.scrub').value);"
    scene.until(lambda: scene.run(at) > 0.7, "the browser's own frames to move it")
    scene.press("Stop")


def test_a_preview_ends_where_the_path_has_one_key_left(scene):
    scene.press("Whole turn")
    scene.press("Preview")
    scene.button("Stop")
    scene.run("""
for (let i = 0; i < 7; i++) document.querySelector('.key [aria-label="Delete key"]').click();""")
    scene.until(lambda: scene.run("return document.querySelector('.reel > button').textContent;") == "Preview", "its end")
    assert "NaN" not in scene.run("return document.querySelector('.clock').textContent;")
    assert scene.complaints() == []


def test_a_preview_waits_for_the_daemon_and_goes_on_with_it(page, fake):
    """Its clock stands while what it would show cannot be drawn, which the picture says."""
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.press("Preview")
    at = "return Number(document.querySelector('.scrub').value);"
    page.until(lambda: page.run(at) > 0.1, "the preview to begin")
    api.stop()
    page.says("The daemon does not answer", ".cover-note")
    page.find("[data-status=offline]")
    stood = page.run(at)
    frames = "await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));"
    assert page.run(frames + at) == stood
    page.button("Stop")
    fake("busy", api.server_address[1])
    page.find("[data-status=online]")
    page.until(lambda: page.run(at) != stood, "the preview to go on")
    page.press("Stop")
    assert page.complaints() == []


def measured(*points):
    """A curve of 200x200 whose points are a tolerance, milliseconds, and PSNR."""
    return {
        "machine": "m", "device": "cpu", "kernels": "avx2", "threads": 2, "version": "0.1.0",
        "digest": None, "step": 5, "measured_at": "2026-01-01T00:00:00Z", "stale": False,
        "width": 200, "height": 200, "views": 6, "photographs": True, "seconds": 9,
        "points": [{"setting": {"tolerance": tolerance} if tolerance else {}, "ms_median": ms,
                    "ms_p95": ms, "psnr": psnr, "ssim": 0.9, "psnr_full": 40, "psnr_spread": 0.5,
                    "rays": 1, "samples": 1} for tolerance, ms, psnr in points]}


def test_a_paths_quality_is_chosen_with_its_time(page, fake):
    """144 frames of 100x100, a quarter of the curve's pixels; the path that is asked for has the setting."""
    api = fake("busy")
    api.world.curve = measured((0.25, 8, 29), (0.12, 20, 30.5), (0.03, 120, 31.1), (0, 400, 31.2))
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    for name in ("Width", "Height"):
        page.type(page.field(name), 100)
    told = "return [...document.querySelectorAll('.qualities label')].map((l) => l.textContent);"
    page.until(lambda: page.run(told) == [
        "quickabout 1 s · 30.5 dB", "goodabout 4 s · 31.1 dB", "bestabout 14 s · 31.2 dB"], "times")
    page.run("document.querySelector('.qualities input[value=good]').click();")
    page.press("Render the path")
    page.says("Camera path sphere-draft", "h1")
    assert api.world.jobs[0]["options"]["tolerance"] == 0.03
    assert page.complaints() == []


def test_through_a_lens_quality_is_cones_and_without_a_curve_nothing_is_promised(page, fake):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    ways = page.run("""
        const {qualitiesOf} = await load('views/pathquality.js');
        return [null, args[0], args[1]].map((curve) => qualitiesOf(curve));""",
                    measured((0.12, 20, 30.5), (0, 400, 31.2)), measured((0, 400, 31.2)))
    assert [way["setting"] for way in ways[0]] == [{"tolerance": 0.12}, {"tolerance": 0.03}, {}]
    assert all(way["msPerPixel"] is None and way["psnr"] is None for way in ways[0])
    assert [way["setting"] for way in ways[1]] == [{"tolerance": 0.12}, {}, {}]
    assert [way["setting"] for way in ways[2]] == [{}, {}, {}]
    page.press("Whole turn")
    page.says("once the scene’s curve is measured", ".qualities")
    page.all(".key-picture")[0].click()
    page.press("Effects of the camera")
    for name, value in (("focus", 3), ("aperture", 0.1)):
        page.type(page.find(f"#key-{name}"), value)
        page.find(f"#key-{name}").send_keys(Keys.TAB)
    page.says("the fewer cones, the more grain", ".qualities")
    page.run("document.querySelector('.qualities input[value=quick]').click();")
    page.press("Render the path")
    page.says("Camera path sphere-draft", "h1")
    assert api.world.jobs[0]["options"]["supersample"] == 2


def test_a_path_that_was_cancelled_is_gone_on_with(page, fake):
    api = fake("busy")
    go_on = api.world.advance_path
    api.world.advance_path = lambda job, dt: len(api.world.frames.get(job["id"], {})) < 9 and go_on(job, dt)
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.press("Render the path")
    page.until(lambda: page.all(".cells [data-there]"), "a frame")
    page.press("Cancel")
    page.says("cancelled", ".chip")
    first = api.world.jobs[0]["id"]
    made = len(api.world.frames[first])
    api.world.advance_path = go_on
    page.press("Resume")
    page.until(lambda: api.world.jobs[0]["id"] != first, "another job")
    again = api.world.jobs[0]["id"]
    page.until(lambda: again in page.driver.current_url, "its page")
    page.until(lambda: len(page.all(".cells [data-there]")) >= made, "what was there")
    assert page.complaints() == []


def test_a_film_is_asked_for_shown_and_saved(scene, downloads):
    scene.press("Whole turn")
    scene.type(scene.field("Frames"), 2)
    scene.driver.execute_script(
        "const s = [...document.querySelectorAll('select')].find((e) => e.querySelector('option[value=av1]'));"
        "s.value = 'gif'; s.dispatchEvent(new Event('change', {bubbles: true}));")
    scene.type(scene.field("Film quality"), 40)
    scene.press("Render the path")
    scene.until(lambda: scene.all("img.film"), "the film")
    assert scene.api.world.jobs[0]["options"]["film"] == "gif"
    assert scene.api.world.jobs[0]["options"]["video_quality"] == 40
    scene.press("Save film")
    downloads.saved(scene, "sphere-draft*.gif")
    width = "return document.querySelector(args[0]).clientWidth;"
    film = scene.run(width, "img.film")
    assert not scene.all("canvas.frame")[0].is_displayed()
    scene.press("frames")
    assert scene.find("canvas.frame") and not scene.all("img.film")[0].is_displayed()  # one of the two, by choice
    assert film == scene.run(width, ".frame")  # as large as the frames, however small it is
    scene.press("film")
    scene.find("img.film")
    scene.open(scene.api.url + "#/scene/sphere-draft")
    scene.until(lambda: scene.ink() > 100, "a picture")
    assert scene.field("Made into").get_attribute("value") == "gif"  # as it was chosen
    assert scene.field("Film quality").get_attribute("value") == "40"
    assert scene.complaints() == []


def test_a_path_is_made_into_a_film_where_films_are_made(page, fake):
    """As the client makes one of `-o film.mp4`; frames are there for who chooses them, or has nothing else."""
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    select = page.field("Made into")
    assert select.get_attribute("value") == "h264" and page.field("Film quality")
    before = len(api.world.jobs)
    page.type(page.field("Frames"), 2)
    page.press("Render the path")
    page.until(lambda: len(api.world.jobs) > before, "a job")
    assert api.world.jobs[0]["options"]["film"] == "h264" and "format" not in api.world.jobs[0]["options"]
    page.says("MP4 H.264", ".facts")
    page.says("MP4 H.264, ", ".panel .row")  # the film, and how large it is
    api.world.films = False
    page.open(api.url + "#/scene/sphere-draft")
    select = page.field("Made into")
    assert select.get_attribute("value") == "png" and "film" not in select.text
    page.press("Render the path")
    page.until(lambda: len(api.world.jobs) > before + 1, "a job of frames")
    assert api.world.jobs[0]["options"]["format"] == "png" and "film" not in api.world.jobs[0]["options"]
    assert page.complaints() == []


def test_the_address_holds_the_camera(scene):
    scene.find(".stage").send_keys(Keys.ARROW_LEFT * 5)
    word = scene.until(
        lambda: "camera=" in scene.driver.current_url and scene.driver.current_url, "the address")
    before = scene.run("return document.querySelector('canvas.picture').width > 1;")
    assert before
    scene.driver.get("about:blank")
    scene.driver.get(word)
    scene.until(lambda: scene.ink() > 100, "a picture")
    scene.find(".stage").send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 1, "a key")
    eye = [row[3] for row in scene.path()["keys"][0]["pose"]]
    numbers = [float(x) for x in word.split("camera=")[1].split("_")]
    assert sum((a - b) ** 2 for a, b in zip(eye, numbers[:3])) == pytest.approx(
        numbers[3] ** 2, rel=1e-3)


def test_w_flies_forward_and_stops(scene):
    scene.find(".stage").send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 1, "a key")
    stage = scene.find(".stage")
    stage.click()
    ActionChains(scene.driver).key_down("w").perform()
    scene.run("for (let i = 0; i < 20; i++) await new Promise(requestAnimationFrame);")
    ActionChains(scene.driver).key_up("w").perform()
    stage.send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 2, "another key")
    stage.send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 3, "a third")
    first, second, third = (key["pose"] for key in scene.path()["keys"])
    moved = [second[i][3] - first[i][3] for i in range(3)]
    assert sum(moved[i] * first[i][2] for i in range(3)) > 0.05  # forward
    assert second == third


def test_preview_and_daemon_agree_on_arcs_and_speed(page, fake, build, tmp_path):
    """The page's cameras against the program's, for each way of moving."""
    page.open(fake("empty").url)
    page.find("main")

    def look(angle, radius, height):
        eye = [radius * math.cos(angle), radius * math.sin(angle), height]
        length = math.sqrt(sum(x * x for x in eye))
        f = [-x / length for x in eye]
        r = [f[1], -f[0], 0]
        n = math.hypot(*r)
        r = [x / n for x in r]
        d = [f[1] * r[2] - f[2] * r[1], f[2] * r[0] - f[0] * r[2], f[0] * r[1] - f[1] * r[0]]
        return [[r[i], d[i], f[i], eye[i]] for i in range(3)]

    keys = [{"time": t, "world_from_camera": look(a, r, h), "fov_y_deg": 40}
            for t, a, r, h in ((0, 0, 3, 1), (1, 1, 4, 1.5), (1.02, 2.2, 3, 0.5), (4, 3, 2, 1))]
    for more in ({"interpolation": "circle"}, {"interpolation": "spline", "tension": 0.5},
                 {"interpolation": "linear"}, {"interpolation": "spline", "constant_speed": True},
                 {"interpolation": "circle", "constant_speed": True, "loop": True}):
        document = {"axes": "opencv", "fps": 5, "width": 64, "height": 48, "loop": False,
                    "keys": keys, **more}
        (tmp_path / "a.json").write_text(json.dumps({"path": document}))
        subprocess.run([build / "client/ripnerf", "paths", "convert", tmp_path / "a.json",
                        tmp_path / "b.json", "--to", "transforms", "--overwrite"],
                       check=True, capture_output=True, timeout=120)
        frames = json.loads((tmp_path / "b.json").read_text())["frames"]
        shown = page.run(
            """
            const p = await load('path.js');
            const path = p.pathOfDocument(args[0]);
            return Array.from({length: p.frameCount(path)}, (_, i) =>
                p.cameraAt(path, i / path.fps).pose.map((row) => row[3]));""",
            document)
        assert len(shown) == len(frames), more
        worst = max(abs(frame["transform_matrix"][i][3] - eye[i])
                    for frame, eye in zip(frames, shown) for i in range(3))
        assert worst < 1e-6, (more, worst)


def test_a_budget_is_chosen_on_the_curve_and_the_truth_is_told(page, fake):
    api = fake("busy")
    api.world.curve = measured((0.06, 8, 27.5), (0.03, 40, 30.4), (0, 200, 31.2))
    asked = []
    api.world.on_render = asked.append
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: len(page.all(".cost-chart .dot")) == 3, "the curve's points")
    page.says("6 views of 200 × 200, against photographs")
    page.driver.execute_script(
        "const s = document.querySelector('#budget'); s.value = 0.335;"
        "s.dispatchEvent(new Event('input'));")
    page.says("within 51 ms: about 30.4 dB", "[aria-label='Accuracy against time']")
    page.driver.execute_script(
        "document.querySelector('#budget').dispatchEvent(new Event('change'));")
    page.says("30.4 dB ± 0.5 expected; took", "[aria-label='Accuracy against time']")
    page.says(" of 51 ms (waited 0.2 ms, rendered in ", "[aria-label='Accuracy against time']")
    page.says(" encoded in 1.1 ms)", "[aria-label='Accuracy against time']")
    page.says("setting tolerance=0.03", "[aria-label='Accuracy against time']")
    size = page.run("const s = document.querySelector('.stage'); const even = (x) => 2 * Math.round(x / 2);"
                    "return `${even(s.clientWidth)} × ${even(s.clientHeight)}`;")
    page.says(f"this view at {size}: ", "[aria-label='Accuracy against time']")
    assert [body for body in asked if body.get("within_ms") == 51]
    page.says("within 51 ms", ".hud")
    page.press("Beside the full picture")
    page.says("The full picture · ", ".wipe-bar label")  # and the truth, in dB
    # The stand-in's pictures are the same whatever the setting: what the browser makes of them for a
    # stage of another size is not between them.
    page.until(lambda: "· equal" in page.text(".wipe-bar label"), "how far they are apart")
    assert "within_ms" not in asked[-1]
    assert page.complaints() == []


def test_a_picture_that_is_late_says_so(page, fake):
    api = fake("busy")
    api.world.curve = measured((0.06, 8, 27.5), (0, 200, 31.2))
    api.world.waited_ms = 6001  # more than can be asked for
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: len(page.all(".cost-chart .dot")) == 2, "the curve's points")
    page.driver.execute_script(
        "const s = document.querySelector('#budget'); s.value = 0;"
        "s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change'));")
    page.says(" of 5.0 ms (waited 6 s, rendered in ", "[aria-label='Accuracy against time']")
    page.says(", late; setting", "[aria-label='Accuracy against time']")
    assert page.complaints() == []


def test_a_mark_on_the_chart_is_looked_at(page, fake):
    api = fake("bare")
    asked = []
    api.world.on_render = asked.append
    page.open(api.url + "#/dataset/sphere")
    page.press("Start training")
    page.until(lambda: len(page.all(".chart .moment")) >= 2, "marks on the chart")
    page.says("◇ leads to the scene as it was then.", "[aria-label='Training']")
    words = page.driver.execute_script(
        "return document.querySelector('.chart .moment').getAttribute('aria-label')")
    assert words.startswith("Look at it after 3.8 s of training")
    page.driver.execute_script(
        "document.querySelector('.chart .moment').dispatchEvent(new MouseEvent('click'));")
    page.says("after 3.8 s of training", ".hud")
    assert [body for body in asked if body.get("at") == 3.75]
    assert page.find(".chart .moment[aria-pressed=true]")
    page.press("Back to now")
    page.until(lambda: "at" not in asked[-1], "a picture of now")
    page.until(lambda: not page.all(".chart .moment[aria-pressed=true]"), "nothing looked back at")
    page.driver.execute_script("const m = document.querySelectorAll('.chart .moment')[1]; m.focus();"
                               "m.dispatchEvent(new KeyboardEvent('keydown', {key: 'Enter'}));")
    page.says("after 7.5 s of training", ".hud")
    page.until(lambda: "at=7.5" in page.driver.current_url, "the address")
    page.open(page.driver.current_url)
    page.says("after 7.5 s of training", ".hud")
    assert page.complaints() == []
