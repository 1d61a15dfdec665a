"""docs/explanation/published-tables.md: every table of the papers beside what is measured here, from the baseline."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

BENCHMARKS = Path(__file__).resolve().parents[1] / "tests" / "benchmarks"
PUBLISHED, BASELINE = BENCHMARKS / "published_tables.json", BENCHMARKS / "baseline.json"
REPRODUCED, CONTRADICTED, NOT_APPLICABLE = "reproduced", "contradicted", "not applicable"
UNDECIDED, NOT_FOUND, NOT_PUBLISHED = "undecided", "not found", "no published figure"
VERDICTS = (REPRODUCED, CONTRADICTED, NOT_FOUND, UNDECIDED, NOT_PUBLISHED, NOT_APPLICABLE)

MANY_SEEDS = 50  # More are not counted out: a published difference that small is none for practice. Chosen by hand.

_HEAD = """<!-- Made by python3 dev.py docs from tests/benchmarks/published_tables.json and baseline.json. -->

# Published tables, measured again

Every table of the work that this program implements, one comparison a row. *Published* is the ratio of the two
published figures. *Here* is the ratio of ours, by the benchmark of the row, on its day. Data and weights differ, so
only ratios can be compared. Where training is involved, ours are medians of three seeds.

| a row is | where |
|---|---|
| *reproduced* | both ratios lie on the same side of 1 |
| *contradicted* | they lie on different sides; the reason stands in the row |
| *undecided* | our ratio is nearer to 1 than two standard errors over seeds; the row has the seeds that would decide |
| *not found* | it is as near to 1, and the published ratio is farther from ours than chance allows for one training |
| *no published figure* | the work proposes it without one |
| *not applicable* | it cannot be measured here, for the reason in the row |

`python3 dev.py bench seeds` counts them; `python3 dev.py bench NAME --update` measures a row again.
[Results](../results.md) has what this program itself reaches."""


@dataclass(frozen=True)
class PublishedRow:
    """One comparison of a published table, and ours."""

    source: str
    table: str
    what: str
    published: float | None = None
    """Ratio of the published figures; None where there are none, or the row is not applicable."""
    here: float | None = None
    """Ratio of ours."""
    bench: str = ""
    reason: str = ""
    """Why it is contradicted, not found or not applicable."""
    log: str = ""
    """Page of the research log that has more."""
    recorded: str = ""
    """Day of ours."""
    spread: float = 0.0
    """Two standard errors of the ratio over seeds of the trainings: nearer to 1 ours shows no difference."""
    seeds: int = 0
    """Trainings that ours is the median of; 0 where none is involved."""

    @property
    def verdict(self) -> str:
        """Whether what was published holds here."""
        if self.here is None:
            return NOT_APPLICABLE
        if self.published is None:
            return NOT_PUBLISHED
        if abs(self.here - 1.0) < self.spread:
            return NOT_FOUND if abs(math.log(self.here / self.published)) > self.chance else UNDECIDED
        return REPRODUCED if (self.published < 1.0) == (self.here < 1.0) else CONTRADICTED

    @property
    def chance(self) -> float:
        """Two standard errors of the logarithm of ours by the published ratio.

        A median of n seeds has ``π / 2n`` of one training's variance; the published ratio is taken to be of one.
        """
        return self.spread * math.sqrt(1.0 + 2.0 * self.seeds / math.pi)

    @property
    def what_decides(self) -> str:
        """How many seeds would separate the published ratio from 1."""
        effect = abs(math.log(self.published or 1.0))
        needed = math.ceil(self.seeds * (self.spread / effect) ** 2) if effect else MANY_SEEDS + 1
        seeds = f"{max(needed, self.seeds + 1)} seeds" if needed <= MANY_SEEDS else f"more than {MANY_SEEDS} seeds"
        return f"Chance is ±{self.spread:.3f} by {self.seeds} seeds; {seeds} would decide."


def published_rows(values: Sequence[Mapping[str, Any]], baseline: Mapping[str, Any]) -> list[PublishedRow]:
    """Return the rows of a data file beside the figures of a baseline.

    Raises:
        KeyError: the baseline lacks a figure that a row names.
    """
    return [_row(value, baseline) for value in values]


def _row(value: Mapping[str, Any], baseline: Mapping[str, Any]) -> PublishedRow:
    shared = value["source"], value["table"], value["what"]
    if "not_applicable" in value:
        return PublishedRow(*shared, reason=value["not_applicable"], log=value.get("log", ""))
    measured = baseline[value["bench"]]
    over, under = (float(measured["figures"][key]["value"]) for key in value["figures"])
    published = value["published"][0] / value["published"][1] if "published" in value else None
    return PublishedRow(
        *shared, published, over / under, value["bench"], value.get("reason", ""), value.get("log", ""),
        measured["recorded"], *_seeds(value, measured["figures"]),
    )  # fmt: skip


def _seeds(value: Mapping[str, Any], figures: Mapping[str, Any]) -> tuple[float, int]:
    """Return the spread of a row over seeds, and their number."""
    return (figures[value["spread"]]["value"], int(figures["seeds"]["value"])) if "spread" in value else (0.0, 0)


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
    parts = [
        _HEAD,
        "",
        f"| {' | '.join(total)} |",
        "|---" * len(total) + "|",
        f"| {' | '.join(map(str, total.values()))} |",
    ]
    for source in dict.fromkeys(row.source for row in found):
        parts += ["", f"## {source}", ""]
        parts += ["| table | comparison | published | here | verdict | benchmark, day |", "|---|---|---|---|---|---|"]
        parts += [_line(row) for row in found if row.source == source]
    return "\n".join([*parts, ""])


def _line(row: PublishedRow) -> str:
    published, here = ("–" if value is None else f"{value:.3f}" for value in (row.published, row.here))
    why = row.what_decides if row.verdict == UNDECIDED else row.reason if row.verdict != REPRODUCED else ""
    reason = f": {why}" if why else ""
    log = f" [More](../research-log/{row.log})." if row.log else ""
    bench = f"`{row.bench}`, {row.recorded}" if row.bench else "–"
    return f"| {row.table} | {row.what} | {published} | {here} | **{row.verdict}**{reason}{log} | {bench} |"
