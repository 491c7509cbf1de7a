"""The page's pure functions, run in the browser that will run them."""

import io
import json
import math
import tarfile

import numpy as np
import pytest
from fake_api import FORMATS
from fake_pictures import png
from PIL import Image
from PIL.PngImagePlugin import PngInfo


@pytest.fixture
def blank(page, fake):
    page.open(fake("empty").url)
    return page


def test_tar_is_read_by_another_reader(blank):
    names = [
        "transforms_train.json",
        "train/r_0.png",
        "train/" + "x" * 120 + "/" + "y" * 90 + ".png",
        "train/ü.png",
    ]
    sizes = [5, 512, 0, 1025]
    data = blank.run(
        """
        const {tarOf} = await load('tar.js');
        const entries = args[0].map(
            (path, i) => ({path, file: new Blob([new Uint8Array(args[1][i]).fill(i + 1)])}));
        return [...new Uint8Array(await tarOf(entries).arrayBuffer())];""",
        names,
        sizes,
    )
    with tarfile.open(fileobj=io.BytesIO(bytes(data))) as tar:
        members = tar.getmembers()
        assert [member.name for member in members] == names
        assert [member.size for member in members] == sizes
        assert all(member.isreg() for member in members)
        assert tar.extractfile(members[3]).read() == b"\x04" * 1025
    assert len(data) % 512 == 0


def test_tar_refuses_a_name_that_does_not_fit(blank):
    refused = blank.run(
        """
        const {tarOf} = await load('tar.js');
        try {
          tarOf([{path: 'x'.repeat(101), file: new Blob([])}]);
          return '';
        } catch (error) { return error.message; }"""
    )
    assert "too long" in refused


def test_event_parser_survives_any_split(blank):
    stream = ': hello\r\nid: 1\r\nevent: state\r\ndata: {"a":1}\r\n\r\nid: 2\ndata: x\ndata: y\n\nevent: progress\rdata:z\r\r\n'
    expected = [["1", "state", '{"a":1}'], ["2", "message", "x\ny"], ["2", "progress", "z"]]
    seen = blank.run(
        """
        const { createParser } = await load('events.js');
        const results = [];
        for (let size = 1; size <= args[0].length; size++) {
          const events = [];
          const parse = createParser((e) => events.push([e.id, e.type, e.data]));
          for (let i = 0; i < args[0].length; i += size) parse(args[0].slice(i, i + size));
          results.push(events);
        }
        return results;""",
        stream,
    )
    assert all(events == expected for events in seen)


def test_orbit_cameras_are_rigid_and_come_back(blank):
    result = blank.run(
        """
        const {poseOfOrbit, orbitOfPose, turn, pan, dolly} = await load('orbit.js');
        const bounds = {centre: [0.2, -0.3, 0.1], radius: 1.5};
        let orbit =
            {target: bounds.centre, distance: 4, yaw: 0.7, pitch: 0.4, up: args[0], fovDeg: 40};
        orbit = dolly(turn(orbit, 1.1, -0.2), 0.9);
        const pose = poseOfOrbit(orbit);
        return {
          pose,
          back: poseOfOrbit(orbitOfPose(pose, 40, args[0], bounds)),
          panned: poseOfOrbit(pan(orbit, 0.25, 0)),
          high: turn(orbit, 0, 99).pitch
        };""",
        [0, 0.6, 0.8],
    )
    pose, back, panned = (np.array(result[key]) for key in ("pose", "back", "panned"))
    rotation = pose[:, :3]
    assert np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert pose[:, 1] @ [0, 0.6, 0.8] < 0  # the picture's y axis points down
    towards = np.array([0.2, -0.3, 0.1]) - pose[:, 3]
    assert np.linalg.norm(towards) == pytest.approx(3.6)
    assert np.allclose(towards / 3.6, pose[:, 2])
    assert np.allclose(back, pose, atol=1e-9)
    height = 2 * 3.6 * math.tan(math.radians(20))
    assert np.allclose(panned[:, 3] - pose[:, 3], -0.25 * height * pose[:, 0])
    assert result["high"] < math.pi / 2


def test_axes_and_up_of_a_dataset(blank):
    result = blank.run(
        """
        const {openCvPose, upOf, fovOf} = await load('orbit.js');
        const camera = {
          world_from_camera: [[1, 0, 0, 1], [0, 0, -1, 2], [0, 1, 0, 3]],
          axes: 'opengl',
          width: 8,
          height: 6,
          fx: 3,
          fy: 3,
          cx: 4,
          cy: 3
        };
        return {pose: openCvPose(camera), up: upOf([camera]), fov: fovOf(camera)};"""
    )
    assert result["pose"] == [[1, 0, 0, 1], [0, 0, 1, 2], [0, -1, 0, 3]]
    assert result["up"] == [0, 0, 1]
    assert result["fov"] == pytest.approx(90)


def test_path_edits_and_motion(blank):
    result = blank.run(
        """
        const p = await load('path.js');
        const pose = (x) => [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0]];
        let path = p.emptyPath(64, 48);
        for (const x of [0, 2, 3]) path = p.addKey(path, pose(x), 40 + x);
        const at = (t) => {
          const c = p.cameraAt(path, t);
          return [c.pose[0][3], c.fovDeg];
        };
        const through = [0, 1, 2].map(at);
        const moved = p.moveKey(path, path.keys[2].id, 0);
        const linear = p.cameraAt({...path, interpolation: 'linear'}, 0.5).pose[0][3];
        const late = p.problemOf(p.changeKey(path, path.keys[1].id, {time: 2}));
        const back = p.documentOf(p.pathOfDocument({...p.documentOf(path), axes: 'opengl'}));
        return {
          through,
          linear,
          late,
          document: p.documentOf(path),
          frames: p.frameCount(path),
          looped: p.frameCount({...path, loop: true}),
          moved: moved.keys.map((k) => [k.time, k.pose[0][3]]),
          fine: p.problemOf(path),
          none: p.problemOf(p.emptyPath(1, 1)),
          back: back.keys[1].world_from_camera
        };"""
    )
    assert np.allclose(result["through"], [[0, 40], [2, 42], [3, 43]])
    assert result["linear"] == pytest.approx(1)
    assert "later" in result["late"] and result["fine"] is None and "one key" in result["none"]
    assert result["frames"] == 2 * 24 + 1 and result["looped"] == 3 * 24
    assert result["moved"] == [[0, 3], [1, 0], [2, 2]]
    assert result["back"] == [[1, 0, 0, 2], [0, -1, 0, 0], [0, 0, -1, 0]]
    assert set(result["document"]) == {
        "axes",
        "fps",
        "interpolation",
        "loop",
        "width",
        "height",
        "keys",
    }


def test_slerp_halves_an_angle_either_way(blank):
    poses = blank.run(
        """
        const v = await load('vector.js');
        const about = (a) => [
            [Math.cos(a), -Math.sin(a), 0, 0], [Math.sin(a), Math.cos(a), 0, 0], [0, 0, 1, 0]];
        const half = (a, b) => v.poseOfQuaternion(
            v.slerp(v.quaternionOf(about(a)), v.quaternionOf(about(b)), 0.5), [0, 0, 0]);
        return [half(0, 1), half(3, 3.4), half(-3.1, 3.1)];"""
    )
    angles = [math.atan2(pose[1][0], pose[0][0]) for pose in poses]
    assert angles[0] == pytest.approx(0.5)
    assert math.cos(angles[1] - 3.2) == pytest.approx(1)
    assert math.cos(angles[2] - math.pi) == pytest.approx(1)


def test_chart_axes(blank):
    result = blank.run(
        """
        const {ticks, valueRange, summary} = await load('chart.js');
        return {
          a: ticks(0, 60, 5),
          b: ticks(20, 34, 4),
          c: ticks(0, 0.3, 3),
          range: valueRange([{y: 28.2}, {y: 28.4}]),
          words: summary([{x: 0, y: 9}, {x: 61, y: 30.25}])
        };"""
    )
    assert result["a"] == [0, 20, 40, 60]
    assert result["b"] == [20, 25, 30]
    assert result["c"] == [0, 0.1, 0.2, 0.3]
    assert result["range"][0] <= 28 and result["range"][1] >= 29
    assert result["words"].endswith("30.25 dB at 61 s")


def test_grey16_reads_every_bit(blank):
    values = (np.arange(6 * 5, dtype=np.uint32).reshape(5, 6) * 2111 % 65536).astype(np.uint16)
    read = blank.run(
        """
        const {readGrey16} = await load('grey16.js');
        const image = await readGrey16(new Blob([new Uint8Array(args[0])]));
        return {
          width: image.width,
          values: [...image.values],
          other: await readGrey16(new Blob([new Uint8Array(args[1])]))
        };""",
        list(png(values)),
        list(png(np.zeros((2, 2, 3), np.uint8))),
    )
    assert (
        read["width"] == 6 and read["values"] == values.ravel().tolist() and read["other"] is None
    )


def test_a_depth_says_how_near_and_far_it_is(blank):
    whole = io.BytesIO()
    scale = PngInfo()
    scale.add_text("ripnerf:depth_scale", "131.07")
    Image.fromarray(np.array([[0, 1000], [2500, 600]], np.uint16)).save(whole, "PNG", pnginfo=scale)
    told = blank.run(
        """
        const {pictureOf} = await load('grey16.js');
        const {legend} = await load('outputs.js');
        const all = [];
        for (const [bytes, output] of [[args[0], 'depth'], [args[0], 'rgb'], [args[1], 'depth']]) {
          const {picture, scale} = await pictureOf(new Blob([new Uint8Array(bytes)]), output);
          const shown = legend(scale, output);
          all.push([picture.width, scale, shown?.textContent, shown?.getAttribute('aria-label')]);
        }
        return all;""",
        list(whole.getvalue()),
        list(png(np.zeros((2, 2), np.uint16))),
    )
    assert told == [
        [2, "1.2 5 dataset units", "1.25 dataset units · black: none",
         "Colours: bright 1.2, dark 5 dataset units, black where nothing is"],
        [2, "", None, None], [2, "", None, None]]
    assert blank.run("return (await load('outputs.js')).legend('0 1 levels', 'level').textContent;") == (
        "01 level · black: 0")


def test_what_is_wrong_is_told_once(blank):
    told = blank.run(
        """
        const {problemBox} = await load('ui.js');
        return args[0].map(([detail, pointer, why]) => problemBox({title: 'No', detail, errors: [
            {pointer, detail: why}]}).innerText);""",
        [["a.json: #/keys/1: no rotation", "#/file", "#/keys/1: no rotation"],
         ["#/name: is taken", "#/name", "is taken"], ["is taken", "#/name", "is taken"]])
    assert [words.count("no rotation") for words in told[:1]] == [1]
    assert [words.count("is taken") for words in told[1:]] == [1, 2]  # once more with its place, untold so far


def test_times_of_pictures_are_told_in_ms_and_s(blank):
    told = blank.run("const {milliseconds} = await load('format.js'); return args.map(milliseconds);",
                     None, 2.44, 240.4, 999.4, 2384)
    assert told == ["–", "2.4 ms", "240 ms", "999 ms", "2.4 s"]


@pytest.mark.parametrize("low", [0.2, 13.0, 29.1])
def test_accuracy_has_a_scale_however_far_it_reaches(blank, low):
    marks = blank.run(
        """
        const {drawCost} = await load('views/curve.js');
        const host = document.body.appendChild(document.createElement('div'));
        const points = args[0].map((psnr, i) => ({psnr, ms_median: 1 + 99 * i, setting: {}}));
        drawCost(host, points, {});
        return [...host.querySelectorAll('.grid + text')].map((mark) => Number(mark.textContent));""",
        [low, 28.7 if low < 20 else 31.2])
    assert len(marks) >= 3 and marks == sorted(set(marks))


def test_the_beginning_of_a_photograph_says_its_size_and_its_camera(blank):
    exif = Image.Exif()
    exif[0x010F] = "Maker " * 800
    whole = io.BytesIO()
    noise = np.random.default_rng(1).integers(0, 255, (90, 160, 3), np.uint8)
    Image.fromarray(noise).save(whole, "JPEG", quality=95, exif=exif, progressive=True)
    heads = blank.run(
        """
        const {headOf} = await load('photocheck.js');
        const head = async (path, bytes) =>
            [...new Uint8Array(await (await headOf({path, file: new Blob([new Uint8Array(bytes)])}))
                                   .file.arrayBuffer())];
        return [await head('a/p.JPG', args[0]), await head('a/p.jpg', args[1]),
                await head('a/cameras.bin', args[1])];""",
        list(whole.getvalue()),
        list(b"\xff\xd8 no picture"),
    )
    assert bytes(heads[0]) == whole.getvalue()[:len(heads[0])]
    assert 4800 < len(heads[0]) < 5900 < len(whole.getvalue())
    seen = Image.open(io.BytesIO(bytes(heads[0])))
    assert seen.size == (160, 90) and seen.getexif()[0x010F].startswith("Maker Maker")
    assert bytes(heads[1]) == bytes(heads[2]) == b"\xff\xd8 no picture"


def test_upload_takes_what_the_json_names(blank):
    formats = json.loads(FORMATS.read_text(encoding="utf-8"))["items"]
    result = blank.run(
        """
        const folder = await load('folder.js');
        const planUpload = (entries) => folder.planUpload(entries, args[0]);
        const file = (path, body) => ({path, file: new File([body], path)});
        const json = (names) => JSON.stringify({frames: names.map((file_path) => ({file_path}))});
        const good = await planUpload([
          file('my lego/transforms_train.json', json(['./train/r_0', 'train/r_1'])),
          file('my lego/transforms_test.json', json(['test/r_0.jpg'])),
          file('my lego/train/r_0.png', 'abc'), file('my lego/test/r_0.jpg', 'de'),
          file('my lego/test/r_0_depth.png', 'xxxxxx')
        ]);
        const multi = await planUpload([
          file(
              'm/metadata.json',
              JSON.stringify({train: {file_path: ['images_train/000_d0.png']}})),
          file('m/images_train/000_d0.png', 'a')
        ]);
        const none = await planUpload([file('x/a.png', '')]);
        const broken = await planUpload([file('x/transforms_train.json', '{')]);
        const many = await planUpload([
          file('a/transforms_train.json', json([])), file('b/transforms_train.json', json([]))
        ]);
        const bare = await planUpload([
          ...[1, 2, 3].map((n) => file(`trip/images/IMG_${n}.HEIC`, 'abc')),
          file('trip/images/.thumb.jpg', 'x'), file('trip/notes.txt', 'x')
        ]);
        const paths = async (...entries) => (await planUpload(entries)).entries.map((e) => e.path);
        const awkward = [
          await paths(file('d/transforms.json', `\ufeff${json(['images/a.png', './images/b'])}`),
                      file('d/images/a.PNG', 'x'), file('d/images/b.JPG', 'x'),
                      file('d/images/dynamic_mask_a.png', 'x'), file('d/masks/sub/b.png', 'x')),
          await paths(file('d/transforms.json',
                           '{"k1": NaN, "frames": [{"file_path": "images/NaN.png", "m": -Infinity}]}'),
                      file('d/images_4/NaN.png', 'x')),
          await paths(...['cameras.bin', 'images.bin', 'points3D.bin'].map((name) => file(`d/sparse/0/${name}`, 'x')),
                      ...['images', 'images_2', 'images_4'].flatMap((folder) =>
                          ['a.jpg', 'b.jpg'].map((name) => file(`d/${folder}/${name}`, 'x'))),
                      file('d/images_4/c.jpg', 'x'))
        ];
        const film = await planUpload([file('walk/a.MOV', 'abcd'), file('walk/a.txt', 'x')]);
        const alone = await planUpload([file('round the cup.mp4', 'abcd')]);
        return {
          bare: {...bare, entries: bare.entries.map((e) => e.path)},
          film: {...film, entries: film.entries.map((e) => e.path)}, alone: alone.name,
          good: {...good, entries: good.entries.map((e) => e.path)},
          awkward,
          multi: multi.layout,
          none: none.problem,
          broken: broken.problem,
          many: many.problem
        };""",
        formats,
    )
    assert [sorted(paths) for paths in result["awkward"]] == [
        ["images/a.PNG", "images/b.JPG", "images/dynamic_mask_a.png", "masks/sub/b.png", "transforms.json"],
        ["images_4/NaN.png", "transforms.json"],
        ["images/a.jpg", "images/b.jpg", "images_4/a.jpg", "images_4/b.jpg", "images_4/c.jpg",
         "sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"]]
    good = result["good"]
    assert good["name"] == "my-lego" and good["views"] == {"train": 2, "test": 1}
    assert sorted(good["entries"]) == [
        "test/r_0.jpg",
        "train/r_0.png",
        "transforms_test.json",
        "transforms_train.json",
    ]
    assert good["missing"] == ["train/r_1.png"] and good["left"] == 1
    bare, film = result["bare"], result["film"]
    assert bare["poses"] == film["poses"] == "find" and not bare["problem"] and "poses" not in good
    assert bare["name"] == "trip" and bare["views"] == {"photographs": 3} and bare["left"] == 2
    assert len(bare["entries"]) == 3 and film["entries"] == ["walk/a.MOV"] and film["bytes"] == 4
    assert film["name"] == "walk" and result["alone"] == "round-the-cup"
    assert result["multi"] == "multi-scale Blender"
    assert (
        "transforms_train.json" in result["none"]
        and "transforms_train.json" in result["broken"]
        and "Several" in result["many"]
    )


def test_coarse_pictures_keep_the_shape_and_an_effort(blank):
    result = blank.run(
        """
        const {sizeFor, coarseOf, nextEffort} = await load('viewer.js');
        const full = {width: 600, height: 400};
        return {
          small: sizeFor({width: 900, height: 600}, 10000),
          all: sizeFor({width: 30, height: 20}, 1e9),
          coarse: [9000, 50000, 240000, 300000, 400000, 1e7].map((effort) => coarseOf(full, effort)),
          large: coarseOf({width: 1280, height: 960}, 1e7),
          slow: nextEffort(40000, 900),
          quick: nextEffort(40000, 1),
          floor: nextEffort(4000, 1e5),
          steady: nextEffort(40000, 26, 16),
          far: nextEffort(40000, 60, 5),
          farther: nextEffort(40000, 150, 30),
          farthest: nextEffort(40000, 3060, 60)
        };"""
    )
    assert result["small"]["width"] / result["small"]["height"] == pytest.approx(1.5, rel=0.05)
    assert 7000 < result["small"]["width"] * result["small"]["height"] < 13000
    assert result["all"] == {"width": 30, "height": 20}
    pixels = [picture["width"] * picture["height"] for picture in result["coarse"]]
    assert pixels[0] < pixels[1] < pixels[2] == pixels[3] == pixels[5] == 240000
    tolerances = [picture["tolerance"] for picture in result["coarse"]]
    assert tolerances[:3] == [0.12] * 3
    assert tolerances[2] > tolerances[3] > tolerances[4] > tolerances[5] == 0.03
    assert result["large"] == {"width": 640, "height": 480, "tolerance": 0.03}
    assert 20000 < result["slow"] < 40000 < result["quick"] == 56000
    assert result["floor"] == 60 * 60 and result["steady"] == pytest.approx(40000)
    assert result["far"] > 50000  # a long way is made no shorter by a worse picture
    assert result["farther"] == result["farthest"] == pytest.approx(40000)


VIEWER = """
        const {createViewer} = await load('viewer.js');
        const canvas = Object.assign(document.createElement('canvas'), {width: 40, height: 30});
        const blob = await new Promise((yes) => canvas.toBlob(yes));
        // A clock of the test's own: what is due is done at its time, however long that takes.
        const real = [setTimeout, clearTimeout, performance.now];
        const timers = new Map();
        let [clock, serial] = [1000, 0];
        window.setTimeout = (call, ms = 0) => (timers.set(++serial, [clock + ms, call]), serial);
        window.clearTimeout = (id) => timers.delete(id);
        performance.now = () => clock;
        const settle = () => new Promise((yes) => real[0].call(window, yes));
        const pause = async (ms) => {
          const end = clock + ms;
          for (await settle();; await settle()) {
            const next = [...timers].filter(([, [at]]) => at <= end).sort(([, a], [, b]) => a[0] - b[0])[0];
            if (!next) break;
            timers.delete(next[0]);
            clock = next[1][0];
            next[1][1]();
          }
          clock = end;
        };
        const asked = [];
        let wayMs = 400;
        const host = {
          camera: (width, height) => ({width, height, pose: asked.length}),
          fullSize: () => ({width: 40, height: 30}), output: () => 'rgb', budgetMs: () => null,
          send: () => new Promise((yes) => asked.push((renderMs) => yes({blob, facts: {
              totalMs: wayMs + (renderMs || 100), queueMs: 0, renderMs, encodeMs: 0, step: 9}}))),
          live: () => false, onPicture: () => {}, onTrouble: () => {}};
        const stop = new AbortController();
        const viewer = createViewer(canvas, host, stop.signal);
        const done = (counts) => {
          stop.abort();
          [window.setTimeout, window.clearTimeout, performance.now] = real;
          return counts;
        };
"""


def test_the_next_coarse_picture_is_asked_for_when_the_daemon_should_be_done(blank):
    """Of one that is far: not when the answer is there, which its way delays; and never more than two
    wait for theirs."""
    counts = blank.run(VIEWER + """
        const moved = async (ms) => { viewer.changed(); await pause(ms); return asked.length; };
        const counts = [await moved(100), await moved(100)];
        asked[0](300);
        await pause(20);
        counts.push(asked.length, await moved(0), await moved(500), await moved(500));
        asked.slice(1).forEach((answer) => answer(NaN));  // not told: one after the other again
        await pause(50);
        counts.push(await moved(100) - await moved(100));
        return done(counts);"""
    )
    # one until it is answered, then the camera of meanwhile; a third 300 ms after that, no fourth
    assert counts == [1, 1, 2, 2, 3, 3, 0]


def test_of_a_daemon_that_is_near_the_next_coarse_picture_is_asked_for_once_one_is_drawn(blank):
    """Which has often the cores that the browser draws with; and then at once, not after a timer's 4 ms."""
    counts = blank.run(VIEWER + """
        wayMs = 5;
        const bitmap = window.createImageBitmap;
        let decoded = () => {};
        window.createImageBitmap = async (...what) => {
          await new Promise((yes) => { decoded = yes; });
          return bitmap(...what);
        };
        const moved = async (ms) => { viewer.changed(); await pause(ms); return asked.length; };
        const counts = [await moved(100)];
        asked[0](10);
        counts.push(await moved(100));  // it is answered, and not drawn
        const drawn = new Promise((yes) => { host.onPicture = yes; });
        decoded();
        await drawn;
        await settle();
        counts.push(asked.length, await moved(30), await moved(30));
        return done(counts);"""
    )
    assert counts == [1, 1, 2, 2, 2]


def test_a_camera_that_rests_for_50_ms_gets_a_finer_picture(blank):
    """Not before, as the next movement would give that up; and counted from the last movement."""
    counts = blank.run(VIEWER + """
        wayMs = 5;
        const counts = [];
        const count = async (ms) => { await pause(ms); counts.push(asked.length); };
        const coarse = async () => {
          const drawn = new Promise((yes) => { host.onPicture = yes; });
          asked.at(-1)(10);
          await drawn;
          await count(0);
        };
        viewer.changed();
        await pause(5);
        await coarse();
        await count(40);  // 45 ms after it moved
        viewer.changed();  // it moves on: another coarse one
        await pause(5);
        await coarse();
        await count(44);  // 49 ms
        await count(1);
        return done(counts);"""
    )
    assert counts == [1, 1, 2, 2, 3]


def test_a_coarse_picture_waits_for_a_camera_that_is_about_to_come(blank):
    """Of one that is nearer than the last; and for no longer, if none comes."""
    counts = blank.run(VIEWER + """
        const counts = [];
        const count = async (ms) => { await pause(ms); counts.push(asked.length); };
        const moved = async (ms) => { viewer.changed(); await count(ms); };
        for (let i = 0; i < 8; i++) { viewer.changed(); await pause(16); }
        await moved(10);
        asked[0](10);
        await count(6);
        await moved(16);  // it comes after 16 ms, and is sent
        asked[1](25);
        await moved(16);
        await moved(10);  // the daemon should be done 9 ms after this one, 7 before the next
        await count(8);   // which does not come
        return done(counts);"""
    )
    assert counts == [1, 1, 2, 3, 3, 4]


def test_a_camera_that_moves_does_not_wait_for_a_refinement_that_is_given_up(blank):
    """Its request is given up at once; when that is over does not matter."""
    counts = blank.run(VIEWER + """
        viewer.changed();
        await pause(50);
        const drawn = new Promise((yes) => { host.onPicture = yes; });
        asked[0](10);
        await drawn;
        await pause(1000);  // the camera stands still: a refinement is on its way, and not answered
        const counts = [asked.length];
        viewer.changed();
        counts.push(asked.length);
        return done(counts);"""
    )
    assert counts == [2, 3]
