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


class Bits:
    """Of a unit of HEVC, without its escapes."""

    def __init__(self, unit):
        self.text = "".join(f"{byte:08b}" for byte in unit.replace(b"\0\0\3", b"\0\0"))
        self.at = 0

    def number(self):
        zeros = self.text.index("1", self.at) - self.at
        self.at += 2 * zeros + 1
        return int(self.text[self.at - zeros - 1:self.at], 2) - 1


def number(value):
    return "0" * ((value + 1).bit_length() - 1) + f"{value + 1:b}"


def escaped(unit):
    out = bytearray()
    for byte in unit:
        if byte <= 3 and out[-2:] == b"\0\0":
            out.append(3)
        out.append(byte)
    return bytes(out)


def parameters(width, height):
    """The coded picture's sequence parameter set, which says another size."""
    configuration, _ = coded()
    at = configuration.index(b"\x42\x01")
    unit = configuration[at:at + struct.unpack_from(">H", configuration, at - 2)[0]]
    bits = Bits(unit[2:])
    bits.at = 4 + 3 + 1 + 96  # one layer
    bits.number(), bits.number()
    begin = bits.at
    bits.number(), bits.number()
    text = (bits.text[:begin] + number(width) + number(height) + bits.text[bits.at:]).rstrip("0")
    text += "0" * (-len(text) % 8)
    return unit[:2] + escaped(int(text, 2).to_bytes(len(text) // 8, "big"))


def configured(width, height):
    """What configures the decoder for another size."""
    configuration, _ = coded()
    at = configuration.index(b"\x42\x01") - 2
    end = at + 2 + struct.unpack_from(">H", configuration, at)[0]
    unit = parameters(width, height)
    return box("hvcC", configuration[8:at], struct.pack(">H", len(unit)), unit, configuration[end:])


def av1(width, height):
    """An item of the coded picture of 16 x 16 pixels in AV1, which says another size."""
    file = CODED.with_suffix(".avif").read_bytes()
    begin = file.index(b"mdat") + 4  # two empty bytes, the sequence header with its length, a frame
    sequence, frame = file[begin + 4:begin + 13], file[begin + 13:begin + 25]
    text = "".join(f"{byte:08b}" for byte in sequence)  # 10 bits, and twice 4 bits and 4 of these
    text = (text[:10] + "1" * 8 + f"{width - 1:016b}{height - 1:016b}" + text[26:]).rstrip("0")
    text += "0" * (-len(text) % 8)
    unit = int(text, 2).to_bytes(len(text) // 8, "big")
    data = b"\x12\0\x0a" + bytes([len(unit)]) + unit + frame
    return 1, "av01", data, [box("av1C", b"\x81\0\x0c\0"), size(16, 16), bits(8, 8, 8)]


def size(width, height):
    return full("ispe", 0, struct.pack(">II", width, height))


def bits(*depths):
    return full("pixi", 0, bytes([len(depths), *depths]))


def alpha():
    return full("auxC", 0, b"urn:mpeg:hevc:2015:auxid:1\0")


def grid(columns, rows, width, height):
    return struct.pack(">BBBBII", 0, 1, rows - 1, columns - 1, width, height)


def overlay(width, height):
    """Of one picture, at its corner."""
    return struct.pack(">BB4HIIii", 0, 1, 0, 0, 0, 0, width, height, 0, 0)


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
