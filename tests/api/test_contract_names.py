"""Every test that the daemon's written contract names is there."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_contract_names_tests_that_exist():
    text = (ROOT / "server" / "README.md").read_text(encoding="utf-8")
    rows = [line for line in text[text.index("## The contract"):].splitlines()
            if line.startswith("| ") and not line.startswith(("| promise", "| bound", "| who |", "| what was found"))]
    sources = [path for suffix in ("*.py", "*.c") for path in (ROOT / "tests").rglob(suffix)]
    files = {path.name for path in sources}
    functions = {name for path in sources
                 for name in re.findall(r"(?:def |START_TEST\()(test_\w+)",
                                        path.read_text(encoding="utf-8", errors="replace"))}
    assert len(rows) >= 30
    for row in rows:
        named = re.findall(r"`(test_[\w.]+)`", row)
        programs = re.findall(r"`(tests/[\w./]+\.(?:py|sh))`", row)
        assert named or programs, f"no test is named: {row}"
        assert all((ROOT / program).is_file() for program in programs), row
        for name in named:
            assert name in (files if "." in name else functions), f"{name}: {row}"
