"""Camera paths in files, on the page: written and read as each program's, whatever lies beside."""

import json

import pytest
from test_page_paths import eye_of

pytest.importorskip("selenium", reason="python3-selenium is not installed")

POSES = [[[1, 0, 0, x], [0, 0, 1, -4], [0, -1, 0, 0.5]] for x in (0, 1, 3)]
THERE_AND_BACK = """
const {pathOfDocument} = await load('path.js');
const {api} = await load('api.js');
const {readPathFiles, writePathFiles} = await load('pathfile.js');
const path = pathOfDocument(args[0]);
const files = (made) => made.map(([name, blob]) => new File([blob], name));
const seen = {};
for (const {name: format} of (await api.formats()).paths) {
  const made = files(await writePathFiles(path, format));
  const back = await readPathFiles([...made].reverse(), undefined, format === 'nerfstudio');
  seen[format] = [made.map(({name}) => name), back.format,
                  back.path.keys.map((key) => key.world_from_camera.map((row) => row[3]))];
}
const [ngp] = files(await writePathFiles(path, 'instant-ngp'));
const moved = new File([JSON.stringify({scale: 0.165, offset: 0.5, frames: []})], 'transforms.json');
seen.moved = (await readPathFiles([moved, ngp])).path.keys.map(
    (key) => key.world_from_camera.map((row) => row[3]));
return seen;"""


def test_every_programs_files_there_and_back(page, daemon):
    """Through a real daemon; instant-ngp's scale and offset of the dataset are heeded."""
    server = daemon("tests/support/ripnerf-runner-fake")
    page.open(server.url)
    page.find("main")
    seen = page.run(THERE_AND_BACK, {
        "axes": "opencv", "fps": 1, "width": 64, "height": 48,
        "keys": [{"time": i, "world_from_camera": pose, "fov_y_deg": 40}
                 for i, pose in enumerate(POSES)]})
    eyes = [[row[3] for row in pose] for pose in POSES]
    moved = seen.pop("moved")
    assert len(seen) == 8
    for name, (files, told, back) in seen.items():
        assert told == name and len(back) == 3, name
        assert back == [pytest.approx(eye, abs=1e-6) for eye in eyes], name
        assert files[1:] == (["cameras.txt"] if name == "colmap" else []), name
    # a scale of 0.165 about the same offset: all is twice as far as with the usual 0.33
    assert moved == [pytest.approx([2 * x for x in eye], abs=1e-6) for eye in eyes]


def test_a_path_is_saved_and_opened(scene, downloads, tmp_path):
    downloads.clear()
    scene.press("Whole turn")
    scene.until(lambda: len(scene.all(".key")) == 8, "eight keys")
    before = scene.path()["keys"]
    scene.press("Keep, load, import, export")
    scene.press("Save as a file")
    file = downloads.saved(scene, "path.json")
    scene.press("Clear")
    scene.press("Remove")
    scene.says("No keys yet")
    scene.all("#path-file")[0].send_keys(str(file))
    scene.until(lambda: len(scene.all(".key")) == 8, "the keys of the file")
    assert [eye_of(key) for key in scene.path()["keys"]] == [eye_of(key) for key in before]
    scene.press("Undo")
    scene.says("No keys yet")
    wrong = tmp_path / "notes.json"
    wrong.write_text("{}")
    scene.all("#path-file")[0].send_keys(str(wrong))
    scene.says("Not read notes.json: is no camera path that is known", "#toasts")


def test_whose_coordinates_they_are_is_asked(scene, tmp_path):
    file = tmp_path / "camera_path.json"
    file.write_text(json.dumps({"of a training": 1, "path": {
        "axes": "opencv", "width": 64, "height": 48,
        "keys": [{"time": 0, "world_from_camera": POSES[1], "fov_y_deg": 40}]}}))
    scene.press("Keep, load, import, export")
    scene.all("#path-file")[0].send_keys(str(file))
    scene.says("those of one training of nerfstudio", "dialog")
    scene.press("Leave it")
    assert not scene.all(".key")
    scene.all("#path-file")[0].send_keys(str(file))
    scene.says("those of one training of nerfstudio", "dialog")
    scene.press("They are the dataset’s")
    scene.until(lambda: len(scene.all(".key")) == 1, "the key")
    assert eye_of(scene.path()["keys"][0]) == [1, -4, 0.5]
