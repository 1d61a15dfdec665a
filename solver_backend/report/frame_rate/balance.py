"""A frame rate by how people keep their balance: who stands is accelerated by leaning over the feet.

The point on the floor from which the body's weight is carried (zero moment point) lies in a sole, or between both:
``p = c - h a / (g + a_z)`` with the centre of mass c, its height h and its acceleration a. A rate that is stated k
times too high makes a ``k²`` times too large, and p flies off to where no foot is. A rate that is too low brings p
below the centre of mass, which is near the feet for most: little shows it.

Reference: Vukobratovic and Borovac 2004, "Zero-moment point: thirty five years of its life", eq. 7.
"""

from __future__ import annotations

import numpy as np

from solver_backend.io.recognition.balance import LEAST_HEIGHT, BalancePoints

G = 9.81
"""Of a fall, m/s²."""
SMOOTHING_S = 0.045
"""Standard deviation of the Gaussian that movements are smoothed with, seconds: a step lasts half a second."""
LOW_M, LOW_SHARE = 0.05, 0.1
"""A foot stands that is so little above the floor, which is where the lowest tenth of the feet's heights ends."""
RAISED_M, STILL_M, STILL_S = 0.2, 0.02, 0.1
"""So does one on its toes, whose ankle is so high and moves so little between so long before and after."""
OFF_M = 0.045
"""How far p lies from the soles, metres: the median of recorded people who walk, dance, exercise and fight."""
MOMENT_S = 0.3
"""Seconds from which to which errors are independent; chosen by hand, about a step."""
LEAST_MOMENTS = 2.0
ON_FEET = 0.5
"""Of the frames at least: who crawls or gets up leans on hands too."""
GAIN = 5.0
"""Twice the logarithm of how much likelier another rate is, from which it is a finding."""
HIGH_SHARE, LOW_RATE_SHARE = 0.42, 0.62
"""Of the misfit that a lower rate, and a higher one, may leave. A lower one must beat what lies between, too: kicks,
dances on swinging feet and animated people (the demo: 0.59) leave what they are. Slow lunges leave 0.71 and more."""
_LEAST_PULL = 3.0
"""Vertical pull at least, m/s², for somebody on the floor."""


def rate_by_balance(body: BalancePoints, fps: float, change: float) -> float | None:
    """Return the factor on the frame rate that balance shows, 1 / ``change`` or ``change``; None where it shows none.

    Args:
        body: centre of mass and soles of F frames, Z up.
        fps: frames a second as stated.
        change: factor of the rates that are compared.
    """
    misfit = {times: _misfit(body, fps, times**2) for times in (1 / change, change**-0.5, 1.0, change)}
    stated, slower, between, faster = (misfit[times] for times in (1.0, 1 / change, change**-0.5, change))
    if not np.isfinite(stated):
        return None
    if stated - slower > GAIN and slower < HIGH_SHARE * stated and slower < between:
        return 1 / change
    return change if stated - faster > GAIN and faster < LOW_RATE_SHARE * stated else None


def _misfit(body: BalancePoints, fps: float, times: float) -> float:
    """Return twice the negative logarithm of the likelihood if accelerations are so many times those of the rate.

    NaN where too little of the take is spent on the feet.
    """
    centre, *feet = (smoothed(x, SMOOTHING_S * fps) for x in (body.centre, *body.feet))
    a = np.gradient(np.gradient(centre, axis=0), axis=0) * fps**2 * times
    heights = np.stack([foot[:, 2] for foot in feet])
    floor = float(np.quantile(heights, LOW_SHARE))
    still = np.stack([_moved(foot, round(STILL_S * fps)) < STILL_M for foot in feet])
    low, h = (heights - floor < LOW_M) | (still & (heights - floor < RAISED_M)), centre[:, 2] - floor
    upright = h > LEAST_HEIGHT * body.leg
    carried = low.any(0) & upright
    end = int(3 * SMOOTHING_S * fps) + 2
    carried[:end] = carried[-end:] = False
    moments = carried.sum() / (MOMENT_S * fps)
    if moments < LEAST_MOMENTS or upright.mean() < ON_FEET:
        return float("nan")
    p = centre[:, :2] - h[:, None] * a[:, :2] / np.maximum(G + a[:, 2:], _LEAST_PULL)
    left, right = (foot[:, :2] for foot in feet)
    gap = right - left
    along = np.clip(((p - left) * gap).sum(-1) / np.maximum((gap**2).sum(-1), 1e-6), 0.0, 1.0)
    along = np.where(low[0], np.where(low[1], along, 0.0), 1.0)
    off = np.linalg.norm(p - left - along[:, None] * gap, axis=-1)[carried]
    return float(moments * (4.0 * np.log1p((off / (2.0 * OFF_M)) ** 2)).mean())


def _moved(foot: np.ndarray, reach: int) -> np.ndarray:
    """Return (F,) how far a foot moves between so many frames before and after."""
    frames, last = np.arange(len(foot)), len(foot) - 1
    reach = max(1, reach)
    return np.linalg.norm(foot[np.minimum(frames + reach, last)] - foot[np.maximum(frames - reach, 0)], axis=-1)


def smoothed(x: np.ndarray, sigma: float) -> np.ndarray:
    """Return (F, 3) convolved with a Gaussian of a standard deviation in frames, ends held."""
    reach = int(4 * sigma) + 1
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-6)) ** 2)
    padded = np.pad(x, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weight / weight.sum(), "valid") for column in padded.T], axis=1)
