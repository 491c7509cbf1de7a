"""Archives on the page: read as the folders that they are, refused where they are damaged; and scenes
that were exported, which come back."""

import base64
import io
import tarfile
import zipfile

import pytest
from test_links import client  # noqa: F401 (a fixture)
from test_sending import folder  # noqa: F401 (a fixture)

pytest.importorskip("selenium", reason="python3-selenium is not installed")

FILES = {"ball/transforms_train.json": b'{"frames": []}', "ball/train/r_0.png": bytes(range(256)) * 40,
         "ball/empty.txt": b"", "ball/" + "a long name/" * 9 + "last.png": b"x" * 511,
         "ball/größe.png": b"grey" * 128}

READ = """
const {entriesOfArchive, isArchive} = await load('archive.js');
const bytes = (words) => Uint8Array.from(atob(words), (c) => c.charCodeAt(0));
const wordsOf = async (file) => btoa(String.fromCharCode(...new Uint8Array(await file.arrayBuffer())));
const read = async ([name, words]) => {
  if (!isArchive(name)) return 'no archive';
  try {
    const entries = await entriesOfArchive(new File([bytes(words)], name), () => {});
    return Object.fromEntries(await Promise.all(
        entries.map(async ({path, file}) => [path, await wordsOf(file)])));
  } catch (error) { return error.message; }
};
return Promise.all(args[0].map(read));"""


def read(page, *archives):
    """What the page finds in each (name, bytes): path -> bytes, or why it cannot be read."""
    answers = page.run(READ, [[name, base64.b64encode(data).decode()] for name, data in archives])
    return [{path: base64.b64decode(words) for path, words in found.items()}
            if isinstance(found, dict) else found for found in answers]


def zipped(method=zipfile.ZIP_DEFLATED, large=False):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        archive.mkdir("ball")
        for path, data in FILES.items():
            with archive.open(path, "w", force_zip64=large) as file:
                file.write(data)
        archive.writestr("__MACOSX/ball/._r_0.png", b"of a Mac")
        archive.comment = b"made by hand"
    return out.getvalue()


def tarred(mode="w", style=tarfile.PAX_FORMAT):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode=mode, format=style) as archive:
        for path, data in FILES.items():
            member = tarfile.TarInfo("./" + path)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
        place = tarfile.TarInfo("ball/train")
        place.type = tarfile.DIRTYPE
        archive.addfile(place)
    return out.getvalue()


@pytest.fixture
def blank(page, fake):
    page.open(fake("empty").url)
    page.find("main")
    return page


def test_every_kind_is_a_folder_of_its_name(blank):
    kinds = [("Lego.zip", zipped()), ("Lego.ZIP", zipped(zipfile.ZIP_STORED)),
             ("Lego.zip", zipped(large=True)), ("Lego.tar", tarred()),
             ("Lego.tar", tarred(style=tarfile.GNU_FORMAT)), ("Lego.tgz", tarred("w:gz")),
             ("Lego.tar.gz", tarred("w:gz"))]
    for (name, _), found in zip(kinds, read(blank, *kinds), strict=True):
        assert found == {"Lego/" + path: data for path, data in FILES.items()}, name
    assert read(blank, ("a.rar", b""), ("notes.txt", b"")) == ["no archive"] * 2


def test_a_damaged_archive_is_refused_by_its_name(blank):
    whole = {"z.zip": zipped(), "s.zip": zipped(zipfile.ZIP_STORED), "t.tar": tarred(),
             "g.tar.gz": tarred("w:gz")}
    cut = [(name, data[:size]) for name, data in whole.items()
           for size in (0, 21, len(data) // 3, len(data) // 2)]
    bytes_of = bytearray(zipped())
    data_at = bytes_of.index(b"r_0.png") + len("r_0.png") + 30
    bytes_of[data_at:data_at + 8] = b"\xff" * 8  # not what was deflated
    locked = bytearray(zipped())
    for at in (i for i in range(len(locked)) if locked[i:i + 4] == b"PK\1\2"):
        locked[at + 8] |= 1
    bomb = bytearray(zipped())
    at = bomb.index(b"PK\1\2", bomb.index(b"PK\1\2") + 50)  # the second entry: says less than it holds
    bomb[at + 24:at + 28] = (3).to_bytes(4, "little")
    for (name, _), said in zip(cut, read(blank, *cut), strict=True):
        assert said == f"{name} is damaged or cut off.", name
    said = read(blank, ("a.zip", bytes(bytes_of)), ("b.zip", bytes(locked)), ("c.zip", bytes(bomb)))
    assert said[0] == "a.zip is damaged or cut off." and said[1].startswith("b.zip is encrypted (ball/")
    assert said[2] == "c.zip is damaged or cut off."


def give(page, file):
    page.find(".drop")
    page.all("#file-input")[0].send_keys(str(file))


def test_a_zip_becomes_a_dataset(page, fake, folder, tmp_path):  # noqa: F811
    archive = tmp_path / "From a phone.zip"
    with zipfile.ZipFile(archive, "w") as out:
        for file in folder.rglob("*"):
            out.write(file, file.relative_to(folder))
    api = fake("empty")
    page.open(api.url)
    give(page, archive)
    page.says("views: 5 train")
    assert page.field("Name").get_attribute("value") == "From-a-phone"
    page.says("2 photographs cannot be read", ".problem")
    page.press("Upload and import")
    page.says("From-a-phone is imported.")
    assert sorted(name for name, _ in api.world.uploaded[0]) == [
        "train/r_0.png", "train/r_2.png", "train/r_4.png", "transforms_train.json"]
    archive.write_bytes(archive.read_bytes()[:-100])
    page.press("Add another")
    give(page, archive)
    page.says("From a phone.zip is damaged or cut off.", ".problem")
    assert page.complaints() == []


def test_an_exported_scene_comes_back(page, fake, tmp_path):
    file = tmp_path / "light ball.ripscene"
    file.write_bytes(b"as it was exported")
    api = fake("busy")
    page.open(api.url)
    give(page, file)
    page.says("A scene for viewing, 18 B")
    assert page.field("Name").get_attribute("value") == "light-ball"
    page.type(page.field("Name"), "sphere-draft")
    page.press("Upload and open")
    page.says("there is a scene of that name", ".faulty .note")
    assert not api.world.uploaded
    page.type(page.field("Name"), "light")
    page.press("Upload and open")
    page.says("light is imported.")
    assert api.world.uploaded == [b"as it was exported"]
    page.press("Look at it")
    page.says("light", "h1")
    page.until(lambda: page.ink() > 100, "a picture")
    assert page.complaints() == []


def test_a_daemon_takes_what_a_daemon_exported(page, client, tmp_path):  # noqa: F811
    """By a token, beside the photographs that it was trained on."""
    client("export", "ball", "--as", "scene", "-o", "ball.ripscene")
    page.open(client.url)
    page.type(page.find("#token-input"), "a-token-of-this-test")
    page.press("Use it")
    page.until(lambda: page.all(".card .thumb[data-state=ready]"), "the scene there is")
    give(page, tmp_path / "ball.ripscene")
    page.type(page.field("Name"), "light")
    page.field("Photographs").send_keys("data")
    page.press("Upload and open")
    page.says("light is imported.")
    page.press("Look at it")
    page.says("from data", ".page-head")
    page.until(lambda: page.ink() > 0, "a picture")
    assert page.complaints() == []
