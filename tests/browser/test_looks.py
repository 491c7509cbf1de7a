"""What the page says of photographs before it sends any: small pictures of them are judged."""

import json
import math

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from PIL import Image, ImageFilter  # noqa: E402

SIZE = 1200  # pixels a side: small pictures are of as many, from 1440 on they are smaller


def pose(angle):
    c, s = math.cos(angle), math.sin(angle)
    return [[-s, 0, c, 4 * c], [c, 0, s, 4 * s], [0, 1, 0, 0], [0, 0, 0, 1]]


@pytest.fixture
def ring(tmp_path):
    """Twelve photographs, of which one is blurred and one shows what the next one shows."""
    folder, frames = tmp_path / "ring", []
    (folder / "images").mkdir(parents=True)
    for i in range(12):
        picture = Image.effect_noise((SIZE // 4, SIZE // 4), 60).resize(
            (SIZE, SIZE), Image.Resampling.BICUBIC).convert("RGB")
        if i == 4:
            picture = picture.filter(ImageFilter.GaussianBlur(8))
        name = f"images/p_{i}.jpg"
        picture.save(folder / name, quality=92)
        if i == 9:
            (folder / name).write_bytes((folder / "images/p_8.jpg").read_bytes())
        frames.append({"file_path": name, "transform_matrix": pose(0.4 * (i - (i == 9)))})
    f = SIZE / 0.73
    (folder / "transforms.json").write_text(json.dumps(
        {"camera_model": "PINHOLE", "fl_x": f, "fl_y": f, "cx": SIZE / 2, "cy": SIZE / 2, "w": SIZE,
         "h": SIZE, "frames": frames}))
    return folder


def notes(page, words):
    """Is told among what is folded below errors and warnings."""
    def told():
        page.run("for (const more of document.querySelectorAll('.preview details')) more.open = true;")
        return any(words in e.text for e in page.all(".preview details .problems"))
    page.until(told, f"{words!r} among the notes")


def test_blur_and_duplicates_are_told_before_anything_is_sent(page, daemon, ring):
    server = daemon()
    page.open(server.url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(ring))
    page.says("the same camera took before and after: p_4", ".preview .problems")
    notes(page, "p_8 and p_9")
    page.says("12 train", ".preview .facts")
    assert page.run("return fetch('v1/datasets').then((r) => r.json());")["items"] == []
    assert page.complaints() == []


@pytest.mark.parametrize("noise, told", [(True, "fitted to what the alpha channels cut out"), (False, "radius 1.5")])
def test_a_ball_that_pixels_decide_is_not_told_before_they_are_read(page, daemon, tmp_path, noise, told):
    """Of files of which only the beginnings were looked at; small ones are looked at whole."""
    folder, frames = tmp_path / "cut", []
    (folder / "train").mkdir(parents=True)
    for i in range(3):
        colour = Image.effect_noise((320, 320), 90) if noise else Image.new("L", (320, 320), 128)
        alpha = Image.new("L", (320, 320), 0)
        alpha.paste(255, (100, 100, 220, 220))
        Image.merge("RGBA", (colour, colour, colour, alpha)).save(folder / f"train/r_{i}.png")
        frames.append({"file_path": f"train/r_{i}", "transform_matrix": pose(2 * i)})
    (folder / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    assert ((folder / "train/r_0.png").stat().st_size > 64 << 10) == noise
    page.open(daemon().url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says(told, ".preview .facts")
    if not noise:
        return
    page.press("Import options")
    page.type(page.field("Bounds"), "0,0,0,2")
    page.field("Bounds").send_keys("\t")
    page.says("radius 2 about (0, 0, 0)", ".preview .facts")
    assert page.complaints() == []


def test_photographs_without_poses_are_looked_at_too(page, daemon, ring):
    server = daemon()
    page.open(server.url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(ring / "images"))
    page.says("photographs without poses")
    page.says("the same camera took before and after: p_4.jpg", ".preview .problems")
    notes(page, "nearly the same: p_8.jpg and p_9.jpg")
    notes(page, "12 photographs without poses, the first of 1200x1200")
    page.until(lambda: page.ink(".preview-thumb") > 0, "a thumbnail")
    assert page.text(".preview .photos").split() == [f"p_{i}.jpg" for i in range(12)]
    assert page.complaints() == []
