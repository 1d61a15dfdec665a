"""Whether a motion's frame rate can be: by how people walk, run, fall and keep their balance, where they do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.recognition.balance import body_points
from solver_backend.report.frame_rate.balance import rate_by_balance
from solver_backend.report.frame_rate.flight import falls_of, rate_by_flight
from solver_backend.report.frame_rate.steps import gait_of, rate_by_run, rate_by_walk
from solver_backend.types import JointSet, Motion

CHANGE = 2.0
"""Factor of the rates that are compared: 60 for 30 and 120 frames a second; slow motion is beyond."""
_STANCE = JointSet.COCO_17
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_SHOWN_BY = ("walk", "run", "fall", "balance")
"""What people do so, as the warning puts it; what shows a rate best comes first."""


def frame_rate_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield that the frame rate is about twice or half of what the movement shows.

    Args:
        motion: F frames of a person in metres, Z up.
    """
    factor, movement = motion_rate(motion)
    if factor != 1.0:
        way = "low" if factor > 1 else "high"
        yield diagnostic(
            "frame_rate_implausible", rate=motion.fps, way=way, movement=movement, likely=motion.fps * factor
        )


def motion_rate(motion: Motion) -> tuple[float, str]:
    """Return what ``shown_rate`` shows of a motion; nothing of one that lacks a limb or lets one rest."""
    names = [f"{side}_{limb}" for limb in _LIMBS for side in ("left", "right")]
    known = motion.body_layout.joints
    if not set(names) <= set(known) or motion.num_frames < 2:
        return 1.0, ""
    columns = [known.index(name) for name in names]
    if motion.resting is not None and motion.resting[:, columns].any():
        return 1.0, ""
    points = np.full((motion.num_frames, len(_STANCE.keypoints), 3), np.nan)
    points[:, [_STANCE.keypoints.index(name) for name in names]] = motion.joints[:, columns]
    return shown_rate(points, motion.fps)


def shown_rate(points: np.ndarray, fps: float) -> tuple[float, str]:
    """Return the factor on the frame rate that a movement shows (1 / ``CHANGE``, 1 or ``CHANGE``), and what shows it.

    Walks, runs and falls show the rate as stated, too, which clears it; where two contradict each other, it stays.

    Args:
        points: (F, 17, 3) of COCO's limbs, metres, Z up.
        fps: frames a second as stated.
    """
    hips, knees, ankles, shoulders = (_both(points, limb) for limb in ("hip", "knee", "ankle", "shoulder"))
    if not np.isfinite([hips, knees, ankles, shoulders]).all():
        return 1.0, ""
    body, trunk = body_points(points, _STANCE), shoulders.mean(0) - hips.mean(0)
    upright = trunk[:, 2] / np.maximum(np.linalg.norm(trunk, axis=-1), 1e-9)
    gait = gait_of(hips, knees, ankles, body.centre, fps)
    found = (
        rate_by_walk(gait, CHANGE),
        rate_by_run(gait, CHANGE),
        rate_by_flight(falls_of(body, upright, fps), CHANGE),
        rate_by_balance(body, fps, CHANGE),
    )
    shown = {factor: by for factor, by in zip(reversed(found), reversed(_SHOWN_BY), strict=True) if factor is not None}
    return next(iter(shown.items())) if len(shown) == 1 else (1.0, "")


def _both(points: np.ndarray, limb: str) -> np.ndarray:
    """Return (2, F, 3) of the left and the right."""
    return np.stack([points[:, _STANCE.keypoints.index(f"{side}_{limb}")] for side in ("left", "right")])
