"""HEIC files, box by box, sound or not: of one coded picture of 64 x 64 pixels, which the corpus of the fuzzer has."""

import struct
from pathlib import Path

CODED = Path(__file__).parents[1] / "fuzz" / "corpus" / "photo" / "gps.heic"
SIDE = 64  # of the coded picture, in pixels


def box(kind, *parts):
    content = b"".join(parts)
    return struct.pack(">I4s", 8 + len(content), kind.encode()) + content


def full(kind, version, *parts):
    return box(kind, struct.pack(">I", version << 24), *parts)


def coded():
    """What configures the decoder, a box; and the picture's own bytes."""
    file = CODED.read_bytes()
    at = file.index(b"hvcC") - 4
    data = file.index(b"mdat") + 4
    return file[at:at + struct.unpack_from(">I", file, at)[0]], file[data:data + 33]


def size(width, height):
    return full("ispe", 0, struct.pack(">II", width, height))


def bits(*depths):
    return full("pixi", 0, bytes([len(depths), *depths]))


def alpha():
    return full("auxC", 0, b"urn:mpeg:hevc:2015:auxid:1\0")


def grid(columns, rows, width, height):
    return struct.pack(">BBBBII", 0, 1, rows - 1, columns - 1, width, height)


def tile(item, width=SIDE, height=SIDE, *more):
    """An item that is the coded picture, said to be of a size."""
    configuration, data = coded()
    return item, "hvc1", data, [configuration, size(width, height), bits(8, 8, 8), *more]


def file(items, references, primary=None):
    """Of items (id, type, data, properties) and references (type, from, [to, ...]); the first item is shown."""
    properties, associations = [], []
    for item, _, _, own in items:
        indices = [len(properties) + 1 + i for i in range(len(own))]
        properties += own
        associations.append(struct.pack(">HB", item, len(own)) + bytes(indices))
    data = b"".join(item[2] for item in items)

    def meta(begin):
        places, at = [], begin
        for item, _, own, _ in items:
            places.append(struct.pack(">HHHII", item, 0, 1, at, len(own)))
            at += len(own)
        return full(
            "meta", 0, full("hdlr", 0, bytes(4), b"pict", bytes(13)),
            full("pitm", 0, struct.pack(">H", primary or items[0][0])),
            full("iloc", 0, b"\x44\0", struct.pack(">H", len(items)), *places),
            full("iinf", 0, struct.pack(">H", len(items)), *(
                full("infe", 2, struct.pack(">HH4sB", item[0], 0, item[1].encode(), 0)) for item in items)),
            box("iprp", box("ipco", *properties),
                full("ipma", 0, struct.pack(">I", len(items)), *associations)),
            full("iref", 0, *(box(kind, struct.pack(f">HH{len(to)}H", of, len(to), *to))
                              for kind, of, to in references)))
    head = box("ftyp", b"heic", bytes(4), b"mif1heic")
    begin = len(head) + len(meta(0)) + 8
    return head + meta(begin) + box("mdat", data)


def tiled(columns, rows, width=None, height=None):
    """A sound picture of that many tiles, as phones make them."""
    width, height = width or columns * SIDE, height or rows * SIDE
    count = columns * rows
    picture = (1, "grid", grid(columns, rows, width, height), [size(width, height), bits(8, 8, 8)])
    return file([picture, tile(2)], [("dimg", 1, [2] * count)])
