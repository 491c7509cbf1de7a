"""Runs last: the suites against the daemon must have called every documented operation."""

import pytest

from support import checked

SUITES = ("test_daemon_resources.py", "test_daemon_lifecycle.py", "test_daemon_misbehave.py")


def test_every_operation_was_exercised(request):
    collected = {item.path.name for item in request.session.items}
    if not collected.issuperset(SUITES) or request.config.option.keyword:
        pytest.skip("only meaningful when the whole suite runs")
    documented = {operation["operationId"] for _, _, operation in checked.operations()}
    assert documented - checked.exercised == set()
