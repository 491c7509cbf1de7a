"""Effects of the camera in keys of a path, pictures laid over another and how they differ, and
pictures of an exact size."""

import math
import threading

import pytest
from support.waiting import PATIENCE_S

pytest.importorskip("selenium", reason="python3-selenium is not installed")

POSE = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]


def test_a_document_keeps_its_effects(page, fake):
    page.open(fake("empty").url)
    document = {
        "axes": "opencv", "fps": 4, "interpolation": "linear", "loop": False,
        "lens": "equirectangular", "width": 64, "height": 32,
        "keys": [
            {"time": 0, "world_from_camera": POSE, "fov_y_deg": 40, "aperture": 0.4, "focus": 3,
             "exposure": -1},
            {"time": 1, "world_from_camera": POSE, "fov_y_deg": 40, "shutter": 0.5,
             "white_balance": 3252}],
    }
    back, half = page.run(
        """
        const {documentOf, pathOfDocument, cameraAt} = await load('path.js');
        const path = pathOfDocument(args[0]);
        return [documentOf(path), cameraAt(path, 0.5).optics];""",
        document,
    )
    assert back == document
    # As the daemon goes over from key to key.
    assert half == {"aperture": 0.2, "focus": 3, "shutter": 0.25, "exposure": -0.5,
                    "white_balance": 0.75 * 6504}


def test_what_the_daemon_would_refuse_is_said_before(page, fake):
    page.open(fake("empty").url)
    said = page.run(
        """
        const {problemOfOptics} = await load('optics.js');
        return args[0].map((optics) => problemOfOptics(optics));""",
        [{}, {"aperture": 0.1, "focus": 2}, {"aperture": 0.1}, {"shutter": 2}, {"exposure": 30},
         {"white_balance": 20}, {"ortho_height": -1}],
    )
    assert said[:2] == [None, None] and all(said[2:]) and len(set(said[2:])) == 5


def test_differences_are_what_they_say(page, fake):
    page.open(fake("empty").url)
    signed, error, equal = page.run(
        """
        const {differenceOf} = await load('difference.js');
        const a = new Uint8ClampedArray([100, 100, 100, 255, 50, 60, 70, 255]);
        const b = new Uint8ClampedArray([110, 110, 110, 255, 40, 60, 70, 255]);
        return [differenceOf(a, b, 'signed'), differenceOf(a, b, 'error'), differenceOf(a, a, 'error')]
            .map(({pixels, psnr}) => ({pixels: [...pixels], psnr}));"""
    )
    assert signed["pixels"][0] == 255 > signed["pixels"][1] == signed["pixels"][2]  # lighter: red
    assert signed["pixels"][6] == 255 > signed["pixels"][4]  # darker: blue
    assert error["pixels"][0] > error["pixels"][4] > 0
    assert abs(error["psnr"] - 29.8917) < 1e-3  # mean square 200 / 3
    assert equal["psnr"] is None and equal["pixels"][:4] == [0, 0, 0, 255]


def put(page, name, value):
    page.driver.execute_script(
        "const i = document.getElementById('key-' + arguments[0]); i.value = arguments[1];"
        "i.dispatchEvent(new Event('change'));", name, value)


def test_a_key_s_effects_reach_picture_and_path(scene):
    asked = []
    scene.api.world.on_render = asked.append
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    scene.all(".key-picture")[2].click()
    scene.until(lambda: scene.all(".key-numbers")[0].is_displayed(), "the key in numbers")
    scene.run("document.querySelector('.key-effects').open = true;")
    put(scene, "aperture", 0.25)
    scene.says("Key 3: an aperture needs a focus")
    put(scene, "focus", 3)
    put(scene, "exposure", 0.5)
    assert scene.path()["keys"][2]["optics"] == {"aperture": 0.25, "focus": 3, "exposure": 0.5}
    scene.until(lambda: any(body.get("optics") == {"aperture": 0.25, "focus": 3, "exposure": 0.5} and
                            "within_ms" in body for body in asked), "a picture through the lens")
    moving = [body for body in asked if body.get("supersample") == 1 and "optics" in body]
    assert moving and all("aperture" not in body["optics"] for body in moving)
    scene.press("Render the path")
    scene.says("Camera path sphere-draft", "h1")  # the stand-in checks it against the contract
    scene.until(lambda: "Aperture" in told(scene), "what the path's keys asked for")
    asked_for = told(scene)
    assert asked_for["Aperture"] == "off to 0.25 width" and asked_for["Focus"] == "off to 3 away"
    assert asked_for["Exposure"] == "off to 0.5 stops" and "Shutter" not in asked_for


def told(page):
    """What the page of a job says that was asked for, by name."""
    return page.run("""
return Object.fromEntries([...document.querySelectorAll('.facts > div')].map(
    (row) => [...row.children].map((e) => e.textContent)));""")


def test_a_key_s_lens_goes_to_all_keys(scene):
    """Depth of field along a whole path is one key's, told once, and one step back."""
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    before = scene.path()["keys"]
    scene.all(".key-picture")[2].click()
    scene.press("Effects of the camera")
    put(scene, "aperture", 0.25)
    put(scene, "focus", 3)
    put(scene, "fovDeg", 25)
    scene.press("Lens to all keys")
    after = scene.path()["keys"]
    assert [(key["fovDeg"], key["optics"]) for key in after] == [(25, {"aperture": 0.25, "focus": 3})] * 8
    assert [(key["time"], key["pose"]) for key in after[3:]] == [(key["time"], key["pose"]) for key in before[3:]]
    scene.press("Undo")
    assert [key["fovDeg"] for key in scene.path()["keys"]].count(25) == 1


def test_keys_of_a_path_all_around_show_all_around(scene):
    asked = []
    scene.press("Whole turn")
    shown = "return [...document.querySelectorAll('.key img')].map((i) => i.naturalWidth);"
    scene.until(lambda: scene.run(shown) == [144] * 8, "what lies ahead of each key")
    scene.api.world.on_render = asked.append
    scene.press("all around")
    scene.until(lambda: scene.run(shown) == [176] * 8, "what lies around each key")
    around = [body["camera"] for body in asked if "lens" in body["camera"]]
    assert len(around) == 8 and all(
        camera["lens"] == {"model": "equirectangular"} and camera["height"] == 88 and
        camera["fx"] == pytest.approx(88 / math.pi) == camera["fy"] for camera in around)
    scene.press("Render the path")
    scene.says("Camera path sphere-draft", "h1")  # the stand-in checks it against the contract
    assert scene.complaints() == []


def test_a_photograph_s_difference_waits_for_what_it_is_compared_with(page, fake):
    """The view beside it has no lens, and may still be coarse: 3.02 dB were told of one that was not there."""
    api = fake("busy")
    rendered = threading.Event()
    api.world.on_render = lambda body: body.get("lens") != "as-taken" or rendered.wait(PATIENCE_S)
    page.open(api.url + "#/scene/sphere-draft?view=test:3")
    page.says("Photograph test:3", ".wipe-bar label")
    page.run("const s = document.querySelector('.wipe-bar select'); s.value = 'error';"
             "s.dispatchEvent(new Event('change'));")
    page.says("rendering it as it was taken", ".wipe-bar label")
    rendered.set()
    page.says("· equal", ".wipe-bar label")


def test_a_photograph_s_difference_is_shown_and_taken_back(page, fake):
    api = fake("busy")
    asked = []
    api.world.on_render = asked.append
    page.open(api.url + "#/scene/sphere-draft?view=test:3")
    page.says("Photograph test:3", ".wipe-bar")
    page.until(lambda: page.all(".wipe-own[src]"), "what it is compared with")
    # Through a lens of its own a photograph shows other places than the view beside it.
    assert [body["view"] for body in asked if body.get("lens") == "as-taken"] == ["test:3"]
    page.until(lambda: page.run(
        "return document.querySelector('.wipe img').naturalWidth;") > 0, "the photograph")
    before = page.run("return document.querySelector('.wipe img').src;")
    choose = ("const s = document.querySelector('.wipe-bar select'); s.value = arguments[0];"
              "s.dispatchEvent(new Event('change'));")
    page.driver.execute_script(choose, "error")
    colours = ("return [...document.querySelectorAll('.wipe-bar .legend')].map("
               "(scale) => [scale.textContent, scale.getAttribute('aria-label')]);")
    assert page.run(colours) == [["064 of 255 and more", "Colours: black where equal, over red and yellow to white"]]
    # The stand-in's photographs are its pictures: pixel by pixel the same.
    page.until(lambda: "· equal" in page.all(".wipe-bar label")[0].text, "what lies between")
    assert page.run("return document.querySelector('.wipe img').src;") != before
    page.driver.execute_script(choose, "signed")
    page.until(lambda: page.run(colours)[0][0] == "rendered darker −64+64 of 255 lighter", "the scale of the signs")
    page.driver.execute_script(choose, "")
    page.until(lambda: page.run(colours) == [], "no scale")
    page.until(lambda: "equal" not in page.all(".wipe-bar label")[0].text, "the photograph again")
