"""Test the verdict on a wrong recording, which follows from its error, its times and its warnings."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.bench_lies import line_of, run, state_of
from tests.benchmarks.spoiled_views import lie_rows
from tests.benchmarks.spoiled_views.lie_rows import FULL, Found


def test_states_of_rows() -> None:
    found = {
        FULL: Found(error_mm=8.0, named=("usual",)),
        "cm for m": Found(error_mm=8.5, named=("usual", "unit_by_person"), says="It is cm"),
        "confidence 1": Found(error_mm=9.0, named=("usual",), says="It is usual"),
        "lenses 10 % long": Found(error_mm=44.0, named=("focal_lengths_off",), says="All are long"),
        "one late": Found(error_mm=44.0, named=("usual",), says="It is usual"),
        "rate halved": Found(error_mm=8.0),
        "rate doubled": Found(error_mm=8.0, length_stated=True),
        "other layout": Found(True, named=("result_refused",), says="Nobody is seen"),
    }
    states = [state_of(name, found) for name in found]
    assert states == ["harmless", "repaired", "harmless", "named", "silent", "silent", "stated", "refused"]
    assert line_of("cm for m", found) == "| cm for m | repaired | 8.5 | `unit_by_person` |  |"


def test_rows_that_were_tried_are_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[object] = []
    monkeypatch.setattr("tests.benchmarks.bench_lies.found_of", lambda lie, folder: tried.append(lie) or Found())
    monkeypatch.setenv("LIES", "one late")
    monkeypatch.setenv("LIES_RECORD", str(tmp_path / "rows.jsonl"))
    assert {metric.key for metric in run()} >= {"one_late_mm", "silent"}
    run()
    assert tried == [lie_rows.ROWS[FULL], lie_rows.ROWS["one late"]]
