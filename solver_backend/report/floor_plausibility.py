"""What feet show of the floor: under it, over it, sliding on it, or elsewhere at the take's end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.metrics import foot_skating_cm_per_frame
from solver_backend.types import Motion

BELOW_FLOOR_M, ABOVE_FLOOR_M = 0.05, 0.25
"""Height of a foot joint, under the floor and over it, beyond which the floor is doubted."""
DRIFT_M, DRIFT_ENDS_S = 0.5, 0.5
"""Metres by which the lowest joint is elsewhere in the last half second than in the first."""
SKATING_CM_S = 15.0
"""Of feet on the floor."""


def floor_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield what is doubtful of feet that are seen throughout."""
    feet = joints_of(motion, "left_foot", "right_foot")
    if feet is None or rests(motion, "left_foot", "right_foot"):
        return
    lowest = feet[..., 2].min(axis=1)
    yield from _drift(motion)
    below, usual = -float(lowest.min()), float(np.median(lowest))
    if below > BELOW_FLOOR_M:
        code = "floor_too_high" if usual < -BELOW_FLOOR_M else "foot_below_floor"
        yield diagnostic(code, size=100 * below)
    if usual > ABOVE_FLOOR_M:
        yield diagnostic("feet_above_floor", size=100 * usual)
    skating = foot_skating_cm_per_frame(feet)
    if skating * motion.fps > SKATING_CM_S and usual > -BELOW_FLOOR_M:  # else they seem on the floor all the time
        yield diagnostic("feet_slide", size=skating)


def joints_of(motion: Motion, *names: str) -> np.ndarray | None:
    """Return (F, N, 3) joints by name, None where the motion's body lacks one."""
    known = motion.body_layout.joints
    return motion.joints[:, [known.index(name) for name in names]] if set(names) <= set(known) else None


def rests(motion: Motion, *names: str) -> bool:
    """Return whether one of these joints is at rest in some frame."""
    columns = [motion.body_layout.joints.index(name) for name in names]
    return motion.resting is not None and bool(motion.resting[:, columns].any())


def _drift(motion: Motion) -> Iterator[Diagnostic]:
    """Another height of the body's lowest joint at the take's end than at its beginning: a floor does not move."""
    lowest, ends = motion.joints[..., 2].min(axis=1), max(1, round(DRIFT_ENDS_S * motion.fps))
    change = float(lowest[-ends:].min() - lowest[:ends].min())
    if len(lowest) > 2 * ends and abs(change) > DRIFT_M:
        yield diagnostic("take_drifts", size=abs(change), way="sinks" if change < 0 else "rises")
