"""Whether a motion's frame rate can be: whoever stands on the floor is accelerated by leaning over the feet.

The point on the floor from which the body's weight is carried (zero moment point) lies in a sole, or between both:
``p = c - h a / (g + a_z)`` with the centre of mass c, its height h and its acceleration a. A rate that is stated k
times too high makes a ``k²`` times too large, and p flies off to where no foot is. A rate that is too low brings p
below the centre of mass, which is near the feet for most: little shows it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.recognition.balance import LEAST_HEIGHT, BalancePoints, body_points
from solver_backend.types import JointSet, Motion

G = 9.81
"""Of a fall, m/s²."""
SMOOTHING_S = 0.045
"""Standard deviation of the Gaussian that movements are smoothed with, seconds: a step lasts half a second."""
LOW_M, LOW_SHARE = 0.05, 0.1
"""A foot stands that is so little above the floor, which is where the lowest tenth of the feet's heights ends."""
OFF_M = 0.045
"""How far p lies from the soles, metres: the median of recorded people who walk, dance, exercise and fight."""
MOMENT_S = 0.3
"""Seconds from which to which errors are independent; chosen by hand, about a step."""
LEAST_MOMENTS = 2.0
CHANGE = 2.0
"""Factor of the rates that are compared: 60 for 30 and 120 frames a second; slow motion is beyond."""
GAIN = 5.0
"""Twice the logarithm of how much likelier another rate is, from which it is a finding."""
SHARE = 0.42
"""Of the misfit that a lower rate may leave, and one between must leave more: kicks, dances on swinging feet and
animated people (the demo: 0.59) leave what they are. With both, two of 229 recorded clips are false alarms."""
_LEAST_PULL = 3.0
"""Vertical pull at least, m/s², for somebody on the floor."""
_STANCE = JointSet.COCO_17
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


def frame_rate_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield that the frame rate is about twice or half of what the movement shows.

    Args:
        motion: F frames of a person in metres, Z up.

    Reference: Vukobratovic and Borovac 2004, "Zero-moment point: thirty five years of its life", eq. 7.
    """
    names = [f"{side}_{limb}" for limb in _LIMBS for side in ("left", "right")]
    known = motion.body_layout.joints
    if not set(names) <= set(known) or motion.num_frames < 2:
        return
    columns = [known.index(name) for name in names]
    if motion.resting is not None and motion.resting[:, columns].any():
        return
    points = np.full((motion.num_frames, len(_STANCE.keypoints), 3), np.nan)
    points[:, [_STANCE.keypoints.index(name) for name in names]] = motion.joints[:, columns]
    factor = likely_rate(body_points(points, _STANCE), motion.fps)
    if factor != 1.0:
        way = "low" if factor > 1 else "high"
        yield diagnostic("frame_rate_implausible", rate=motion.fps, way=way, likely=motion.fps * factor)


def likely_rate(body: BalancePoints, fps: float) -> float:
    """Return the factor on the frame rate that the movement shows: 1 / ``CHANGE``, 1 or ``CHANGE``.

    Args:
        body: centre of mass and soles of F frames, Z up.
        fps: frames a second as stated.
    """
    misfit = {change: _misfit(body, fps, change**2) for change in (CHANGE**-1, CHANGE**-0.5, 1.0, CHANGE)}
    if not np.isfinite(misfit[1.0]):
        return 1.0
    slower = misfit[CHANGE**-1]
    between = misfit[CHANGE**-0.5]
    if misfit[1.0] - slower > GAIN and slower < SHARE * misfit[1.0] and slower < between:
        return CHANGE**-1
    return CHANGE if misfit[1.0] - misfit[CHANGE] > GAIN else 1.0


def _misfit(body: BalancePoints, fps: float, times: float) -> float:
    """Return twice the negative logarithm of the likelihood if accelerations are so many times those of the rate.

    NaN where too little of the take is spent on the feet.
    """
    centre, *feet = (_smoothed(x, SMOOTHING_S * fps) for x in (body.centre, *body.feet))
    a = np.gradient(np.gradient(centre, axis=0), axis=0) * fps**2 * times
    heights = np.stack([foot[:, 2] for foot in feet])
    floor = float(np.quantile(heights, LOW_SHARE))
    low, h = heights - floor < LOW_M, centre[:, 2] - floor
    carried = low.any(0) & (h > LEAST_HEIGHT * body.leg)
    end = int(3 * SMOOTHING_S * fps) + 2
    carried[:end] = carried[-end:] = False
    moments = carried.sum() / (MOMENT_S * fps)
    if moments < LEAST_MOMENTS:
        return float("nan")
    p = centre[:, :2] - h[:, None] * a[:, :2] / np.maximum(G + a[:, 2:], _LEAST_PULL)
    left, right = (foot[:, :2] for foot in feet)
    gap = right - left
    along = np.clip(((p - left) * gap).sum(-1) / np.maximum((gap**2).sum(-1), 1e-6), 0.0, 1.0)
    along = np.where(low[0], np.where(low[1], along, 0.0), 1.0)
    off = np.linalg.norm(p - left - along[:, None] * gap, axis=-1)[carried]
    return float(moments * (4.0 * np.log1p((off / (2.0 * OFF_M)) ** 2)).mean())


def _smoothed(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return (F, 3) convolved with a Gaussian of a standard deviation in frames, ends held."""
    reach = int(4 * sigma) + 1
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-6)) ** 2)
    padded = np.pad(x, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weight / weight.sum(), "valid") for column in padded.T], axis=1)
