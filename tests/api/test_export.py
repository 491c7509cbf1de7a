"""Point clouds and meshes out of a scene: where they lie, what they look like, what is cut away."""

import json
import math
import struct

import pytest
from PIL import Image

from support.client import FAILED, NOT_FOUND, USAGE


def read_points(path):
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    count = int(lines[2].removeprefix("element vertex "))
    assert len(body) == 15 * count
    return [struct.unpack_from("<3f3B", body, 15 * i) for i in range(count)]


def test_points_lie_on_the_sphere(ball, tmp_path):
    out = tmp_path / "ball.ply"
    said = ball.json("export", "ball", "--as", "points", "--views", 6, "-o", out)
    points = read_points(out)
    assert said == {"file": str(out), "points": len(points), "views": 6}
    assert len(points) > 6 * 48 * 48 / 50
    # above its stand: a shell of radius 0.72 around (0, 0, 0.2), with holes and a ball within
    radii = sorted(math.dist(point[:3], (0, 0, 0.2)) for point in points if point[2] > -0.2)
    assert abs(radii[len(radii) // 2] - 0.69) < 0.06
    assert radii[-len(radii) // 20] < 0.8
    assert len({point[3:] for point in points}) > 50


def test_a_crop_and_fewer_pixels(ball, tmp_path):
    out = tmp_path / "half.ply"
    ball.run("export", "ball", "--views", 6, "--max-size", 24, "--crop=-9,-9,0,9,9,9", "-o", out)
    points = read_points(out)
    assert 0 < len(points) < 6 * 24 * 24 and all(point[2] >= 0 for point in points)


def test_a_crop_of_a_picture(ball, tmp_path):
    # from the side, at the height of the ball's middle: what lies above it fills the upper half
    level = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0.2]]
    camera = {"world_from_camera": level, "axes": "opencv", "width": 64, "height": 64,
              "fov_y_deg": 30}
    (tmp_path / "camera.json").write_text(json.dumps({"camera": camera}))

    def alpha(*crop):
        ball.run("render", "ball", "--camera", tmp_path / "camera.json", "--output", "alpha",
                   *crop, "-o", tmp_path / "a.png")
        return Image.open(tmp_path / "a.png").convert("L")

    whole, upper = alpha(), alpha("--crop=-9,-9,0.2,9,9,9")
    assert alpha("--crop=-9,-9,-9,9,9,9").tobytes() == whole.tobytes()
    assert max(alpha("--crop=8,8,8,9,9,9").tobytes()) == 0
    # half a cell is half a pixel here, and a cone is wider than a pixel
    assert max(upper.crop((0, 35, 64, 64)).tobytes()) == 0 < max(whole.crop((0, 35, 64, 64)).tobytes())
    assert upper.crop((0, 0, 64, 24)).tobytes() == whole.crop((0, 0, 64, 24)).tobytes()
    assert max(upper.tobytes()) > 200
    assert alpha().tobytes() == whole.tobytes()  # what a crop left behind: nothing
    said = ball.run("render", "ball", "--view", "test:0", "--crop", "1,1,1,0,0,0", "-o",
                      tmp_path / "b.png", code=USAGE).stderr
    assert "--crop" in said and "X0,Y0,Z0,X1,Y1,Z1" in said


def read_mesh(path):
    header, body = path.read_bytes().split(b"end_header\n", 1)
    counts = [int(line.split()[2]) for line in header.decode().splitlines() if "element" in line]
    vertices = [struct.unpack_from("<3f3B", body, 15 * i) for i in range(counts[0])]
    faces = [struct.unpack_from("<3i", body, 15 * counts[0] + 13 * i + 1) for i in range(counts[1])]
    return vertices, faces


def test_a_mesh_lies_on_the_sphere(ball, tmp_path):
    out = tmp_path / "ball.ply"
    said = ball.json("export", "ball", "--as", "mesh", "--cells", 96, "-o", out)
    vertices, faces = read_mesh(out)
    assert said["vertices"] == len(vertices) and said["triangles"] == len(faces)
    assert said["bytes"] == out.stat().st_size
    # above its stand: a shell of radius 0.72 around (0, 0, 0.2), with holes and a ball within
    outermost = {}
    for vertex in vertices:
        radius = math.dist(vertex[:3], (0, 0, 0.2))
        if vertex[2] > -0.2 and radius > 0:
            way = tuple(round(5 * (x - c) / radius) for x, c in zip(vertex[:3], (0, 0, 0.2)))
            outermost[way] = max(outermost.get(way, 0), radius)
    radii = sorted(outermost.values())
    assert len(radii) > 100 and 0.62 < radii[len(radii) // 2] < 0.76, radii[:: len(radii) // 10]
    colours = {v[3:] for v in vertices}
    assert len(colours) > 100 and sum(sum(c) / 3 for c in colours) / len(colours) > 40
    ball.run("export", "ball", "--as", "mesh", "--cells", 48, "--crop=-9,-9,0,9,9,9", "-o",
               tmp_path / "half.obj")
    lines = (tmp_path / "half.obj").read_text().splitlines()
    heights = [float(line.split()[3]) for line in lines if line.startswith("v ")]
    assert heights and min(heights) >= -1e-6


def test_what_is_there_is_kept_unless_asked(ball, tmp_path):
    for options in (["-o", "kept.ply"], ["--as", "mesh", "-o", "kept.obj"],
                    ["--as", "scene", "-o", "kept.ripscene"]):
        kept = tmp_path / options[-1]
        kept.write_text("mine")
        said = ball.run("export", "nothing", *options[:-1], kept, code=USAGE).stderr
        assert f"{kept}: is there already; --overwrite replaces it" in said
        ball.run("export", "nothing", *options[:-1], kept, "--overwrite", code=NOT_FOUND)
        assert kept.read_text() == "mine"
    ball.run("export", "ball", "--views", 2, "--max-size", 16, "-o", tmp_path / "kept.ply", "--overwrite")
    assert (tmp_path / "kept.ply").read_bytes().startswith(b"ply")
    (tmp_path / "folder.ply").mkdir()
    said = ball.run("export", "ball", "-o", tmp_path / "folder.ply", "--overwrite", code=USAGE)
    assert "is a folder" in said.stderr
    said = ball.run("export", "nothing", "-o", tmp_path / "nowhere" / "a.ply", code=FAILED).stderr
    assert "nowhere/a.ply: cannot create" in said


def test_what_is_refused(ball, tmp_path):
    assert "needs -o FILE.ply" in ball.run("export", "ball", code=USAGE).stderr
    assert "use .ply" in ball.run("export", "ball", "-o", "a.obj", code=USAGE).stderr
    for wrong in (("--as", "mesh", "-o", "a.stl"), ("--as", "mesh", "--views", 3, "-o", "a.ply"),
                  ("--cells", 9, "-o", "a.ply")):
        ball.run("export", "ball", *wrong, code=USAGE)
    for crop in ("1,2,3", "0,0,0,1,1,0", "a", "0,0,0,1,1,1x"):
        run = ball.run("export", "ball", "-o", "a.ply", f"--crop={crop}", code=USAGE)
        assert "--crop" in run.stderr
    ball.run("export", "nothing", "-o", "a.ply", code=NOT_FOUND)
