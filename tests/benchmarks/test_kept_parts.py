"""Test that a long benchmark resumes after an interruption, and repeats parts that other code measured."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks import kept_parts
from tests.benchmarks.comparison.code_version import PACKAGES, closure

NAME = "tests.benchmarks.bench_sync"


def test_a_part_is_measured_once_while_its_code_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[str] = []

    def measure(part: str) -> dict[str, list[float]]:
        measured.append(part)
        return {"errors": [0.1, 0.2]}

    for part in ("seed 0", "seed 0", "seed 1"):
        assert kept_parts.kept(NAME, part, lambda part=part: measure(part), tmp_path) == {"errors": [0.1, 0.2]}
    assert measured == ["seed 0", "seed 1"]
    monkeypatch.setattr(kept_parts, "code_version", lambda *_: "other code")
    kept_parts.kept(NAME, "seed 0", lambda: measure("again"), tmp_path)
    assert measured[-1] == "again"


def test_a_measurement_that_was_stopped_leaves_nothing(tmp_path: Path) -> None:
    def stopped() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        kept_parts.kept(NAME, "seed 0", stopped, tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_code_of_a_benchmark_is_its_own_too() -> None:
    names = {path.name for path in closure(NAME, (*PACKAGES, "tests"))}
    assert {"bench_sync.py", "validation_takes.py", "synchronise.py", "filming.py"} <= names
