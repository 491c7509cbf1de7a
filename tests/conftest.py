"""What every pytest suite shares: where the built programs are.

RIPNERF_BUILD names the build folder (default: build/ beside tests/).
"""

import os
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(SOURCE / "tests"))
# What is tested is the CPU, on a machine with a GPU too, but where a test names another module.
os.environ["RIPNERF_CUDA_MODULE"] = "none"


@pytest.fixture(scope="session")
def build():
    folder = Path(os.environ.get("RIPNERF_BUILD", SOURCE / "build"))
    if not (folder / "build.ninja").is_file():
        pytest.fail(f"{folder} is no build folder; set RIPNERF_BUILD")
    return folder
