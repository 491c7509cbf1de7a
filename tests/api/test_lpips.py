"""LPIPS where the daemon is given weights: told by evaluations, absent otherwise; a file that holds
other things is refused at the start."""

import json
import random
import struct
import subprocess

import pytest

from support.client import Client
from support.daemon import Daemon
from support.waiting import PATIENCE_S

LAYERS = [("net.slice1.0", 3, 64), ("net.slice1.2", 64, 64), ("net.slice2.5", 64, 128),
          ("net.slice2.7", 128, 128), ("net.slice3.10", 128, 256), ("net.slice3.12", 256, 256),
          ("net.slice3.14", 256, 256), ("net.slice4.17", 256, 512), ("net.slice4.19", 512, 512),
          ("net.slice4.21", 512, 512), ("net.slice5.24", 512, 512), ("net.slice5.26", 512, 512),
          ("net.slice5.28", 512, 512)]


def tensors(without=()):
    """Name, shape and spread of each."""
    for name, ins, outs in LAYERS:
        yield f"{name}.weight", [outs, ins, 3, 3], (2 / (9 * ins)) ** 0.5
        yield f"{name}.bias", [outs], 0.1
    for i, count in enumerate((64, 128, 256, 512, 512)):
        if f"lin{i}" not in without:
            yield f"lin{i}.model.1.weight", [1, count, 1, 1], None


def write_weights(path, without=()):
    """Random weights, of which the last layers' are positive as in the published ones."""
    noise = random.Random(3)
    pool = struct.pack("<65536f", *(noise.gauss(0, 1) for _ in range(65536)))
    scaled = {}
    head, body = {}, []
    end = 0
    for name, shape, spread in tensors(without):
        count = 1
        for size in shape:
            count *= size
        if spread not in scaled:
            values = struct.unpack("<65536f", pool)
            scaled[spread] = struct.pack("<65536f", *(0.1 * abs(v) if spread is None else spread * v
                                                      for v in values))
        piece = scaled[spread] * (count // 65536 + 1)
        body.append(piece[:4 * count])
        head[name] = {"dtype": "F32", "shape": shape, "data_offsets": [end, end + 4 * count]}
        end += 4 * count
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(body))


def test_evaluations_tell_it_where_weights_are_named(build, tmp_path):
    weights = tmp_path / "vgg.safetensors"
    write_weights(weights)
    found = {}
    for options in ((), ("--lpips", weights)):
        with Daemon(build, tmp_path / "data", *options) as daemon:
            client = Client(build / "client" / "ripnerf", tmp_path, daemon.url)
            if not options:
                client.run("synth", "sphere", "source", "--size", 32, "--views", 12)
                client.run("import", "source", "--name", "sphere")
                client.run("train", "sphere", "--name", "ball", "--preset", "draft", "--max-steps",
                           20, "--wait")
            found[bool(options)] = client.json("eval", "ball", "--views", 2)
            said = client.run("eval", "ball", "--views", 2).stdout
            assert ("LPIPS (VGG) " in said) == bool(options)
    assert "lpips" not in found[False] and "lpips" not in found[False]["per_view"][0]
    views = [view["lpips"] for view in found[True]["per_view"]]
    assert found[True]["lpips"] == pytest.approx(sum(views) / 2) and 0 < min(views) < 10
    assert found[True]["psnr"] == found[False]["psnr"]


def test_a_file_of_other_things_is_refused(build, tmp_path):
    weights = tmp_path / "other.safetensors"
    for write, words in ((lambda: write_weights(weights, {"lin2"}), "has no tensor lin2.model.1.weight"),
                         (lambda: weights.write_text("weights"), "is no safetensors file"),
                         (weights.unlink, "No such file")):
        write()
        said = subprocess.run([build / "server" / "ripnerfd", "--data", tmp_path / "data", "--listen",
                               "127.0.0.1:0", "--lpips", weights], capture_output=True, text=True,
                              timeout=PATIENCE_S, check=False)
        assert said.returncode != 0 and words in said.stderr and str(weights) in said.stderr
