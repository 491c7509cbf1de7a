"""Pictures of a banded ball on a striped floor, and PNG without a library."""

import math
import struct
import zlib

import numpy as np


def png(pixels):
    """8-bit RGB or 16-bit grey (height, width[, 3]) as PNG bytes."""
    height, width = pixels.shape[:2]
    wide = pixels.dtype == np.uint16
    raw = pixels.astype(">u2" if wide else "u1").reshape(height, -1)
    body = b"".join(b"\0" + row.tobytes() for row in raw)

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 16 if wide else 8, 0 if wide else 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(body, 1))
        + chunk(b"IEND", b"")
    )


def draw(camera, output="rgb", sharp=1.0):
    """A banded unit ball and a striped floor as the camera sees them."""
    width, height = camera["width"], camera["height"]
    pose = np.array(camera["world_from_camera"], float)[:3]
    if camera["axes"] == "opengl":
        pose[:, 1:3] *= -1
    focal = camera.get("fy") or 0.5 * height / math.tan(math.radians(camera["fov_y_deg"]) / 2)
    x, y = np.meshgrid(
        (np.arange(width) + 0.5 - width / 2) / focal, (np.arange(height) + 0.5 - height / 2) / focal
    )
    rays = x[..., None] * pose[:, 0] + y[..., None] * pose[:, 1] + pose[:, 2]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    eye = pose[:, 3]
    colour = np.ones((height, width, 3))
    depth = np.zeros((height, width))
    with np.errstate(all="ignore"):
        floor = (-0.8 - eye[2]) / rays[..., 2]
        ground = eye + floor[..., None] * rays
        on = (floor > 0) & (np.hypot(ground[..., 0], ground[..., 1]) < 1.4)
        stripes = 0.5 + 0.5 * np.sign(np.sin(8 * ground[..., 0]) * np.sin(8 * ground[..., 1]))
        colour[on] = (0.55 + 0.3 * stripes[on])[:, None] * np.array([0.75, 0.8, 0.9])
        depth[on] = floor[on]
        b = rays @ eye
        root = b * b - (eye @ eye - 0.7)
        near = -b - np.sqrt(root)
        hit = (root > 0) & (near > 0)
        point = eye + near[..., None] * rays
        band = 0.5 + 0.5 * np.tanh(
            6 * np.sin(7 * point[..., 2] + 2 * np.arctan2(point[..., 1], point[..., 0]))
        )
        light = np.clip(point @ np.array([0.4, -0.5, 0.76]), 0, 1)[..., None] * 0.7 + 0.35
        skin = band[..., None] * np.array([0.95, 0.6, 0.2]) + (1 - band[..., None]) * np.array(
            [0.16, 0.42, 0.7]
        )
        colour[hit] = (skin * light)[hit]
        depth[hit] = near[hit]
    if output == "depth":
        return png((depth * 1000).astype(np.uint16))
    if output == "alpha":
        return png(np.repeat(((depth > 0) * 255).astype(np.uint8)[..., None], 3, axis=2))
    colour = sharp * colour + (1 - sharp) * np.random.default_rng(1).random((height, width, 1))
    return png((np.clip(colour, 0, 1) * 255).astype(np.uint8))


def ring(count, elevation=0.5):
    """Poses around the ball, OpenGL axes."""
    poses = []
    for i in range(count):
        a = 2 * math.pi * i / count
        out = np.array(
            [
                math.cos(a) * math.cos(elevation),
                math.sin(a) * math.cos(elevation),
                math.sin(elevation),
            ]
        )
        right = np.cross([0, 0, 1], out)
        right /= np.linalg.norm(right)
        poses.append(np.column_stack([right, np.cross(out, right), out, 3.6 * out]).tolist())
    return poses
