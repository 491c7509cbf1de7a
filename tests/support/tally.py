"""Adds up what meson and pytest recorded: tally.py TESTLOG_JSON PYTEST_XML...

Prints `N passed, N failed`, with `, N skipped` where something was skipped. A record that is
missing or unreadable counts as one failure, and so does a run without any passed test. The exit
code is 0 only when nothing failed.
"""

import json
import sys
import xml.etree.ElementTree as ElementTree

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"
MESON_RESULTS = {"OK": PASSED, "EXPECTEDFAIL": PASSED, "SKIP": SKIPPED}


def meson_results(path):
    """One result per test program; timeouts and unexpected passes are failures."""
    with open(path, encoding="utf-8") as lines:
        return [MESON_RESULTS.get(json.loads(line)["result"], FAILED) for line in lines]


def pytest_results(path):
    """One result per test case of a JUnit file."""
    results = []
    for case in ElementTree.parse(path).iter("testcase"):
        tags = {child.tag for child in case}
        if tags & {"failure", "error"}:
            results.append(FAILED)
        else:
            results.append(SKIPPED if "skipped" in tags else PASSED)
    return results


def collect(reader, path):
    try:
        return reader(path)
    except (OSError, ValueError, KeyError, ElementTree.ParseError) as error:
        print(f"tally: {path}: {error}")
        return [FAILED]


def main(testlog, *junits):
    results = collect(meson_results, testlog)
    for junit in junits:
        results += collect(pytest_results, junit)
    passed, failed, skipped = (results.count(kind) for kind in (PASSED, FAILED, SKIPPED))
    if passed == 0 and failed == 0:
        failed = 1
    print(f"{passed} passed, {failed} failed" + (f", {skipped} skipped" if skipped else ""))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
