"""A measured figure, and the gate that compares it with its baseline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from solver_backend.exchange.errors import MocapError


@dataclass(frozen=True)
class Metric:
    """One figure of a benchmark."""

    key: str
    """Name, unique within the benchmark."""
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    """Which way is better."""
    rel_tol: float = 0.05
    """How much worse than the baseline it may be, as a share of the baseline."""
    abs_tol: float = 0.0
    """How much worse than the baseline it may be, in its unit; added to the share."""

    def limit(self, baseline: float) -> float:
        """Return the worst value that still passes."""
        slack = self.rel_tol * abs(baseline) + self.abs_tol
        return baseline + slack if self.direction == "lower" else baseline - slack

    def passes(self, baseline: float) -> bool:
        """Say whether the figure is no worse than the baseline allows; a figure that is no number never passes."""
        if math.isnan(self.value):
            return False
        limit = self.limit(baseline)
        return self.value <= limit if self.direction == "lower" else self.value >= limit


@dataclass(frozen=True)
class Verdict:
    """A figure beside its baseline."""

    metric: Metric
    baseline: float | None
    """None where the baseline does not know the figure."""

    @property
    def passed(self) -> bool:
        """True where there is a baseline and the figure is no worse than it allows."""
        return self.baseline is not None and self.metric.passes(self.baseline)

    def line(self) -> str:
        """Return the verdict as a row of text."""
        metric = self.metric
        shown = f"{metric.key:<30} {metric.value:12.4g} {metric.unit:<8}"
        if self.baseline is None:
            return f"  ✗ {shown} no baseline; record it with --update"
        sign = "≤" if metric.direction == "lower" else "≥"
        mark = "✓" if self.passed else "✗"
        return f"  {mark} {shown} baseline {self.baseline:10.4g}, passes {sign} {metric.limit(self.baseline):.4g}"


class BenchmarkSkipped(MocapError):
    """A benchmark cannot run here; the message says what it lacks."""


def key_of(label: str) -> str:
    """Return a row's name in the baseline."""
    return "_".join("".join(c if c.isalnum() else " " for c in label.lower().replace("++", " plus")).split())


def judge(metrics: Sequence[Metric], baseline: dict[str, float]) -> tuple[list[Verdict], list[str]]:
    """Return a verdict for every figure, and the keys of the baseline that were not measured."""
    measured = {metric.key for metric in metrics}
    if len(measured) < len(metrics):
        raise ValueError("Two figures of a benchmark have the same key.")
    return [Verdict(m, baseline.get(m.key)) for m in metrics], sorted(set(baseline) - measured)
