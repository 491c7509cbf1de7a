"""The checks check: planted faults are found, and failures are counted as failures."""

import importlib.util
import json
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


lint = load(TESTS / "lint" / "lint.py")
tally = load(TESTS / "support" / "tally.py")


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize("name, text", [
    ("server/jobs/a.c", "#include <microhttpd.h>\n"), ("client/a.c", "#include <jansson.h>\n"),
    ("server/api/a.c", "#include <sqlite3.h>\n"), ("server/jobs/a.c", "#include <cuda_runtime.h>\n"),
    ("common/base/a.c", '#include "proto/codec.h"\n'),
    ("proto/a.c", '#include "server/store/store.h"\n'),
    ("client/a.c", '#include "server/http/message.h"\n'),
    ("server/engine/field/a.h", '#include "server/engine/kernels/kernels.h"\n'),
    ("server/engine/scene/a.c", '#include "server/engine/engine.h"\n'),
    ("server/engine/effects/a.c", '#include "server/engine/train/trainer.h"\n'),
    ("server/engine/render/a.c", '#include "server/engine/cuda/layout.h"\n'),
    ("server/http/a.c", '#include "server/api/app.h"\n'),
    ("server/runner/a.c", '#include "server/jobs/control.h"\n'),
])
def test_a_fence_is_held(tmp_path, name, text):
    write(tmp_path / name, "// fine\n" + text)
    findings = list(lint.check_fences(tmp_path))
    assert len(findings) == 1 and findings[0].startswith(f"{name}:2: ")
    write(tmp_path / name, "#include <stdio.h>\n")
    assert not list(lint.check_fences(tmp_path))


@pytest.mark.parametrize("line", ["clock_gettime(CLOCK_REALTIME, &now);", "gettimeofday(&now, NULL);",
                                  "srand(time(NULL));", "pthread_cond_init(&changed, NULL);"])
def test_a_wait_on_the_wall_clock_is_found(tmp_path, line):
    write(tmp_path / "server/http/b.c", "pthread_cond_timedwait(&changed, &lock, &until);\n")
    assert not list(lint.check_waits(tmp_path))
    write(tmp_path / "server/http/a.c", f"// fine\n{line}\n")
    findings = list(lint.check_waits(tmp_path))
    assert len(findings) == 1 and findings[0].startswith("server/http/a.c:2: ")


def test_a_folder_without_a_layer_and_a_circle_are_found(tmp_path):
    write(tmp_path / "server" / "new" / "a.c", "int a;\n")
    assert [f.split(":")[0] for f in lint.check_fences(tmp_path)] == ["server/new/a.c"]
    assert lint.circle(lint.LAYERS) is None
    assert lint.circle({"a": ("b",), "b": ("c/",), "c/d": ("a",), "e": ("a",)}) is not None
    assert lint.circle({"a": ("b",), "b": (), "c/d": ("a",)}) is None


@pytest.mark.parametrize("cell, wrong", [
    ("`test_a`, `test_a.py`, `tests/api/`", []), ("`test_b.c` `test_b`", []), ("", ["a promise without a test"]),
    ("`test_a`, `test_c`", ["there is no test_c"]),
])
def test_a_promise_names_its_tests(tmp_path, cell, wrong):
    write(tmp_path / "tests" / "api" / "test_a.py", "def test_a():\n    pass\n")
    write(tmp_path / "tests" / "unit" / "test_b.c", "START_TEST(test_b) {\n}\n")
    write(tmp_path / "server" / "README.md",
          f"|  | read |\n|---|---|\n| a | b |\n\n| promise | test |\n|---|---|\n| it is `kept` | {cell} |\n")
    assert list(lint.check_promises(tmp_path)) == [f"server/README.md:7: {text}" for text in wrong]


def test_headers_compile_alone(tmp_path):
    write(tmp_path / "common" / "a.h", "struct a { size_t size; };\n")
    assert len(list(lint.check_headers(tmp_path))) == 1
    write(tmp_path / "common" / "a.h", "#include <stddef.h>\nstruct a { size_t size; };\n")
    assert not list(lint.check_headers(tmp_path))


def test_unfinished_words_and_long_files(tmp_path):
    write(tmp_path / "a.c", "int a; // " + "TO" + "DO: later\n")
    write(tmp_path / "b.py", "pass\n" * 701)
    write(tmp_path / "c.py", "pass\n" * 700)
    assert [finding.split(":")[0] for finding in lint.check_text(tmp_path)] == ["a.c", "b.py"]


def run_tally(tmp_path, capsys, meson, cases):
    log, junit = tmp_path / "log.json", tmp_path / "junit.xml"
    log.write_text("".join(json.dumps({"result": result}) + "\n" for result in meson))
    junit.write_text("<testsuites><testsuite>" + "".join(
        f"<testcase name='x'>{case}</testcase>" for case in cases) + "</testsuite></testsuites>")
    code = tally.main(str(log), str(junit))
    return code, capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize("meson, cases, code, line", [
    (["OK"], [""], 0, "2 passed, 0 failed"),
    (["OK", "SKIP"], ["<skipped/>"], 0, "1 passed, 0 failed, 2 skipped"),
    (["FAIL", "TIMEOUT", "ERROR", "UNEXPECTEDPASS", "INTERRUPT"], [], 1, "0 passed, 5 failed"),
    (["OK"], ["<failure/>", "<error/>", ""], 1, "2 passed, 2 failed"),
    ([], [], 1, "0 passed, 1 failed"),
])
def test_the_tally_adds_up(tmp_path, capsys, meson, cases, code, line):
    assert run_tally(tmp_path, capsys, meson, cases) == (code, line)


def test_a_missing_record_is_a_failure(tmp_path, capsys):
    assert tally.main(str(tmp_path / "none.json"), str(tmp_path / "none.xml")) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "0 passed, 2 failed"
