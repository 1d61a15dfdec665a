"""Generate docs/explanation/published-tables.md: every published table with our own measurements."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from supply.take_ratios import interval, take_medians, take_ratios

BENCHMARKS = Path(__file__).resolve().parents[1] / "tests" / "benchmarks"
PUBLISHED, BASELINE = BENCHMARKS / "published_tables.json", BENCHMARKS / "baseline.json"
TAKE_FILES = {
    "many_takes": BENCHMARKS / "many_takes.json", "walking_takes": BENCHMARKS / "walking_takes.json",
    "run_times": BENCHMARKS / "run_times.json", "noise_aware": BENCHMARKS / "noise_takes.json",
}  # fmt: skip
REPRODUCED, CONTRADICTED, UNDECIDED = "reproduced", "contradicted", "undecided"
WITHOUT_INTERVAL, TOO_SMALL, SMOOTHING = "without interval", "too small to judge", "same without the prior"
BOTH_SIDES = "published on both sides"
NOT_PUBLISHED, NOT_APPLICABLE, NOT_MEASURED = "no published figure", "not applicable", "not measured"
MEANINGS = {
    REPRODUCED: "the 95 % interval over takes excludes 1 on the published side",
    CONTRADICTED: "the interval excludes 1 on the other side",
    UNDECIDED: "the interval contains 1, or fewer than 12 takes are measured",
    WITHOUT_INTERVAL: "there is one measurement and no interval over takes, so there is no verdict",
    TOO_SMALL: "our networks are far smaller than the published ones, or too few were trained",
    BOTH_SIDES: "one published ratio is above 1 and another below",
    SMOOTHING: "the control without a prior is also on the published side",
    NOT_PUBLISHED: "the publication proposes the method without a figure",
    NOT_APPLICABLE: "the comparison cannot be measured here, for the reason in the row",
    NOT_MEASURED: "the benchmark can measure the row, but has not run yet",
}
VERDICTS = tuple(MEANINGS)
WIDEST = 5  # Methods per table, so that it fits a page.
LEAST_TAKES = 12  # Smallest number of takes for a verdict.

NETWORKS = (
    ("landmark_rows", "base of chapter 4's rows, width 8", "base_", "`fixed`"),
    ("landmark_rows", "σ(D) with SQUAD, width 8", "ortho_", "`fixed`"),
    ("landmark_thesis", "base, width 8, 600 steps", "base_thesis_thesis_", "`thesis`"),
    ("landmark_thesis", "σ(D) with SQUAD, width 8, 600 steps", "ortho_thesis_thesis_", "`thesis`"),
    ("landmark_thesis", "e(R) with SLERP, width 8, 600 steps", "e_r_slerp_thesis_thesis_", "`thesis`"),
    ("landmark_clouds", "the included network", "fixed_", "`fixed`"),
    ("landmark_clouds", "the included network", "thesis_", "`thesis`"),
)
"""Benchmark, name, prefix of the figures' keys, and corruption of every network with absolute figures."""
POSES = ("ordinary", "tail", "floor")  # Pose sets for evaluating landmark networks.
COLUMNS = ("rmse_mm", "mpjpe_mm", "pck1_percent", "pck3_percent", "pck7_percent")  # Suffixes of the figures' keys.
_NETWORKS = """Rows of width 8 without a number of steps are medians of three trainings with 2,000 steps. The
others are one training. A dash marks a missing figure.

Each error is a mean over 1,000 ordinary poses, 646 rare poses (*tail*) or 171 poses on the floor.

`thesis` clouds have only the corruption in equations 4.20 to 4.27. `fixed` clouds also vary the body size and the
heading, and have misplaced markers and props.

`python3 dev.py bench landmark_clouds` measures the included network on fewer poses, 400 ordinary and 400 rare ones."""

_HEAD = """<!-- Made by python3 dev.py docs from published_tables.json, the results of takes, and baseline.json. -->

# Published tables, measured again

Each row compares two methods by the ratio of their figures. The verdict *reproduced* needs {num_takes} takes of
recorded CMU motion with {seeds}. Markers, cameras and detector are simulated. We
implemented both methods ourselves. We did not use the published data, code or weights, so absolute errors cannot be
compared.

Our ratio is the median over the takes. A row is *reproduced* if the 95 % bootstrap interval of this ratio excludes 1
on the published side. A row without an interval has no verdict.

The column *published* shows the ratio of the two published figures, for each published data set. The column *here*
shows our ratio, with our two figures in brackets. The conditions of each table are under its heading.

PCK is the share of joints within 1, 3 or 7 cm. FID is the Fréchet distance to real poses, and DIV is the
distance between random pairs of poses, both in VPoser's codes.

| verdict of a row | condition |
|---|---|
"""


@dataclass(frozen=True)
class PublishedRow:
    """A comparison of two methods from a published table, with our result."""

    source: str
    table: str
    what: str
    published: Mapping[str, float] = field(default_factory=dict)
    """Ratios of the published figures by data set. The name of a single data set is empty."""
    here: float | None = None  # Our ratio, None if it is not applicable.
    figures: tuple[float, float] | None = None  # Our two figures.
    ends: tuple[float, float] | None = None  # Bounds of the 95 % interval over takes.
    num_takes: int = 0  # Number of takes of the interval.
    num_seeds: int = 0  # Smallest number of seeds of a take.
    control: float | None = None  # Ratio with no prior instead of the method.
    bench: str = ""
    reason: str = ""  # Reason for a contradiction, or for a row that is not applicable.
    log: str = ""  # Page of the research log with details.
    recorded: str = ""  # Date of our measurement.
    is_too_small: bool = False

    @property
    def verdict(self) -> str:
        """Verdict on the comparison, a key of ``MEANINGS``."""
        if self.here is None:
            return NOT_MEASURED if self.bench else NOT_APPLICABLE
        if not self.published:
            return NOT_PUBLISHED
        if self.is_too_small:
            return TOO_SMALL
        is_lower, *others = {ratio < 1.0 for ratio in self.published.values()}
        if others:
            return BOTH_SIDES
        if self.control is not None and (self.control < 1.0) == is_lower == (self.here < 1.0):
            return SMOOTHING
        if self.ends is None:
            return WITHOUT_INTERVAL
        if self.ends[0] <= 1.0 <= self.ends[1] or self.num_takes < LEAST_TAKES:
            return UNDECIDED
        return REPRODUCED if is_lower == (self.here < 1.0) else CONTRADICTED


@dataclass(frozen=True)
class Figures:
    """Committed benchmark figures that the rows refer to."""

    baseline: Mapping[str, Any]
    takes: Mapping[str, Any]  # Contents of ``TAKE_FILES``.
    too_small: Sequence[str]  # Benchmarks of networks that are too small.

    def row(self, value: Mapping[str, Any]) -> PublishedRow:
        """Build a row of the data file with its figures.

        Raises:
            KeyError: a figure that the row refers to is missing.
        """
        shared = {key: value[key] for key in ("source", "table", "what", "log") if key in value}
        if "not_applicable" in value:
            return PublishedRow(**shared, reason=value["not_applicable"])
        published, bench = value.get("published", {}), value["bench"]
        published = published if isinstance(published, dict) else {"": published}
        shared |= {"published": {name: a / b for name, (a, b) in published.items()}, "bench": bench}
        shared |= {"reason": value.get("reason", "")}
        if "methods" in value:
            return self._over_takes(shared, value)
        if bench not in self.baseline:
            return PublishedRow(**shared)
        measured = self.baseline[bench]
        over, under = (float(measured["figures"][key]["value"]) for key in value["figures"])
        control = float(measured["figures"][value["control"]]["value"]) / under if "control" in value else None
        return PublishedRow(
            **shared, here=over / under, figures=(over, under), control=control,
            recorded=measured["recorded"], is_too_small=bench in self.too_small,
        )  # fmt: skip

    def _over_takes(self, shared: Mapping[str, Any], value: Mapping[str, Any]) -> PublishedRow:
        found, (over, under), column = self.takes.get(value["bench"], {}), value["methods"], value["column"]
        runs = found.get("runs", {})
        ratios = take_ratios(runs, over, under, column) if {over, under} <= set(runs) else {}
        if not ratios:
            return PublishedRow(**shared)
        here, low, high = interval(ratios)
        first, second = (float(np.median(list(take_medians(runs, n, column).values()))) for n in (over, under))
        return PublishedRow(
            **shared,
            here=here,
            figures=(first, second),
            ends=(low, high),
            num_takes=len(ratios),
            num_seeds=min(len(set(runs[over][take]) & set(runs[under][take])) for take in ratios),
            recorded=found["recorded"],
        )


@cache
def rows() -> list[PublishedRow]:
    """Return the rows of all published tables from the committed files."""
    data = _read(PUBLISHED)
    takes = {name: _read(path) for name, path in TAKE_FILES.items() if path.exists()}
    figures = Figures(_read(BASELINE), takes, data["too_small"])
    return [figures.row(value) for value in data["rows"]]


def counts(found: Sequence[PublishedRow]) -> dict[str, int]:
    """Return the number of rows with each verdict."""
    return {name: sum(row.verdict == name for row in found) for name in VERDICTS}


def published_page() -> str:
    """Return the page of published tables with our measurements."""
    found, data = rows(), _read(PUBLISHED)
    total, judged = counts(found), [row for row in found if row.verdict == REPRODUCED] or found
    head = _HEAD.format(num_takes=min(row.num_takes for row in judged), seeds=_seeds(judged))
    parts = [head + "\n".join(f"| *{name}* ({total[name]} rows) | {text} |" for name, text in MEANINGS.items()), ""]
    parts += ["`python3 dev.py bench seeds` counts the verdicts.", "", *take_table(_read(TAKE_FILES["many_takes"]))]
    parts += [*noise_table(_read(TAKE_FILES["noise_aware"])), *network_table(_read(BASELINE))]
    parts += column_tables(data["landmark_columns"], _read(BASELINE))
    for source in dict.fromkeys(row.source for row in found):
        parts += ["", f"## {source}"]
        for table in dict.fromkeys(row.table for row in found if row.source == source):
            own = [row for row in found if (row.source, row.table) == (source, table)]
            kind = "Tables " if "," in table else "Table " if table[0].isdigit() else ""
            parts += ["", f"### {kind}{table if kind else table.capitalize()}", ""]
            if benches := list(dict.fromkeys(row.bench for row in own if row.bench)):
                parts += ["| benchmark | conditions | recorded |", "|---|---|---|"]
            for bench in benches:
                measured = [row for row in own if row.bench == bench and row.recorded]
                days = ", ".join(sorted({row.recorded for row in measured}))
                conditions = data["conditions"][bench]
                if measured and measured[0].ends is not None:
                    conditions = f"{_amount(measured)} {conditions}"
                parts.append(f"| `{bench}` | {conditions} | {days or '–'} |")
            parts += [""] if benches else []
            parts += ["| comparison | published | here | verdict |", "|---|---|---|---|", *map(_line, own)]
    return "\n".join([*parts, ""])


def take_table(results: Mapping[str, Any]) -> list[str]:
    """Return a table of every method's error in every take."""
    lines = ["## Every take", "", "Each cell is a method's MPJPE in mm on a take, as the median over noise seeds."]
    lines += ["`python -m tests.benchmarks.comparison.many_takes` measures twelve takes with three seeds each.", ""]
    return lines + _cells(results["runs"], list(results["runs"]), "mpjpe_mm")


def noise_table(results: Mapping[str, Any]) -> list[str]:
    """Return a table of the errors of marker-only fits in every take (chapter 5)."""
    lines = [
        "Fits of markers under three kinds of noise: each cell is the RMSE of joints in mm, as the median over seeds."
    ]
    lines += ["`python -m tests.benchmarks.comparison.noise_takes` measures twelve takes.", ""]
    names = [name for name in results["runs"] if ", markers, " in name and not name.endswith("ours")]
    return lines + _cells(results["runs"], names, "rmse_mm")


def _cells(runs: Mapping[str, Any], names: Sequence[str], column: str) -> list[str]:
    """Return tables of medians over seeds, with at most ``WIDEST`` methods each."""
    medians = {name: take_medians(runs, name, column) for name in names}
    takes, lines = list(dict.fromkeys(take for name in names for take in runs[name])), []
    if not names:
        return ["No take is measured yet.", ""]
    for part in (names[first : first + WIDEST] for first in range(0, len(names), WIDEST)):
        lines += [f"| take | {' | '.join(part)} |", "|---" * (len(part) + 1) + "|"]
        for take in (take for take in takes if any(take in medians[name] for name in part)):
            cells = [f"{medians[name][take]:.1f}" if take in medians[name] else "–" for name in part]
            seeds = max(len(runs[name].get(take, ())) for name in part)
            lines.append(f"| {take} ({seeds} {'seed' if seeds == 1 else 'seeds'}) | {' | '.join(cells)} |")
        lines.append("")
    return lines


def network_table(baseline: Mapping[str, Any]) -> list[str]:
    """Return absolute errors of landmark networks: rows of chapter 4, and the included network."""
    lines = ["## Landmark networks in absolute figures", "", _NETWORKS, ""]
    lines += ["| network | clouds, poses | RMSE mm | MPJPE mm | PCK1 % | PCK3 % | PCK7 % |", "|---" * 7 + "|"]
    for bench, name, prefix, clouds in NETWORKS:
        figures = baseline[bench]["figures"]
        for poses in POSES:
            keys = [f"{prefix}{poses}_{end}" for end in COLUMNS]
            if keys[0] in figures:
                cells = (f"{figures[key]['value']:.1f}" if key in figures else "–" for key in keys)
                lines.append(f"| {name} | {clouds}, {poses} | {' | '.join(cells)} |")
    return [*lines, ""]


def column_tables(data: Mapping[str, Any], baseline: Mapping[str, Any]) -> list[str]:
    """Return thesis tables 4.1 to 4.3 as ratios of each row to its base, with the published ratios in brackets.

    Args:
        data: published figures of the base (by set of poses) and of the rows. A row has its benchmark, and the prefixes
            of its own and its base's figure keys.
        baseline: figures of all benchmarks. PCK may be missing.
    """
    lines = ["Figures of each row relative to its base, with the published ratio in brackets:", ""]
    for poses in POSES:
        lines += [f"| row, {poses} poses | RMSE | MPJPE | PCK1 | PCK3 | PCK7 |", "|---" * 6 + "|"]
        for row in data["rows"]:
            figures, cells = baseline[row["bench"]]["figures"], []
            published = row["published"].get(poses, ())
            for end, over, under in zip_longest(COLUMNS, published, data["base"][poses]):
                keys = [f"{row[which]}_{poses}_{end}" for which in ("key", "base")]
                if keys[0] in figures or not end.startswith("pck"):
                    here, base = (figures[key]["value"] for key in keys)
                    cells.append(f"{here / base:.3f}" if base else "–")
                else:
                    cells.append("–")
                cells[-1] += f" ({over / under:.3f})" if over else ""
            lines.append(f"| {row['name']} | {' | '.join(cells)} |")
        lines.append("")
    return lines


def _amount(measured: Sequence[PublishedRow]) -> str:
    """Return a sentence with the numbers of takes and noise seeds of a table's rows."""
    least, most = min(row.num_takes for row in measured), max(row.num_takes for row in measured)
    return f"{least if least == most else f'{least} to {most}'} takes, {_seeds(measured)}."


def _seeds(measured: Sequence[PublishedRow]) -> str:
    least, most = min(row.num_seeds for row in measured), max(row.num_seeds for row in measured)
    return f"{least if least == most else f'{least} to {most}'} noise seed{'s' if most > 1 else ''} each"


def _line(row: PublishedRow) -> str:
    published = ", ".join(f"{ratio:.3f} ({name})" if name else f"{ratio:.3f}" for name, ratio in row.published.items())
    here = "–" if row.here is None else f"{row.here:.3f}"
    if row.ends is not None:
        here += f", {row.ends[0]:.3f} to {row.ends[1]:.3f}"
    if row.figures is not None:
        here += f" ({row.figures[0]:.4g} / {row.figures[1]:.4g})"
    if row.control is not None:
        here += f", control {row.control:.3f}"
    reason = f": {row.reason}" if row.reason and row.verdict in (CONTRADICTED, NOT_PUBLISHED, NOT_APPLICABLE) else ""
    log = f"{'' if reason else ':'} [More](../research-log/{row.log})." if row.log else ""
    return f"| {row.what} | {published or '–'} | {here} | **{row.verdict}**{reason}{log} |"


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
