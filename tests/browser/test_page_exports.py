"""A scene as a file: what it can be exported as, what came of it, and one that came so."""

import math

import pytest

pytest.importorskip("selenium", reason="python3-selenium is not installed")

VIEWING = {"bits": 8, "views": 6, "split": "test", "psnr": 33.5, "trained": 33.53, "loss": 0.03,
           "dataset": "sphere", "parameters_sha256": "0" * 64, "version": "0.1.0"}
AWAY = [[-1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, 1, -3]]  # looks along z, and its top is y


def test_what_an_export_made_is_there(page, fake):
    api = fake("busy")
    with api.world.lock:
        job = api.world.submit({"type": "export", "scene": "sphere-draft", "options": {"as": "scene"}})
        job["result"] = {"file": "scene.ripscene", "bytes": 14_200_000, "bits": 8, "views": 6,
                         "psnr": 33.5, "trained": 33.53, "loss": 0.03, "split": "test"}
        api.world.set_state(job, "succeeded")
        mesh = api.world.submit({"type": "export", "scene": "sphere-draft"})
        mesh["result"] = {"file": "mesh.ply", "bytes": 9000, "vertices": 120, "triangles": 236}
        api.world.set_state(mesh, "succeeded")
    page.open(api.url + f"#/job/{job['id']}")
    page.says("planes in 8 bits a value by blocks")
    page.says("33.50 dB on 6 test views, 0.030 dB less than the scene")
    link = page.button("Download")
    assert link.get_attribute("download") == "sphere-draft.ripscene"
    assert link.get_attribute("href").endswith(f"/v1/jobs/{job['id']}/export")
    page.open(api.url + f"#/job/{mesh['id']}")
    page.says("120 vertices, 236 triangles")
    assert page.button("Download").get_attribute("download") == "sphere-draft.ply"
    page.open(api.url + "#/scene/sphere-draft")
    page.button("For viewing")
    page.button("Mesh, .obj")
    assert page.complaints() == []


def test_a_scene_that_came_as_a_file_says_so(page, fake):
    api = fake("busy")
    with api.world.lock:
        scene = api.world.find(api.world.scenes, "sphere-draft", "scene")
        scene.update(dataset=None, dataset_name=None, viewing=VIEWING)
    page.open(api.url + "#/")
    page.says("for viewing", ".card")
    page.open(api.url + "#/scene/sphere-draft")
    page.says("its photographs are not here", ".page-head")
    page.says("planes in 8 bits a value by blocks; it is not trained further")
    page.says("33.50 dB on 6 test views, 0.030 dB less than the scene that it is of")


def first_cameras(page, api):
    """Of the scene's first picture among the others, and on its own page."""
    asked = []
    api.world.on_render = asked.append
    for view in ("#/", "#/scene/sphere-draft"):
        asked.clear()
        page.open(api.url + view)
        page.until(lambda: asked, f"a picture in {view}")
        yield asked[0]["camera"]


@pytest.mark.parametrize("source, least, most", [("cameras", 0.5, 0.8), ("layout", 2, 3)])
def test_a_scene_whose_file_tells_no_start_begins_where_its_cameras_were(page, fake, source, least, most):
    """Bounds about the cameras are of a place, which is looked at from within: outside its walls hide it."""
    api = fake("busy")
    with api.world.lock:
        scene = api.world.find(api.world.scenes, "sphere-draft", "scene")
        scene.update(dataset=None, dataset_name=None, viewing=VIEWING, loaded=True,
                     bounds={"centre": [1, 2, 3], "radius": 5, "source": source})
    for camera in first_cameras(page, api):
        pose = camera["world_from_camera"]
        away = [row[3] - c for row, c in zip(pose, (1, 2, 3))]
        assert least < math.hypot(*away) / 5 < most
        assert sum(x * row[2] for x, row in zip(away, pose)) < 0  # it looks at the middle


def test_a_scene_that_came_as_a_file_begins_where_its_file_says(page, fake):
    """With the up that it tells; so does its picture among the others."""
    api = fake("busy")
    start = {"camera": {"world_from_camera": AWAY, "axes": "opencv", "width": 320, "height": 240,
                        "fx": 300, "fy": 300, "cx": 160, "cy": 120}, "up": [0, 1, 0]}
    with api.world.lock:
        scene = api.world.find(api.world.scenes, "sphere-draft", "scene")
        scene.update(dataset=None, dataset_name=None, viewing={**VIEWING, "start": start}, loaded=True)
    for camera in first_cameras(page, api):
        assert [x for row in camera["world_from_camera"] for x in row] == \
            pytest.approx([x for row in AWAY for x in row], abs=1e-9)
        assert camera["fov_y_deg"] == pytest.approx(43.60, abs=0.01)
    assert page.complaints() == []
