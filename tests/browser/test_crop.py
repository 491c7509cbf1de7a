"""The box that a picture shows: set by its faces, drawn over the picture, kept in the address."""

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")


@pytest.fixture
def asked(scene):
    """What was asked for last."""
    bodies = []
    scene.api.world.on_render = bodies.append
    return lambda: bodies[-1] if bodies else {}


def face(page, label, value):
    page.run(
        """
        const slider = document.querySelector(`.crop input[aria-label="${args[0]}"]`);
        slider.value = args[1];
        slider.dispatchEvent(new Event('input', {bubbles: true}));""", label, value)


def test_a_box_is_set_by_its_faces(scene, asked):
    scene.press("Crop")
    face(scene, "x from", -0.3)
    face(scene, "z to", 0.6)
    box = [-0.3, -1.5, -1.5, 1.5, 1.5, 0.6]
    scene.until(lambda: asked().get("crop") == pytest.approx(box, abs=0.01), "a picture of the box")
    scene.until(lambda: scene.all(".stage[data-level=refined]"), "the refined picture")
    scene.says("-0.3, -1.5, -1.5, 1.5, 1.5, 0.6", ".crop output")
    scene.until(lambda: "crop=" in scene.driver.current_url, "the box in the address")
    face(scene, "x to", -1.2)  # a face stays before the one opposite
    low, high = scene.until(
        lambda: [asked()["crop"][i] for i in (0, 3)] if asked()["crop"][3] < 1 else None, "the face")
    assert low < high == pytest.approx(-0.285, abs=0.001)
    scene.press("Whole")
    scene.until(lambda: asked().get("crop") == [-1.5] * 3 + [1.5] * 3, "the whole ball")
    scene.find("#crop-on").click()
    scene.until(lambda: "crop" not in asked(), "all of the scene")
    scene.until(lambda: "crop=" not in scene.driver.current_url, "the address")
    assert scene.complaints() == []


def test_a_box_of_the_address_is_shown_and_drawn(scene, asked):
    scene.open(scene.api.url + "#/scene/sphere-draft?crop=-0.5_-0.5_-0.5_0.5_0.5_0.5")
    scene.until(lambda: asked().get("crop") == [-0.5] * 3 + [0.5] * 3, "a picture of the box")
    scene.until(lambda: scene.ink("canvas.overlay") > 0, "the box's edges")
    assert scene.find("#crop-on").is_selected()
    for word in ("1_0_0_0_1_1", "x", "1_2_3", "0_0_0_1_1_nan"):
        scene.open(scene.api.url + f"#/scene/sphere-draft?crop={word}")
        scene.until(lambda: scene.ink() > 100, "a picture")
        assert "crop" not in asked(), word


def test_the_faces_have_a_row_of_their_own(scene):
    """Below the buttons, which stay in theirs; each face's slider is as wide as there is room for."""
    scene.press("Crop")
    row = scene.run("return [...document.querySelectorAll('.tools-end > button')].map((e) => e.offsetTop);")
    assert len(set(row)) == 1
    assert scene.find(".crop-form").location["y"] > scene.button("Share").location["y"]
    assert scene.run("return Math.min(...[...document.querySelectorAll('.crop-axis input')].map("
                     "(e) => e.offsetWidth));") > 150
