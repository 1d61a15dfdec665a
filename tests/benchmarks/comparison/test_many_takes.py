"""The search of baselines' settings, and the resumption of the comparison."""

from __future__ import annotations

import json

import pytest

from tests.benchmarks import tune_baselines
from tests.benchmarks.comparison import many_takes
from tests.benchmarks.comparison.methods import Method


def test_the_search_ends_where_every_neighbour_is_worse():
    def errors(steps):
        return 10.0 + (steps[0] - 3) ** 2, 5.0 + (steps[1] + 1) ** 2

    assert tune_baselines.search(errors, 2) == ((3, -1), True)


def test_the_search_says_when_its_budget_is_too_small():
    best, inside = tune_baselines.search(lambda steps: (100.0 - steps[0], 1.0), 1)
    assert best == (tune_baselines.BUDGET - 2,) and not inside  # one trial is spent on the worse side


@pytest.fixture
def one_method(monkeypatch, tmp_path):
    """Two takes of one method, whose measurement is the number of calls so far."""
    calls: list[str] = []

    def measure(part):
        calls.append(part.take)
        return {"mpjpe_mm": float(len(calls)), "code": part.code}

    monkeypatch.setattr(many_takes, "RESULTS", tmp_path / "many_takes.json")
    monkeypatch.setattr(many_takes, "METHODS", (Method("MuVS"),))
    monkeypatch.setattr(many_takes, "TAKES", ("a", "b"))
    monkeypatch.setattr(many_takes, "SEEDS", (0,))
    monkeypatch.setattr(many_takes.Part, "measure", measure)
    return calls


def test_a_second_call_measures_only_what_is_missing_or_of_other_code(one_method):
    many_takes.main([])
    assert one_method == ["a", "b"]
    many_takes.main([])
    assert one_method == ["a", "b"]
    table = json.loads(many_takes.RESULTS.read_text())
    table["runs"]["MuVS"]["b"]["0"]["code"] = "another"
    many_takes.RESULTS.write_text(json.dumps(table))
    many_takes.main([])
    assert one_method == ["a", "b", "b"]


def test_rows_that_wait_for_their_measurement_stay(one_method):
    many_takes.main([])
    table = json.loads(many_takes.RESULTS.read_text())
    for row in table["runs"]["MuVS"].values():
        row["0"]["code"] = "another"
    many_takes.RESULTS.write_text(json.dumps(table))
    many_takes.main(["--minutes", "0"])
    assert json.loads(many_takes.RESULTS.read_text())["runs"] == table["runs"]
