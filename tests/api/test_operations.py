"""Runs last: the suites against the daemon must have called every documented operation.

Where several processes ran them, this alone comes after them all, with the file RIPNERF_EXERCISED, in
which each has noted what it called.
"""

import os
from pathlib import Path

import pytest

from support import checked

SUITES = ("test_daemon_resources.py", "test_daemon_lifecycle.py", "test_daemon_misbehave.py")


def test_every_operation_was_exercised(request):
    if "RIPNERF_EXERCISED" in os.environ:
        exercised = set(Path(os.environ["RIPNERF_EXERCISED"]).read_text(encoding="utf-8").split())
    else:
        exercised = checked.exercised
        collected = {item.path.name for item in request.session.items}
        if not collected.issuperset(SUITES) or request.config.option.keyword:
            pytest.skip("only meaningful when the whole suite runs")
    documented = {operation["operationId"] for _, _, operation in checked.operations()}
    assert documented - exercised == set()
