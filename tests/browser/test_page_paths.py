"""Camera paths on the page: keys in numbers and on the timeline, undo, ready-made paths, what is
kept, films; and what moves the camera."""

import json
import math
import subprocess

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402

PATH = """
return JSON.parse(Object.entries(sessionStorage).find(([k]) => k.startsWith('ripnerf-path'))[1]);"""


@pytest.fixture
def scene(page, fake):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.api = api
    return page


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


def test_a_key_is_dragged_along_the_timeline_and_stops_at_its_neighbours(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".mark")) == 8, "eight marks")
    before = [key["time"] for key in scene.run(PATH)["keys"]]
    mark = scene.all(".mark")[1]
    scene.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", mark)
    ActionChains(scene.driver).click_and_hold(mark).move_by_offset(20, 0).move_by_offset(
        12, 0).release().perform()
    after = scene.until(
        lambda: (t := [key["time"] for key in scene.run(PATH)["keys"]]) != before and t, "a change")
    assert before[1] < after[1] < before[2] and after[2:] == before[2:]
    ActionChains(scene.driver).click_and_hold(mark).move_by_offset(900, 0).release().perform()
    far = [key["time"] for key in scene.run(PATH)["keys"]]
    assert far == sorted(far) and far[1] < far[2]
    mark.send_keys(Keys.ARROW_LEFT)
    assert scene.run(PATH)["keys"][1]["time"] < far[1]


def test_a_key_in_numbers(scene):
    scene.find(".stage").send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 1, "a key")
    scene.all(".key-picture")[0].click()
    field = scene.find("#key-x")
    scene.type(field, "1.25")
    field.send_keys(Keys.TAB)
    scene.type(scene.find("#key-roll"), "30")
    scene.find("#key-roll").send_keys(Keys.TAB)
    pose = scene.run(PATH)["keys"][0]["pose"]
    assert pose[0][3] == pytest.approx(1.25)
    angles = scene.run(
        "return (await load('orbit.js')).anglesOfPose(args[0], [0, 0, 1]);", pose)
    assert angles["roll"] == pytest.approx(math.radians(30), abs=1e-3)


def test_the_scrubber_moves_along_and_a_key_is_made_there(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.driver.execute_script(
        "const s = document.querySelector('.scrub'); s.value = 1.1;"
        "s.dispatchEvent(new Event('input'));")
    scene.says("1.10 s", ".clock")
    scene.press("Key here")
    scene.until(lambda: len(scene.all(".key")) == 9, "nine keys")
    keys = scene.run(PATH)["keys"]
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


def test_preview_goes_at_the_paths_own_speed(scene):
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.press("Preview")
    seen = scene.run(
        """
        const at = () => Number(document.querySelector('.scrub').value);
        const [t0, began] = [at(), performance.now()];
        await new Promise((r) => setTimeout(r, 1000));
        return (at() - t0) / ((performance.now() - began) / 1000);""")
    assert 0.8 < seen < 1.2
    scene.press("Stop")


def test_a_film_is_asked_for_shown_and_saved(scene, downloads):
    scene.press("Whole turn")
    scene.type(scene.field("Frames"), 2)
    scene.driver.execute_script(
        "const s = [...document.querySelectorAll('select')].find((e) => e.querySelector('option[value=av1]'));"
        "s.value = 'gif'; s.dispatchEvent(new Event('change'));")
    scene.type(scene.field("Film quality"), 40)
    scene.press("Render the path")
    scene.until(lambda: scene.all("img.film"), "the film", 30)
    assert scene.api.world.jobs[0]["options"]["film"] == "gif"
    assert scene.api.world.jobs[0]["options"]["video_quality"] == 40
    scene.press("Save film")
    scene.until(lambda: list(downloads.glob("sphere-draft*.gif")), "the file")
    assert scene.complaints() == []


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
    eye = [row[3] for row in scene.run(PATH)["keys"][0]["pose"]]
    numbers = [float(x) for x in word.split("camera=")[1].split("_")]
    assert sum((a - b) ** 2 for a, b in zip(eye, numbers[:3])) == pytest.approx(
        numbers[3] ** 2, rel=1e-3)


def test_w_flies_forward_and_stops(scene):
    scene.find(".stage").send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 1, "a key")
    stage = scene.find(".stage")
    stage.click()
    ActionChains(scene.driver).key_down("w").pause(0.4).key_up("w").perform()
    stage.send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 2, "another key")
    stage.send_keys("k")
    scene.until(lambda: len(scene.all(".key")) == 3, "a third")
    first, second, third = (key["pose"] for key in scene.run(PATH)["keys"])
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
            for t, a, r, h in ((0, 0, 3, 1), (1, 1, 4, 1.5), (1.5, 2.2, 3, 0.5), (4, 3, 2, 1))]
    for more in ({"interpolation": "circle"}, {"interpolation": "spline", "tension": 0.5},
                 {"interpolation": "linear"}, {"interpolation": "spline", "constant_speed": True},
                 {"interpolation": "circle", "constant_speed": True, "loop": True}):
        document = {"axes": "opencv", "fps": 5, "width": 64, "height": 48, "loop": False,
                    "keys": keys, **more}
        (tmp_path / "a.json").write_text(json.dumps({"path": document}))
        subprocess.run([build / "client/ripnerf", "paths", "convert", tmp_path / "a.json",
                        tmp_path / "b.json", "--to", "transforms", "--overwrite"],
                       check=True, capture_output=True, timeout=60)
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
    points = [{"setting": {"tolerance": t}, "ms_median": ms, "ms_p95": ms, "psnr": psnr, "ssim": 0.9,
               "psnr_full": 40, "psnr_spread": 0.5, "rays": 1, "samples": 1}
              for t, ms, psnr in ((0.06, 8, 27.5), (0.03, 40, 30.4), (0, 200, 31.2))]
    api.world.curve = {
        "machine": "m", "device": "cpu", "kernels": "avx2", "threads": 2, "version": "0.1.0",
        "digest": None, "step": 5, "measured_at": "2026-01-01T00:00:00Z", "stale": False,
        "width": 200, "height": 200, "views": 6, "photographs": True, "seconds": 9, "points": points}
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
    page.says("30.4 dB expected; took", "[aria-label='Accuracy against time']")
    page.says("tolerance=0.03", "[aria-label='Accuracy against time']")
    assert [body for body in asked if body.get("within_ms") == 51]
    page.says("within 51 ms", ".hud")
    assert page.complaints() == []
