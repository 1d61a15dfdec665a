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


@pytest.mark.parametrize(
    ("arguments", "shown_last"),
    [([""], "1 passed, 1 deselected"), (["", "--all"], "1 failed, 1 passed"), (["test_one.py"], "1 failed, 1 passed")],
    ids=["a folder", "all", "a file"],
)
def test_what_runs(tmp_path: Path, arguments: list[str], shown_last: str) -> None:
    (tmp_path / "test_one.py").write_text(FILE)
    path, *options = arguments
    settings = ["--rootdir", str(ROOT), "-c", str(ROOT / "pyproject.toml"), "-p", "tests.conftest"]
    command = [sys.executable, "-m", "pytest", "-q", *settings, *options, str(tmp_path / path)]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout
    assert shown.splitlines()[-1].startswith(shown_last), shown


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
