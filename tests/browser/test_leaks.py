"""A page that stays open keeps nothing of the views that were left: no nodes, no listeners, no
pictures or addresses of some, no streams of events."""

import pytest
from support.waiting import wait_for

pytest.importorskip("selenium", reason="python3-selenium is not installed")

COUNT = """
window.addresses = new Set();
const [make, drop] = [URL.createObjectURL, URL.revokeObjectURL];
URL.createObjectURL = (what) => { const a = make.call(URL, what); addresses.add(a); return a; };
URL.revokeObjectURL = (a) => { addresses.delete(a); drop.call(URL, a); };
window.bitmaps = new Set();
const decode = window.createImageBitmap;
window.createImageBitmap = async (...what) => {
  const bitmap = await decode(...what);
  const close = bitmap.close.bind(bitmap);
  bitmaps.add(bitmap);
  return Object.assign(bitmap, {close: () => { bitmaps.delete(bitmap); close(); }});
};
"""
FEW = {"Nodes": 40, "JSEventListeners": 4, "addresses": 0, "bitmaps": 0, "streams": 0}  # a scene's page: 2,000 nodes


def held(page, api):
    """What the page holds once all that can go is gone."""
    page.driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    metrics = page.driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    figures = {item["name"]: item["value"] for item in metrics if item["name"] in FEW}
    return {**figures, "addresses": page.run("return addresses.size;"),
            "bitmaps": page.run("return bitmaps.size;"), "streams": api.streams}


def finished_path(api):
    """A path job with its frames, and its id."""
    with api.world.lock:
        eye = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]
        keys = [{"time": t, "fov_y_deg": 40, "world_from_camera": eye} for t in (0, 0.5)]
        job = api.world.submit({"type": "path", "scene": "sphere-draft", "camera_path": {
            "axes": "opencv", "fps": 8, "width": 64, "height": 48, "keys": keys}})
        api.world.set_state(job, "running")
        while job["state"] == "running":
            api.world.advance(job, 0.2)
    return job["id"]


def test_views_that_were_left_leave_nothing(page, fake):
    api = fake("busy")
    job = finished_path(api)
    page.open(api.url)
    page.driver.execute_cdp_cmd("Performance.enable", {})
    page.run(COUNT)
    page.run("location.hash = '#/scene/sphere-draft';")
    page.press("Whole turn")  # eight keys, which have pictures

    def around():
        for place, sign in (
                ("scene/sphere-draft", ".stage[data-level=refined]"),
                ("scene/sphere-draft", ".key:last-child img:not([hidden])"), (f"job/{job}", ".cells [data-there]"),
                ("dataset/sphere", "#train"), ("jobs", ".job-row"), ("system", ".facts"),
                ("", ".card .thumb[data-state=ready]")):  # with its picture, which has an address
            page.run("location.hash = args[0];", f"#/{place}")
            # asked in the page: the driver holds on to elements that it finds
            page.until(lambda: page.run("return Boolean(document.querySelector(args[0]));", sign), sign)

    around()
    before = page.until(lambda: (now := held(page, api))["streams"] == 1 and now, "one stream of events")
    for _ in range(2):
        around()
    now = {}

    def all_gone():
        now.update(held(page, api))
        return all(now[name] <= before[name] + few for name, few in FEW.items())
    wait_for(all_gone, said=lambda: f"{now} is held, {before} before")
    assert page.complaints() == []
