"""What synth adds to its photographs."""

import re

import pytest

from support.client import USAGE, Client


@pytest.fixture
def client(build, tmp_path):
    return Client(build / "client" / "ripnerf", tmp_path, "http://127.0.0.1:9")


def test_a_synthetic_capture_has_what_photographs_have(client):
    """Lens and exposures of known size, found again by what validation measures."""
    client.run("synth", "place", "p", "--capture", "--size", "48", "--views", "14", "--lens", "-0.2,0.03",
               "--exposure", "0.5", "--aperture", "0.02", "--shutter", "0.02", "--movers", "2")
    said = client.run("validate", "p").stdout
    assert "0 errors, 0 warnings" in said and "colmap layout" in said
    assert "up is 0,0,1, by the cameras" in said  # which is 1.55e-17,5.29e-18,1
    assert "seen" in said and "mean reprojection error 0.0000 px" in said
    assert 10 < float(re.search(r"exposures of 90 % of the photographs differ by (\S+) %", said)[1]) < 70
    assert 3 < float(re.search(r"the lens moves what is seen by up to (\S+) pixels", said)[1]) < 6
    said = client.run("synth", "place", "q", "--lens", "0.1,", code=USAGE).stderr
    assert "lens" in said and "K1,K2,P1,P2" in said
    said = client.run("synth", "sphere", "q", "--movers", "1", code=USAGE).stderr
    assert "place and window" in said
