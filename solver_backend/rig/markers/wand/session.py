"""A rig's calibration from a wand: by one marker and depth, or by three lights of known lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.rig.adjustment.problem import Adjusted
from solver_backend.rig.extrinsics.result import RigCalibration, moved_world, result_of
from solver_backend.rig.markers.clock.wand_clocks import coarse_clocks, common_moments, flat_of
from solver_backend.rig.markers.wand.coverage import Coverage, coverage_of
from solver_backend.rig.markers.wand.depth_scale import depth_scale, depth_sigma
from solver_backend.rig.markers.wand.errors import WandAmbiguous, WandInvalid, WandNotSeen
from solver_backend.rig.markers.wand.leds import Wand, distances, identified, in_order
from solver_backend.rig.markers.wand.solve import (
    SIGMA_PX,
    WandTask,
    adjusted,
    cameras_at,
    held_out,
    refitted,
    reprojection_px,
    triangulated,
)
from solver_backend.rig.markers.wand.start import (
    LEAST_TOGETHER,
    poses_by_depth,
    poses_by_lights,
    require_proportion,
)
from solver_backend.rig.markers.wand.views import Moments, WandView
from solver_backend.rig.sync.clocks import Clocks

MOST_CROWDED = 0.5
"""Share of frames with more than one wand in sight with which a recording is refused."""
REACH_S = 6.5
"""Largest offset of clocks that is looked for."""
LATE_FRAMES = 0.25
"""A delay beyond this share of a frame moves the moments that are compared, and is found again."""
MOST_PX = 8.0
"""Median error with which nothing fits."""
GOOD_PX = 1.0
LATE_S = 0.001
"""Worse errors and larger delays are told."""


@dataclass(frozen=True)
class WandOptions:
    """How a wand's recording is taken."""

    wand: Wand | None = None
    """Three lights; None is one marker with depth."""
    clocks: Clocks | None = None
    """Told by a trigger; None has them found from the wand's movement."""
    every_sensor: bool = False
    """Only moments at which all sensors saw it, as published; else two are enough."""


@dataclass(frozen=True)
class WandCalibration:
    """The result, in the first sensor's axes until it is laid on a Γ."""

    rig: RigCalibration
    """Cameras with deviations, findings and notes."""
    clocks: Clocks
    """Of the sensors."""
    together: np.ndarray
    """(C, C) moments that two sensors saw together."""
    moments: int
    """Moments that were solved."""
    held_out_px: float
    """Root mean squared reprojection error of stretches of time that were left out of the fit."""
    length_rmse_m: np.ndarray
    """(3,) root mean squared error of the lights' distances over those stretches; NaN without lights."""
    depth_rmse_m: float
    """Spread of measured depths about the marker; NaN without depth."""
    coverage: Coverage
    """Where the wand was."""


def calibrate_by_wand(
    views: Sequence[WandView], options: WandOptions = WandOptions(), progress: Progress = silent
) -> WandCalibration:
    """Return sensors' poses by a wand that all of them saw.

    Clocks first (told, or found by speed to a frame and by the adjustment to a small part of one); then poses, by
    Umeyama's alignment of every pair's points or by essential matrices and the wand's lengths, chained; then one sparse
    bundle adjustment on pixels with the first sensor held.

    Args:
        views: of C sensors.
        options: what waved.
        progress: called with what is done.

    Raises:
        WandNotSeen: a sensor, or all others together, never saw it with another one.
        WandAmbiguous: something else shone in most frames.
        WandInvalid: the wand is not the one that was told.

    Reference: thesis 5.3.2, "Spatial Alignment"; Gossard et al. 2024 (three lights without depth).
    """
    names = tuple(view.name for view in views)
    _require_seen(views)
    views = [view if options.wand is None else _with_lights(view, options.wand) for view in views]
    progress("Clocks of the sensors", 0, 3)
    clocks = coarse_clocks(views, options.wand, REACH_S) if options.clocks is None else options.clocks
    moments = _moments(views, clocks, options)
    progress("Pairs of sensors", 1, 3)
    task = _task(views, moments, options)
    progress("All sensors at once", 2, 3)
    found, used = adjusted(task, moments)
    interval_s = float(np.median(np.diff(views[0].times_s)))
    if task.find_delays and np.abs(found.delays).max() > LATE_FRAMES * interval_s:
        clocks = _later(clocks, found.delays)
        moments = _moments(views, clocks, options)
        task = replace(task, cameras=found.cameras)
        found, used = adjusted(task, moments)
    clocks = _later(clocks, found.delays) if task.find_delays else clocks
    _require_fit(found, names)
    rig, depth_rmse = _metric(found, moments.where(used), options)
    scaled = replace(found, cameras=rig.cameras)
    judge_px, lengths = _judged(task, scaled, moments.where(used), options)
    at = triangulated(rig.cameras, moments, found.delays)
    together = moments.seen.astype(int) @ moments.seen.astype(int).T
    coverage = coverage_of(rig.cameras, moments.px, at)
    rig = replace(rig, findings=_findings(views, rig, clocks, options), notes=_notes(moments, together, names, options))
    return WandCalibration(rig, clocks, together, len(used), judge_px, lengths, depth_rmse, coverage)


def _require_seen(views: Sequence[WandView]) -> None:
    for view in views:
        seen = np.isfinite(view.px).all((1, 2))
        if view.crowded > MOST_CROWDED * max(len(view), 1):
            raise WandAmbiguous(
                f"In {view.crowded} of {len(view)} frames more than one wand, or something else, shone.",
                where=f"sensor {view.name}", hint="Take the second wand, lamps and mirrors out of sight; wear no markers.",
            )  # fmt: skip
        if seen.sum() < LEAST_TOGETHER:
            raise WandNotSeen(
                f"The wand is seen in {int(seen.sum())} of {len(view)} frames.", where=f"sensor {view.name}",
                hint="Is its infrared on, its exposure fixed, the marker before it?",
            )  # fmt: skip
    if len(views) < 2:
        raise WandNotSeen(f"{len(views)} sensors saw a wand; two are needed.", where=", ".join(v.name for v in views))


def _with_lights(view: WandView, wand: Wand) -> WandView:
    """Return the view with its lights in the wand's order.

    Raises:
        WandAmbiguous: what shines is in no line, or ends cannot be told apart.
    """
    order, sure = identified(wand, flat_of(view), SIGMA_PX / float(view.lens.K[0, 0]))
    seen = np.isfinite(view.px).all((1, 2))
    if sure.sum() < (1.0 - MOST_CROWDED) * seen.sum():
        raise WandAmbiguous(
            f"In {int((seen & ~sure).sum())} of {int(seen.sum())} frames three lights are no wand of "
            f"{wand.first_m:.3f} and {wand.second_m:.3f} m.", where=f"sensor {view.name}",
            hint="Is a second wand or a lamp in sight, or does the wand point at the sensor?",
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


def _task(views: Sequence[WandView], moments: Moments, options: WandOptions) -> WandTask:
    """Return what is solved, with the poses it begins with."""
    names = tuple(view.name for view in views)
    rng = np.random.default_rng(0)
    still = cameras_at(views, [(np.eye(3), np.zeros(3))] * len(views))
    flat = undistort(still.K, still.distortion, moments.px, still.distortion_model)
    none = np.zeros(len(views))
    if options.wand is None:
        ray = np.concatenate([flat[:, :, 0], np.ones((*flat.shape[:2], 1))], axis=-1)
        depth = moments.depth_m[:, :, 0]
        focal = still.K[:, 0, 0, None]
        sigma = np.hypot(depth_sigma(depth), depth * SIGMA_PX / focal)
        poses = poses_by_depth(names, ray * depth[..., None], sigma, rng)
        return WandTask(names, cameras_at(views, poses), np.zeros((1, 3)), options.clocks is None, none)
    poses = poses_by_lights(names, flat, float(np.median(still.K[:, 0, 0])), options.wand, rng)
    cameras = cameras_at(views, poses)
    require_proportion(options.wand, np.nanmedian(distances(triangulated(cameras, moments, none)), axis=0))
    return WandTask(names, cameras, options.wand.lights, options.clocks is None, none)


def _later(clocks: Clocks, delays: np.ndarray) -> Clocks:
    """Return the clocks with delays that were found on top: a sensor that is late shows at t what was at ``t + δ``."""
    return replace(clocks, offset_s=clocks.offset_s - delays, method="the wand's movement")


def _require_fit(found: Adjusted, names: tuple[str, ...]) -> None:
    usual = float(np.nanmedian(np.linalg.norm(found.error, axis=-1)))
    if not usual < MOST_PX:
        raise WandInvalid(
            f"What the sensors saw does not fit together: {usual:.0f} px off at the middle.", where=", ".join(names),
            hint="Do their clocks agree (--trigger), are lenses of this mode, and was there one wand alone?",
        )  # fmt: skip


def _metric(found: Adjusted, moments: Moments, options: WandOptions) -> tuple[RigCalibration, float]:
    """Return the calibration in metres with its deviations, and how far depths scatter."""
    rig = result_of("wand", found)
    if options.wand is not None:
        return rig, float("nan")
    told = depth_scale(found.cameras, found.bodies.t, moments.depth_m[:, :, 0])
    rig = moved_world(rig, np.eye(3), np.zeros(3), told.scale)
    way = np.linalg.norm(rig.cameras.centres, axis=1)
    return replace(rig, centre_sigma_m=np.hypot(rig.centre_sigma_m, told.sigma * way)), told.rmse_m


def _judged(task: WandTask, found: Adjusted, moments: Moments, options: WandOptions) -> tuple[float, np.ndarray]:
    """Return errors of stretches of time that a fit of its own did not see: px, and of the lights' distances (3,)."""
    out = held_out(moments.px.shape[1])
    if out.sum() < LEAST_TOGETHER or (~out).sum() < LEAST_TOGETHER:
        return float("nan"), np.full(3, np.nan)
    fitted, _ = adjusted(refitted(task, found, moments), moments.where(~out))
    kept = moments.where(out)
    at = triangulated(fitted.cameras, kept, found.delays)
    error = reprojection_px(fitted.cameras, kept, found.delays, at)
    px = float(np.sqrt(np.nanmean(error**2)))
    if options.wand is None:
        return px, np.full(3, np.nan)
    off = distances(at) - options.wand.distances_m
    return px, np.sqrt(np.nanmean(off**2, axis=0))


def _findings(views: Sequence[WandView], rig: RigCalibration, clocks: Clocks, options: WandOptions) -> tuple[str, ...]:
    words = [word for view in views for word in view.findings]
    words += list(clocks.findings)
    words += [
        f"{view.name}: in {view.crowded} of {len(view)} frames more than the wand shone; they were left out."
        for view in views if view.crowded
    ]  # fmt: skip
    for c, name in enumerate(rig.cameras.names):
        if rig.camera_rmse_px[c] > GOOD_PX:
            words.append(
                f"{name} errs by {rig.camera_rmse_px[c]:.1f} px: its lens was calibrated in another mode, it was moved, "
                "or its exposures are long for how fast the wand was waved."
            )
        ahead = clocks.offset_s[c]
        if options.clocks is None and abs(ahead) > LATE_S:
            words.append(
                f"The clock of {name} is {'ahead of' if ahead > 0 else 'behind'} that of {rig.cameras.names[0]} by "
                f"{1e3 * abs(ahead):.1f} ms."
            )
    return tuple(words)


def _notes(moments: Moments, together: np.ndarray, names: tuple[str, ...], options: WandOptions) -> tuple[str, ...]:
    i, j = np.unravel_index(np.argmin(together + 1e9 * np.eye(len(names))), together.shape)
    what = "a marker and its depth" if options.wand is None else (
        f"a wand of {options.wand.first_m:.3f} and {options.wand.second_m:.3f} m"
    )  # fmt: skip
    return (
        f"By {what} at {moments.px.shape[1]} moments; {names[i]} and {names[j]} saw least together, {together[i, j]}.",
        f"The world is {names[0]}'s own axes, Z along its sight, until a Γ tells up (--gamma).",
    )


__all__ = ["WandCalibration", "WandInvalid", "WandOptions", "calibrate_by_wand"]
