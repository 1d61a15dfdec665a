"""Find a step length that satisfies the strong Wolfe conditions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

Payload = TypeVar("Payload")


@dataclass(frozen=True)
class WolfeSettings:
    """Strong Wolfe conditions for a step, and limits of the search."""

    decrease: float = 1e-4  # Fraction c1 of the predicted decrease that must be achieved (Armijo).
    curvature: float = 0.9  # Fraction c2 of the initial slope that may remain.
    max_evaluations: int = 25  # Largest number of trials.
    growth: float = 2.5  # Factor applied to the step while it is too short.


@dataclass(frozen=True)
class StepTrial(Generic[Payload]):
    """Cost and slope after one trial step along a line."""

    step: float
    cost: float
    slope: float  # Derivative of the cost w.r.t. the step.
    payload: Payload  # Result of the evaluation, for the caller.


def strong_wolfe(
    evaluate: Callable[[float], StepTrial[Payload]],
    start: StepTrial[Payload],
    first: float,
    settings: WolfeSettings = WolfeSettings(),
) -> tuple[StepTrial[Payload], bool, int]:
    """Find a step a with ``f(a) <= f(0) + c1 a f'(0)`` and ``|f'(a)| <= c2 |f'(0)|``.

    The step grows until an interval brackets such a point. The interval then shrinks by safeguarded cubic
    interpolation. A cost that is not finite means that the step is too long.

    Args:
        evaluate: maps a step length to a trial.
        start: trial at step 0, with a negative slope.
        first: first step length to try.
        settings: the constants c1 and c2, and limits.

    Returns:
        The trial, whether it satisfies both conditions, and the number of evaluations. If no trial does, it
            is the best trial with sufficient decrease, or ``start``.

    Reference: Nocedal and Wright 2006, "Numerical Optimization", algorithms 3.5 and 3.6.
    """

    def enough(trial: StepTrial[Payload]) -> bool:
        target = start.cost + settings.decrease * trial.step * start.slope
        return math.isfinite(trial.cost) and math.isfinite(trial.slope) and trial.cost <= target

    def flat(trial: StepTrial[Payload]) -> bool:
        return abs(trial.slope) <= -settings.curvature * start.slope

    low, high, step, count = start, None, first, 0
    for count in range(1, settings.max_evaluations + 1):
        trial = evaluate(step)
        if not enough(trial) or (low.step > 0 and trial.cost >= low.cost):
            high = trial
        elif flat(trial):
            return trial, True, count
        else:
            if high is None:
                high = low if trial.slope >= 0 else None
            elif trial.slope * (high.step - low.step) >= 0:
                high = low
            low = trial
        step = settings.growth * step if high is None else _between(low, high)
        if high is not None and abs(high.step - low.step) <= 1e-14 * max(abs(high.step), abs(low.step)):
            break
    return low, False, count


def _between(low: StepTrial[Payload], high: StepTrial[Payload]) -> float:
    """Return the minimum of the cubic through two trials, at least 10 % of the interval from its ends."""
    width = high.step - low.step
    middle = low.step + 0.5 * width
    if not (math.isfinite(high.cost) and math.isfinite(high.slope)):
        return low.step + 0.1 * width
    d1 = low.slope + high.slope - 3.0 * (high.cost - low.cost) / width
    square = d1 * d1 - low.slope * high.slope
    if square < 0:
        return middle
    d2 = math.copysign(math.sqrt(square), width)
    bottom = high.slope - low.slope + 2.0 * d2
    if bottom == 0:
        return middle
    share = 1.0 - (high.slope + d2 - d1) / bottom
    return low.step + min(max(share, 0.1), 0.9) * width
