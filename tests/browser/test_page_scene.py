"""What a scene's page shows beside its picture: heat maps with their scale, other trainings' curves, and
a report that needs nothing beside it."""

import re

import pytest
from test_links import client  # noqa: F401  pylint: disable=unused-import
from test_page_paths import measured

pytest.importorskip("selenium", reason="python3-selenium is not installed")


@pytest.mark.parametrize("name, words", [
    ("cost", "50 samples"), ("level", "7 levels"), ("footprint", "0.02 units")])
def test_a_heat_map_says_what_its_colours_stand_for(scene, name, words):
    scene.press(name)
    scene.says(words, ".hud .legend")
    assert scene.find(".legend").get_attribute("aria-label") == f"Colours: dark 0, bright {words}, black where it is 0"
    assert scene.ink() > 50
    scene.press("colour")
    scene.until(lambda: not scene.all(".legend"), "no legend")
    assert scene.complaints() == []


def test_several_trainings_are_drawn_over_each_other(page, fake):
    api = fake("busy")
    with api.world.lock:
        for name, seconds in (("sphere-long", 60), ("sphere-short", 10)):
            job = api.world.train({"dataset": "sphere", "scene": name,
                                   "options": {"preset": "draft", "max_time_s": seconds}})
            api.world.set_state(job, "running")
            while job["state"] == "running":
                api.world.advance(job, 0.1)
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Beside other trainings")
    lines = "return [...document.querySelectorAll('.chart .other')].map((l) => l.getAttribute('class'));"
    assert page.run(lines) == []
    for label in page.until(lambda: len(found := page.all(".rivals label")) == 2 and found, "both names"):
        label.click()
    page.until(lambda: page.run(lines) == ["line other other-0", "line other other-1"], "two curves")
    strokes = page.run("return [...document.querySelectorAll('.chart-box .line')].map("
                       "(line) => getComputedStyle(line).stroke);")
    assert len(set(strokes)) == 3  # this one's and theirs, each with the colour that stands by its name
    assert strokes[:2] == page.run("return [...document.querySelectorAll('.rivals .swatch')].map("
                                   "(mark) => getComputedStyle(mark).backgroundColor);")
    # the axis reaches as far as the longest of them
    reach = "return [...document.querySelectorAll('.chart-box text')].map((t) => Number(t.textContent));"
    assert max(x for x in page.run(reach) if x) >= 50
    page.all(".rivals label")[0].click()
    page.until(lambda: len(page.run(lines)) == 1, "one curve")
    assert page.complaints() == []


def test_trainings_that_cannot_be_drawn_over_each_other_say_so(page, fake):
    """One with a single figure is a mark; of one no figures are kept; a fifth has no colour."""
    api = fake("busy")
    with api.world.lock:
        for i in range(5):
            job = api.world.train({"dataset": "sphere", "scene": f"other-{i}", "options": {"max_time_s": 4}})
            api.world.set_state(job, "running")
            while job["state"] == "running":
                api.world.advance(job, 0.1)
            figures = [e for e in api.world.events if (e[1], e[2]) == (job["id"], "metric") and e[3]["psnr"]]
            for event in figures[i if i < 2 else len(figures):]:
                api.world.events.remove(event)
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Beside other trainings")
    labels = page.until(lambda: len(found := page.all(".rivals label")) == 5 and found, "five names")
    box = {label.text: label for label in labels}
    box["other-1"].click()
    page.until(lambda: page.run("const e = document.querySelector('.chart-box circle.other-0');"
                                "return e && getComputedStyle(e).fill === getComputedStyle("
                                "document.querySelector('.rivals .swatch.other-0')).backgroundColor;"), "its mark")
    box["other-0"].click()
    page.says("Of other-0 no figures are kept", "#toasts")
    for name in ("other-2", "other-3", "other-4"):
        box[name].click()
    page.says("4 others fit on the chart", "#toasts")
    assert [e.is_selected() for e in page.all(".rivals input")].count(True) == 4


def test_a_ready_scene_is_trained_again_with_its_settings(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = next(j for j in api.world.jobs if j["type"] == "train")
        job["options"].update(planes=6, until_plateau=True, effect_cones="off", kernels="avx2", seed=7)
    api.world.end_train = lambda *_: None  # however late the page looks
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Train again")
    page.says("steps in 30 s, 31.47 dB", ".like")
    page.says("Also as there: kernels avx2.", ".like")
    name = page.field("Scene’s name")
    assert name.get_attribute("value") == "sphere-draft-2"
    time = page.field("Time")
    assert time.get_attribute("value") == "30"
    page.type(time, "45")
    page.press("Start training")
    page.says("sphere-draft-2", "h1")
    assert api.world.jobs[0]["options"] == {
        "preset": "draft", "train_split": "train", "max_time_s": 45, "seed": 7, "until_plateau": True,
        "planes": 6, "effect_cones": "off", "kernels": "avx2"}
    page.until(lambda: not any(e.text == "Train again" for e in page.all("a.button")), "none while it trains")
    assert page.complaints() == []


def test_a_scene_whose_training_is_not_known_has_no_rates(page, fake):
    api = fake("busy")
    with api.world.lock:
        api.world.jobs.clear()
    page.open(api.url + "#/scene/sphere-draft")
    page.says("31.47 dB", ".stats")
    assert "/s" not in page.text(".stats")


def test_a_photograph_is_enlarged(page, fake):
    from selenium.webdriver.common.keys import Keys

    page.open(fake("busy").url + "#/dataset/sphere")
    second = page.until(lambda: page.all(".photo")[1:2], "a second photograph")[0]
    second.send_keys(Keys.ENTER)
    dialog = page.find("dialog.enlarged")
    page.says("train:1 · r_1 · 2 of 24", ".enlarged")
    page.find(".enlarged-frame[data-state=ready]")
    width = "return document.querySelector('.enlarged img').naturalWidth;"
    page.until(lambda: page.run(width) == 200, "the photograph, not the thumbnail")
    for key, words in ((Keys.ARROW_LEFT, "train:0 · r_0 · 1 of 24"), (Keys.ARROW_LEFT, "train:23 · r_23 · 24 of 24"),
                       (Keys.ARROW_RIGHT, "train:0 · r_0 · 1 of 24")):
        dialog.send_keys(key)
        page.says(words, ".enlarged")
    dialog.send_keys(Keys.ESCAPE)
    page.until(lambda: not page.all(".enlarged"), "the page alone")
    assert page.run("return document.activeElement.className;") == "photo"
    assert page.complaints() == []


def test_a_small_photograph_fills_a_phone_and_is_cut_out_on_white(page, fake):
    """In a dark page, too: what is dark in it was lost in what is behind it."""
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True})
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {
        "features": [{"name": "prefers-color-scheme", "value": "dark"}]})
    page.open(fake("busy").url + "#/dataset/sphere")
    behind = "return getComputedStyle(document.querySelector(args[0])).backgroundColor;"
    page.find(".photo .thumb[data-state=ready]")
    page.all(".photo")[0].click()
    page.find(".enlarged-frame[data-state=ready]")
    for css in (".photo .thumb[data-state=ready] img", ".enlarged img"):
        assert page.run(behind, css) == "rgb(255, 255, 255)"
    assert page.run("return document.querySelector('.enlarged img').getBoundingClientRect().width;") > 300
    assert page.complaints() == []


def test_a_report_is_whole_in_one_file(page, fake, downloads):
    api = fake("busy")
    api.world.curve = measured((0.06, 8, 27.5), (0, 200, 31.2))
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Evaluate")
    page.says("30.40 dB")
    downloads.clear()
    page.press("Report")
    file = downloads.saved(page, "sphere-draft-report.html")
    assert page.complaints() == []  # its pictures and its style are none of the page's
    text = file.read_text(encoding="utf-8")
    assert "<script" not in text and not re.search(r"(src|href)=\"(?!data:)", text)
    assert text.count("data:image/jpeg") == 9  # photograph, rendering and error of three views
    page.open(file.as_uri())
    assert page.text("h1") == "sphere-draft"
    assert [e.text for e in page.all("h2")] == [
        "Views", "Evaluations", "Training", "Accuracy against time", "Effects", "Compared with the paper"]
    page.until(lambda: page.run(
        "return [...document.images].every((i) => i.naturalWidth > 50);"), "its pictures")
    page.says("Worst, test:0", "figcaption")
    page.says("30.40 dB", "td")
    cells = page.run("return [...document.querySelectorAll('tr')].map((row) => [...row.cells].map((c) => c.textContent));")
    assert next(row for row in cells if row[0] == "Scale pyramid")[3:5] == ["8 times the finest footprint", "if over 1.41 times the finest footprint"]
    assert next(row for row in cells if row[0] == "Forward facing")[3:5] == ["87.4 degrees", "if at most 30 degrees"]


def test_a_report_has_no_heading_over_nothing(page, fake, downloads):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.says("Not evaluated yet")
    downloads.clear()
    page.press("Report")
    page.open(downloads.saved(page, "sphere-draft-report.html").as_uri())
    assert [e.text for e in page.all("h2")] == ["Views", "Training", "Effects", "Compared with the paper"]


def test_a_report_without_test_views_shows_others_and_fits(page, fake, downloads):
    """Of a capture that withholds none: what it was trained on, rather than nothing; on paper and on a phone."""
    api = fake("busy")
    every = api.world.cameras()
    api.world.cameras = lambda: [view for view in every if view["split"] == "train"]
    api.world.curve = {**measured((0.06, 8, None), (0, 200, None)), "photographs": False}
    for point in api.world.curve["points"]:
        point["psnr_full"] = 40 - 100 * (point["setting"] or {}).get("tolerance", 0)
    page.open(api.url + "#/scene/sphere-draft")
    page.says("Not evaluated yet")
    downloads.clear()
    page.press("Report")
    page.open(downloads.saved(page, "sphere-draft-report.html").as_uri())
    assert [e.text.split(":")[0] + e.text.split(":")[1][:2] for e in page.all("figcaption")] == ["train0", "train1", "train2"]
    page.says("against the full picture", "p")
    assert "Gain" not in [e.text for e in page.all("th")]  # nothing was measured
    for media, width in (("screen", 320), ("screen", 390), ("print", 673)):  # A4 between margins of 16 mm
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": True})
        assert page.run("return document.documentElement.scrollWidth;") <= width, media
        scrolled = page.run("""
return [...document.querySelectorAll('*')].filter((e) => e.clientWidth && e.scrollWidth > e.clientWidth &&
    getComputedStyle(e).overflowX === 'auto').map((e) => [e.tabIndex, e.getAttribute('aria-label')]);""")
        assert all(index == 0 and label for index, label in scrolled), scrolled
        assert scrolled or width > 320
    why, whole = page.run("return ['th.why', 'table:has(th.why)'].map((css) => document.querySelector(css).clientWidth);")
    assert why > 0.44 * whole


def test_a_report_of_what_was_never_trained_says_why(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = api.world.train({"dataset": "sphere", "scene": "never", "options": {"preset": "draft"}})
        job["problem"] = {"type": "/problems/damaged", "title": "A stored file is damaged", "status": 500,
                          "detail": "import the dataset again"}
        api.world.set_state(job, "failed")
    page.open(api.url)
    told = page.run("const {reportOf} = await load('report.js'); return (await reportOf('never')).text();")
    assert "not: A stored file is damaged: import the dataset again" in told
    facts = told[:told.index("</table>")]
    assert "–" not in facts and "0 steps" not in facts


def test_a_ladder_s_table_is_cut_off_neither_on_a_screen_nor_on_paper(page, client):  # noqa: F811  pylint: disable=redefined-outer-name
    client("ladder", "data", "--over", "footprint=rip,mip", "--seeds", "2", "--max-steps", "5", "--equal", "steps",
           "--report", "report.html")
    page.open((client.folder / "report.html").as_uri())
    for media, width in (("screen", 1280), ("print", 718)):  # A4 between margins of 1 cm
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False})
        wide, room = page.run("const box = document.querySelector('.wide');"
                              "return [box.scrollWidth, box.clientWidth];")
        assert wide <= room, media
