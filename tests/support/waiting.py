"""Waiting for what must come to pass: for so long that no load of the machine explains its absence."""

import time

PATIENCE_S = 240


def wait_for(condition, seconds=PATIENCE_S, said=lambda: "it did not come to pass"):
    """The first true value of condition()."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, said()
        time.sleep(0.03)
    return found
