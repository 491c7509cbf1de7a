"""One small capture, four photographs around the origin, written in each layout that is read.

A test changes the capture, or what was written of it, and asks what a reader says. Poses are
camera to world in OpenGL axes, as photographs.pose has them.
"""

import json
import math
import struct
from dataclasses import dataclass, field

from PIL import Image

from support.photographs import pose

COUNT, WIDTH, HEIGHT, FOCAL = 4, 40, 30, 50.0
PINHOLE, SIMPLE_RADIAL = (1, "PINHOLE"), (2, "SIMPLE_RADIAL")  # COLMAP's number and name


@dataclass
class Photograph:
    name: str  # by which documents know it
    pose: list
    size: tuple = (WIDTH, HEIGHT)
    mask: tuple = None  # its size
    camera: int = 1
    quaternion: tuple = None  # instead of the pose's rotation
    extra: dict = field(default_factory=dict)  # members of its frame


@dataclass
class Capture:
    photographs: list
    cameras: dict
    points: dict  # id: position
    sightings: dict  # number of a photograph: ids of the points that it sees
    extra: dict = field(default_factory=dict)  # members of a document


def make():
    photographs = [Photograph(f"images/p{i}.png", pose(0.4 + 1.5 * i), camera=2 if i == 1 else 1)
                   for i in range(COUNT)]
    lens = (PINHOLE, WIDTH, HEIGHT, [FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2])
    return Capture(photographs, {1: lens, 2: lens}, {5: (0.1, 0.2, 0.3), 9: (0.0, -0.1, 0.2)},
                   {i: [5, 9] for i in range(COUNT)})


def put_elsewhere(capture):
    """The scene turned about an axis askew, and away from the origin by a thousand times its size."""
    turn, shift = ((0.36, 0.48, -0.8), (-0.8, 0.6, 0.0), (0.48, 0.64, 0.6)), (4000.0, -9000.0, 250.0)
    for one in capture.photographs:
        one.pose = [[sum(a * row[column] for a, row in zip(axis, one.pose)) + (column == 3) * by
                     for column in range(4)] for axis, by in zip(turn, shift)] + [[0, 0, 0, 1]]
    capture.points = {point: tuple(sum(a * x for a, x in zip(axis, at)) + by
                                   for axis, by in zip(turn, shift))
                      for point, at in capture.points.items()}


def write_pictures(capture, folder, where="{}"):
    """`where`: the file of a photograph of this name; the photograph's own name by default."""
    for number, photograph in enumerate(capture.photographs):
        path = folder / where.format(photograph.name.rsplit("/", 1)[-1])
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.effect_noise(photograph.size, 60 + number).convert("RGB").save(path)
        if photograph.mask:
            (folder / "masks").mkdir(exist_ok=True)
            Image.new("L", photograph.mask, 255).save(folder / "masks" / f"{path.name}.png")


def axes(photograph):
    """Rows of the rotation from the world to OpenCV's camera, and its centre."""
    m = photograph.pose
    right, down, forward = ([sign * m[row][column] for row in range(3)]
                            for column, sign in ((0, 1), (1, -1), (2, -1)))
    return (right, down, forward), [m[row][3] for row in range(3)]


def quaternion(r):
    """Of a rotation by its rows; scalar first (Shepperd 1978)."""
    trace = r[0][0] + r[1][1] + r[2][2]
    squares = [trace, r[0][0], r[1][1], r[2][2]]
    most = squares.index(max(squares))
    if most == 0:
        q = [1 + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]]
    else:
        i = most - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [r[k][j] - r[j][k], 0, 0, 0]
        q[1 + i] = 1 + r[i][i] - r[j][j] - r[k][k]
        q[1 + j] = r[i][j] + r[j][i]
        q[1 + k] = r[i][k] + r[k][i]
    length = sum(x * x for x in q) ** 0.5
    return [x / length for x in q]


def colmap_pose(photograph):
    rotation, centre = axes(photograph)
    translation = [-sum(a * b for a, b in zip(row, centre)) for row in rotation]
    return photograph.quaternion or quaternion(rotation), translation


def colmap_name(photograph):
    return photograph.name.removeprefix("images/")


def tracks(capture, point):
    return [(i, ids.index(point)) for i, ids in capture.sightings.items() if point in ids]


def write_colmap_binary(capture, folder):
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    data = struct.pack("<Q", len(capture.cameras))
    for number, ((model_id, _), width, height, parameters) in capture.cameras.items():
        data += struct.pack(f"<IiQQ{len(parameters)}d", number, model_id, width, height, *parameters)
    (model / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(capture.photographs))
    for i, photograph in enumerate(capture.photographs):
        rotation, translation = colmap_pose(photograph)
        data += struct.pack("<I7dI", i + 1, *rotation, *translation, photograph.camera)
        data += colmap_name(photograph).encode() + b"\0"
        seen = capture.sightings.get(i, [])
        data += struct.pack("<Q", len(seen))
        data += b"".join(struct.pack("<ddQ", 10 + k, 12, point) for k, point in enumerate(seen))
    (model / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(capture.points))
    for point, position in capture.points.items():
        track = tracks(capture, point)
        data += struct.pack("<Q3d3BdQ", point, *position, 10, 20, 30, 0.5, len(track))
        data += b"".join(struct.pack("<II", i + 1, k) for i, k in track)
    (model / "points3D.bin").write_bytes(data)


def words(*values):
    return " ".join(repr(v) if isinstance(v, float) else str(v) for v in values) + "\n"


def write_colmap_text(capture, folder):
    """With the comments that COLMAP writes, which have the counts."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    text = f"# Camera list with one line of data per camera:\n# Number of cameras: {len(capture.cameras)}\n"
    for number, ((_, name), width, height, parameters) in capture.cameras.items():
        text += words(number, name, width, height, *parameters)
    (model / "cameras.txt").write_text(text)
    text = ("# Image list with two lines of data per image:\n"
            f"# Number of images: {len(capture.photographs)}, mean observations per image: 2\n")
    for i, photograph in enumerate(capture.photographs):
        rotation, translation = colmap_pose(photograph)
        text += words(i + 1, *map(float, [*rotation, *translation]), photograph.camera,
                      colmap_name(photograph))
        text += "".join(f"{10.5 + k} 12.5 {point} "
                        for k, point in enumerate(capture.sightings.get(i, []))).rstrip() + "\n"
    (model / "images.txt").write_text(text)
    text = ("# 3D point list with one line of data per point:\n"
            f"# Number of points: {len(capture.points)}, mean track length: 4\n")
    for point, position in capture.points.items():
        track = [x for i, k in tracks(capture, point) for x in (i + 1, k)]
        text += words(point, *map(float, position), 10, 20, 30, 0.5, *track)
    (model / "points3D.txt").write_text(text)


def frames(capture):
    return [{"file_path": photograph.name, "transform_matrix": photograph.pose, **photograph.extra}
            for photograph in capture.photographs]


def write_transforms(capture, folder, **members):
    _, width, height, (fx, fy, cx, cy) = capture.cameras[1]
    document = {"w": width, "h": height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, **members,
                **capture.extra, "frames": frames(capture)}
    (folder / "transforms.json").write_text(json.dumps(document))


def write_blender(capture, folder):
    document = {"camera_angle_x": 0.76, "w": capture.cameras[1][1], "h": capture.cameras[1][2],
                **capture.extra, "frames": frames(capture)}
    (folder / "transforms_train.json").write_text(json.dumps(document))


def rotation_vector(rotation):
    w, *vector = quaternion(rotation)
    length = math.hypot(*vector)
    return [2 * math.atan2(length, w) * x / max(length, 1e-300) for x in vector]


def write_opensfm(capture, folder):
    cameras, shots = {}, {}
    for number, ((_, name), width, height, (fx, fy, cx, cy)) in capture.cameras.items():
        size = max(width, height)
        cameras[str(number)] = {
            "projection_type": "brown" if name == "PINHOLE" else name, "width": width, "height": height,
            "focal_x": fx / size, "focal_y": fy / size, "c_x": (cx - width / 2) / size,
            "c_y": (cy - height / 2) / size, "k1": 0, "k2": 0, "p1": 0, "p2": 0, "k3": 0}
    for photograph in capture.photographs:
        rotation, centre = axes(photograph)
        shots[colmap_name(photograph)] = {
            "camera": str(photograph.camera), "rotation": rotation_vector(rotation),
            "translation": [-sum(a * b for a, b in zip(row, centre)) for row in rotation]}
    points = {str(point): {"coordinates": at, "color": [10, 20, 30]} for point, at in capture.points.items()}
    (folder / "reconstruction.json").write_text(
        json.dumps([{"cameras": cameras, "shots": shots, "points": points}]))


def write_bundler(capture, folder):
    """Rows of the rotation, and the translation, to axes right, up and backwards."""
    text = f"# Bundle file v0.3\n{len(capture.photographs)} {len(capture.points)}\n"
    for photograph in capture.photographs:
        rotation, centre = axes(photograph)
        focal = capture.cameras[photograph.camera][3][0]
        rows = [[sign * x for x in row] for sign, row in zip((1, -1, -1), rotation)]
        text += words(float(focal), 0, 0) + "".join(words(*map(float, row)) for row in rows)
        text += words(*(-sum(a * b for a, b in zip(row, centre)) for row in rows))
    for point, position in capture.points.items():
        track = [x for i, k in tracks(capture, point) for x in (i, k, 1.5 + k, -2.5)]
        text += words(*map(float, position)) + words(10, 20, 30) + words(len(track) // 4, *track)
    (folder / "bundle.out").write_text(text)
    (folder / "list.txt").write_text("".join(f"{one.name} 0 {FOCAL}\n" for one in capture.photographs))


def write_llff(capture, folder, shape=None):
    rows = b""
    for photograph in sorted(capture.photographs, key=lambda one: one.name):
        (right, down, forward), centre = axes(photograph)
        _, width, height, parameters = capture.cameras[photograph.camera]
        for i, size in enumerate((height, width, parameters[0])):
            rows += struct.pack("<5d", down[i], right[i], -forward[i], centre[i], size)
        rows += struct.pack("<2d", 1.5, 9.0)
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape or (len(capture.photographs), 17)}, }}"
    header = header.ljust(117) + "\n"
    (folder / "poses_bounds.npy").write_bytes(
        b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + rows)


# How each layout is written, and the documents that it consists of beside pictures.
MODEL = ("cameras", "images", "points3D")
LAYOUTS = {
    "COLMAP, binary": (write_colmap_binary, [f"sparse/0/{part}.bin" for part in MODEL]),
    "COLMAP, text": (write_colmap_text, [f"sparse/0/{part}.txt" for part in MODEL]),
    "nerfstudio": (write_transforms, ["transforms.json"]),
    "instant-ngp": (lambda capture, folder: write_transforms(capture, folder, aabb_scale=4),
                    ["transforms.json"]),
    "OpenSfM": (write_opensfm, ["reconstruction.json"]),
    "Bundler": (write_bundler, ["bundle.out", "list.txt"]),
    "LLFF": (write_llff, ["poses_bounds.npy"]),
    "NeRF-synthetic": (write_blender, ["transforms_train.json"]),
    "photographs": (lambda capture, folder: None, []),
}


def write(layout, capture, folder):
    folder.mkdir(parents=True, exist_ok=True)
    LAYOUTS[layout][0](capture, folder)
    write_pictures(capture, folder, "images/{}")
    return folder
