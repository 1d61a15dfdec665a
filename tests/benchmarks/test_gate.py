"""Test the comparison with baselines: figures that pass or fail, and the output."""

from __future__ import annotations

import json
from datetime import date

import pytest

from tests.benchmarks import __main__ as runner
from tests.benchmarks.metric import BenchmarkSkipped, Metric, judge


@pytest.mark.parametrize(
    ("direction", "value", "passed"),
    [
        ("lower", 0.0, True), ("lower", 11.5, True), ("lower", 11.6, False), ("lower", float("nan"), False),
        ("higher", 99.0, True), ("higher", 8.5, True), ("higher", 8.4, False), ("higher", float("nan"), False),
    ],
)  # fmt: skip
def test_tolerances_add_up_on_the_bad_side_alone(direction, value, passed):
    assert Metric("x", value, "mm", direction, rel_tol=0.1, abs_tol=0.5).passes(10.0) is passed


def test_new_and_lost_figures_do_not_pass():
    verdicts, lost = judge([Metric("old", 1.0, ""), Metric("new", 1.0, "")], {"old": 1.0, "gone": 2.0})
    assert [verdict.passed for verdict in verdicts] == [True, False]
    assert "no baseline" in verdicts[1].line()
    assert lost == ["gone"]
    with pytest.raises(ValueError, match="the same key"):
        judge([Metric("a", 1.0, ""), Metric("a", 2.0, "")], {})


@pytest.fixture
def figures(monkeypatch):
    """Install a benchmark with figures that the test sets."""
    values: dict[str, float] = {"error_mm": 10.0}

    class Module:
        """Made-up figures."""

        @staticmethod
        def run():
            if not values:
                raise BenchmarkSkipped("There is nothing to measure.", hint="Bring data.")
            return [Metric(key, value, "mm") for key, value in values.items()]

    monkeypatch.setattr(runner, "discover", lambda: ["made_up"])
    monkeypatch.setattr(runner.importlib, "import_module", lambda name: Module)
    return values


def test_the_runner_records_then_compares(figures, tmp_path, capsys):
    path = tmp_path / "baseline.json"
    assert runner.main(["made_up"], path) == 1
    assert runner.main(["--update"], path) == 0
    recorded = json.loads(path.read_text())["made_up"]
    assert recorded["figures"] == {"error_mm": {"value": 10.0, "unit": "mm"}}
    assert date.fromisoformat(recorded["recorded"]) >= date(2026, 11, 27)
    assert runner.main([], path) == 0
    figures["error_mm"] = 10.6
    capsys.readouterr()
    assert runner.main(["made_up"], path) == 1
    shown = capsys.readouterr().out
    assert "made_up: Made-up figures." in shown
    assert "✗ error_mm" in shown
    assert "passes ≤ 10.5" in shown


def test_a_run_keeps_what_another_recorded_meanwhile(figures, tmp_path, monkeypatch):
    path = tmp_path / "baseline.json"

    def run(name: str) -> list[Metric]:
        path.write_text(json.dumps({"other": {"figures": {}}}))
        return [Metric("error_mm", 1.0, "mm")]

    monkeypatch.setattr(runner, "run", run)
    assert runner.main(["made_up", "--update"], path) == 0
    assert set(json.loads(path.read_text())) == {"other", "made_up"}


def test_a_skip_is_told_with_its_reason_and_passes(figures, tmp_path, capsys):
    figures.clear()
    assert runner.main([], tmp_path / "baseline.json") == 0
    assert "skipped: There is nothing to measure." in capsys.readouterr().out


def test_an_unknown_name_lists_the_known_ones(figures, capsys):
    assert runner.main(["other"]) == 2
    assert "There is no benchmark other. There are: made_up." in capsys.readouterr().err


@pytest.mark.parametrize("name", runner.discover())
def test_every_benchmark_can_start(name):
    module = runner.importlib.import_module(f"tests.benchmarks.{runner.PREFIX}{name}")
    assert module.__doc__
    assert callable(module.run)


def test_the_real_benchmarks_are_found():
    assert {"demo", "held_out"} <= set(runner.discover())
