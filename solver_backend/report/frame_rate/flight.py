"""A frame rate by how people fall: while nothing carries them, their centre of mass falls with 9.81 m/s².

A rate that is stated k times too high makes a fall k² times as fast.
"""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.runs import true_runs
from solver_backend.io.recognition.balance import BalancePoints
from solver_backend.report.frame_rate.balance import G

OFF_FLOOR_M, FLOOR_QUANTILE = 0.1, 0.25
"""A sole is in the air from this height over the floor, which is at this quantile of the lower sole's heights: heels
rise, and floors are known to centimetres."""
LEAST_FRAMES, LEAST_SAG_M = 6, 0.08
"""A flight has so many frames, and leaves its chord by so much at the middle."""
MISFIT = 0.04
"""Root mean square distance from a parabola, of the sag: recorded flights have 0.003 to 0.03; whoever climbs, sits
or turns a cartwheel 0.03 and more."""
LEAST_LEVEL = 0.7
"""Cosine of the trunk with up over a flight: a cartwheel stands on its hands."""
FALLS = 0.75, 1.35
"""Of g, flights that are as stated: recorded ones reach 0.92 to 1.21."""


def falls_of(body: BalancePoints, upright: np.ndarray, fps: float) -> np.ndarray:
    """Return the accelerations of flights, in g.

    Args:
        body: centre of mass and soles of F frames, metres, Z up.
        upright: (F,) cosine of the trunk with up.
        fps: frames a second as stated.
    """
    if len(body.centre) < LEAST_FRAMES:
        return np.empty(0)
    lower = body.feet[:, :, 2].min(0)
    air = lower > np.quantile(lower, FLOOR_QUANTILE) + OFF_FLOOR_M
    found = []
    for first, last in true_runs(air):
        if first == 0 or last == len(air) - 1 or last - first + 1 < LEAST_FRAMES:
            continue
        span = slice(first, last + 1)
        if upright[span].min() > LEAST_LEVEL:
            found += _fall(body.centre[span, 2], fps)
    return np.array(found)


def _fall(height: np.ndarray, fps: float) -> list[float]:
    """Return the acceleration of a flight in g; nothing where it is no parabola."""
    t = (np.arange(len(height)) - 0.5 * (len(height) - 1)) / fps
    parabola = np.polyfit(t, height, 2)
    sag = -float(parabola[0]) * t[-1] ** 2
    off = float(np.sqrt(np.mean((np.polyval(parabola, t) - height) ** 2)))
    return [-2 * float(parabola[0]) / G] if sag > LEAST_SAG_M and off < MISFIT * sag else []


def rate_by_flight(falls: np.ndarray, change: float) -> float | None:
    """Return the factor on the frame rate that flights show: 1 / ``change``, 1, ``change``, None where there are none.

    Args:
        falls: accelerations of flights, in g.
        change: factor of the rates that are compared.
    """
    if not len(falls):
        return None
    fall = float(np.median(falls))
    for factor in (1.0, 1 / change, change):
        if FALLS[0] <= fall * factor**2 <= FALLS[1]:
            return factor
    return None
