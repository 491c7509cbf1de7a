"""Small datasets in the NeRF-synthetic layout, made up."""

import json
import math

from PIL import Image


def pose(angle, distance=4.0):
    """World-from-camera in OpenGL axes, on a circle, looking at the origin; z is up."""
    c, s = math.cos(angle), math.sin(angle)
    return [[-s, 0, c, distance * c], [c, 0, s, distance * s], [0, 1, 0, 0], [0, 0, 0, 1]]


def write_dataset(folder, size=16, train=6, val=8, test=4):
    folder.mkdir(parents=True, exist_ok=True)
    for green, (split, count) in enumerate((("train", train), ("val", val), ("test", test)), 128):
        frames = []
        (folder / split).mkdir(exist_ok=True)
        for i in range(count):
            image = Image.new("RGBA", (size, size))  # what it shows lies in the layout's sphere
            rim = size // 8
            image.paste((40 * i % 256, green, 200, 255), (rim, rim, size - rim, size - rim))
            image.save(folder / split / f"r_{i}.png")
            frames.append({"file_path": f"./{split}/r_{i}",
                           "transform_matrix": pose(2 * math.pi * i / count)})
        (folder / f"transforms_{split}.json").write_text(
            json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    return folder


def write_blank(path, width, height):
    """A picture that is transparent all over."""
    Image.new("RGBA", (width, height)).save(path)


def write_blank_dataset(folder, views=3):
    """The same layout of blank photographs, with a file that no JSON names."""
    for split in ("train", "val", "test"):
        (folder / split).mkdir(parents=True)
        for i in range(views):
            write_blank(folder / split / f"r_{i}.png", 16, 12)
        frames = [{"file_path": f"./{split}/r_{i}", "transform_matrix": pose(0)} for i in range(views)]
        (folder / f"transforms_{split}.json").write_text(
            json.dumps({"camera_angle_x": 0.69, "frames": frames}))
    write_blank(folder / "test" / "r_0_depth_0001.png", 16, 12)
    return folder
