"""A calibration's world made to fit the person: its up axis, its scale, its level and its floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.person_selection import SelectedPerson
from solver_backend.cameras.camera_corrections import unrolled
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import JobInvalid, NoDetections
from solver_backend.exchange.world_settings import AUTO, OFF, WorldSettings
from solver_backend.io.recognition.level import CONTRADICTS, OFF_FLOOR_M, Level, measure_level, roll_gain
from solver_backend.io.recognition.one_camera import fit_one_camera
from solver_backend.io.recognition.person_scale import scale_from_stature
from solver_backend.io.recognition.up_axis import rotation_to_z_up, with_up_axis
from solver_backend.io.recognition.world_check import (
    PLAUSIBLE_STATURE_M,
    WorldCheck,
    check_world,
    nothing_checked,
)
from solver_backend.types import Cameras, Keypoints2D

SURELY_UPRIGHT = np.cos(np.radians(6.0))
"""Cosine of a person's angle with Z within which a world whose floor is under the feet is not looked at closer."""
SAME_SCALE = 0.2
"""Logarithm of a scale up to which people found before it stay the same."""
OTHER_STATURE, STATURE_SIGMAS = 0.06, 3.0
"""Logarithm of a scale, and its standard deviations, beyond which a calibration in which the person has a possible size
contradicts a stature that was given; within them it is a board that was measured badly."""


@dataclass(frozen=True)
class WorldFit:
    """Cameras in a world that fits, what the person is like in it, and what was done."""

    cameras: Cameras
    check: WorldCheck
    notes: tuple[Diagnostic, ...] = ()
    """What was done because it was asked for."""
    problems: tuple[Diagnostic, ...] = ()
    """What was done unasked."""
    from_person: bool = False
    """Up and floor of a single camera's world are the person's."""


def scale_world(
    cameras: Cameras, keypoints: Keypoints2D, settings: WorldSettings
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Return the cameras in the scale that was asked for, a note where that is another one, and what is doubtful of it.

    A world ``s`` times as large leaves every picture as it is: ``x_cam = R x + t`` becomes ``R x + s t``.

    Args:
        cameras: C cameras.
        keypoints: detections of the person whose stature is known.
        settings: hold the stature or the scale.

    Raises:
        JobInvalid: both are given, the stature is impossible, or too little of the person is seen.
    """
    if settings.stature and len(cameras) > 1 and settings.scale != 1.0:
        raise JobInvalid("Stature and scale both set the size of the world.", hint="Give one of them.")
    if (not settings.stature or len(cameras) < 2) and settings.scale == 1.0:
        return cameras, ()
    if not settings.stature or len(cameras) < 2:  # what one camera sees has no scale of its own
        note = diagnostic("world_scaled", reason="scale", scale=settings.scale)
        return replace(cameras, t=cameras.t * settings.scale), (note,)
    scale, share = scale_from_stature(check_world(cameras, keypoints).points, keypoints.joint_set, settings.stature)
    found = [diagnostic("world_scaled", reason="stature", scale=scale, percent=100 * share, stature=settings.stature)]
    calibrated = settings.stature / scale
    contradicts = abs(np.log(scale)) > max(OTHER_STATURE, STATURE_SIGMAS * share)
    if contradicts and PLAUSIBLE_STATURE_M[0] < calibrated < PLAUSIBLE_STATURE_M[1]:
        found.append(diagnostic("stature_contradicts", size=calibrated, stature=settings.stature, scale=scale))
    return replace(cameras, t=cameras.t * scale), tuple(found)


def find_people(
    cameras: Cameras,
    select: Callable[[Cameras], tuple[SelectedPerson, ...]],
    settings: WorldSettings,
    to_plausible: float = 1.0,
) -> tuple[Cameras, tuple[SelectedPerson, ...], tuple[Diagnostic, ...]]:
    """Return the cameras in the scale that was asked for, who is seen by them, and what was done.

    Who belongs together is measured in metres, so people are found again where the scale is another one.

    Args:
        cameras: as calibrated.
        select: finds people, the main one first.
        settings: see ``scale_world``.
        to_plausible: factor on the cameras' lengths by which a person has a possible size, see ``unit_by_person``.

    Raises:
        JobInvalid: see ``scale_world``.
    """
    plausible = replace(cameras, t=cameras.t * to_plausible) if to_plausible != 1.0 else cameras
    people = select(plausible)
    scaled, notes = scale_world(cameras, people[0].keypoints, settings)
    size = [float(np.abs(c.t).max()) + 1e-9 for c in (plausible, scaled)]
    again = bool(notes) and abs(np.log(size[1] / size[0])) > SAME_SCALE
    return scaled, select(scaled) if again else people, notes


def fit_world(
    cameras: Cameras,
    keypoints: Keypoints2D,
    settings: WorldSettings = WorldSettings(),
    up_axis: str | None = None,
    rolls: Sequence[int] = (),
) -> WorldFit:
    """Return cameras in a world that the person stands upright in.

    A calibration without a floor has the axes of one of its cameras, whose y points down, or those of a board.

    Args:
        cameras: C cameras, in metres.
        keypoints: detections of one person.
        settings: whether the world is levelled.
        up_axis: the axis that the user stated to point up, which stays the nearest one.
        rolls: quarter turns by which pictures were found turned against those calibrated; either may be upright.

    Raises:
        NoDetections: the world was to be levelled, and nobody stands in it.
    """
    if len(cameras) == 1:
        one = fit_one_camera(cameras, keypoints, settings)
        return WorldFit(one.camera, nothing_checked(keypoints), one.notes, one.problems, one.from_person)
    world = check_world(cameras, keypoints)
    axis, problems = world.up_axis(), ()
    if up_axis is None and axis != "z" and settings.level != OFF and not _lies(cameras, axis, rolls):
        cameras, problems = with_up_axis(cameras, axis), (diagnostic("up_by_person", basis="axis", axis=axis.upper()),)
        world = check_world(cameras, keypoints)
    levelled, found = _level(cameras, keypoints, world, settings.level, rolls)
    if levelled is not cameras:
        world = check_world(levelled, keypoints)
    if settings.level == AUTO:
        return WorldFit(levelled, world, problems=(*problems, *found))
    return WorldFit(levelled, world, found, problems)


def _level(
    cameras: Cameras, keypoints: Keypoints2D, world: WorldCheck, how: str, rolls: Sequence[int]
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Return the cameras in a level world, and what was done; the same cameras where nothing is done."""
    fits = world.upright[2] > SURELY_UPRIGHT and abs(world.lowest_m) < OFF_FLOOR_M
    if how == OFF or (how == AUTO and fits):
        return cameras, ()
    try:
        level = measure_level(world.points, keypoints.joint_set, _upright(cameras, rolls, world.upright), world.fps)
    except NoDetections:
        if how == AUTO:
            return cameras, ()
        raise
    if level.is_tilted or how != AUTO:
        return _moved(cameras, level.turn, level.floor_upright_m), (_levelled(level, how),)
    if level.is_above_feet:
        found = diagnostic("floor_by_feet", depth=-level.floor_m)
        return _moved(cameras, np.eye(3), level.floor_m), (found,)
    return cameras, ()


def _lies(cameras: Cameras, axis: str, rolls: Sequence[int]) -> bool:
    """Return whether cameras show that somebody along an axis lies: they stand level in the world as it is."""
    up = rotation_to_z_up(axis).T[:, 2]
    return roll_gain(_upright(cameras, rolls, up).R, up) <= -CONTRADICTS


def _upright(cameras: Cameras, rolls: Sequence[int], up: Sequence[float] | np.ndarray) -> Cameras:
    """Return the cameras with the roll of their pictures as recorded or as calibrated, whichever fits an up better."""
    if not any(rolls) or not np.isfinite(up).all():
        return cameras
    calibrated = replace(cameras, R=unrolled(cameras.R, rolls))
    return max((cameras, calibrated), key=lambda found: roll_gain(found.R, np.asarray(up)))


def _moved(cameras: Cameras, turn: np.ndarray, floor_m: float) -> Cameras:
    """Return cameras in the world ``x' = turn x - (0, 0, floor)``: ``R' = R turnᵀ``, ``t' = t + R' (0, 0, floor)``."""
    R = cameras.R @ turn.T
    return replace(cameras, R=R, t=cameras.t + floor_m * R[..., 2])


def _levelled(level: Level, how: str) -> Diagnostic:
    figures = {
        "tilt": np.degrees(level.tilt), "sigma": np.degrees(level.sigma), "floor": level.floor_upright_m,
    }  # fmt: skip
    if how != AUTO:
        return diagnostic("world_levelled", reason="asked", severity=Severity.NOTE, **figures)
    shown = (("the balance", level.balance), ("the floor under the feet", level.floor), ("the cameras", level.cameras))
    witnesses = " and ".join(name for name, gain in shown if gain > 0)
    return diagnostic("world_levelled", reason="shown", witnesses=witnesses, **figures)
