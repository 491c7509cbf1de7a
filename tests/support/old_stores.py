"""old_stores.py BUILD NAME: the data folder of a build's daemon, with one of everything, as
tests/api/stores/NAME.tar.xz. What a release writes is kept there, so that the next ones are tested
on it."""

import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.checked import Daemon  # noqa: E402
from support.photographs import write_dataset  # noqa: E402

PATH = {"axes": "opengl", "fps": 2, "interpolation": "linear", "loop": False, "width": 8, "height": 8,
        "keys": [{"time": t, "fov_y_deg": 40, "world_from_camera":
                  [[1, 0, 0, t], [0, 1, 0, 0], [0, 0, 1, 4]]} for t in (0, 1)]}


class OldDaemon(Daemon):
    """Of another version: its answers are not those of this one's document, nor are its options."""

    def request(self, *arguments, **options):
        return super().request(*arguments, **{**options, "check": False})


def fill(daemon, photographs):
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    daemon.train("ready")
    assert daemon.wait(daemon.submit(type="path", scene="ready", camera_path=PATH))["state"] \
        == "succeeded"
    job = daemon.submit(type="eval", scene="ready", options={"split": "test"})
    assert daemon.wait(job)["state"] == "succeeded"
    assert daemon.post("/v1/camera-paths", {"name": "kept", "path": PATH}).status == 201


def main(build, name):
    build = Path(build)
    target = Path(__file__).resolve().parents[1] / "api" / "stores" / f"{name}.tar.xz"
    target.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        photographs = write_dataset(Path(folder) / "photographs", size=8, train=3, val=1, test=2)
        daemon = OldDaemon(build / "server/ripnerfd", build / "tests/support/ripnerf-runner-fake",
                           Path(folder) / "data", **{"curve-after": []})
        with daemon:
            fill(daemon, photographs)
        subprocess.run(["tar", "-C", folder, "--sort=name", "--mtime=@0", "--owner=0", "--group=0",
                        "-cJf", target, "data"], check=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
