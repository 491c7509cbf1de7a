"""Captures as other machines and programs leave them: what is read all the same, and what is told.

Each case spoils a sound capture in a way that people have, and says what `validate` makes of it.
"""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from support import captures
from support.captures import COUNT
from support.checked import Daemon
from support.client import INVALID, OK, USAGE
from support.waiting import PATIENCE_S

MARK = b"\xef\xbb\xbf"  # with which Windows' editors begin a text
BINARY, TEXT, STUDIO, NGP = "COLMAP, binary", "COLMAP, text", "nerfstudio", "instant-ngp"


def edit(folder, change):
    path = folder / "transforms.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def every_file(folder, pattern, change):
    for path in sorted(folder.glob(pattern)):
        change(path)


def halve(path):
    picture = Image.open(path)
    picture.resize((picture.width // 2, picture.height // 2)).save(path)


def mark(folder):
    every_file(folder, "**/*.txt", lambda path: path.write_bytes(MARK + path.read_bytes()))
    every_file(folder, "*.json", lambda path: path.write_bytes(MARK + path.read_bytes()))


def other_case(folder):
    every_file(folder, "images/*", lambda path: path.rename(path.with_suffix(".PNG")))


def without_extension(folder):
    other_case(folder)
    edit(folder, lambda document: [frame.update(file_path=frame["file_path"][:-4])
                                   for frame in document["frames"]])


def smaller_alone(folder):
    (folder / "images").rename(folder / "images_2")
    every_file(folder, "images_2/*", halve)


def windows_paths(folder):
    def change(document):
        for frame in document["frames"]:
            frame["file_path"] = ".\\" + frame["file_path"].replace("/", "\\")
        document["train_filenames"] = [f"images/p{i}.png" for i in range(COUNT - 1)]
        document["val_filenames"] = [f"images\\p{COUNT - 1}.png"]
    edit(folder, change)


def windows_names(folder):
    (folder / "images").rename(folder / "cam")
    (folder / "images_4").mkdir()
    (folder / "cam").rename(folder / "images_4" / "cam")
    path = folder / "sparse" / "0" / "images.txt"
    path.write_text(path.read_text().replace(" p", " cam\\p"))


def one_model(folder):
    (folder / "sparse" / "0").rename(folder / "sparse" / "1")


def two_models(folder):
    """The first has two photographs."""
    one_model(folder)
    shutil.copytree(folder / "sparse" / "1", folder / "sparse" / "0")
    path = folder / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[2:6]))


def both_forms(folder):
    captures.write_colmap_text(captures.make(), folder / "text")
    every_file(folder, "text/sparse/0/*", lambda path: path.rename(folder / "sparse" / "0" / path.name))
    shutil.rmtree(folder / "text")


def not_ended(folder):
    path = folder / "sparse" / "0" / "cameras.txt"
    path.write_text(path.read_text().rstrip("\n"))


def deeper(folder):
    inner = folder / "capture"
    inner.mkdir()
    for path in [path for path in folder.iterdir() if path != inner]:
        path.rename(inner / path.name)


def wide(folder):
    path = folder / "transforms.json"
    path.write_bytes(path.read_text().encode("utf-16"))


def other_kind(folder):
    edit(folder, lambda document: document["frames"][1].update(file_path="images/p1.bmp"))
    Image.open(folder / "images" / "p1.png").save(folder / "images" / "p1.bmp")


def raw_among(folder):
    (folder / "images" / "p9.DNG").write_bytes(b"II*\0")
    Image.new("RGB", (40, 30)).save(folder / "p8.jpg")


def raw_alone(folder):
    shutil.rmtree(folder / "images")
    (folder / "p9.CR2").write_bytes(b"II*\0")


def of_all_frames(folder):
    edit(folder, lambda document: document.update(rolling_shutter=[0, 0, 1]))


def strange_masks(folder):
    (folder / "masks").mkdir()
    Image.new("L", (40, 30), 255).save(folder / "masks" / "p1_mask.png")


def black_mask(folder):
    (folder / "masks").mkdir()
    Image.new("L", (40, 30), 0).save(folder / "masks" / "p1.png")


def cut_mask(folder):
    (folder / "masks").mkdir()
    path = folder / "masks" / "p1.png"
    Image.effect_noise((40, 30), 60).save(path)
    path.write_bytes(path.read_bytes()[:400])


# What is done to it: (layout, exit code, usable photographs or None, words that are told).
CASES = {
    mark: [(STUDIO, OK, COUNT, ""), (NGP, OK, COUNT, ""), (TEXT, OK, COUNT, "")],
    other_case: [(STUDIO, OK, COUNT, ""), (BINARY, OK, COUNT, "")],
    without_extension: [(NGP, OK, COUNT, "")],
    smaller_alone: [(STUDIO, OK, COUNT, "images_2/p0.png is taken"), (BINARY, OK, COUNT, "is 20x15")],
    windows_paths: [(STUDIO, OK, COUNT, "")],
    windows_names: [(TEXT, OK, COUNT, "")],
    one_model: [(BINARY, OK, COUNT, ""), (TEXT, OK, COUNT, "")],
    two_models: [(TEXT, OK, COUNT, "another model, of 4 photographs")],
    both_forms: [(BINARY, OK, COUNT, "the binary one is read")],
    not_ended: [(TEXT, INVALID, None, "end it as the others are")],
    deeper: [(BINARY, INVALID, None, "/capture does: give that folder"),
             (STUDIO, INVALID, None, "/capture does: give that folder"),
             ("photographs", OK, None, "4 photographs without poses")],
    wide: [(STUDIO, INVALID, None, "is UTF-16")],
    other_kind: [(STUDIO, INVALID, COUNT - 1, "p1.bmp: this is no picture of a known format")],
    raw_among: [("photographs", OK, None, "pictures of kinds that are not read, the first p9.DNG"),
                ("photographs", OK, None, "photographs outside of its folder images")],
    raw_alone: [("photographs", INVALID, None, "1 of other kinds, the first p9.CR2")],
    of_all_frames: [(STUDIO, INVALID, None, "rolling_shutter")],
    black_mask: [(BINARY, OK, COUNT, "left out as a whole, since their masks are black everywhere: p1")],
    cut_mask: [(STUDIO, INVALID, COUNT - 1, "masks/p1.png: the PNG file is damaged")],
    strange_masks: [(BINARY, OK, COUNT, "has no mask of any photograph")],
}


def validate(build, folder):
    done = subprocess.run([build / "client" / "ripnerf", "--json", "validate", folder],
                          capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    return done.returncode, json.loads(done.stdout)


@pytest.mark.parametrize("change, case", [(change, case) for change, cases in CASES.items() for case in cases],
                         ids=lambda value: getattr(value, "__name__", None) or value[0])
def test_what_is_made_of_it(build, tmp_path, change, case):
    layout, exit_code, usable, words = case
    folder = captures.write(layout, captures.make(), tmp_path / "Straße 1")
    change(folder)
    code, report = validate(build, folder)
    told = [f"{problem['where']}: {problem['text']}" for problem in report["problems"]]
    assert code == exit_code, told
    assert any(words in text for text in told), told
    assert usable is None or sum(report["usable"].values()) == usable, report
    assert len(set(told)) == len(told), told


def test_a_format_that_is_none(build, tmp_path):
    done = subprocess.run([build / "client" / "ripnerf", "validate", tmp_path, "--format", "nerf"],
                          capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == USAGE and "must be one of native, " in done.stderr, done.stderr
    assert "llff; it is 'nerf'" in done.stderr


# How masks are stored: what is used is white, or as said; of the left half all is.
MASKS = {
    "masks/{name}.png": lambda mask: mask,
    "masks/{stem}.PNG": lambda mask: mask,
    "masks/{stem}.jpg": lambda mask: mask,
    "masks/{stem}.png": lambda mask: mask.point(lambda value: value // 255),
    "images/dynamic_mask_{stem}.png": lambda mask: mask.point(lambda value: (255 - value) // 255),
    "masks/{name}": lambda mask: Image.merge("LA", (Image.new("L", mask.size, 255), mask)),
}


@pytest.fixture(scope="module")
def daemon(programs, build, tmp_path_factory):
    folder = tmp_path_factory.mktemp("awkward") / "data"
    with Daemon(programs[0], build / "server" / "ripnerf-runner", folder) as running:
        yield running


@pytest.mark.parametrize("file", MASKS)
def test_masks_of_each_convention(daemon, tmp_path, file):
    folder = captures.write(NGP, captures.make(), tmp_path / "data")
    mask = Image.new("L", (40, 30), 0)
    mask.paste(255, (0, 0, 20, 30))
    for path in sorted((folder / "images").glob("p*.png")):
        to = folder / file.format(name=path.name, stem=path.stem)
        to.parent.mkdir(exist_ok=True)
        MASKS[file](mask).save(to)
    job = daemon.wait(daemon.upload(f"masks-{list(MASKS).index(file)}", folder))
    assert job["state"] == "succeeded", job
    kept = sorted((Path(daemon.data) / "datasets" / job["dataset"]).rglob("*_mask.png"))
    assert len(kept) == COUNT
    for path in kept:
        assert Image.open(path).convert("L").tobytes() == mask.tobytes()
