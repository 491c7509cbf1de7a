import os

import pytest

from support import checked
from support.checked import Daemon
from support.client import Client
from support.clocks import Clocks
from support.daemon import Daemon as RealDaemon
from support.fake_daemon import FakeDaemon
from support.on_slurm import on_slurm, slow_runner, slurm, undisturbed  # noqa: F401, fixtures
from support.photographs import write_dataset


def pytest_collection_modifyitems(items):
    """Whether every operation was exercised is known at the end."""
    items.sort(key=lambda item: item.path.name == "test_operations.py")


def pytest_sessionfinish():
    """Several processes that share the tests note the operations that they called in one file."""
    if "RIPNERF_EXERCISED" in os.environ:
        with open(os.environ["RIPNERF_EXERCISED"], "a", encoding="utf-8") as file:
            file.write("".join(f"{name}\n" for name in sorted(checked.exercised)))


@pytest.fixture(scope="session")
def programs(build):
    found = build / "server" / "ripnerfd", build / "tests" / "support" / "ripnerf-runner-fake"
    for program in found:
        assert program.is_file(), f"{program} was not built"
    return found


@pytest.fixture(scope="session")
def photographs(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("photographs") / "data")


@pytest.fixture(scope="session")
def shared(programs, photographs, tmp_path_factory):
    """A daemon for tests that leave it as they found it, with dataset `data` and scene `ready`."""
    data = tmp_path_factory.mktemp("shared") / "data"
    with Daemon(*programs, data, dataset_root=photographs.parent) as daemon:
        job = daemon.wait(daemon.upload("data", photographs))
        assert job["state"] == "succeeded", job
        daemon.train("ready")
        yield daemon


@pytest.fixture
def make_daemon(programs, tmp_path):
    """make_daemon(environment, **options): a daemon of the test's own, started; stopped later."""
    made = []

    def make(environment=None, **options):
        made.append(Daemon(*programs, tmp_path / f"d{len(made)}", environment, **options))
        return made[-1].start()
    yield make
    for daemon in made:
        daemon.stop()


@pytest.fixture
def own(make_daemon, photographs):
    """A daemon of the test's own with dataset `data`; steps take a while."""
    daemon = make_daemon({"RIPNERF_FAKE_STEP_US": "2000"})
    assert daemon.wait(daemon.upload("data", photographs))["state"] == "succeeded"
    return daemon


@pytest.fixture
def daemon():
    """A stand-in for a daemon, without an engine; modules of other daemons have their own."""
    with FakeDaemon() as fake:
        yield fake


@pytest.fixture
def clock(build, programs, tmp_path):
    if any(name in programs[0].read_bytes() for name in (b"__asan_init", b"__tsan_init")):
        pytest.skip("a sanitizer looks at the clock past what is preloaded")
    return Clocks(tmp_path / "shift", build / "tests/support/ripnerf-wallclock.so")


@pytest.fixture
def client(build, daemon, tmp_path):
    """The client, of that daemon."""
    return Client(build / "client" / "ripnerf", tmp_path, daemon.url)


@pytest.fixture(scope="session")
def ball(build, tmp_path_factory):
    """A client whose daemon has scene `ball`, trained by the real runner on dataset `sphere`."""
    with RealDaemon(build, tmp_path_factory.mktemp("ball") / "daemon") as daemon:
        client = Client(build / "client" / "ripnerf", tmp_path_factory.mktemp("client"), daemon.url)
        client.run("synth", "sphere", "source", "--size", 48, "--views", 16)
        client.run("import", "source", "--name", "sphere")
        client.run("train", "sphere", "--name", "ball", "--preset", "draft", "--max-steps", 400,
                   "--threads", 1, "--wait")
        yield client
