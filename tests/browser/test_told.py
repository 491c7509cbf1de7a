"""What the page says is so: figures say of what they are, pictures what they show, and every part
is reachable by the keyboard."""

import threading
import time

import pytest
from support.waiting import PATIENCE_S
from test_leaks import finished_path

pytest.importorskip("selenium", reason="python3-selenium is not installed")

PLACES = ("", "#/dataset/sphere", "#/scene/sphere-draft", "#/jobs", "#/system")


def phone(page, width):
    page.driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": 700, "deviceScaleFactor": 2, "mobile": True},
    )


def test_a_card_renders_a_view_that_there_is(page, fake):
    """The first training view may be a test view by now: its number is nobody's."""
    api = fake("busy")
    api.world.missing.add(("train", 0))
    asked = []
    api.world.on_render = asked.append
    page.open(api.url)
    page.until(lambda: asked and page.all(".card .thumb[data-state=ready]") and page.text(".stands-in") == "",
               "the card's rendering")
    assert [body["view"] for body in asked] == ["train:1"]


def test_a_photograph_stands_in_for_a_rendering_that_takes_long(page, fake):
    api = fake("busy")
    held = threading.Event()
    api.world.on_render = lambda body: held.wait(PATIENCE_S)
    page.open(api.url)
    page.says("photograph", ".card .stands-in")
    page.find(".card .thumb[data-state=ready]")
    held.set()
    page.until(lambda: page.text(".stands-in") == "", "the rendering")


def test_a_photograph_on_a_card_says_so(page, fake):
    api = fake("busy")
    api.world.scenes[0]["loaded"] = False
    page.open(api.url)
    page.until(lambda: page.all(".card .thumb[data-state=ready]"), "the card's picture")
    assert page.text(".stands-in") == "photograph"


def test_figures_say_which_views_they_are_of(page, fake):
    api = fake("busy")
    page.open(api.url)
    page.says("held out", ".card .figures")
    page.open(api.url + "#/scene/sphere-draft")
    page.says("PSNR, held out", ".stats")
    page.says("8 evenly spaced views of the validation split", ".facts")


def test_a_dataset_tells_what_training_takes_and_shows_its_points(page, fake):
    api = fake("busy")
    api.world.find(api.world.datasets, "sphere", "dataset").update(
        capture="outdoor", up=[-1.181e-17, 5.2e-18, 1], bounds={"centre": [0, 0, 0], "radius": 1.5, "source": "depths"})
    page.open(api.url + "#/dataset/sphere")
    page.says("from the depths that its poses give", ".facts")
    page.says("something turned around in its surroundings; up is 0, 0, 1", ".facts")
    page.says("Training, estimated", ".facts")
    page.says("1 min 00 s, 321 MiB of memory", ".facts")
    page.says("Training, by 3 trainings here", ".facts")
    page.says("1 min 06 s, 391 MiB of memory", ".facts")
    page.says("31 points, 30 of them shown, 40 cameras", ".panel")
    drawn = """const c = document.querySelector('canvas.cloud');
return c.width && c.toDataURL();"""
    before = page.until(lambda: page.run(drawn), "the points")
    page.run("""document.querySelector('canvas.cloud').dispatchEvent(
  new KeyboardEvent('keydown', {key: 'ArrowLeft', bubbles: true}));""")
    page.until(lambda: page.run(drawn) != before, "the points from another side")


def test_an_effect_that_is_off_over_its_threshold_says_why(page, fake):
    api = fake("busy")
    effect = next(e for e in api.world.scenes[0]["effects"] if e["name"] == "anisotropy")
    effect.update(on=False, decided=True, number=0.95, threshold=0.585,
                  number_text="1.93 times", threshold_text="1.5 times")
    effect["reason"] = "95 % of footprints are at most 1.93 times as long as wide; without a scale pyramid it has no use"
    page.open(api.url + "#/scene/sphere-draft")
    row = page.until(
        lambda: next((e for e in page.all(".effect") if "Anisotropy" in e.text), None), "the effect"
    )
    assert "off" in row.text and "1.93 times" in row.text and "without a scale pyramid" in row.text
    assert "and what else its reason names allows it" in page.text("[aria-label=Effects]")


def test_an_effect_says_on_which_side_of_its_threshold_it_is_on(page, fake):
    api = fake("busy")
    effects = {effect["name"]: effect for effect in api.world.scenes[0]["effects"]}
    around = effects["forward-facing"]  # 52 degrees are over its threshold, and no reason for it
    around.update(number=52.1, number_text="52.1 degrees")
    page.open(api.url + "#/scene/sphere-draft")
    shown = "return Object.fromEntries([...document.querySelectorAll('.effect')].map((e) =>" \
            "[e.querySelector('strong').textContent, [e.querySelector('.number').textContent, Boolean(e.closest('details'))]]));"
    told = page.until(lambda: page.run(shown), "the effects")
    assert told["Forward facing"] == ["52.1 degreeson if at most 30 degrees", True]
    assert told["Scale pyramid"] == ["8 times the finest footprinton if over 1.41 times the finest footprint", False]
    around.update(number=29.9, number_text="29.9 degrees")  # for it, and something else is against it
    page.driver.refresh()
    told = page.until(lambda: page.run(shown), "the effects")
    assert told["Forward facing"] == ["29.9 degreeson if at most 30 degrees", False]
    for effect in effects.values():
        effect.pop("below", None)  # as an older build described them
    page.driver.refresh()
    page.until(lambda: page.run(shown).get("Scale pyramid") == ["8 times the finest footprintthreshold 1.41 times the finest footprint", False], "a threshold")


def test_how_long_measuring_takes_is_told_before(page, fake):
    api = fake("busy")
    effects = api.world.scenes[0]["effects"]
    count = sum(effect["measurable"] for effect in effects)
    page.open(api.url + "#/scene/sphere-draft")
    page.says(f"takes {count} min 00 s and what loading", "[aria-label=Effects]")
    page.says(f"3 pairs of trainings of 10 s for each of {count} that", "[aria-label=Effects]")
    page.button("Measure")
    for effect in effects:
        effect["measurable"] = False
    page.driver.refresh()
    page.says("there is nothing to measure", "[aria-label=Effects]")
    assert not any(e.is_displayed() for e in page.all("[aria-label=Effects] header button"))


def test_gains_stand_apart_from_what_they_are_of(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.press("4 differences")
    item = page.until(
        lambda: next((e for e in page.all(".differences li") if e.text.count("dB")), None),
        "a difference with its gain",
    )
    what, gain = item.text.split("\n")
    assert what and gain and "dB" not in what


def test_a_job_on_a_cluster_says_where_it_runs_or_why_it_waits(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = api.world.train(
            {"dataset": "sphere", "scene": "far", "options": {"preset": "draft", "max_time_s": 300}}
        )
        job["runner"] = {"slurm_job": "17", "reason": "Priority"}
    for place in ("#/jobs", f"#/job/{job['id']}"):
        page.open(api.url + place)
        page.says("waits: Priority, Slurm 17")
    with api.world.lock:
        api.world.advance_train = lambda job, dt: None
        job["runner"] = {"slurm_job": "17", "machine": "n2"}
        api.world.set_state(job, "running")
    page.says("on n2, Slurm 17")
    page.open(api.url + "#/jobs")
    page.says("on n2, Slurm 17")
    assert page.complaints() == []


def test_the_player_plays_as_fast_as_the_path_says(page, fake):
    api = fake("busy")
    path = {
        "axes": "opencv",
        "width": 8,
        "height": 8,
        "fps": 7,
        "keys": [
            {
                "time": t,
                "world_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -3]],
                "fov_y_deg": 40,
            }
            for t in (0, 1)
        ],
    }
    with api.world.lock:
        job = api.world.submit({"type": "path", "scene": "sphere-draft", "camera_path": path,
                                "options": {"quality": 40}})
    page.open(api.url + f"#/job/{job['id']}")
    page.until(lambda: page.all("#play-rate"), "the player")
    page.says("stop=0.1, tolerance=0.03; 30.4 dB ± 0.9 expected", ".facts")  # what its budget became
    assert page.all("#play-rate")[0].get_attribute("value") == "7"
    page.says("7 a second", ".facts")
    page.says("all that the scene has", ".facts")


def test_a_training_job_has_its_curve_and_what_was_asked(page, fake):
    api = fake("busy")
    job = next(j for j in api.world.jobs if j["type"] == "train")
    with api.world.lock:
        job["result"]["estimate"] = {"job": "job_a2c4e6g3i5k7", "seconds": 31.5, "psnr": 29.25, "passings": []}
    page.open(api.url + f"#/job/{job['id']}")
    page.until(lambda: page.all(".chart .last"), "the curve")
    page.says("29.25 dB after 32 s", ".facts")  # what had been estimated of it
    page.says("PSNR, held out", ".stats")
    page.says("30 s", ".facts")


def test_loading_is_told_as_a_stage(page, fake):
    api = fake("busy")
    api.world.advance_train = lambda job, dt: None
    with api.world.lock:
        job = api.world.train({"dataset": "sphere", "scene": "large", "options": {"max_time_s": 30}})
        api.world.set_state(job, "running")
    job["progress"] = api.world.train_progress(job, 0) | {"stage": "loading photographs", "load_seconds": 12.3}
    page.open(api.url + "#/jobs")
    page.says("loading photographs · 12 s")
    page.open(api.url + f"#/scene/{job['scene']}")
    page.says("loading photographs · 12 s", ".panel")
    job["progress"] = api.world.train_progress(job, 5) | {"evaluating": True}  # the clock stands still
    page.open(api.url + f"#/scene/{job['scene']}")
    page.says("evaluating after 5 s", ".panel")


def test_the_first_steps_are_not_called_refined(page, fake):
    api = fake("busy")
    api.world.scenes[0]["steps"] = 0
    api.world.untrained = True
    page.open(api.url + "#/scene/sphere-draft")
    page.says("not trained yet", ".hud")
    assert "refined" not in page.text(".hud")


def test_a_scene_that_waits_for_its_turn_says_that_training_has_not_begun(page, fake):
    api = fake("busy")
    api.world.scenes[0]["steps"] = 0
    page.open(api.url + "#/scene/sphere-draft")
    page.says("No picture yet: training has not begun.", ".cover-note")


def test_a_fog_is_not_refined_before_the_first_step(page, fake):
    """Its full picture would take the longest of all, from the training that makes it a scene."""
    api = fake("bare")
    asked = []
    api.world.untrained, api.world.on_render = True, asked.append
    api.world.advance_train = lambda job, dt: None
    with api.world.lock:
        api.world.train({"dataset": "sphere", "scene": "fog", "options": {"max_time_s": 3000}})
    page.open(api.url + "#/scene/fog")
    page.says("not trained yet", ".hud")
    page.until(lambda: len(asked) > 3, "the next pictures")
    assert all(body["format"] == "jpeg" for body in asked)
    del api.world.advance_train
    page.find(".stage[data-level=refined]")
    assert asked[-1]["format"] == "png" and "not trained" not in page.text(".hud")


def test_training_comes_before_the_small_print_on_a_phone(page, fake):
    phone(page, 390)
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.until(lambda: page.all("[aria-label='Compared with the paper']"), "the page")
    top = {
        name: page.run(
            "return document.querySelector(`[aria-label='${args[0]}']`).getBoundingClientRect().top;",
            name,
        )
        for name in ("View", "Training", "Camera path", "Compared with the paper")
    }
    assert list(top) == sorted(top, key=top.get), top


def test_a_few_photographs_come_before_training_on_a_phone(page, fake):
    api = fake("busy")
    count = api.world.datasets[0]["views"]["train"]
    phone(page, 390)
    page.open(api.url + "#/dataset/sphere")
    page.find("#train")
    assert count > 6
    page.until(lambda: len(page.all(".photos figure")) == 6, "six photographs")
    page.press(f"Show all {count}")
    page.until(lambda: len(page.all(".photos figure")) == count, "all of them")


@pytest.mark.parametrize("width", [320, 390])
def test_nothing_is_wider_than_a_phone(page, fake, width):
    api = fake("busy")
    phone(page, width)
    for place in PLACES:
        page.open(api.url + place)
        page.find("main .panel")
        if place.startswith("#/scene"):
            page.find(".path-options select")
        time.sleep(0.4)
        wide = page.run(
            """
            return [...document.querySelectorAll('main *, header *')]
                .filter((e) => e.getBoundingClientRect().right > args[0] + 1 &&
                    !e.closest('.scroll, .keys, .timeline'))
                .map((e) => `${e.tagName}.${e.className} ${e.textContent.slice(0, 30)}`);""",
            width,
        )
        assert page.run("return document.documentElement.scrollWidth;") <= width, (place, wide[:5])
        short = page.run("return [...document.querySelectorAll('main input[type=range]')]"
                         ".filter((e) => e.checkVisibility() && e.clientWidth < 80).map((e) => e.outerHTML);")
        assert not short  # a slider is for dragging


ACCESS = """
const seen = (e) => e.checkVisibility() && e.getBoundingClientRect().width > 0;
const say = (e) => e.outerHTML.slice(0, 100);
const all = (css) => [...document.querySelectorAll(css)].filter(seen);
const faults = [];
for (const e of all('a[href], button'))
  if (!(e.textContent.trim() || e.getAttribute('aria-label') || e.title)) faults.push('nameless stop ' + say(e));
for (const e of all('*'))
  if (/auto|scroll/.test(getComputedStyle(e).overflowX + getComputedStyle(e).overflowY) &&
      e !== document.documentElement && e !== document.body && e.tagName !== 'SELECT' &&
      (e.scrollWidth > e.clientWidth + 1 || e.scrollHeight > e.clientHeight + 1) &&
      e.tabIndex < 0 && !e.querySelector('a[href], button, input, select'))
    faults.push('scrolls without focus ' + say(e));
for (const e of all('th'))
  if (!e.textContent.trim()) faults.push('empty header ' + say(e));
for (const e of all('p a:not(.button), dd a, li a:not(.button)'))
  if (e.textContent.trim() && e.parentElement.textContent.trim() !== e.textContent.trim() &&
      !getComputedStyle(e).textDecorationLine.includes('underline'))
    faults.push('told by colour alone ' + say(e));
for (const e of all('main button, main a.button, main select, main input:not([type=checkbox], [type=radio])')) {
  const box = e.getBoundingClientRect();
  if (!e.classList.contains('unseen') && (box.width < 24 || box.height < 24))
    faults.push(`${Math.round(box.width)}x${Math.round(box.height)} ` + say(e));
}
for (const e of document.querySelectorAll('[id]'))
  if (document.querySelectorAll('#' + CSS.escape(e.id)).length > 1) faults.push('id twice ' + say(e));
return faults;
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_part_is_reachable_and_large_enough(page, fake, scheme):
    """WCAG 2: 1.4.1 use of colour, 2.1.1 keyboard, 2.4.4 link purpose, 2.5.8 target size."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    api = fake("busy")
    for place in PLACES:
        page.open(api.url + place)
        page.find("main .panel")
        time.sleep(0.5)
        assert page.run(ACCESS) == [], place
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.until(lambda: len(page.all(".key")) == 8, "eight keys")
    assert page.run(ACCESS) == []


CONTRAST = """
const canvas = document.createElement('canvas');
canvas.width = canvas.height = 1;
const context = canvas.getContext('2d', {willReadFrequently: true});
/** The colours over one another, the last one on top, as the browser mixes them. */
const mixed = (...colours) => {
  for (const colour of colours) {
    context.fillStyle = colour;
    context.fillRect(0, 0, 1, 1);
  }
  return [...context.getImageData(0, 0, 1, 1).data];
};
const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const behind = (e) => {
  const colours = [];
  for (let at = e; at; at = at.parentElement) colours.unshift(getComputedStyle(at).backgroundColor);
  return ['white', ...colours];
};
const faults = [];
for (const e of document.querySelectorAll('body *')) {
  const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
  if (!own || !e.checkVisibility({opacityProperty: true, visibilityProperty: true}) ||
      e.closest('[disabled], [aria-disabled=true], .overlay, .stage, svg, .unseen, .skip')) continue;
  const style = getComputedStyle(e);
  const back = behind(e);
  const [a, b] = [light(mixed(...back)), light(mixed(...back, style.color))];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  const size = parseFloat(style.fontSize);
  const least = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700) ? 3 : 4.5;
  if (ratio < least) faults.push(`${ratio.toFixed(2)} ${e.outerHTML.slice(0, 90)}`);
}
for (const e of document.querySelectorAll('main input, main select, main progress, main canvas[tabindex]'))
  if (e.checkVisibility() && !(e.labels?.length || e.ariaLabel || e.title ||
      e.getAttribute('aria-labelledby'))) faults.push('no label ' + e.outerHTML.slice(0, 90));
for (const e of document.querySelectorAll('img'))
  if (!e.hasAttribute('alt')) faults.push('no alternative ' + e.outerHTML.slice(0, 90));
const levels = [...document.querySelectorAll('h1, h2, h3, h4')].filter((e) => e.checkVisibility())
    .map((e) => Number(e.tagName[1]));
levels.forEach((level, i) => level > (levels[i - 1] ?? 0) + 1 && faults.push(`heading ${levels}`));
for (const e of document.querySelectorAll('[aria-describedby], [aria-labelledby]'))
  for (const name of ['aria-describedby', 'aria-labelledby'])
    for (const id of (e.getAttribute(name) ?? '').split(' ').filter(Boolean))
      if (!document.getElementById(id)) faults.push(`${name} ${id} is nowhere`);
for (const e of document.querySelectorAll('ul > :not(li), ol > :not(li), dl > :not(div, dt, dd)'))
  faults.push('not of a list ' + e.outerHTML.slice(0, 90));
return faults;
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_what_is_behind_them(page, fake, scheme):
    """WCAG 2: 1.4.3 contrast, 1.1.1 alternatives, 1.3.1 lists and headings, 4.1.2 names."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    api = fake("failed")
    jobs = [f"#/job/{job['id']}" for job in api.world.jobs]
    for place in (*PLACES, *jobs):
        page.open(api.url + place)
        page.find("main .panel")
        page.until(lambda: not page.all(".skeleton"), "the view")
        assert page.run(CONTRAST) == [], place
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Whole turn")
    page.until(lambda: len(page.all(".key")) == 8, "eight keys")
    page.run("document.querySelectorAll('details').forEach((e) => { e.open = true; });")
    assert page.run(CONTRAST) == []


def test_the_worst_view_leads_to_its_photograph(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.press("Evaluate")
    page.says("30.40 dB")
    page.find(".evaluation a").click()
    page.says("By view, worst first")
    page.find(".scroll.tall tbody a").click()
    page.says("Photograph test:0", ".wipe-bar")


def test_an_import_takes_a_layout_and_masks(page, fake):
    page.open(fake("empty").url)
    page.press("Or a folder on the daemon’s machine")
    page.press("Import options")
    field = page.field("Layout")
    page.until(lambda: len(field.find_elements("css selector", "option")) > 4, "the layouts")
    assert "COLMAP" in field.text
    assert page.field("Masks").get_attribute("placeholder") == "as in the files"


def test_a_frame_keeps_its_shape(page, fake):
    """On a phone a frame that is wider than high was drawn as high as the player."""
    api = fake("busy")
    phone(page, 375)
    page.open(api.url + f"#/job/{finished_path(api)}")
    page.until(lambda: page.ink("canvas.frame") > 0, "a frame")
    fit, shown, drawn = page.run("""
const frame = document.querySelector('canvas.frame');
return [getComputedStyle(frame).objectFit, frame.clientWidth / frame.clientHeight,
        frame.width / frame.height];""")
    assert drawn > 1.2 and (fit == "contain" or shown == pytest.approx(drawn, rel=0.02))
