"""What is slow or of an area is left out, unless everything, its own file or its area is asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.support.slow_tests import AREAS, TESTS, is_left_out, left_out

ROOT = Path(__file__).resolve().parents[1]
FILE = """import pytest
def test_quick(): pass
@pytest.mark.slow
def test_slow(): assert False, "it ran"
"""


RUNS = """import sys, pytest
for call in sys.argv[1:]:
    pytest.main(call.split("|"))
    print("== ended", flush=True)
"""
"""Calls of pytest in one process, which imports what they need once."""


@pytest.mark.slow
def test_what_runs(tmp_path: Path) -> None:
    (tmp_path / "test_one.py").write_text(FILE)
    settings = ["-q", "--rootdir", str(ROOT), "-c", str(ROOT / "pyproject.toml"), "-p", "tests.conftest"]
    a_folder, a_file = str(tmp_path), str(tmp_path / "test_one.py")
    calls = ["|".join([*settings, *given]) for given in ([a_folder], [a_folder, "--all"], [a_file])]
    done = subprocess.run([sys.executable, "-c", RUNS, *calls], cwd=ROOT, capture_output=True, text=True)
    last = [shown.splitlines()[-1] for shown in done.stdout.split("== ended\n")[:-1]]
    expected = ["1 passed, 1 deselected", "1 failed, 1 passed", "1 failed, 1 passed"]
    assert [line.split(" in ")[0] for line in last] == expected, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("asked_for", "every", "runs"), [("tests", False, 1), ("tests", True, 2), ("tests/io/a.py", False, 2)]
)
def test_a_slow_test_runs_where_its_file_is_named(asked_for: str, every: bool, runs: int) -> None:
    named = SimpleNamespace(dir=ROOT)
    config = SimpleNamespace(getoption=lambda name: every, args=[asked_for], invocation_params=named)
    path = TESTS / "io" / "a.py"
    items = [
        SimpleNamespace(path=path, get_closest_marker=lambda name, mark=mark: mark) for mark in (None, pytest.mark.slow)
    ]
    assert [item for item in items if item not in left_out(config, items)] == items[:runs]


@pytest.mark.parametrize("area", AREAS)
@pytest.mark.parametrize(
    ("asked_for", "runs"),
    [("tests", False), ("tests/{}", True), ("tests/{}/engine/test_one.py::test_it", True), ("tests/exchange", False)],
)
def test_an_area_runs_where_it_is_named(area: str, asked_for: str, runs: bool) -> None:
    assert (TESTS / area).is_dir()
    named = SimpleNamespace(dir=ROOT)
    config = SimpleNamespace(getoption=lambda name: False, args=[asked_for.format(area)], invocation_params=named)
    item = SimpleNamespace(path=TESTS / area / "engine" / "test_one.py", get_closest_marker=lambda name: None)
    assert left_out(config, [item]) == ([] if runs else [item])
    assert is_left_out(config, TESTS / area) is not runs, "what is left out is not imported"
