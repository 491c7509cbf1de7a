"""An EXR of scan lines, uncompressed or ZIP, as numpy arrays by channel, after OpenEXR's file layout."""

import struct
import zlib

import numpy as np


def text_at(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def attributes(data):
    found, at = {}, 8
    while data[at]:
        name, at = text_at(data, at)
        kind, at = text_at(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        found[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    return found, at + 1


def channels_of(block):
    found, at = [], 0
    while block[at]:
        name, at = text_at(block, at)
        (kind,) = struct.unpack_from("<i", block, at)
        found.append((name, {1: np.dtype("<f2"), 2: np.dtype("<f4")}[kind]))
        at += 16
    return found


def unzipped(block, size):
    if len(block) == size:
        return block  # what did not shrink is stored as it is
    bytes_ = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
    bytes_[1:] -= 128
    bytes_ = (np.cumsum(bytes_) % 256).astype(np.uint8)
    whole = np.empty(size, np.uint8)
    half = (size + 1) // 2
    whole[0::2], whole[1::2] = bytes_[:half], bytes_[half:]
    return whole.tobytes()


def read(data):
    """{channel: array of height x width}, {attribute: bytes}"""
    assert data[:4] == b"\x76\x2f\x31\x01"
    about, at = attributes(data)
    left, top, right, bottom = struct.unpack("<4i", about["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    channels = channels_of(about["channels"])
    lines = {0: 1, 2: 1, 3: 16}[about["compression"][0]]
    planes = {name: np.empty((height, width), np.float32) for name, _ in channels}
    for chunk in range(-(-height // lines)):
        (place,) = struct.unpack_from("<Q", data, at + 8 * chunk)
        y, size = struct.unpack_from("<ii", data, place)
        rows = range(y - top, min(y - top + lines, height))
        raw = unzipped(data[place + 8:place + 8 + size],
                       len(rows) * width * sum(kind.itemsize for _, kind in channels))
        line_at = 0
        for row in rows:
            for name, kind in channels:
                planes[name][row] = np.frombuffer(raw, kind, width, line_at)
                line_at += width * kind.itemsize
    return planes, about
