"""What a scene's page says of numbers that were not finite, and the doctor that looks after them."""

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")

RAY = {"id": 7, "fault": "gradient", "split": "train", "index": 5, "scale": 1, "x": 40, "y": 61,
       "origin": [0, 0, -1], "direction": [0, 0, 1], "target": [1, 1, 1], "near": 2, "length": 2,
       "radius": 1e-3, "weight": 1, "stride": 1}
FILE = "incidents/step-000000120-rollback.json"
INCIDENT = {"kind": "rollback", "step": 120, "seed": 1, "rate": 0.001, "nonfinite_rays": 40,
            "nonfinite_parameters": 1, "march_step": 0.01, "background": [1, 1, 1],
            "kernels": "avx2", "rays": [RAY], "parameters": [{"index": 12, "value": "nan"}]}


def case(name, worst, bound, **more):
    return {"name": name, "kernels": "avx2", "worst": worst, "bound": bound, "unit": "ULP",
            "passed": bound is None or worst <= bound, "skipped": False, "where": "x = 1", **more}


def examined(*cases):
    return {"passed": all(c["passed"] for c in cases), "seed": 4, "kernels": "generic,avx2",
            "cases": list(cases)}


def test_counters_are_explained_and_incidents_have_their_rays(page, fake):
    api = fake("busy")
    with api.world.lock:
        api.world.incidents = [{"file": FILE, "incident": INCIDENT}]
        job = next(j for j in api.world.jobs if j["type"] == "train")
        job["progress"]["nonfinite"] = {"rays": 40, "steps_rejected": 0, "rollbacks": 1}
    page.open(api.url + "#/scene/sphere-draft")
    page.says("Step 120: rollback", "[aria-label=Stability]")
    said = page.text("[aria-label=Stability]")
    for words in ("Rays left out", "40", "last good parameters", "12 (nan)", "1 parameter"):
        assert words in said, words
    page.press("Its rays, the first 1")
    page.says("train:5", ".incidents tbody")
    page.says("40, 61 at 1/2", ".incidents tbody")
    link = page.find(".incidents tbody a").get_attribute("href")
    assert link.endswith("#/scene/sphere-draft?view=train:5")
    page.press("Replay")
    page.until(lambda: api.world.jobs[0]["type"] == "doctor", "the job")
    assert api.world.jobs[0]["options"] == {"incident": FILE}
    assert page.complaints() == []


def test_a_scene_without_incidents_says_so(page, fake):
    page.open(fake("busy").url + "#/scene/sphere-draft")
    page.says("No step of this training was anything but finite.", "[aria-label=Stability]")


@pytest.mark.parametrize("worst, says, where", [
    (0.9, "All of 2 bounds hold, 1 skipped.", None),
    (7.0, "1 of 3 bounds do not hold, 1 skipped.", "exp")])
def test_the_doctor_is_run_from_the_page(page, fake, worst, says, where):
    api = fake("busy")
    page.open(api.url + "#/scene/sphere-draft")
    page.press("Run the doctor")
    page.until(lambda: page.all(".side-column [aria-label=Stability] progress"), "the bar")
    with api.world.lock:
        api.world.doctor = examined(
            case("log2", 0.5, 2), case("exp", worst, 2),
            case("beside the CPU", None, None, kernels="cuda", passed=False, skipped=True))
    page.says(says, ".doctor")
    if not where:
        page.press("Each number beside its bound")
    rows = page.until(lambda: [e.text for e in page.all(".doctor tbody tr")], "the cases")
    assert len(rows) == 3 and "skipped" in rows[-1]
    assert where is None or rows[0].startswith(f"{where} avx2 7 ULP 2 fails")
    page.open(api.url + "#/job/" + api.world.jobs[0]["id"])
    page.says(says, ".doctor")
    page.open(api.url + "#/jobs")
    page.says(says.rstrip("."), ".job-row .outcome")
    assert page.complaints() == []
