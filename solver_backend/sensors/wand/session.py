"""Calibrate sensors and their clocks from wand recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import CAMERA_PARAMETERS, Adjusted
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.wand.evaluation import findings_of, held_out_errors, metric, notes_of, require_fit
from solver_backend.sensors.wand.solve import (
    LEAST_TOGETHER,
    SIGMA_PX,
    WandCalibration,
    WandOptions,
    WandTask,
    adjusted,
    cameras_at,
    depth_sigma,
    poses_by_depth,
    poses_by_lights,
    require_proportion,
    triangulated,
)
from solver_backend.sensors.wand.views import (
    Coverage,
    Moments,
    Wand,
    WandAmbiguous,
    WandNotSeen,
    WandView,
    distances,
    identified,
    in_order,
    middle_from_lights,
    values_and_velocities,
)
from solver_backend.videos.sync.clocks import Clocks, at_times, clocks_of_pairs
from solver_backend.videos.sync.signals import Signal, SyncUnknown, convolved, pair_lag
from solver_backend.videos.sync.synchronise import ROLLING_SHUTTER, in_step

RATE_HZ = 120.0
"""Rate at which speeds are compared, per second."""
PIECE_S, FLOOR_S = 6.0, 0.004
"""Length of the compared pieces, and shift of a speed's peak by perspective, in seconds."""
CLIP_SIGMAS = 3.0
"""Speeds are limited to this many standard deviations. Chosen by hand."""
SMOOTHING_S = 0.06
"""Standard deviation of the smoothing of the wand's path, in seconds."""
SLOWEST_M_S = 0.05
"""A slower wand counts as still, in m/s."""
LEAST_CORRELATION = 0.5
"""Least correlation of two speeds that is used."""
MOST_MOMENTS = 900
"""Most moments that are solved, spread over the recording."""


def flat_of(view: WandView) -> np.ndarray:
    """Return the (F, K, 2) undistorted normalised coordinates of a view."""
    return undistort(view.lens.as_camera(), view.px[None])[0]


def clocks_by_speed(views: Sequence[WandView], wand: Wand | None, reach_s: float) -> Clocks:
    """Synchronise C sensors to about a frame by the wand's speed, which is the same in all axes.

    Args:
        views: lights in the wand's order.
        wand: its lengths, which give distances where there is no depth. None for a marker with depth.

    Raises:
        SyncUnknown: a sensor's speeds agree with no other one.
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
    """Return the clocks by speed. If speeds show no offset, return equal clocks with a note."""
    names = tuple(view.name for view in views)
    interval_s = float(np.median(np.concatenate([np.diff(view.times_s) for view in views])))
    try:
        found = in_step(clocks_by_speed(views, wand, reach_s), 1.0 / interval_s)
        return replace(found, findings=tuple(item for item in found.findings if item != ROLLING_SHUTTER))
    except SyncUnknown as why:
        note = diagnostic("clocks_assumed", severity=Severity.NOTE, reason=why.message)
        return replace(Clocks.alike(names), findings=(note,))


def common_moments(views: Sequence[WandView], clocks: Clocks) -> Moments:
    """Sample all views at the first one's frames, and keep moments that two or more views saw."""
    wanted = clocks.from_video(0, views[0].times_s)
    columns = []
    for c, view in enumerate(views):
        both = np.concatenate([view.px, view.depth_or_nan[..., None]], axis=-1)
        value, rate = values_and_velocities(both, view.times_s, clocks.in_video(c, wanted))
        columns.append((value[..., :2], rate[..., :2], value[..., 2]))
    px, velocity, depth = (np.stack(part) for part in zip(*columns, strict=True))
    moments = Moments(wanted, px, velocity, depth)
    together = np.flatnonzero(moments.seen.sum(0) >= 2)
    kept = np.unique(np.linspace(0, len(together) - 1, min(MOST_MOMENTS, len(together))).astype(int))
    return moments.where(together[kept])


def _speed(view: WandView, wand: Wand | None) -> Signal:
    """Return the logarithm of the wand's smoothed speed at even times, 0 where unknown."""
    flat = flat_of(view)
    if wand is not None:
        middle = middle_from_lights(wand, flat)
    else:
        middle = np.concatenate([flat[:, 0] * view.depth_or_nan, view.depth_or_nan], axis=1)
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


MOST_CROWDED = 0.5
"""A recording is refused if a larger share of its frames has other lights. Chosen by hand."""
REACH_S = 6.5
"""Largest clock offset that is tested, in seconds."""
LATE_FRAMES = 0.25
"""Moments are sampled again if a delay is larger than this share of a frame. Chosen by hand."""


def calibrate_by_wand(
    views: Sequence[WandView], options: WandOptions = WandOptions(), progress: Progress = silent
) -> WandCalibration:
    """Return the sensors' poses by a wand that all of them saw.

    First come the clocks: given, or estimated by speed and refined by the adjustment. Then poses of pairs, by aligned
    points or by essential matrices and the wand's lengths, are chained. Then a sparse bundle adjustment refines all.

    Raises:
        WandNotSeen: a sensor, or all others together, never saw it with another one.
        WandAmbiguous: most frames have other lights.
        WandInvalid: the wand differs from the given one.

    Reference: thesis 5.3.2, "Spatial Alignment"; Gossard et al. 2024 (three lights without depth).
    """
    names = tuple(view.name for view in views)
    _require_seen(views)
    views = [view if options.wand is None else _with_lights(view, options.wand) for view in views]
    progress("Clocks of the sensors", 0, 3)
    clocks = coarse_clocks(views, options.wand, REACH_S) if options.clocks is None else options.clocks
    of_clocks = clocks.findings
    interval_s = float(np.median(np.diff(views[0].times_s)))
    # Small given offsets are treated as delays of the pictures. Larger ones are interpolated between frames.
    known = -clocks.offset_s if np.abs(clocks.offset_s).max() < LATE_FRAMES * interval_s else np.zeros(len(names))
    sampled = replace(clocks, offset_s=clocks.offset_s + known)
    moments = _moments(views, sampled, options)
    progress("Pairs of sensors", 1, 3)
    task = _task(views, moments, options, known)
    progress("All sensors at once", 2, 3)
    found, used = adjusted(task, moments)
    if task.find_delays and np.abs(found.delays).max() > LATE_FRAMES * interval_s:
        sampled = _later(sampled, found)
        moments = _moments(views, sampled, options)
        task = replace(task, cameras=found.cameras, delays=np.zeros(len(names)))
        found, used = adjusted(task, moments)
    clocks = _later(sampled, found) if task.find_delays else clocks
    require_fit(found)
    array, depth_rmse = metric(found, moments.where(used), options)
    scaled = replace(found, cameras=array.cameras)
    held_out_px, lengths = held_out_errors(task, scaled, moments.where(used), options)
    at = triangulated(array.cameras, moments, found.delays)
    together = moments.seen.astype(int) @ moments.seen.astype(int).T
    notes = (*notes_of(moments, together, names, options), *of_clocks)
    array = replace(array, findings=findings_of(views, array, clocks, options), notes=notes)
    coverage = Coverage(names, array.cameras.image_size)
    coverage.add(moments.px.mean(axis=2), at.mean(axis=1))
    return WandCalibration(array, clocks, together, len(used), held_out_px, lengths, depth_rmse, coverage)


def _require_seen(views: Sequence[WandView]) -> None:
    for view in views:
        seen = np.isfinite(view.px).all((1, 2))
        if view.crowded > MOST_CROWDED * max(len(view), 1):
            message = f"In {view.crowded} of {len(view)} frames more than one wand, or something else, was lit."
            hint = "Remove the second wand, lamps, mirrors and worn markers."
            raise WandAmbiguous(message, where=f"sensor {view.name}", hint=hint)
        if seen.sum() < LEAST_TOGETHER:
            message = f"The wand is seen in {int(seen.sum())} of {len(view)} frames."
            hint = "Check that its infrared is on, its exposure fixed, and the marker in sight."
            raise WandNotSeen(message, where=f"sensor {view.name}", hint=hint)
    if len(views) < 2:
        raise WandNotSeen(f"{len(views)} sensors saw a wand; two are needed.", where=", ".join(v.name for v in views))


def _with_lights(view: WandView, wand: Wand) -> WandView:
    """Return the view with its lights in the wand's order."""
    order, sure = identified(wand, flat_of(view), SIGMA_PX / float(view.lens.K[0, 0]))
    seen = np.isfinite(view.px).all((1, 2))
    if sure.sum() < (1.0 - MOST_CROWDED) * seen.sum():
        count = f"{int((seen & ~sure).sum())} of {int(seen.sum())} frames"
        message = f"In {count} three lights do not make a wand of {wand.first_m:.3f} and {wand.second_m:.3f} m."
        hint = "Check that no second wand or lamp is in sight, and that the wand does not point at the sensor."
        raise WandAmbiguous(message, where=f"sensor {view.name}", hint=hint)
    return replace(view, px=in_order(view.px, order, sure))


def _moments(views: Sequence[WandView], clocks: Clocks, options: WandOptions) -> Moments:
    moments = common_moments(views, clocks)
    if options.every_sensor:
        moments = moments.where(moments.seen.all(0))
    if (count := moments.px.shape[1]) < LEAST_TOGETHER:
        message = f"At {count} moments {'all' if options.every_sensor else 'two'} sensors see the wand at once."
        where = ", ".join(view.name for view in views)
        raise WandNotSeen(message, where=where, hint="Wave it where their sights overlap.")
    return moments


def _task(views: Sequence[WandView], moments: Moments, options: WandOptions, delays: np.ndarray) -> WandTask:
    names = tuple(view.name for view in views)
    rng = np.random.default_rng(0)
    still = cameras_at(views, [(np.eye(3), np.zeros(3))] * len(views))
    flat = undistort(still, moments.px)
    if options.wand is None:
        ray = np.concatenate([flat[:, :, 0], np.ones((*flat.shape[:2], 1))], axis=-1)
        depth = moments.depth_m[:, :, 0]
        focal = still.K[:, 0, 0, None]
        sigma = np.hypot(depth_sigma(depth), depth * SIGMA_PX / focal)
        poses = poses_by_depth(names, ray * depth[..., None], sigma, rng)
        return WandTask(cameras_at(views, poses), np.zeros((1, 3)), options.clocks is None, delays)
    poses = poses_by_lights(names, flat, float(np.median(still.K[:, 0, 0])), options.wand, rng)
    cameras = cameras_at(views, poses)
    require_proportion(options.wand, np.nanmedian(distances(triangulated(cameras, moments, delays)), axis=0))
    return WandTask(cameras, options.wand.lights, options.clocks is None, delays)


def _later(clocks: Clocks, found: Adjusted) -> Clocks:
    """Return the clocks with additional delays δ: a late sensor shows at t what happened at ``t + δ``."""
    count = len(found.cameras)
    variance = np.diag(found.covariance).reshape(count, CAMERA_PARAMETERS)[:, -1]
    covariance = np.zeros((count, 2, 2))
    covariance[:, 0, 0] = variance
    return replace(clocks, offset_s=clocks.offset_s - found.delays, covariance=covariance, method="the wand's movement")
