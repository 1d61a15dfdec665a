"""Test the search of the baselines' settings, and the resumption of the comparison."""

from __future__ import annotations

import json

import pytest

from supply.published_page import LEAST_TAKES
from supply.published_page import PUBLISHED as PUBLISHED_ROWS
from tests.benchmarks import tune_baselines
from tests.benchmarks.comparison import kept_runs, many_takes, run_times, walking_takes
from tests.benchmarks.comparison.methods import Method


def test_the_search_ends_where_every_neighbour_is_worse():
    def errors(steps):
        return 10.0 + (steps[0] - 3) ** 2, 5.0 + (steps[1] + 1) ** 2

    assert tune_baselines.search(errors, 2) == ((3, -1), True)


def test_the_search_says_when_its_budget_is_too_small():
    best, inside = tune_baselines.search(lambda steps: (100.0 - steps[0], 1.0), 1)
    assert best == (tune_baselines.BUDGET - 2,) and not inside  # one trial is spent on the worse side


def test_a_setting_must_gain_more_than_takes_differ_by_chance():
    in_use, clear = [[20.0, 10.0], [30.0, 20.0]], [[19.0, 9.5], [28.5, 19.1]]
    mixed = [[17.0, 9.0], [32.9, 20.9]]
    assert tune_baselines.is_better(clear, in_use, [in_use, clear])
    assert not tune_baselines.is_better(mixed, in_use, [in_use, mixed])
    assert not tune_baselines.is_better(in_use, in_use, [in_use, clear])


def test_the_baselines_have_the_settings_that_the_search_chose():
    stored = json.loads(tune_baselines.RESULTS.read_text(encoding="utf-8"))
    assert set(stored) == set(tune_baselines.STARTS)
    for name, (baseline, fields) in tune_baselines.STARTS.items():
        assert {field: getattr(baseline, field) for field in fields} == pytest.approx(stored[name]["chosen"]), name


@pytest.fixture
def one_method(monkeypatch, tmp_path):
    """Return two takes of one method that is measured by its number of calls."""
    calls: list[str] = []

    def measure(part):
        calls.append(part.take)
        return {"mpjpe_mm": float(len(calls))}

    monkeypatch.setattr(many_takes, "RESULTS", tmp_path / "many_takes.json")
    monkeypatch.setattr(many_takes, "METHODS", (Method("MuVS"),))
    monkeypatch.setattr(many_takes, "TAKES", ("a", "b"))
    monkeypatch.setattr(many_takes, "SEEDS", (0,))
    monkeypatch.setattr(many_takes.Part, "measure", measure)
    return calls


def measure(*argv):
    kept_runs.resume(list(many_takes.parts()), many_takes.RESULTS, argv)


def test_a_second_call_measures_only_what_is_missing_or_of_other_code(one_method):
    measure()
    assert one_method == ["a", "b"]
    measure()
    assert one_method == ["a", "b"]
    table = json.loads(many_takes.RESULTS.read_text())
    table["runs"]["MuVS"]["b"]["0"]["code"] = "another"
    many_takes.RESULTS.write_text(json.dumps(table))
    measure()
    assert one_method == ["a", "b", "b"]


def test_rows_that_wait_for_their_measurement_stay(one_method):
    measure()
    table = json.loads(many_takes.RESULTS.read_text())
    for row in table["runs"]["MuVS"].values():
        row["0"]["code"] = "another"
    many_takes.RESULTS.write_text(json.dumps(table))
    for words in (["--minutes", "0"], ["--missing"]):
        measure(*words)
        assert json.loads(many_takes.RESULTS.read_text())["runs"] == table["runs"]


def test_a_call_may_measure_some_seeds_and_drops_none_of_the_others(one_method, monkeypatch):
    monkeypatch.setattr(many_takes, "SEEDS", (0, 1))
    measure("--seeds", "1")
    measure("--seeds", "0")
    found = json.loads(many_takes.RESULTS.read_text())["runs"]["MuVS"]
    assert {take: sorted(rows) for take, rows in found.items()} == {"a": ["0", "1"], "b": ["0", "1"]}
    assert one_method == ["a", "b", "a", "b"]


def test_walks_are_other_takes_than_those_of_the_main_tables() -> None:
    walks, main = ({take.partition(":")[0] for take in takes} for takes in (walking_takes.TAKES, many_takes.TAKES))
    assert len(walking_takes.TAKES) == len(walks) == LEAST_TAKES and not walks & main
    rows = json.loads(PUBLISHED_ROWS.read_text(encoding="utf-8"))["rows"]
    named = {name for row in rows if row.get("bench") == "walking_takes" for name in row["methods"]}
    assert named == {part.name for part in walking_takes.parts()}


def test_run_times_are_of_all_published_methods_in_turn() -> None:
    parts = list(run_times.parts())
    first = parts[: len(run_times.METHODS)]
    assert {part.take for part in first} == {run_times.TAKES[0]} and len({part.name for part in first}) == len(first)
    assert len(parts) == 3 * len(many_takes.TAKES) * len(first)
    rows = json.loads(PUBLISHED_ROWS.read_text(encoding="utf-8"))["rows"]
    named = {name for row in rows if row.get("bench") == "run_times" for name in row["methods"]}
    assert named == {part.name for part in first} and {row["column"] for row in rows if "run time" in row["what"]} == {
        "cpu_s"
    }
