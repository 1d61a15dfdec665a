"""docs/explanation/published-tables.md: every table of the papers beside what is measured here, from the baseline."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

BENCHMARKS = Path(__file__).resolve().parents[1] / "tests" / "benchmarks"
PUBLISHED, BASELINE = BENCHMARKS / "published_tables.json", BENCHMARKS / "baseline.json"
REPRODUCED, CONTRADICTED, NOT_MEASURED = "reproduced", "contradicted", "not measured"
UNDECIDED, NOT_PUBLISHED = "undecided", "no published figure"
VERDICTS = (REPRODUCED, CONTRADICTED, UNDECIDED, NOT_PUBLISHED, NOT_MEASURED)

_HEAD = """<!-- Made by python3 dev.py docs from tests/benchmarks/published_tables.json and baseline.json. -->

# Published tables, measured again

Every table of the work that this program implements, one comparison a row. *Published* is the ratio of the two
published figures, *here* the ratio of ours, by the benchmark of the row, on the day that stands there: data and weights
differ, so only ratios can be compared. A row is *reproduced* where both ratios lie on the same side of 1, and
*contradicted* where they do not, with the reason. Where training is involved, ours are medians of three seeds, and a
row is *undecided* where ours is nearer to 1 than two standard errors of the ratio over seeds. What is proposed without
a figure stands as *no published figure*.
`python3 dev.py bench seeds` counts them; `python3 dev.py bench NAME --update` measures a row anew.
[Results](../results.md) has what this program itself reaches."""


@dataclass(frozen=True)
class PublishedRow:
    """One comparison of a published table, and ours."""

    source: str
    table: str
    what: str
    published: float | None = None
    """Ratio of the published figures; None where there are none, or the row is not measured."""
    here: float | None = None
    """Ratio of ours."""
    bench: str = ""
    reason: str = ""
    """Why it is contradicted, or not measured."""
    log: str = ""
    """Page of the research log that has more."""
    recorded: str = ""
    """Day of ours."""
    spread: float = 0.0
    """Two standard errors of the ratio over seeds of the trainings: nearer to 1 ours is undecided."""

    @property
    def verdict(self) -> str:
        """Whether what was published holds here."""
        if self.here is None:
            return NOT_MEASURED
        if self.published is None:
            return NOT_PUBLISHED
        if abs(self.here - 1.0) < self.spread:
            return UNDECIDED
        return REPRODUCED if (self.published < 1.0) == (self.here < 1.0) else CONTRADICTED


def published_rows(values: Sequence[Mapping[str, Any]], baseline: Mapping[str, Any]) -> list[PublishedRow]:
    """Return the rows of a data file beside the figures of a baseline.

    Raises:
        KeyError: the baseline lacks a figure that a row names.
    """
    return [_row(value, baseline) for value in values]


def _row(value: Mapping[str, Any], baseline: Mapping[str, Any]) -> PublishedRow:
    shared = value["source"], value["table"], value["what"]
    if "not_measured" in value:
        return PublishedRow(*shared, reason=value["not_measured"], log=value.get("log", ""))
    measured = baseline[value["bench"]]
    over, under = (float(measured["figures"][key]["value"]) for key in value["figures"])
    published = value["published"][0] / value["published"][1] if "published" in value else None
    return PublishedRow(
        *shared, published, over / under, value["bench"], value.get("reason", ""), value.get("log", ""),
        measured["recorded"], measured["figures"][value["spread"]]["value"] if "spread" in value else 0.0,
    )  # fmt: skip


@cache
def rows() -> list[PublishedRow]:
    """Return the rows of the committed files."""
    return published_rows(
        json.loads(PUBLISHED.read_text(encoding="utf-8")), json.loads(BASELINE.read_text(encoding="utf-8"))
    )


def counts(found: Sequence[PublishedRow]) -> dict[str, int]:
    """Return how many rows have each verdict."""
    return {name: sum(row.verdict == name for row in found) for name in VERDICTS}


def published_page() -> str:
    """Return the page."""
    found = rows()
    total = counts(found)
    parts = [_HEAD, "", ", ".join(f"{number} {name}" for name, number in total.items()) + "."]
    for source in dict.fromkeys(row.source for row in found):
        parts += ["", f"## {source}", ""]
        parts += ["| table | comparison | published | here | verdict | benchmark, day |", "|---|---|---|---|---|---|"]
        parts += [_line(row) for row in found if row.source == source]
    return "\n".join([*parts, ""])


def _line(row: PublishedRow) -> str:
    published, here = ("–" if value is None else f"{value:.3f}" for value in (row.published, row.here))
    reason = f": {row.reason}" if row.reason and row.verdict not in (REPRODUCED, UNDECIDED) else ""
    log = f" [More](../research-log/{row.log})." if row.log else ""
    bench = f"`{row.bench}`, {row.recorded}" if row.bench else "–"
    return f"| {row.table} | {row.what} | {published} | {here} | **{row.verdict}**{reason}{log} | {bench} |"
