"""A measured figure, and its comparison with a baseline."""

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
    """Better direction."""
    rel_tol: float = 0.05
    """Allowed worsening relative to the baseline."""
    abs_tol: float = 0.0
    """Allowed additional worsening in the figure's unit."""

    def limit(self, baseline: float) -> float:
        """Return the worst value that still passes."""
        slack = self.rel_tol * abs(baseline) + self.abs_tol
        return baseline + slack if self.direction == "lower" else baseline - slack

    def passes(self, baseline: float) -> bool:
        """Return whether the figure is no worse than the baseline allows. NaN never passes."""
        if math.isnan(self.value):
            return False
        limit = self.limit(baseline)
        return self.value <= limit if self.direction == "lower" else self.value >= limit


@dataclass(frozen=True)
class Verdict:
    """A figure with its baseline."""

    metric: Metric
    baseline: float | None
    """None if the baseline does not have the figure."""

    @property
    def passed(self) -> bool:
        """True if there is a baseline and the figure is no worse than it allows."""
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
    """A benchmark cannot run here. The message states the missing requirement."""


def key_of(label: str) -> str:
    """Return a row's name in the baseline."""
    return "_".join("".join(c if c.isalnum() else " " for c in label.lower().replace("++", " plus")).split())


def judge(metrics: Sequence[Metric], baseline: dict[str, float]) -> tuple[list[Verdict], list[str]]:
    """Return a verdict for every figure, and the baseline's keys that were not measured."""
    measured = {metric.key for metric in metrics}
    if len(measured) < len(metrics):
        raise ValueError("Two figures of a benchmark have the same key.")
    return [Verdict(m, baseline.get(m.key)) for m in metrics], sorted(set(baseline) - measured)
