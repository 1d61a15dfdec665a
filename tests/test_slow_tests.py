"""What is marked slow is left out, unless everything or its own file is asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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
