"""Published tables beside ours: verdicts follow from figures, and every contradiction has its reason."""

from __future__ import annotations

import json
from datetime import date

import pytest

from supply.published_page import (
    BASELINE,
    CONTRADICTED,
    NOT_APPLICABLE,
    NOT_FOUND,
    NOT_PUBLISHED,
    PUBLISHED,
    REPRODUCED,
    UNDECIDED,
    PublishedRow,
    counts,
    published_page,
    published_rows,
    rows,
)

VALUES = json.loads(PUBLISHED.read_text(encoding="utf-8"))
ENTRY = {
    "source": "A paper", "table": "1", "what": "This against that", "published": [9.0, 10.0],
    "bench": "b", "figures": ["this", "that"], "reason": "Ours is another.",
}  # fmt: skip


def baseline(this: float, that: float) -> dict:
    return {"b": {"recorded": "2026-11-27", "figures": {"this": {"value": this}, "that": {"value": that}}}}


@pytest.mark.parametrize(("this", "verdict"), [(1.9, REPRODUCED), (2.1, CONTRADICTED)])
def test_the_verdict_is_the_side_of_one(this: float, verdict: str):
    (row,) = published_rows([ENTRY], baseline(this, 2.0))
    assert (row.published, row.here) == pytest.approx((0.9, this / 2.0)) and row.verdict == verdict
    assert counts([row])[verdict] == 1


@pytest.mark.parametrize(
    ("this", "published", "verdict"),
    [(1.9, 0.9, REPRODUCED), (1.97, 0.97, UNDECIDED), (2.03, 0.99, UNDECIDED), (2.03, 0.97, NOT_FOUND),
     (2.1, 0.9, CONTRADICTED)],
)  # fmt: skip
def test_nearer_to_one_than_chance_is_not_found_or_undecided(this: float, published: float, verdict: str):
    """By three seeds the published ratio, of one training, scatters 1.7 times as much about ours as ours does."""
    measured = baseline(this, 2.0)
    measured["b"]["figures"] |= {"by_seeds": {"value": 0.02}, "seeds": {"value": 3}}
    (row,) = published_rows([{**ENTRY, "published": [published, 1.0], "spread": "by_seeds"}], measured)
    assert row.verdict == verdict
    assert row.chance == pytest.approx(0.02 * 1.706, rel=1e-3)


@pytest.mark.parametrize(("published", "seeds"), [(0.95, "4 seeds"), (0.99, "12 seeds"), (1.0, "more than 50 seeds")])
def test_an_undecided_row_says_how_many_seeds_would_tell(published: float, seeds: str):
    row = PublishedRow("A", "1", "W", published, 0.99, spread=0.02, seeds=3)
    assert row.what_decides == f"Chance is ±0.020 by 3 seeds; {seeds} would decide."


def test_what_has_no_published_figure_is_called_so_and_has_its_day():
    (row,) = published_rows([{key: value for key, value in ENTRY.items() if key != "published"}], baseline(1.0, 2.0))
    assert (row.verdict, row.here, row.recorded) == (NOT_PUBLISHED, 0.5, "2026-11-27")


def test_every_benchmark_of_the_baseline_has_its_day():
    for name, measured in json.loads(BASELINE.read_text(encoding="utf-8")).items():
        assert date.fromisoformat(measured["recorded"]) >= date(2026, 11, 21), name


def test_a_figure_that_the_baseline_lacks_is_named():
    with pytest.raises(KeyError, match="this"):
        published_rows([ENTRY], {"b": {"recorded": "", "figures": {}}})


def test_what_is_not_applicable_has_its_reason():
    (row,) = published_rows([{"source": "A", "table": "2", "what": "W", "not_applicable": "No data."}], {})
    assert (row.verdict, row.reason) == (NOT_APPLICABLE, "No data.")


def test_the_committed_rows_name_figures_of_the_baseline_and_no_ratio_is_typed():
    figures = json.loads(BASELINE.read_text(encoding="utf-8"))
    for value in VALUES:
        assert (
            set(value) <= {*ENTRY, "not_applicable", "log", "spread"}
            and value["source"]
            and value["table"]
            and value["what"]
        )
        if "not_applicable" not in value:
            named = {*value["figures"], *([value["spread"]] if "spread" in value else [])}
            assert named <= set(figures[value["bench"]]["figures"]), value["what"]
            assert len(value.get("published", (1, 2))) == len(value["figures"]) == 2


def test_every_contradiction_has_a_reason_in_a_sentence():
    explained = [row for row in rows() if row.verdict not in (REPRODUCED, UNDECIDED)]
    assert not [row.what for row in explained if not row.reason.endswith(".")]
    assert not [row.what for row in explained if not 20 < len(row.reason) < 250]


def test_every_table_of_the_thesis_stands_on_the_page():
    tables = {table.strip() for row in rows() if "thesis" in row.source for table in row.table.split(",")}
    chapters = {4: 7, 5: 2, 6: 9}
    assert tables == {"1.1"} | {f"{c}.{t}" for c, last in chapters.items() for t in range(1, last + 1)}


def test_a_row_of_the_page_shows_both_ratios_and_the_reason_of_a_contradiction_alone():
    page = published_page()
    assert f"| {' | '.join(map(str, counts(rows()).values()))} |" in page
    for row in rows():
        (line,) = [line for line in page.splitlines() if line.startswith(f"| {row.table} | {row.what} |")]
        assert row.verdict in line and (row.reason in line) == (
            row.verdict not in (REPRODUCED, UNDECIDED) or not row.reason
        )
        assert (row.verdict == UNDECIDED) == ("would decide." in line)
    assert isinstance(rows()[0], PublishedRow)
