"""Uploads from the page: parts that go on after a lost connection, photographs that are left out."""

import json

import pytest
from fake_pictures import draw, ring

pytest.importorskip("selenium", reason="python3-selenium is not installed")


@pytest.fixture
def folder(tmp_path):
    """Five posed photographs, of which one is damaged and one is empty."""
    root = tmp_path / "ball"
    (root / "train").mkdir(parents=True)
    frames = []
    for i, pose in enumerate(ring(5)):
        frames.append({"file_path": f"./train/r_{i}.png", "transform_matrix": pose + [[0, 0, 0, 1]]})
        camera = {"world_from_camera": pose, "axes": "opengl", "width": 20, "height": 20,
                  "fov_y_deg": 40}
        (root / "train" / f"r_{i}.png").write_bytes(draw(camera))
    (root / "train" / "r_1.png").write_bytes(b"\x89PNG\r\n\x1a\n no picture")
    (root / "train" / "r_3.png").write_bytes(b"")
    (root / "transforms_train.json").write_text(
        json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    return root


def choose(page, api, folder):
    page.open(api.url)
    page.find(".drop")
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says("views: 5 train")


def sent(api):
    return sorted(name for name, _ in api.world.uploaded[0])


def test_an_upload_goes_on_where_a_lost_connection_left_it(page, fake, folder):
    api = fake("empty")
    api.world.line_dead_below = 3000
    choose(page, api, folder)
    page.press("Upload and import")
    page.says("ball is imported.")
    # A browser itself repeats what was cut off, as often as it likes, from where that began; the
    # page asks how much is there.
    assert sorted({at for at, _ in api.world.parts}) == [0, 1000, 2000, 3000]
    assert "transforms_train.json" in sent(api)


def test_which_bad_photographs_to_leave_out_is_asked(page, fake, folder):
    api = fake("empty")
    choose(page, api, folder)
    page.says("2 photographs cannot be read", ".problem")
    page.says("train/r_3.png is empty", ".problem")
    damaged = next(e for e in page.all(".problem label") if "r_1.png" in e.text)
    assert "damaged" in damaged.text
    damaged.click()  # the daemon shall look at it
    page.press("Upload and import")
    page.says("ball is imported.")
    assert "train/r_1.png" in sent(api) and "train/r_3.png" not in sent(api)
    assert page.complaints() == []


def test_a_taken_name_is_told_before_anything_is_sent(page, fake, folder):
    api = fake("bare")
    choose(page, api, folder)
    page.type(page.field("Name"), "sphere")
    page.press("Upload and import")
    page.says("there is a dataset of that name")
    page.press("Import options")
    page.type(page.field("Test: every N-th view"), "2\t")
    page.says("3 test", ".preview .facts")  # looked at once more, which is no answer to that
    page.says("there is a dataset of that name")
    assert not api.world.parts


def test_what_an_import_would_keep_is_shown_before_it_is_sent(page, fake, folder):
    api = fake("empty")
    choose(page, api, folder)
    page.says("5 train", ".preview .facts")
    page.says("20 × 20 px", ".preview .facts")
    page.says("1 of 5 views", ".preview .facts")
    page.says("radius 1.5", ".preview .facts")
    page.until(lambda: page.ink(".preview canvas.cloud") > 0, "the cameras")
    page.until(lambda: page.ink(".preview-thumb") > 0, "a thumbnail")
    assert "train, masked" in page.text(".preview .photos") and not api.world.parts
    page.press("Import options")
    page.type(page.field("Test: every N-th view"), "2")
    page.type(page.field("Longest side"), "10\t")
    page.says("3 test", ".preview .facts")
    page.says("10 × 10 px", ".preview .facts")
    assert api.world.uploads and set(api.world.uploads) == api.world.looked_at
    page.press("Upload and import")
    page.says("ball is imported.")
    page.until(lambda: not api.world.uploads, "what was looked at to be given up")
    page.open(api.url + "#/jobs")
    page.says("2 to train, 0 to validate, 3 to test; 1 error, 0 warnings", ".job-row .outcome")
    assert page.complaints() == []


def take(page, words):
    """Takes the options of which the report says so; it may be made anew meanwhile."""
    def click():
        row = next((row for row in page.all(".preview .choices tbody tr") if words in row.text), None)
        if row:
            row.find_element("css selector", "button").click()
        return row

    page.until(click, f"options {words!r}")


def test_what_other_options_would_give_is_told_and_can_be_taken(page, fake, folder):
    api = fake("empty")
    choose(page, api, folder)
    page.says("as the files are", ".preview .choices")
    page.says("376 MiB", ".preview .choices")
    take(page, "longest side 400 px")
    page.says("400 × 400 px", ".preview .facts")
    take(page, "test: every 8th view, 4 scales")
    page.says("20 × 20 px, 4 scales", ".preview .facts")
    page.says("1 test", ".preview .facts")
    assert page.complaints() == []


def test_what_other_options_would_give_fits_and_can_be_reached(page, fake, folder):
    """At the page's own width beside the form, on a phone a row below the other: nothing is scrolled for."""
    api = fake("empty")
    choose(page, api, folder)
    for width, high in ((1440, 60), (375, 120)):
        page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
            "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 400})
        page.says("376 MiB", ".preview .choices")
        hidden, tall, beside = page.run("""
const box = document.querySelector('.choices').parentElement;
const rows = [...box.querySelectorAll('tbody tr')];
return [box.scrollWidth - box.clientWidth, Math.max(...rows.map((row) => row.offsetHeight)),
        document.querySelector('.sending').getBoundingClientRect().right <=
            document.querySelector('.preview').getBoundingClientRect().left];""")
        assert not page.run("return [...document.querySelectorAll('th')].filter((e) => !e.textContent).length;")
        assert hidden <= 0 and tall <= high and beside == (width > 1000)


def test_what_cannot_be_read_is_told_before_it_is_sent(page, fake, folder):
    api = fake("empty")
    api.world.fails["validate"] = {
        "type": "/problems/invalid", "title": "Invalid", "status": 422,
        "detail": "transforms_train.json#/frames/3/transform_matrix: is no rotation", "errors": []}
    choose(page, api, folder)
    page.says("transforms_train.json#/frames/3/transform_matrix: is no rotation", ".preview .problem")
    page.says("An import would be refused", ".sending")
    submit = next(e for e in page.all(".sending button") if e.text == "Upload and import")
    assert not submit.is_enabled()
    del api.world.fails["validate"]  # with other options it is read
    page.press("Import options")
    page.type(page.field("Test: every N-th view"), "2\t")
    page.says("3 test", ".preview .facts")
    page.until(submit.is_enabled, "the button again")
    assert "refused" not in page.text(".sending")
    page.press("Back")
    page.find(".drop")
    page.until(lambda: not api.world.uploads, "what was looked at to be given up")


def test_a_tab_closed_in_an_upload_leaves_no_dataset(page, fake, folder):
    """The browser asks first; what was sent takes no room, is no dataset, and the name is free."""
    api = fake("empty")
    api.world.line_dead_below = 1 << 30  # no part ever ends
    choose(page, api, folder)
    page.press("Upload and import")
    page.says("The connection is lost.")
    asked = """const closing = new Event('beforeunload', {cancelable: true});
dispatchEvent(closing); return closing.defaultPrevented;"""
    assert page.run(asked) and api.world.uploads
    page.open("about:blank")
    page.until(lambda: not api.world.uploads, "what was sent to be given up")
    api.world.line_dead_below = 0
    choose(page, api, folder)
    assert not page.run(asked) and not api.world.datasets
    page.press("Upload and import")
    page.says("ball is imported.")
    assert [item["name"] for item in api.world.datasets] == ["ball"]


def leave_and_return(page):
    page.run("location.hash = '#/jobs';")
    page.says("Jobs", "h1")
    page.run("location.hash = '#/';")
    page.says("Upload ball", "[aria-label='Under way']")


def test_an_upload_whose_view_was_left_is_told_and_can_be_cancelled(page, fake, folder):
    api = fake("empty")
    api.world.line_dead_below = 1 << 30
    choose(page, api, folder)
    page.press("Upload and import")
    page.says("The connection is lost. It goes on where it was, once the daemon answers.")
    assert "Upload ball" not in page.text("main")  # its form tells of it
    leave_and_return(page)
    page.press("Cancel")
    page.until(lambda: "Upload ball" not in page.text("main"), "the upload gone")
    page.until(lambda: not api.world.uploads, "what was sent to be given up")
    assert not api.world.datasets and page.complaints() == []


NAMED = """
const {api, Problem} = await load('api.js');
const {beginUpload, sendPart} = api;
let named = null;  // the form's; what is looked at before has no name, and may be sent meanwhile
api.beginUpload = async (body, signal) => {
  const upload = await beginUpload(body, signal);
  if (body.name) named = upload.id;
  return upload;
};
"""


def test_an_upload_that_fails_after_its_view_was_left_says_why(page, fake, folder):
    api = fake("empty")
    choose(page, api, folder)
    page.says("5 train", ".preview .facts")
    page.run(NAMED + """
api.sendPart = (id, ...rest) => id !== named ? sendPart(id, ...rest) : new Promise((_, refuse) => {
  window.fail = () => refuse(new Problem(413, {title: 'Too large', detail: 'no more is taken'}));
});""")
    page.press("Upload and import")
    page.until(lambda: page.run("return Boolean(window.fail);"), "a part on its way")
    leave_and_return(page)
    page.run("window.fail();")
    page.says("no more is taken", "body")
    page.until(lambda: "Upload ball" not in page.text("main"), "the upload gone")
    page.until(lambda: not api.world.uploads, "what was sent to be given up")


def test_an_upload_goes_on_where_a_full_disk_left_it(page, fake, folder):
    """Of which it says so meanwhile; what was sent is not sent again."""
    api = fake("empty")
    choose(page, api, folder)
    page.says("5 train", ".preview .facts")
    page.run(NAMED + """
window.full = true;
window.sent = [];
api.sendPart = async (id, offset, part, ...rest) => {
  if (id !== named || !window.full) {
    if (id === named) window.sent.push(offset);
    return sendPart(id, offset, part, ...rest);
  }
  if (!offset) await sendPart(id, offset, part.slice(0, 1000), ...rest);
  throw new Problem(507, {title: 'The disk is full', detail: 'upload: No space left on device'});
};""")
    page.press("Upload and import")
    page.says("No space left on device. It goes on where it was, by itself.")
    page.run("window.full = false;")
    page.says("ball is imported.")
    assert page.run("return window.sent;") == [1000]


def test_an_upload_goes_on_when_the_page_has_found_the_daemon(page, fake):
    """Not at the end of a wait of its own, of 8 s after some failures."""
    page.open(fake("empty").url)
    page.find(".drop")
    tries = page.run("""
const [{api, Unreachable}, {sendInParts}, {state, noteUpload}] =
    await Promise.all(['api.js', 'sending.js', 'store.js'].map(load));
const status = async (word) => {
  state.connection.status = word;
  noteUpload('any', null);  // tells all who watch
  await Promise.resolve();
};
let tries = 0;
api.beginUpload = async () => {
  if (++tries < 20) throw new Unreachable();
  return {id: 'up', offset: 0};
};
await sendInParts(new Blob([]), 'any', {
  onProgress: () => {},
  onWait: async () => { await status('offline'); await status('online'); },
  signal: new AbortController().signal
});
return tries;""")
    assert tries == 20


def test_an_upload_that_is_whole_waits_for_the_daemon_to_take_it(page, fake):
    """The last of its requests, whose answer was lost: all was to be sent once more."""
    page.open(fake("empty").url)
    page.find(".drop")
    assert page.run("""
const [{api, Unreachable}, {sendInParts}] = await Promise.all(['api.js', 'sending.js'].map(load));
api.beginUpload = async () => ({id: 'up', offset: 0});
let lost = 0;
const job = await sendInParts(new Blob([]), 'any', {
  onProgress: () => {},
  onWait: () => setTimeout(() => dispatchEvent(new Event('online'))),
  take: async (upload) => {
    if (++lost < 20) throw new Unreachable();
    return `what imports ${upload}`;
  },
  signal: new AbortController().signal
});
return [job, lost];""") == ["what imports up", 20]


def test_what_was_chosen_stands_in_the_middle_of_its_plot_and_before_its_photographs(page, fake, folder):
    """Cameras far from the bounds' centre were a speck; what is wrong stood below all photographs."""
    api = fake("empty")
    api.world.centre = [20, 0, 0]
    choose(page, api, folder)
    page.until(lambda: page.ink(".preview canvas.cloud") > 0, "the cameras")
    wide, off = page.run("""
const canvas = document.querySelector('.preview canvas.cloud');
const {data, width, height} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
const columns = [...Array(width).keys()].filter(
    (x) => [...Array(height).keys()].some((y) => data[4 * (y * width + x) + 3]));
const [low, high] = [columns[0], columns.at(-1)];
return [(high - low) / height, Math.abs((low + high) / 2 - width / 2) / height];""")
    assert wide > 0.5 and off < 0.15
    report, photos = (page.run("return document.querySelector(args[0]).getBoundingClientRect().top;", css)
                      for css in (".preview .problems", ".preview .photos"))
    assert report < photos


def test_photographs_are_chosen_as_files_where_there_is_no_folder(page, fake, folder):
    """As of a phone's gallery: whose cameras are looked for."""
    page.open(fake("empty").url)
    page.find(".drop")
    good = [folder / "train" / f"r_{i}.png" for i in (0, 2, 4)]
    page.all("#file-input")[0].send_keys("\n".join(str(path) for path in good))
    page.says("photographs without poses · views: 3 photographs")
    page.says("3 files")


def test_on_a_phone_what_is_added_comes_first(page, fake, folder):
    """Where there is nothing yet, and once it was chosen."""
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {
        "width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True})
    above = """const top = (words) => [...document.querySelectorAll('.panel')].find(
        (e) => e.getAttribute('aria-label') === words).getBoundingClientRect().top;
return top('Add a dataset') < top('Scenes');"""
    page.open(fake("empty").url)
    page.says("From photographs to a scene")
    page.until(lambda: page.run(above), "the panel above the scenes")
    page.open(fake("busy").url)
    page.until(lambda: page.all(".card"), "scenes")
    assert not page.run(above)
    page.all("#folder-input")[0].send_keys(str(folder))
    page.says("views: 5 train")
    assert page.run(above)
