"""Every state of the page against a stand-in for the daemon."""

import json
import re
import time

import pytest
from fake_pictures import draw, ring
from fake_world import contract

pytest.importorskip("selenium", reason="python3-selenium is not installed")
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402


def never(_job, _why):
    """In the place of the end of a training that shall be seen to train, however long the page takes."""


def quiet(page):
    """The browser has nothing to complain about: no script error, no breach of the CSP."""
    assert page.complaints() == []


def test_empty(page, fake):
    page.open(fake("empty").url)
    page.says("From photographs to a scene")
    page.says("No datasets")
    page.says("connected", ".connection")
    page.open(page.driver.current_url.split("#")[0] + "#/jobs")
    page.says("No jobs")
    quiet(page)


def test_an_unknown_scene_and_page(page, fake):
    api = fake("empty")
    page.open(api.url + "#/scene/nowhere")
    page.says("There is no scene nowhere.", ".problem")
    page.open(api.url + "#/nothing")
    page.says("No such page", "h1")
    page.says("There is nothing at #/nothing.", ".problem")


def five_views(folder):
    """A dataset of five views, the first of which has no file."""
    (folder / "train").mkdir(parents=True)
    frames = []
    for i, pose in enumerate(ring(5)):
        frames.append({"file_path": f"./train/r_{i}", "transform_matrix": pose + [[0, 0, 0, 1]]})
        if i:
            (folder / "train" / f"r_{i}.png").write_bytes(
                draw(
                    {
                        "world_from_camera": pose,
                        "axes": "opengl",
                        "width": 20,
                        "height": 20,
                        "fov_y_deg": 40,
                    }
                )
            )
    (folder / "transforms_train.json").write_text(
        json.dumps({"camera_angle_x": 0.7, "frames": frames})
    )
    (folder / "notes.txt").write_text("not for upload")


def test_upload_import_and_train(page, fake, tmp_path):
    api = fake("empty")
    folder = tmp_path / "ball"
    five_views(folder)
    page.open(api.url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says("views: 5 train")
    page.says("1 image named but not in the folder")
    page.says("1 file that the dataset does not need")
    assert page.field("Name").get_attribute("value") == "ball"
    page.press("Upload and import")
    page.says("ball is imported.")
    names = [name for name, _ in api.world.uploaded[0]]
    assert sorted(names) == [
        "train/r_1.png",
        "train/r_2.png",
        "train/r_3.png",
        "train/r_4.png",
        "transforms_train.json",
    ]
    page.press("Look at it and train")
    page.says("What the import found")
    page.press("draft")
    api.world.end_train = never
    page.press("Start training")
    page.says("training", ".page-head .chip")
    page.until(lambda: page.all(".chart .last"), "a point on the chart")
    job = api.world.jobs[0]
    assert job["type"] == "train" and job["options"] == {
        "preset": "draft",
        "train_split": "train",
        "max_time_s": 15,
    }
    quiet(page)


def test_what_an_import_found_fits_beside_the_scenes(page, fake):
    page.open(fake("empty").url)
    page.find(".drop")
    wide, high = page.run("""
const box = document.createElement('div');
box.className = 'scroll';
box.style.width = '320px';
box.innerHTML = `<table class="table problems"><thead><tr><th>Where</th><th>What</th></tr></thead><tbody><tr>
<td>warning</td><td><code>transforms.json#/frames/4/file_path</code></td>
<td>names images/0005.jpg, which does not exist; the last at transforms.json#/frames/65/file_path</td>
</tr></tbody></table>`;
document.querySelector('main').append(box);
return [box.scrollWidth - box.clientWidth, box.querySelector('code').getClientRects().length];""")
    assert wide <= 0 and high <= 2


def test_a_dataset_that_photographs_are_missing_from_is_kept_or_not(page, fake, tmp_path):
    api = fake("empty")
    five_views(tmp_path / "ball")
    add = api.world.add_dataset

    def add_with_faults(name):
        add(name)
        report = api.world.datasets[-1]["report"]
        report["unusable"]["train"] = 2
        report["problems"].append({"severity": "error", "where": "r_3.png", "text": "is cut off"})

    def add_without(name):
        add(name)
        api.world.datasets[-1]["report"]["unusable"]["train"] = 1

    api.world.add_dataset = add_without
    page.open(api.url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(tmp_path / "ball"))
    page.says("1 image named but not in the folder")
    page.press("Upload and import")
    page.says("ball is imported.")
    time.sleep(1)
    assert not page.all("dialog[open]")  # it was told before
    api.world.datasets.clear()
    api.world.add_dataset = add_with_faults
    for choice, left in (("Keep", 1), ("Delete it", 1)):
        page.open(api.url)
        page.find(".drop")
        page.all("#folder-input")[0].send_keys(str(tmp_path / "ball"))
        page.says("views: 5 train")
        page.field("Name").clear()
        page.field("Name").send_keys("ball" if choice == "Keep" else "other")
        page.press("Upload and import")
        page.says("2 photographs cannot be used and were left out of", "dialog[open]")
        page.says("r_3.png: is cut off", "dialog[open]")
        page.press(choice)
        page.until(lambda: not page.all("dialog[open]"), "the question to be answered")
        page.until(lambda: len(api.world.datasets) == left, "the dataset")


def test_an_effect_is_switched_off_before_a_training(page, fake):
    api = fake("bare")
    page.open(api.url + "#/dataset/sphere")
    page.press("Effects")
    exposure = page.until(
        lambda: next((e for e in page.all("fieldset.choice") if e.text.startswith("Exposure")), None),
        "the effect",
    )
    assert [e.text for e in exposure.find_elements("css selector", "label")] == ["auto", "on", "off"]
    exposure.find_elements("css selector", "label")[2].click()
    api.world.end_train = never
    page.press("Start training")
    page.says("training", ".page-head .chip")
    assert api.world.jobs[-1]["options"] == {
        "preset": "standard",
        "train_split": "train",
        "max_time_s": 60,
        "effect_exposure": "off",
    }
    quiet(page)


def test_limits_follow_the_preset_until_one_is_chosen(page, fake):
    page.open(fake("bare").url + "#/dataset/sphere")
    time_field = page.field("Time")
    assert time_field.get_attribute("value") == "60"
    page.press("draft")
    assert time_field.get_attribute("value") == "15"
    page.press("paper")
    assert time_field.get_attribute("value") == ""
    page.type(time_field, 7)
    page.press("standard")
    assert time_field.get_attribute("value") == "7"


def test_an_estimate_before_a_training(page, fake):
    api = fake("bare")
    page.open(api.url + "#/dataset/sphere")
    page.press("draft")
    page.press("Estimate")
    page.says("30 dB after 8.5 s, 33 dB after 30 s.", ".estimate")
    page.says("Ends after 1 min 00 s of training at 34.6 dB ± 0.7.", ".estimate")
    page.says("4 estimates here so far: off by 0.4 dB and 12 % of the time.", ".estimate")
    job = api.world.jobs[0]
    assert job["type"] == "estimate" and job["options"]["preset"] == "draft"
    assert not [scene for scene in api.world.scenes if scene["name"] == "sphere"]
    page.open(api.url + "#/job/" + job["id"])
    page.says("33 dB after 30 s", ".estimate")
    quiet(page)


def test_a_ladder_and_its_report(page, fake):
    api = fake("bare")
    with api.world.lock:
        job = api.world.job("ladder", dataset=api.world.datasets[0]["id"], dataset_name="sphere",
                            options={"over": "planes=3,4", "train": {"max_time_s": 15}})
    page.open(api.url + "#/job/" + job["id"])
    page.says("Nothing is trained yet", ".ladder")
    page.says("planes=3,4", "[aria-label='About']")
    with api.world.lock:
        api.world.report = contract.example("LadderReport")
        job["progress"] = {**contract.example("WorkProgress"), "done": 1, "total": 2, "fraction": 0.5}
        api.world.emit(job, "state", job)
    page.says("planes=4", ".ladder")
    page.says("1 of 2 trainings", ".ladder")
    link = page.find(".ladder a").get_attribute("href")
    assert link == f"{api.url}v1/jobs/{job['id']}/report"
    quiet(page)


def test_a_training_may_end_by_itself(page, fake):
    api = fake("bare")
    page.open(api.url + "#/dataset/sphere")
    page.find("#until-plateau").click()
    page.press("Start training")
    page.says("training", ".page-head .chip")
    assert api.world.jobs[0]["options"] == {
        "preset": "standard", "train_split": "train", "until_plateau": True}


def test_a_view_that_is_unusable_leaves_no_hole(page, fake):
    """Photographs go by their numbers in the JSON."""
    api = fake("bare")
    api.world.missing.add(("train", 3))
    page.open(api.url + "#/dataset/sphere")
    page.says("train:4")
    shown = [e.text for e in page.all(".photos figcaption")]
    assert len(shown) == 23 and "train:3" not in shown and "train:23" in shown


def test_effects_are_told_in_their_units(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    numbers = page.until(
        lambda: [e.text.split("\n") for e in page.all(".effect .number")], "the effects"
    )
    assert ["8 times the finest footprint", "on if over 1.41 times the finest footprint"] in numbers
    assert ["8 times the finest cone"] in numbers  # cones are no question of a number
    assert numbers[0][1] == "on if over 0 %" and numbers[3] == ["–", "on if over 2/255"]


def test_effects_that_nothing_calls_for_are_folded(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.press("3 that the photographs do not call for")
    page.says("Distortion", ".effects")
    assert sum("off" in e.text for e in page.all("details .effect")) == 3
    page.press("3 that the photographs do not call for")
    shown = [e.text for e in page.all(".effect") if e.text]  # what is folded has none
    assert len(shown) == len(page.all(".effect")) - 3 and not any("Distortion" in text for text in shown)


def test_what_may_be_wrong_with_a_dataset_comes_first(page, fake):
    """And what else was measured is folded; a photograph that is named there is found by its name."""
    api = fake("bare")
    api.world.datasets[0]["report"]["problems"] = [
        {"severity": severity, "where": "the folder", "text": text} for severity, text in (
            ("info", "points"), ("warning", "r_0 is blurred"), ("info", "exposures"), ("error", "r_9 is cut off"))]
    page.open(api.url + "#/dataset/sphere")

    def shown():
        return [e.text.split()[0] for e in page.all(".problems tbody tr") if e.text]
    page.says("r_9 is cut off", ".problems")
    assert shown() == ["error", "warning"]
    page.press("2 notes")
    page.until(lambda: shown() == ["error", "warning", "info", "info"], "the notes below")
    page.find(".photo").click()
    page.says("train:0 · r_0 · 1 of 24", "dialog")


def test_what_effects_bring_is_told(page, fake):
    api = fake("busy")
    gain = {"on": True, "psnr": 27.1, "psnr_without": 26.3, "gain": 0.8, "gain_spread": 0.06,
            "cost": 0.12, "picture_cost": -0.034}
    api.world.effects = {
        "machine": "m", "device": "cpu", "kernels": "avx2", "threads": 2, "version": "0.1.0",
        "measured_at": "2026-01-01T00:00:00Z", "seconds": 10, "seeds": 3, "held_out": "5 views",
        "gains": [{"name": "anisotropy", **gain},
                  {"name": "distortion", **gain, "gain": None, "gain_spread": None}]}
    page.open(api.url + "#/scene/sphere-draft")
    page.says("+0.80 dB ± 0.06; +12 % time in training, −3 % for a picture", ".effects")
    page.says("Gains: 3 pairs of trainings of 10 s", "[aria-label='Effects']")
    assert len(page.all(".effect-gain")) == 2
    assert page.complaints() == []


def test_a_path_cancelled_before_its_first_frame(page, fake):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    with api.world.lock:
        job = api.world.submit(
            {"type": "path", "scene": "sphere-draft", "camera_path": {"keys": [], "fps": 1}}
        )
        api.world.act(job, "cancel")
    page.open(api.url + f"#/job/{job['id']}")
    page.says("No frames: the job was cancelled", ".cover-note")


def test_faults_are_shown_at_their_fields(page, fake):
    api = fake("busy")
    page.open(api.url + "#/dataset/sphere")
    page.type(page.field("Scene’s name"), "sphere-draft")
    page.press("Start training")
    page.says("this name is taken", ".faulty .note")
    page.says("The scene sphere-draft exists.", ".problem")
    assert page.field("Scene’s name").get_attribute("aria-invalid") == "true"
    page.type(page.field("Scene’s name"), "another")
    page.press("More")
    page.type(page.field("Seed"), 2**53 + 2)
    page.press("More")  # folded: the fault unfolds it
    page.press("Start training")
    page.says("maximum of 9007199254740991", ".faulty .note")


def test_directory_is_refused_with_its_reason(page, fake):
    page.open(fake("empty").url)
    page.press("Or a folder on the daemon’s machine")
    page.says("--dataset-root")
    page.type(page.field("Folder on the daemon’s machine"), "/data/lego")
    page.type(page.field("Name"), "lego")
    page.press("Import")
    page.says("no folder of this machine may be read", ".faulty .note")


def test_orbit_while_training_and_pause(page, fake):
    api = fake("bare")
    page.open(api.url + "#/dataset/sphere")
    page.type(page.field("Time"), 36000)
    page.press("Start training")
    page.until(lambda: page.ink() > 100, "a picture")
    stage = page.find(".stage")
    page.until(lambda: stage.get_attribute("data-level") == "refined", "the refined picture")
    before = page.run(
        """
        return document.querySelector('canvas.picture').toDataURL().length +
            document.querySelector('.hud').textContent;"""
    )
    levels = page.watch_levels()
    ActionChains(page.driver).click_and_hold(stage).move_by_offset(60, 10).move_by_offset(
        60, 5
    ).perform()
    page.until(lambda: "coarse" in levels(), "a coarse picture while moving")
    ActionChains(page.driver).release().perform()
    page.until(lambda: levels()[-1] == "refined", "the refined picture")
    hud = page.text(".hud")
    for part in ("refined", "step", "samples"):
        assert part in hud
    assert re.search(r"\d m?s rendering", hud)
    assert (
        page.run(
            """
        return document.querySelector('canvas.picture').toDataURL().length +
            document.querySelector('.hud').textContent;"""
        )
        != before
    )
    step = int("".join(c for c in hud.split("step ")[1].split("·")[0] if c.isdigit()))
    page.until(
        lambda: int(
            "".join(c for c in page.text(".hud").split("step ")[1].split("·")[0] if c.isdigit())
        )
        > step,
        "a fresh picture while it trains",
    )
    page.press("Pause")
    page.says("paused", ".page-head .chip")
    page.press("Resume")
    page.says("training", ".page-head .chip")
    page.press("Finish")
    page.says("finished by hand")
    page.says("ready", ".page-head .chip")
    quiet(page)


def test_keyboard_orbits_and_records(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.find(".stage").send_keys(
        "k", Keys.ARROW_LEFT * 4, "+", "k", Keys.SHIFT + Keys.ARROW_UP, "k"
    )
    page.until(lambda: len(page.all(".key")) == 3, "three keys")
    poses = page.run(
        """
        const p = JSON.parse(
            Object.entries(sessionStorage).find(([k]) => k.startsWith('ripnerf-path'))[1]);
        return p.keys.map((k) => k.pose.map((r) => r[3]));"""
    )
    assert poses[0] != poses[1] != poses[2]
    page.until(
        lambda: len([i for i in page.all(".key img") if i.is_displayed()]) == 3, "three thumbnails"
    )
    page.all(".key")[2].find_element("css selector", "[aria-label=Earlier]").click()
    moved = page.run(
        """
        const p = JSON.parse(
            Object.entries(sessionStorage).find(([k]) => k.startsWith('ripnerf-path'))[1]);
        return p.keys.map((k) => [k.time, ...k.pose.map((r) => r[3])]);"""
    )
    assert [key[0] for key in moved] == [0, 1, 2] and moved[1][1:] == poses[2]
    page.type(page.all(".key")[1].find_element("css selector", "input"), 0)
    page.find(".stage").click()
    page.says("its time must be later")
    page.all(".key")[1].find_element("css selector", "[aria-label='Delete key']").click()
    page.until(lambda: len(page.all(".key")) == 2, "two keys")
    page.driver.refresh()
    page.until(lambda: len(page.all(".key")) == 2, "the keys after a reload")


def test_path_frames_arrive_and_play(page, fake, downloads):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.press("Whole turn")
    page.type(page.field("Width"), 48)
    page.type(page.field("Height"), 32)
    page.type(page.field("Frames"), 4)
    page.says("24 frames of 48 × 32")
    page.press("Render the path")
    page.says("Camera path sphere-draft", "h1")
    page.until(lambda: page.ink("canvas.frame") > 100, "a frame")
    page.says("succeeded", ".page-head .chip")
    page.until(lambda: not page.all(".cells span:not([data-there])"), "all frames")
    page.press("frames")  # in the film's place
    first = page.text(".player output")
    page.press("Play")
    page.until(lambda: page.text(".player output") != first, "another frame")
    page.press("Download")
    downloads.saved(page, "*-frames.tar")
    quiet(page)


def test_a_view_is_compared_with_its_photograph(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.find("#view-pick").send_keys("test:3")
    page.says("Photograph test:3", ".wipe-bar")
    page.until(
        lambda: page.run("return document.querySelector('.wipe img').naturalWidth;") == 200,
        "the photograph",
    )
    page.driver.execute_script(
        "const r = document.getElementById('wipe'); r.value = 20; r.dispatchEvent(new Event('input'));"
    )
    assert page.run("return document.querySelector('.wipe img').style.clipPath;").startswith(
        "inset(0px 80% 0px 0px"
    )
    page.find(".stage").send_keys(Keys.ARROW_LEFT)
    page.until(lambda: not any(e.is_displayed() for e in page.all(".wipe")), "the comparison gone")
    assert page.find("#view-pick").get_attribute("value") == ""
    quiet(page)


def test_failed_training_says_why(page, fake):
    page.open(fake("failed").url + "#/scene/sphere-paper")
    page.says("Out of memory", ".problem")
    page.says("512 needs 9.1 GiB", ".problem")
    page.says("Training ended without a checkpoint", ".empty")
    page.button("Train again")


def test_where_training_left_nothing_there_is_nothing_that_cannot_work(page, fake):
    """Neither a view's tools nor a chart without a point, from when it fails on."""
    api = fake("busy")
    with api.world.lock:
        job = api.world.train({"dataset": "sphere", "scene": "never", "options": {"preset": "draft"}})
        job["runner"] = {"slurm_job": "17", "reason": "Priority"}  # it waits
    page.open(api.url + "#/scene/never")
    page.find(".viewport-tools")
    page.find(".stats")
    with api.world.lock:
        job["problem"] = {"type": "/problems/damaged", "title": "A stored file is damaged", "status": 500,
                          "detail": "r_3.png: its bytes do not have their digest; import the dataset again"}
        api.world.set_state(job, "failed")
    page.says("Training ended without a checkpoint", ".empty")
    page.says("import the dataset again", ".problem")
    for css in (".stage", ".viewport-tools", ".chart", ".stats", ".cost-chart", "[aria-label=Quality]", "#budget"):
        assert not any(e.is_displayed() for e in page.all(css)), css
    assert [e.text for e in page.all("h2") if e.is_displayed()] == ["Training", "Record"]
    page.button("Train again")
    assert page.complaints() == []


def test_evaluation(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.says("Not evaluated yet")
    page.press("Evaluate")
    page.says("30.40 dB")
    page.find(".evaluation a").click()
    page.says("By view, worst first")
    assert page.text(".scroll.tall tbody tr").startswith("r_0")


def test_token_is_asked_for_once(page, fake):
    page.open(fake("token").url)
    page.type(page.find("#token-input"), "wrong")
    page.press("Use it")
    page.says("That token was refused: A token is missing or wrong.", "#token-why")
    assert page.find("#token-input").get_attribute("value") == ""
    page.press("Not now")
    page.says("Nothing can be shown without one", "#banner")
    page.press("Try now")
    assert page.find("#token-input") and page.text("#token-why") == ""
    page.type(page.find("#token-input"), "secret")
    page.press("Use it")
    page.says("sphere-draft")
    page.driver.refresh()
    page.says("sphere-draft")
    assert page.run("return sessionStorage.getItem('ripnerf-token');") == "secret"
    page.until(lambda: page.all(".card .thumb[data-state=ready]"), "a picture behind the token")
    page.run("location.hash = '#/system';")
    page.says("with the scope admin")


def test_what_failed_without_the_daemon_is_no_longer_told_with_it(page, fake):
    api = fake("busy")
    port = api.server_address[1]
    page.open(api.url + "#/dataset/sphere")
    page.find("#train")
    api.stop()
    page.press("Start training")
    page.says("Daemon unreachable", "main .problem")
    fake("busy", port)
    page.until(lambda: not page.all("main .problem"), "nothing that went wrong")
    assert page.button("Start training")


def test_a_button_says_what_had_no_answer(page, fake):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.until(lambda: page.ink() > 100, "a picture")
    page.press("Whole turn")
    page.find(".key")
    api.stop()
    page.says("No connection to the daemon", "#banner")
    assert not page.all(".toast")  # nobody asked for anything
    page.press("Save picture")
    page.says("“Save picture” had no answer. The daemon is away", "#toasts")
    page.press("Keep, load, import, export")
    page.press("Keep")
    page.says("“Keep” had no answer.", "#toasts")


def test_daemon_goes_and_comes_back(page, fake):
    api = fake("busy")
    port = api.server_address[1]
    page.open(api.url)
    page.says("sphere-draft")
    api.stop()
    page.says("No connection to the daemon", "#banner")
    # As where it still answered, that it ends; until the page tries again.
    refused = """
const {state} = await load('store.js');
state.connection.problem = {message: 'the daemon is shutting down'};
return document.getElementById('banner').textContent;"""
    page.until(lambda: "daemon. It says: the daemon is shutting down. Trying" in page.run(refused), "what it said")
    page.says("not connected", ".connection")
    page.says("sphere-draft")
    page.run("location.hash = '#/dataset/sphere';")
    page.says("Daemon unreachable", "main .problem")
    page.run("document.body.style.minHeight = '4000px'; scrollTo(0, 2000);")
    assert page.run("return document.getElementById('banner').getBoundingClientRect().top;") >= 0
    again = fake("failed", port)
    page.find("#train")  # by itself
    page.run("document.body.style.minHeight = ''; location.hash = '#/';")
    page.says("sphere-paper")
    page.says("connected", ".connection")
    assert not page.find("main").find_elements("css selector", "#banner")
    assert again.url == api.url


def test_behind_a_prefix_all_addresses_stay_below_it(page, fake):
    page.open(fake("busy").url)
    page.says("sphere-draft")
    addresses = page.run(
        """
        const {address} = await load('api.js');
        return ['v1/info', '/v1/jobs/x/frames/0'].map(address).concat([
          ...document.querySelectorAll('link[href], script[src], img[src]')
        ].map((e) => e.getAttribute('href') ?? e.getAttribute('src')));"""
    )
    base = page.driver.current_url.split("#")[0]
    assert addresses[0] == base + "v1/info" and addresses[1] == base + "v1/jobs/x/frames/0"
    assert not [a for a in addresses[2:] if a.startswith("/")]


def test_no_wide_overflow_on_a_phone(page, fake):
    api = fake("busy")
    page.driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": True},
    )
    for place in ("", "#/dataset/sphere", "#/scene/sphere-draft", "#/jobs", "#/system"):
        page.open(api.url + place)
        page.find("main .panel")
        time.sleep(0.4)
        assert page.run("return document.documentElement.scrollWidth;") <= 391, place


CONTRAST = """
const parse = (colour) => {
  const [r, g, b, a = 1] = colour.match(/[0-9.]+/g).map(Number);
  return { rgb: [r, g, b], a };
};
const light = (rgb) => {
  const [r, g, b] = rgb.map((x) => x / 255).map(
      (x) => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = (e) => {
  for (; e; e = e.parentElement) {
    const colour = parse(getComputedStyle(e).backgroundColor);
    if (colour.a === 1) return colour.rgb;
    if (colour.a > 0) return null; // over a picture
  }
  return [255, 255, 255];
};
const low = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
while (walker.nextNode()) {
  const e = walker.currentNode.parentElement;
  if (!walker.currentNode.data.trim() || !e.checkVisibility() || e.closest('svg')) continue;
  if (e.closest(':disabled, [aria-disabled=true], option')) continue;
  const back = behind(e);
  if (!back) continue;
  const [a, b] = [light(parse(getComputedStyle(e).color).rgb), light(back)];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  if (ratio < 4.5) low.push(`${ratio.toFixed(2)} ${e.className} ${walker.currentNode.data.trim()}`);
}
return low;
"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(page, fake, scheme):
    """WCAG 2, success criterion 1.4.3: a contrast of at least 4.5."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
    api = fake("failed")
    places = ["", "#/dataset/sphere", "#/scene/sphere-draft", "#/scene/sphere-paper", "#/jobs"]
    for place in places:
        page.open(api.url + place)
        page.find("main .panel")
        page.says("connected", ".connection")
        time.sleep(0.3)
        assert page.run(CONTRAST) == [], place


def test_the_skip_link_leads_to_the_content(page, fake):
    page.open(fake("empty").url + "#/jobs")
    page.says("No jobs")
    page.driver.execute_script("document.querySelector('.skip').focus()")
    page.find(".skip").send_keys(Keys.ENTER)
    assert page.run("return document.activeElement.id;") == "main"
    page.says("No jobs")


def test_every_control_has_a_name(page, fake):
    """Buttons, fields and pictures are named for a screen reader."""
    api = fake("busy")
    for place in ("", "#/dataset/sphere", "#/scene/sphere-draft", "#/jobs", "#/system"):
        page.open(api.url + place)
        page.find("main .panel")
        time.sleep(0.5)
        nameless = page.run(
            """
        const named = (e) => e.getAttribute('aria-label') || e.getAttribute('aria-labelledby') ||
            e.textContent.trim() || e.title ||
            [...(e.labels ?? [])].some((l) => l.textContent.trim());
        return [
          ...document.querySelectorAll(
              'main button, main a, main input, main select, main progress, main canvas[role], main [role=application]')
        ].filter((e) => !named(e))
            .map((e) => e.outerHTML.slice(0, 120))
            .concat([...document.querySelectorAll('img')]
                        .filter((e) => !e.hasAttribute('alt'))
                        .map((e) => e.outerHTML));"""
        )
        assert nameless == [], place
