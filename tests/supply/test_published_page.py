"""Published tables beside ours: verdicts follow from intervals, and every contradiction has its reason."""

from __future__ import annotations

import json
from datetime import date
from typing import Any

import numpy as np
import pytest

from supply.published_page import (
    BASELINE,
    BOTH_SIDES,
    COLUMNS,
    CONTRADICTED,
    NOT_APPLICABLE,
    NOT_MEASURED,
    NOT_PUBLISHED,
    POSES,
    PUBLISHED,
    REPRODUCED,
    SMOOTHING,
    TAKE_FILES,
    TOO_SMALL,
    UNDECIDED,
    VERDICTS,
    WITHOUT_INTERVAL,
    Figures,
    PublishedRow,
    column_tables,
    counts,
    published_page,
    rows,
    take_table,
)
from supply.take_ratios import interval, take_medians, take_ratios

DATA = json.loads(PUBLISHED.read_text(encoding="utf-8"))
TAKES = json.loads(TAKE_FILES["many_takes"].read_text(encoding="utf-8"))
ENTRY = {"source": "A paper", "table": "1", "what": "This against that", "published": [9.0, 10.0]}
NAMED = {**ENTRY, "bench": "b", "figures": ["this", "that"]}
SOLVED = {**ENTRY, "bench": "takes", "methods": ["this", "that"], "column": "mpjpe_mm"}


def runs(ratios: list[float]) -> dict[str, Any]:
    """Return many takes whose errors have these ratios."""
    takes = {f"take_{n}": ratio for n, ratio in enumerate(ratios)}
    return {
        "recorded": "2026-11-29",
        "runs": {
            "this": {take: {"0": {"mpjpe_mm": 20.0 * ratio}} for take, ratio in takes.items()},
            "that": {take: {"0": {"mpjpe_mm": 20.0}} for take in takes},
        },
    }


def figures(this: float, more: dict[str, float] | None = None) -> dict[str, Any]:
    values = {"this": this, "that": 2.0, **(more or {})}
    return {"b": {"recorded": "2026-11-27", "figures": {key: {"value": value} for key, value in values.items()}}}


@pytest.mark.parametrize(
    ("ratios", "verdict"),
    [([0.7, 0.8, 0.9] * 4, REPRODUCED), ([0.7, 0.8, 1.4, 1.3] * 3, UNDECIDED), ([0.7, 0.8, 0.9], UNDECIDED),
     ([1.2, 1.3, 1.1] * 4, CONTRADICTED)],
)  # fmt: skip
def test_a_verdict_needs_an_interval_that_excludes_one(ratios: list[float], verdict: str) -> None:
    row = Figures({}, {"takes": runs(ratios)}, ()).row(SOLVED)
    assert row.here == pytest.approx(np.median(ratios))
    assert row.ends is not None and min(ratios) <= row.ends[0] <= row.here <= row.ends[1] <= max(ratios)
    assert (row.verdict, row.num_takes, row.num_seeds) == (verdict, len(ratios), 1)
    assert counts([row])[verdict] == 1


def test_methods_without_a_common_take_are_not_measured() -> None:
    found = runs([0.7, 0.8])
    first, *_ = found["runs"]
    found["runs"][first] = {f"other {take}": rows for take, rows in found["runs"][first].items()}
    assert Figures({}, {"takes": found}, ()).row(SOLVED).verdict == NOT_MEASURED


@pytest.mark.parametrize(("other", "verdict"), [([6.0, 8.0], REPRODUCED), ([8.0, 6.0], BOTH_SIDES)])
def test_one_measurement_stands_beside_every_published_data_set(other: list[float], verdict: str) -> None:
    two = {**SOLVED, "published": {"Studio": [9.0, 10.0], "Street": other}}
    row = Figures({}, {"takes": runs([0.7, 0.8, 0.9] * 4)}, ()).row(two)
    assert dict(row.published) == {"Studio": 0.9, "Street": other[0] / other[1]} and row.verdict == verdict


def test_one_measurement_has_no_verdict_however_far_from_one() -> None:
    row = Figures(figures(1.0), {}, ()).row(NAMED)
    assert (row.here, row.figures, row.verdict) == (0.5, (1.0, 2.0), WITHOUT_INTERVAL)


def test_networks_that_are_too_small_have_no_verdict() -> None:
    assert Figures(figures(1.0), {}, ("b",)).row(NAMED).verdict == TOO_SMALL


@pytest.mark.parametrize(("control", "verdict"), [(1.5, SMOOTHING), (2.5, WITHOUT_INTERVAL)])
def test_a_control_on_the_published_side_takes_the_credit(control: float, verdict: str) -> None:
    row = Figures(figures(1.0, {"none": control}), {}, ()).row({**NAMED, "control": "none"})
    assert row.control == control / 2.0 and row.verdict == verdict


def test_a_row_without_a_published_figure_or_that_cannot_be_measured_is_called_so() -> None:
    unpublished = {key: value for key, value in NAMED.items() if key != "published"}
    assert Figures(figures(1.0), {}, ()).row(unpublished).verdict == NOT_PUBLISHED
    row = Figures({}, {}, ()).row({"source": "A", "table": "2", "what": "W", "not_applicable": "No data."})
    assert (row.verdict, row.reason) == (NOT_APPLICABLE, "No data.")


def test_a_figure_that_is_missing_is_named() -> None:
    with pytest.raises(KeyError, match="this"):
        Figures({"b": {"recorded": "", "figures": {}}}, {}, ()).row(NAMED)


def test_the_interval_covers_the_median_of_its_population() -> None:
    """Of 200 samples of 12 takes the 95 % interval holds the true median in 90 % or more."""
    rng = np.random.default_rng(3)
    samples = np.exp(0.2 * rng.normal(size=(200, 12)))
    held = [low <= 1.0 <= high for _, low, high in (interval(dict(enumerate(sample))) for sample in samples)]
    assert 0.9 <= np.mean(held) <= 1.0


def test_only_seeds_that_both_methods_solved_are_compared() -> None:
    both = {"a": {"t": {"0": {"m": 2.0}, "1": {"m": 9.0}}, "u": {"0": {"m": 1.0}}}, "b": {"t": {"0": {"m": 4.0}}}}
    assert take_ratios(both, "a", "b", "m") == {"t": 0.5} and take_medians(both, "a", "m") == {"t": 5.5, "u": 1.0}
    assert take_ratios(both, "a", "b", "not measured") == take_medians(both, "a", "not measured") == {}


def test_a_take_on_which_the_other_method_has_no_error_counts() -> None:
    found = {"a": {"t": {"0": {"m": 2.0}}, "u": {"0": {"m": 0.0}}}, "b": {take: {"0": {"m": 0.0}} for take in "tu"}}
    assert take_ratios(found, "a", "b", "m") == {"t": np.inf}


def test_the_committed_rows_name_figures_and_no_ratio_is_typed() -> None:
    kept = json.loads(BASELINE.read_text(encoding="utf-8"))
    for value in DATA["rows"]:
        assert set(value) <= {*NAMED, *SOLVED, "not_applicable", "log", "reason", "control"} and value["what"]
        if "figures" in value:
            named = {*value["figures"], *([value["control"]] if "control" in value else [])}
            assert named <= set(kept[value["bench"]]["figures"]), value["what"]
            assert len(value["figures"]) == 2
        pairs = value["published"] if isinstance(value.get("published"), dict) else {"": value.get("published", (1, 2))}
        assert all(len(pair) == 2 for pair in pairs.values())
        assert ("figures" in value) + ("methods" in value) + ("not_applicable" in value) == 1
        assert ("bench" in value) != ("not_applicable" in value)
    assert set(DATA["conditions"]) >= {row.bench for row in rows() if row.bench}


def test_no_measurement_stands_twice() -> None:
    named = [(row["source"], row["what"], row["table"]) for row in DATA["rows"]]
    assert len(named) == len(set(named))
    measured = [row for row in DATA["rows"] if "bench" in row]
    keys = [(row["bench"], *row.get("figures", row.get("methods", ())), row.get("column")) for row in measured]
    assert len(keys) == len(set(keys))


def test_every_benchmark_of_the_baseline_has_its_day() -> None:
    for name, measured in json.loads(BASELINE.read_text(encoding="utf-8")).items():
        assert date.fromisoformat(measured["recorded"]) >= date(2026, 11, 21), name


def test_every_contradiction_has_a_reason_in_a_sentence() -> None:
    explained = [row for row in rows() if row.verdict in (CONTRADICTED, NOT_PUBLISHED, NOT_APPLICABLE)]
    assert not [row.what for row in explained if not row.reason.endswith(".") or not 20 < len(row.reason) < 250]


def test_every_table_of_the_thesis_stands_on_the_page() -> None:
    tables = {table.strip() for row in rows() if "thesis" in row.source for table in row.table.split(",")}
    chapters = {4: 7, 5: 2, 6: 9}
    assert tables >= {"1.1"} | {f"{c}.{t}" for c, last in chapters.items() for t in range(1, last + 1)}


def test_the_page_shows_every_row_and_every_take_and_says_what_reproduced_rests_on() -> None:
    page = published_page()
    assert "The verdict *reproduced* needs" in page[:400] and "A row is *reproduced* if" in page[:900]
    for row in rows():
        assert f"| {row.what} |" in page
    assert all(f"| *{name}* (" in page for name in VERDICTS)
    assert all(f"| {take} (" in page for found in TAKES["runs"].values() for take in found)
    assert isinstance(rows()[0], PublishedRow)
    assert [line for line in take_table(runs([1.0, 2.0])) if line.startswith("| take_1 (1 seed) | 40.0 | 20.0 |")]
    assert "No take is measured yet." in take_table({"runs": {}})


def test_every_column_of_a_landmark_row_is_compared_with_the_published_one() -> None:
    keys = [f"{key}_{poses}_{end}" for key in "ab" for poses in POSES for end in COLUMNS[:4]]
    found = {"b": {"figures": {key: {"value": 20.0 if key[0] == "a" else 30.0} for key in keys}}}
    row = {"name": "SQUAD", "bench": "b", "key": "b", "base": "a", "published": {"tail": [3, 4, 5, 9, 6]}}
    lines = column_tables({"base": {name: [4, 8, 5, 6, 3] for name in POSES}, "rows": [row]}, found)
    assert "| SQUAD | 1.500 (0.750) | 1.500 (0.500) | 1.500 (1.000) | 1.500 (1.500) | – (2.000) |" in lines
    assert "| SQUAD | 1.500 | 1.500 | 1.500 | 1.500 | – |" in lines
    with pytest.raises(KeyError):
        column_tables({"base": {name: [1] * 5 for name in POSES}, "rows": [{**row, "key": "c"}]}, found)
