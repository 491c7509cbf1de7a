"""Films that go wrong: an answer in words, in bounded time and memory, and nothing stays of them."""

import os
from pathlib import Path

import pytest

from support.checked import tar_of

SUPPORT = Path(__file__).parents[1] / "support"
# How the film goes wrong, by fake_ffmpeg.py; the answer's status; words of it.
FILMS = {
    "tall": (413, ["walk.mp4", "480 x 8000", "crop"]),
    "flat": (413, ["walk.mp4", "480 x 0"]),
    "many": (413, ["walk.mp4", "1000000 frames", "cut it"]),
    "endless": (413, ["--import-time"]),
    "silent": (413, ["--import-time"]),
    "noise": (422, ["walk.mp4", "no pictures", "convert it"]),
    "other": (422, ["walk.mp4", "Invalid argument", "convert it to MP4"]),
    "none": (422, ["walk.mp4", "no frame"]),
    "gone": (422, ["walk.mp4", "none of its frames"]),
    "crash": (500, ["ffmpeg", "signal 9"]),
}


def send(daemon, content=b"film"):
    reply = daemon.request("POST", "/v1/datasets?name=walk&poses=find", tar_of({"walk.mp4": content}),
                           {"Content-Type": "application/x-tar"})
    assert reply.status == 202, reply.body
    return daemon.wait(reply.json["id"])


def make(make_daemon, mood, **options):
    return make_daemon({"RIPNERF_COLMAP": str(SUPPORT / "fake_colmap.py"), "RIPNERF_FAKE_FFMPEG": mood,
                        "RIPNERF_FFMPEG": str(SUPPORT / "fake_ffmpeg.py")}, **options)


@pytest.mark.parametrize("mood", FILMS)
def test_a_film_that_goes_wrong(make_daemon, mood):
    status, words = FILMS[mood]
    slow = mood in ("endless", "silent")
    daemon = make(make_daemon, mood, memory_limit="512M", **({"import_time": 2} if slow else {}))
    job = send(daemon)
    assert job["state"] == "failed" and job["attempt"] == 1, job
    assert job["problem"]["status"] == status, job["problem"]
    assert all(word in job["problem"]["detail"] for word in words), job
    assert daemon.get("/healthz").status == 200 and daemon.get("/v1/datasets/walk").status == 404
    daemon.eventually(lambda: not os.listdir(Path(daemon.data) / "spool"))
    assert not os.listdir(Path(daemon.data) / "datasets")


@pytest.mark.parametrize("mood", ["absurd", "cut"])
def test_a_film_that_says_what_is_not_so(make_daemon, mood):
    """Of its length; of a frame more, which ends too early. What it shows is taken."""
    daemon = make(make_daemon, mood)
    job = send(daemon)
    assert job["state"] == "succeeded", job
    assert daemon.get("/v1/datasets/walk").json["views"]["train"] == 4
