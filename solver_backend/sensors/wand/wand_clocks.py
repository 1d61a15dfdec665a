"""How the clocks of sensors differ, from how fast each of them sees the wand move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.sensors.wand.interpolation import values_and_velocities
from solver_backend.sensors.wand.leds import Wand, middle_from_lights
from solver_backend.sensors.wand.views import Moments, WandView
from solver_backend.videos.sync.clocks import Clocks
from solver_backend.videos.sync.convolution import convolved
from solver_backend.videos.sync.errors import SyncUnknown
from solver_backend.videos.sync.graph import clocks_of_pairs
from solver_backend.videos.sync.resample import at_times
from solver_backend.videos.sync.signals import Signal, pair_lag
from solver_backend.videos.sync.synchronise import ROLLING_SHUTTER, in_step

RATE_HZ = 120.0
"""Speeds are compared at so many moments a second."""
PIECE_S, FLOOR_S = 6.0, 0.004
"""Length of the pieces that are compared, and how far perspective shifts the peak of a speed."""
CLIP_SIGMAS = 3.0
SMOOTHING_S = 0.06
"""Standard deviation of the smoothing of the wand's way."""
SLOWEST_M_S = 0.05
"""A wand this slow stands."""
LEAST_CORRELATION = 0.5
"""Pairs whose speeds agree less carry no information."""
MOST_MOMENTS = 900
"""Moments that are solved, spread over the recording."""


def flat_of(view: WandView) -> np.ndarray:
    """Return (F, K, 2) undistorted normalised coordinates of what a view saw."""
    return undistort(view.lens.as_camera(), view.px[None])[0]


def clocks_by_speed(views: Sequence[WandView], wand: Wand | None, reach_s: float) -> Clocks:
    """Return the clocks of sensors that saw one wand, to about a frame, by its speed: the same in everybody's axes.

    Args:
        views: of C sensors, lights in the wand's order.
        wand: its lengths, which give distances where there is no depth; None for a marker with depth.
        reach_s: largest offset looked for.

    Raises:
        SyncUnknown: the speeds of a sensor agree with nobody's.
    """
    names = tuple(view.name for view in views)
    signals = [_speed(view, wand) for view in views]
    pairs = {}
    for i, j in combinations(range(len(views)), 2):
        found = pair_lag(signals[i], signals[j], reach_s=reach_s, piece_s=PIECE_S, floor_s=FLOOR_S)
        if found is not None and found.correlation > LEAST_CORRELATION:
            pairs[i, j] = found
    return clocks_of_pairs(names, pairs, "the wand's speed")


def coarse_clocks(views: Sequence[WandView], wand: Wand | None, reach_s: float) -> Clocks:
    """Return the clocks by speed; alike, with a word, where speeds show nothing or no more than that."""
    names = tuple(view.name for view in views)
    interval_s = float(np.median(np.concatenate([np.diff(view.times_s) for view in views])))
    try:
        found = in_step(clocks_by_speed(views, wand, reach_s), 1.0 / interval_s)
        return replace(found, findings=tuple(item for item in found.findings if item != ROLLING_SHUTTER))
    except SyncUnknown as why:
        return replace(Clocks.alike(names), findings=(diagnostic("wand_clocks_assumed", reason=why.message),))


def common_moments(views: Sequence[WandView], clocks: Clocks) -> Moments:
    """Return what all views saw at the first one's frames, those moments that two or more views saw."""
    wanted = clocks.from_video(0, views[0].times_s)
    columns = []
    for c, view in enumerate(views):
        depth = np.full(view.px.shape[:2], np.nan) if view.depth_m is None else view.depth_m
        both = np.concatenate([view.px, depth[..., None]], axis=-1)
        value, rate = values_and_velocities(both, view.times_s, clocks.in_video(c, wanted))
        columns.append((value[..., :2], rate[..., :2], value[..., 2]))
    px, velocity, depth = (np.stack(part) for part in zip(*columns, strict=True))
    moments = Moments(wanted, px, velocity, depth)
    together = np.flatnonzero(moments.seen.sum(0) >= 2)
    kept = np.unique(np.linspace(0, len(together) - 1, min(MOST_MOMENTS, len(together))).astype(int))
    return moments.where(together[kept])


def _speed(view: WandView, wand: Wand | None) -> Signal:
    """Return the logarithm of the wand's smoothed speed at even times, 0 where it is not known."""
    flat = flat_of(view)
    if wand is not None:
        middle = middle_from_lights(wand, flat)
    else:
        depth = np.full(view.px.shape[:2], np.nan) if view.depth_m is None else view.depth_m
        middle = np.concatenate([flat[:, 0] * depth, depth], axis=1)
    count = int((view.times_s[-1] - view.times_s[0]) * RATE_HZ) + 1
    wanted = view.times_s[0] + np.arange(count) / RATE_HZ
    located = np.isfinite(middle).all(1)
    place = at_times(middle[located], view.times_s[located], wanted)
    known = np.isfinite(place).all(1)
    reach = max(round(3 * SMOOTHING_S * RATE_HZ), 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (SMOOTHING_S * RATE_HZ)) ** 2)
    total, share = (convolved(a, kernel) for a in (np.where(known[:, None], place, 0.0), known.astype(float)))
    smooth = np.where((share > 0.5 * kernel.sum())[:, None], total / np.maximum(share, 1e-9)[:, None], np.nan)
    speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=-1) * RATE_HZ
    known = np.isfinite(speed)
    if known.sum() < 2:
        return Signal(np.zeros((count, 1)), RATE_HZ, float(view.times_s[0]))
    loud = np.log(np.maximum(np.where(known, speed, SLOWEST_M_S), SLOWEST_M_S))
    loud = np.where(known, loud - loud[known].mean(), 0.0)
    spread = float(loud[known].std())
    return Signal(np.clip(loud, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)[:, None], RATE_HZ, float(view.times_s[0]))
