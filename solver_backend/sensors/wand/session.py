"""The calibration of a sensor array from a wand: by one marker and depth, or by three lights of known lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.camera_calibration.adjustment.problem import CAMERA_PARAMETERS, Adjusted
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.wand.coverage import coverage_of
from solver_backend.sensors.wand.depth_scale import depth_sigma
from solver_backend.sensors.wand.errors import WandAmbiguous, WandNotSeen
from solver_backend.sensors.wand.evaluation import findings_of, held_out_errors, metric, notes_of, require_fit
from solver_backend.sensors.wand.leds import Wand, distances, identified, in_order
from solver_backend.sensors.wand.result import WandCalibration, WandOptions
from solver_backend.sensors.wand.solve import SIGMA_PX, WandTask, adjusted, cameras_at, triangulated
from solver_backend.sensors.wand.start import (
    LEAST_TOGETHER,
    poses_by_depth,
    poses_by_lights,
    require_proportion,
)
from solver_backend.sensors.wand.views import Moments, WandView
from solver_backend.sensors.wand.wand_clocks import coarse_clocks, common_moments, flat_of
from solver_backend.videos.sync.clocks import Clocks

MOST_CROWDED = 0.5
"""Share of frames with more than one wand in sight with which a recording is refused."""
REACH_S = 6.5
"""Largest offset of clocks that is looked for."""
LATE_FRAMES = 0.25
"""A delay beyond this share of a frame moves the moments that are compared, and is found again."""


def calibrate_by_wand(
    views: Sequence[WandView], options: WandOptions = WandOptions(), progress: Progress = silent
) -> WandCalibration:
    """Return sensors' poses by a wand that all of them saw.

    Clocks first (given, or found by speed to a frame and by the adjustment to a small part of one); then poses, by
    Umeyama's alignment of every pair's points or by essential matrices and the wand's lengths, chained; then one sparse
    bundle adjustment on pixels with the first sensor held.

    Args:
        views: of C sensors.
        options: what waved.
        progress: called with what is done.

    Raises:
        WandNotSeen: a sensor, or all others together, never saw it with another one.
        WandAmbiguous: something else shone in most frames.
        WandInvalid: the wand is not the one that was given.

    Reference: thesis 5.3.2, "Spatial Alignment"; Gossard et al. 2024 (three lights without depth).
    """
    names = tuple(view.name for view in views)
    _require_seen(views)
    views = [view if options.wand is None else _with_lights(view, options.wand) for view in views]
    progress("Clocks of the sensors", 0, 3)
    clocks = coarse_clocks(views, options.wand, REACH_S) if options.clocks is None else options.clocks
    of_clocks = clocks.findings
    interval_s = float(np.median(np.diff(views[0].times_s)))
    # Given offsets of a small part of a frame are delays of the pictures; larger ones are met between frames.
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
    coverage = coverage_of(array.cameras, moments.px, at)
    return WandCalibration(array, clocks, together, len(used), held_out_px, lengths, depth_rmse, coverage)


def _require_seen(views: Sequence[WandView]) -> None:
    for view in views:
        seen = np.isfinite(view.px).all((1, 2))
        if view.crowded > MOST_CROWDED * max(len(view), 1):
            raise WandAmbiguous(
                f"In {view.crowded} of {len(view)} frames more than one wand, or something else, was lit.",
                where=f"sensor {view.name}",
                hint="Remove the second wand, lamps, mirrors and worn markers.",
            )  # fmt: skip
        if seen.sum() < LEAST_TOGETHER:
            raise WandNotSeen(
                f"The wand is seen in {int(seen.sum())} of {len(view)} frames.", where=f"sensor {view.name}",
                hint="Check that its infrared is on, its exposure fixed, and the marker in sight.",
            )  # fmt: skip
    if len(views) < 2:
        raise WandNotSeen(f"{len(views)} sensors saw a wand; two are needed.", where=", ".join(v.name for v in views))


def _with_lights(view: WandView, wand: Wand) -> WandView:
    """Return the view with its lights in the wand's order.

    Raises:
        WandAmbiguous: what shines is in no line, or ends cannot be distinguished.
    """
    order, sure = identified(wand, flat_of(view), SIGMA_PX / float(view.lens.K[0, 0]))
    seen = np.isfinite(view.px).all((1, 2))
    if sure.sum() < (1.0 - MOST_CROWDED) * seen.sum():
        raise WandAmbiguous(
            f"In {int((seen & ~sure).sum())} of {int(seen.sum())} frames three lights do not make a wand of "
            f"{wand.first_m:.3f} and {wand.second_m:.3f} m.", where=f"sensor {view.name}",
            hint="Check that no second wand or lamp is in sight, and that the wand does not point at the sensor.",
        )  # fmt: skip
    return replace(view, px=in_order(view.px, order, sure))


def _moments(views: Sequence[WandView], clocks: Clocks, options: WandOptions) -> Moments:
    moments = common_moments(views, clocks)
    if options.every_sensor:
        moments = moments.where(moments.seen.all(0))
    if moments.px.shape[1] < LEAST_TOGETHER:
        raise WandNotSeen(
            f"At {moments.px.shape[1]} moments "
            f"{'all sensors' if options.every_sensor else 'two sensors'} see the wand at once.",
            where=", ".join(view.name for view in views), hint="Wave it where their sights overlap.",
        )  # fmt: skip
    return moments


def _task(views: Sequence[WandView], moments: Moments, options: WandOptions, delays: np.ndarray) -> WandTask:
    """Return what is solved, with the poses it begins with."""
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
        return WandTask(names, cameras_at(views, poses), np.zeros((1, 3)), options.clocks is None, delays)
    poses = poses_by_lights(names, flat, float(np.median(still.K[:, 0, 0])), options.wand, rng)
    cameras = cameras_at(views, poses)
    require_proportion(options.wand, np.nanmedian(distances(triangulated(cameras, moments, delays)), axis=0))
    return WandTask(names, cameras, options.wand.lights, options.clocks is None, delays)


def _later(clocks: Clocks, found: Adjusted) -> Clocks:
    """Return the clocks with delays that were found on top: a sensor that is late shows at t what was at ``t + δ``."""
    count = len(found.cameras)
    variance = np.diag(found.covariance).reshape(count, CAMERA_PARAMETERS)[:, -1]
    covariance = np.zeros((count, 2, 2))
    covariance[:, 0, 0] = variance
    return replace(clocks, offset_s=clocks.offset_s - found.delays, covariance=covariance, method="the wand's movement")
