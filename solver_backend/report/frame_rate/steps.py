"""A frame rate by how people walk and run.

A leg swings like a pendulum, and longer steps are quicker ones: people keep the *walk ratio*, step length over cadence,
over all speeds they choose. Both are measured in the leg's own length l and time ``u = sqrt(l / g)``. A rate that is
stated k times too high divides both by k. Runs have no such ratio, but whoever runs falls between the steps, k² times
as fast.

Reference: Sekiya and Nagasaki 1998, "Reproducibility of the walking patterns of normal young adults" (walk ratio);
Mochon and McMahon 1980, "Ballistic walking" (swing of the leg).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver_backend.geometry.runs import true_runs
from solver_backend.report.frame_rate.balance import G, smoothed

SMOOTHING_S = 0.03
"""Standard deviation of the Gaussian by which places are smoothed, seconds: a step lasts half a second."""
TURNING_SHARE = 0.5
"""Of the usual distance between the feet, by which they must come back before a step has ended."""
LEAST_STEP, LEAST_HEIGHT = 0.5, 0.8
"""Of a step, and of the hips over the lower ankle, in lengths of the leg: shuffling, kneeling, sitting are no walk."""
LEAST_BESIDE, SIDEWAYS, MOST_TURN = 0.25, 0.3, 35.0
"""Distance between the feet at a step's ends, and the hips' way sideways, against their way ahead; and degrees by which
they turn in a step."""
WALK_SHARE = 0.78
"""Distance between the feet against the hips' way from which it is a walk: recorded walks have 0.83 to 0.98, runs,
which fly between the steps, 0.58 to 0.76."""
WALK_STEPS, EVEN = 3, 0.15
"""Steps in a row, and how much their times vary at most (standard deviation over mean)."""
FASTEST = 0.97
"""Quantile of the speeds of a foot that counts as its fastest."""
RUN_STEPS, RUN_STEP, RUN_SHARE = 2, 0.95, 0.74
"""The same of runs: steps in a row, the least step in lengths of the leg, the most of the distance between the feet."""
SWINGS, RATIOS = (0.9, 2.0), (1.0, 2.2)
"""In u, and in l u: recorded walks (CMU, subjects 1 to 49) have 1.05 to 1.7 and 1.04 to 3.0, the most by somebody who
strode slowly. Both must be outside for a rate to be another."""
RUN_FALLS, RUN_TIMES = (0.36, 1.4), (0.72, 1.5)
"""The fastest fall between running steps in g, and their time in u; both must be outside, too. Recorded runs (the same
people) have 0.58 to 1.0 and 0.78 to 1.4."""


@dataclass(frozen=True)
class Gait:
    """What the steps of a take show; NaN where there are none. ``u = sqrt(l / g)`` for a leg's length l."""

    walked: int
    """How many steps are a walk's."""
    swing: float
    """Time of a leg's swing in u, the median."""
    ratio: float
    """Walk ratio in l u, the median."""
    run: int
    """How many steps are a run's."""
    fall: float
    """The fastest fall between them in g, the median."""
    time: float
    """Of a running step in u, the median."""


@dataclass(frozen=True)
class _Tracks:
    """Smoothed places of F frames."""

    centre: np.ndarray
    """(F, 3) between the hips."""
    feet: np.ndarray
    """(2, F, 3) ankles."""
    ahead: np.ndarray
    """(F, 3) where the hips face, level."""
    apart: np.ndarray
    """(F,) how far the left foot is before the right one."""
    leg: float
    """Length of a leg."""


def gait_of(hips: np.ndarray, knees: np.ndarray, ankles: np.ndarray, centre_of_mass: np.ndarray, fps: float) -> Gait:
    """Return what the steps of F frames show.

    Args:
        hips, knees, ankles: (2, F, 3) of the left and the right, metres, Z up.
        centre_of_mass: (F, 3).
        fps: frames a second as stated.
    """
    sigma = SMOOTHING_S * fps
    tracks = _tracks(hips, knees, ankles, sigma)
    ends = turning_points(tracks.apart)
    good = np.array([_is_step(tracks, a, b) for a, b in pairwise(ends)], bool)
    rows = [ends[a : b + 2] for a, b in true_runs(good)]
    falls = -np.gradient(np.gradient(smoothed(centre_of_mass, sigma)[:, 2])) * fps**2 / G
    walk = [found for row in rows if (found := _walked(tracks, row, fps)) is not None]
    run = [found for row in rows if (found := _run(tracks, falls, row, fps)) is not None]
    u = float(np.sqrt(tracks.leg / G))
    walked, swing, length_time = _medians(walk)
    ran, fall, time = _medians(run)
    return Gait(walked, swing / u, length_time / (tracks.leg * u), ran, fall, time / u)


def rate_by_walk(gait: Gait, change: float) -> float | None:
    """Return the factor on the frame rate that a walk shows: 1 / ``change``, 1 or ``change``; None where none.

    Args:
        gait: of a take.
        change: factor of the rates that are compared.
    """
    return _agreed(((gait.swing, 1, SWINGS), (gait.ratio, 1, RATIOS)), change)


def rate_by_run(gait: Gait, change: float) -> float | None:
    """Return the same of a run."""
    return _agreed(((gait.fall, -2, RUN_FALLS), (gait.time, 1, RUN_TIMES)), change)


def _agreed(figures: Sequence[tuple[float, int, tuple[float, float]]], change: float) -> float | None:
    """Return the factor under which all figures are what people have, 1 if some but not all are: that shows nothing.

    Args:
        figures: value, the power of time that it grows with, and what people have.
        change: factor of the rates that are compared.
    """

    def fit(factor: float) -> list[bool]:
        return [low <= value / factor**power <= high for value, power, (low, high) in figures]

    if any(fit(1.0)):
        return 1.0 if all(fit(1.0)) else None
    return next((factor for factor in (1 / change, change) if all(fit(factor))), None)


def _tracks(hips: np.ndarray, knees: np.ndarray, ankles: np.ndarray, sigma: float) -> _Tracks:
    leg = float(np.median(np.linalg.norm(hips - knees, axis=-1) + np.linalg.norm(knees - ankles, axis=-1)))
    hips, feet = (np.stack([smoothed(side, sigma) for side in both]) for both in (hips, ankles))
    ahead = np.cross(hips[0] - hips[1], (0.0, 0.0, 1.0))
    ahead /= np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    return _Tracks(hips.mean(0), feet, ahead, ((feet[0] - feet[1]) * ahead).sum(-1), max(leg, 1e-9))


def _is_step(tracks: _Tracks, a: int, b: int) -> bool:
    """Return whether somebody steps ahead on their feet between two frames."""
    heading = tracks.ahead[a : b + 1].mean(0)[:2]
    heading = heading / max(float(np.linalg.norm(heading)), 1e-9)
    way = (tracks.centre[b] - tracks.centre[a])[:2]
    forward, aside = float(way @ heading), abs(float(way @ (-heading[1], heading[0])))
    height = float(tracks.centre[a : b + 1, 2].mean() - tracks.feet[:, a : b + 1, 2].min())
    turn = float(np.degrees(np.arccos(np.clip(tracks.ahead[a] @ tracks.ahead[b], -1.0, 1.0))))
    before, after = float(tracks.apart[a]), float(tracks.apart[b])
    ahead = forward > LEAST_STEP * tracks.leg and aside < SIDEWAYS * forward and turn < MOST_TURN
    apart = before * after < 0 and min(abs(before), abs(after)) > LEAST_BESIDE * forward
    return ahead and apart and height > LEAST_HEIGHT * tracks.leg


def _walked(tracks: _Tracks, ends: np.ndarray, fps: float) -> tuple[int, float, float] | None:
    """Return number, time of swing (s) and length times time (m s) of even steps that are a walk, else None.

    A foot that always was as fast as at its fastest would go the length of two steps in the time of its swing.
    """
    times, lengths, share = _steps(tracks, ends, fps)
    if len(times) < WALK_STEPS or times.std() > EVEN * times.mean() or share < WALK_SHARE:
        return None
    part = tracks.feet[:, ends[0] : ends[-1] + 1]
    speeds = np.linalg.norm(np.gradient(part, axis=1), axis=-1) * fps
    fastest = float(np.quantile(speeds, FASTEST, axis=1).mean())
    return len(times), float(2 * lengths.mean() / fastest), float(lengths.mean() * times.mean())


def _run(tracks: _Tracks, falls: np.ndarray, ends: np.ndarray, fps: float) -> tuple[int, float, float] | None:
    """Return number, fastest fall (g) and time (s) of even steps that are a run, else None."""
    times, lengths, share = _steps(tracks, ends, fps)
    short = lengths.mean() < RUN_STEP * tracks.leg
    if len(times) < RUN_STEPS or times.std() > EVEN * times.mean() or share > RUN_SHARE or short:
        return None
    fastest = [falls[a : b + 1].max() for a, b in pairwise(ends)]
    return len(times), float(np.median(fastest)), float(times.mean())


def _steps(tracks: _Tracks, ends: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return times (s) and lengths (m) of steps, and the distance between the feet at their ends against the length."""
    lengths = np.linalg.norm(np.diff(tracks.centre[ends, :2], axis=0), axis=-1)
    return np.diff(ends) / fps, lengths, float(np.abs(tracks.apart[ends]).mean() / max(lengths.mean(), 1e-9))


def _medians(found: list[tuple[int, float, float]]) -> tuple[int, float, float]:
    """Return the number of all steps and the medians over them."""
    if not found:
        return 0, float("nan"), float("nan")
    steps, first, second = (np.array(column) for column in zip(*found, strict=True))
    return int(steps.sum()), float(np.median(np.repeat(first, steps))), float(np.median(np.repeat(second, steps)))


def turning_points(x: np.ndarray) -> np.ndarray:
    """Return the frames in which (F,) values turn, small ones left out."""
    least = TURNING_SHARE * float(np.quantile(np.abs(x - np.median(x)), 0.9))
    found: list[int] = []
    top = bottom = 0
    rising: bool | None = None
    for f, value in enumerate(x.tolist()):
        top, bottom = (f if value > x[top] else top), (f if value < x[bottom] else bottom)
        if rising is not False and x[top] - value > least:
            found += [top] if rising else []
            rising, bottom = False, f
        elif rising is not True and value - x[bottom] > least:
            found += [] if rising is None else [bottom]
            rising, top = True, f
    return np.array(found, int)
