"""Sensors' poses, delays and the wand's path in one bundle adjustment, the first sensor held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import adjust
from solver_backend.camera_calibration.adjustment.lens import PARAMETERS
from solver_backend.camera_calibration.adjustment.problem import Adjusted, Bodies, BodySightings, Unknowns
from solver_backend.camera_calibration.extrinsics.two_views import intersected
from solver_backend.cameras.projection import project, undistort
from solver_backend.geometry.alignment import umeyama
from solver_backend.sensors.wand.views import Moments, WandView
from solver_backend.types import Cameras

SIGMA_PX = 0.3
"""Standard deviation of a light's or a marker's pixel position, from which robust scales are set."""
STEPS, TOLERANCE = 60, 1e-6
HELD_OUT_BLOCKS = 10
"""The recording is cut into so many stretches of time, every fifth of which is held out."""


@dataclass(frozen=True)
class WandTask:
    """What is solved: C views, and the wand's lights about its middle, (K, 3); zero for a marker alone."""

    names: tuple[str, ...]
    cameras: Cameras
    """C cameras with lenses; poses where they start."""
    lights: np.ndarray
    """(K, 3) metres."""
    find_delays: bool
    """Delays of all but the first are unknown."""
    delays: np.ndarray
    """(C,) seconds, known or at a start."""


def cameras_at(views: Sequence[WandView], poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> Cameras:
    """Return the views' cameras at poses."""
    return Cameras(
        tuple(view.name for view in views), np.stack([view.lens.K for view in views]),
        np.stack([view.lens.distortion for view in views]), np.stack([R for R, _ in poses]),
        np.stack([t for _, t in poses]), np.array([view.lens.image_size for view in views]),
        tuple(view.lens.distortion_model for view in views),
    )  # fmt: skip


def adjusted(task: WandTask, moments: Moments) -> tuple[Adjusted, np.ndarray]:
    """Return the bundle adjustment of moments, and the numbers of the moments that took part.

    Minimised is the reprojection of the lights of a rigid wand, or of a marker; the world is the first sensor's axes.
    Lights alone do not determine a scale where there is but one: see ``depth_scale``.

    Reference: Triggs et al. 2000.
    """
    at = triangulated(task.cameras, moments, task.delays)
    usable = moments.seen & (np.isfinite(moments.velocity).all((-1, -2)) | (not task.find_delays))
    used = np.flatnonzero(np.isfinite(at).all((1, 2)) & (usable.sum(0) >= 2))
    rigid = len(task.lights) > 1
    if rigid:
        _, R, t = umeyama(np.broadcast_to(task.lights, at[used].shape), at[used])
    else:
        R, t = np.tile(np.eye(3), (len(used), 1, 1)), at[used, 0]
    camera, moment, light = np.nonzero(np.broadcast_to(usable[:, used, None], (*usable[:, used].shape, at.shape[1])))
    pick = camera, used[moment], light
    timed = task.find_delays or bool(task.delays.any())
    seen = BodySightings(
        camera, moment, task.lights[light], moments.px[pick], np.full(len(camera), SIGMA_PX),
        np.nan_to_num(moments.velocity[pick]) if timed else None,
    )  # fmt: skip
    others = np.arange(len(task.names)) > 0
    unknowns = Unknowns(others, np.zeros((len(others), PARAMETERS), bool), delays=others if task.find_delays else None)
    found = adjust(
        task.cameras, Bodies(R, t), seen, unknowns, delays=task.delays, steps=STEPS, tolerance=TOLERANCE,
        gauge=0 if rigid else 1,
    )  # fmt: skip
    return found, used


def triangulated(cameras: Cameras, moments: Moments, delays: np.ndarray) -> np.ndarray:
    """Return (M, K, 3) metres where the rays of what was seen meet, delays taken into account; NaN with one ray."""
    px = in_step_px(moments, delays)
    flat = undistort(cameras, px)
    return intersected(cameras.R, cameras.t, flat.reshape(len(cameras), -1, 2)).reshape(*px.shape[1:3], 3)


def in_step_px(moments: Moments, delays: np.ndarray) -> np.ndarray:
    """Return (C, M, K, 2) what the views would have seen without their delays, ``px - v δ``."""
    if not delays.any():
        return moments.px
    return moments.px - moments.velocity * delays[:, None, None, None]


def reprojection_px(cameras: Cameras, moments: Moments, delays: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return (C, M, K) px between points (M, K, 3) and what was seen; NaN where it was not."""
    px = project(cameras, at)
    return np.linalg.norm(px - in_step_px(moments, delays), axis=-1)


def held_out(count: int) -> np.ndarray:
    """Return (M,) which of M moments in their order are held out: every fifth stretch of time.

    Stretches, so that a wand that moves slowly is not both fitted and evaluated at one place.
    """
    block = np.arange(count) * HELD_OUT_BLOCKS // max(count, 1)
    return block % 5 == 2


def refitted(task: WandTask, found: Adjusted) -> WandTask:
    """Return the task that begins where a solution ended, its delays taken for known."""
    return replace(task, cameras=found.cameras, delays=found.delays, find_delays=False)
