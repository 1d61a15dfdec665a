"""How good a calibration by wand is: in metres, on time that it did not see, and what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.camera_calibration.adjustment.problem import Adjusted
from solver_backend.camera_calibration.extrinsics.result import CalibratedCameras, moved_world, result_of
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.sensors.wand.depth_scale import depth_scale
from solver_backend.sensors.wand.errors import WandInvalid
from solver_backend.sensors.wand.leds import distances
from solver_backend.sensors.wand.result import WandOptions
from solver_backend.sensors.wand.solve import (
    WandTask,
    adjusted,
    held_out,
    refitted,
    reprojection_px,
    triangulated,
)
from solver_backend.sensors.wand.start import LEAST_TOGETHER
from solver_backend.sensors.wand.views import Moments, WandView
from solver_backend.videos.sync.clocks import Clocks

MOST_PX = 8.0
"""Median error with which nothing fits."""
GOOD_PX = 1.0
LATE_S = 0.001
"""Worse errors and larger delays are reported."""


def require_fit(found: Adjusted) -> None:
    """Refuse what does not fit together.

    Raises:
        WandInvalid: the median error is beyond ``MOST_PX``.
    """
    usual = float(np.nanmedian(np.linalg.norm(found.error, axis=-1)))
    if not usual < MOST_PX:
        raise WandInvalid(
            f"What the sensors saw does not fit together: {usual:.0f} px off at the middle.",
            where=", ".join(found.cameras.names),
            hint="Check that clocks agree (--trigger), lenses are of this mode, and only one wand was in sight.",
        )  # fmt: skip


def metric(found: Adjusted, moments: Moments, options: WandOptions) -> tuple[CalibratedCameras, float]:
    """Return the calibration in metres with its deviations, and how far depths scatter."""
    array = result_of("wand", found)
    if options.wand is not None:
        return array, float("nan")
    by_depth = depth_scale(found.cameras, found.bodies.t, moments.depth_m[:, :, 0])
    array = moved_world(array, np.eye(3), np.zeros(3), by_depth.scale)
    way = np.linalg.norm(array.cameras.centres, axis=1)
    return replace(array, centre_sigma_m=np.hypot(array.centre_sigma_m, by_depth.sigma * way)), by_depth.rmse_m


def held_out_errors(
    task: WandTask, found: Adjusted, moments: Moments, options: WandOptions
) -> tuple[float, np.ndarray]:
    """Return errors of stretches of time that a fit of its own did not see: px, and of the lights' distances (3,).

    Delays, one number a sensor, are those of the whole recording.
    """
    out = held_out(moments.px.shape[1])
    if out.sum() < LEAST_TOGETHER or (~out).sum() < LEAST_TOGETHER:
        return float("nan"), np.full(3, np.nan)
    fitted, _ = adjusted(refitted(task, found), moments.where(~out))
    kept = moments.where(out)
    at = triangulated(fitted.cameras, kept, found.delays)
    error = reprojection_px(fitted.cameras, kept, found.delays, at)
    px = float(np.sqrt(np.nanmean(error**2)))
    if options.wand is None:
        return px, np.full(3, np.nan)
    off = distances(at) - options.wand.distances_m
    return px, np.sqrt(np.nanmean(off**2, axis=0))


def findings_of(
    views: Sequence[WandView], array: CalibratedCameras, clocks: Clocks, options: WandOptions
) -> tuple[Diagnostic, ...]:
    """Return what the user should know of a calibration."""
    found = [item for view in views for item in view.findings]
    found += [
        diagnostic("wand_crowded", cameras=[view.name], lost=view.crowded, of=len(view))
        for view in views if view.crowded
    ]  # fmt: skip
    first = array.cameras.names[0]
    for c, name in enumerate(array.cameras.names):
        if array.camera_rmse_px[c] > GOOD_PX:
            found.append(diagnostic("sensor_off_wand", cameras=[name], size=array.camera_rmse_px[c]))
        ahead = clocks.offset_s[c]
        if options.clocks is None and abs(ahead) > LATE_S:
            found.append(diagnostic("sensor_clock_differs", cameras=[name, first], size_ms=1e3 * ahead))
    return tuple(found)


def notes_of(
    moments: Moments, together: np.ndarray, names: tuple[str, ...], options: WandOptions
) -> tuple[Diagnostic, ...]:
    """Return what was done."""
    i, j = np.unravel_index(np.argmin(together + 1e9 * np.eye(len(names))), together.shape)
    wand = "a marker and its depth" if options.wand is None else (
        f"a wand of {options.wand.first_m:.3f} and {options.wand.second_m:.3f} m"
    )  # fmt: skip
    figures = {"wand": wand, "moments": moments.px.shape[1], "together": together[i, j]}
    return (
        diagnostic("wand_seen", cameras=[names[i], names[j]], **figures),
        diagnostic("world_of_first_sensor", cameras=names[:1]),
    )
