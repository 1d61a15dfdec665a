"""Correct the up axis, scale, level and floor of a calibration's world from the person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from solver_backend.agreement.body_evidence import MEAN_STATURE_M, POSSIBLE_M, STATURE_SPREAD_M, STATURES_M
from solver_backend.agreement.evidence import BOUND, FRAMES, MOVED, SIGMAS, UNRELATED_NOISE, person_size
from solver_backend.agreement.person_selection import SelectedPerson
from solver_backend.agreement.single_view import LEAST_UPRIGHT
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.camera_corrections import unrolled
from solver_backend.cameras.robust_triangulation import predict_views, triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import JobInvalid, NoDetections
from solver_backend.exchange.plausible import HIGHEST_STEP_M
from solver_backend.exchange.reading_settings import AUTO, OFF, ON, WorldSettings
from solver_backend.geometry.alignment import turn_to_z
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.camera_paths import FilmedPath, read_camera_path
from solver_backend.io.recognition.gravity import floor_height, measure_level, roll_gain, trunk_direction
from solver_backend.io.recognition.marker_up_axis import FLOOR_M
from solver_backend.io.recognition.path_fit import fit_path
from solver_backend.io.recognition.person_scale import LEG_SHARE, bone_lengths, scale_from_stature
from solver_backend.io.units_and_axes import rotation_to_z_up
from solver_backend.priors.lifted_take import lift_take, lowest_feet, up_by_floor
from solver_backend.types import Cameras, JointSet, Keypoints2D

_LEG = ("hip", "knee"), ("knee", "ankle")
SHIFTED = 0.5 * MOVED
"""Largest constant offset of a camera's keypoints in sizes of the person. Good captures reach 0.012, and recorded
cameras that are off by 20 to 33 pixels have 0.028 to 0.044."""
_CODES = frozenset({
    "person_triangulated", "stature_unlikely", "person_along_axis", "floor_off", "views_disagree", "cameras_shifted",
    "nothing_located", "views_in_line",
})  # fmt: skip


def without_world(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Remove the diagnostics of an earlier world check."""
    return tuple(item for item in found if item.code not in _CODES)


@dataclass(frozen=True)
class WorldCheck:
    """Measurements of a triangulated person that show if the world is plausible, NaN where unknown."""

    points: np.ndarray  # (F, K, 3) keypoints in the sampled frames, metres.
    joint_set: JointSet  # Joint set of the keypoints.
    fps: float  # Frame rate of the sampled frames.
    R: np.ndarray  # (C, 3, 3) rotations of the cameras.
    residual_px: float = float("nan")  # Median reprojection error in pixels.
    off_px: tuple[float, ...] = ()
    """Length in pixels of the median vector from the other cameras' prediction to each camera's keypoints."""
    person_px: tuple[float, ...] = ()  # Size of the person in each view in pixels.
    views: tuple[str, ...] = ()  # Names of the cameras.
    apart: float = np.pi / 2  # Angle between the directions from the person to two cameras, radians.
    rolls: Sequence[int] = ()  # Quarter turns from the calibrated to the recorded images.

    @cached_property
    def stature_m(self) -> float:
        """Stature in metres, from the lengths of thighs and shanks."""
        bones = bone_lengths(self.points, self.joint_set)
        legs = [bones.get((f"{s}_{a}", f"{s}_{b}"), np.nan) for s in ("left", "right") for a, b in _LEG]
        return 2.0 * float(np.nanmean(legs)) / LEG_SHARE if np.isfinite(legs).any() else np.nan

    @cached_property
    def upright(self) -> np.ndarray:
        """(3,) direction of the trunk of the standing person in world axes, NaN if unknown."""
        return trunk_direction(self.points, self.joint_set)

    def found(self) -> tuple[Diagnostic, ...]:
        """Return a note with the measurements, and a diagnostic for each implausible measurement."""
        found, name = list[Diagnostic](), self.up_axis().upper()
        floor = floor_height(self.points, self.joint_set)
        if np.isfinite([self.stature_m, floor]).all():
            figures = {"lowest": round(floor, 2) + 0.0, "size": self.residual_px}  # no -0
            found.append(diagnostic("person_triangulated", stature=self.stature_m, **figures))
        if np.isfinite(self.stature_m) and not POSSIBLE_M[0] < self.stature_m < POSSIBLE_M[1]:
            found.append(diagnostic("stature_unlikely", stature=self.stature_m))
        elif name != "Z":
            found.append(diagnostic("person_along_axis", axis=name))
        elif self._is_possible and self.upright[2] > LEAST_UPRIGHT and abs(floor) > FLOOR_M:
            raised = 0 < floor <= HIGHEST_STEP_M  # stairs, trampolines and stages are also above the floor
            severity = Severity.NOTE if raised else Severity.WARNING
            found.append(diagnostic("floor_off", severity=severity, lowest=floor))
        if SIGMAS * np.sin(self.apart) < 1.0:  # errors along the views are many times the errors across them
            found.append(diagnostic("views_in_line", cameras=list(self.views), angle=np.degrees(self.apart)))
        if self.residual_px > UNRELATED_NOISE * np.mean(self.person_px or 1.0):  # no single camera is then the cause
            return (*found, diagnostic("views_disagree", size=self.residual_px))
        of_views = zip(self.views, self.off_px, self.person_px, strict=True)
        wrong = {name: round(off) for name, off, size in of_views if off > SHIFTED * size}
        found += [diagnostic("cameras_shifted", cameras=list(wrong), shifts=wrong)] if wrong else []
        return tuple(found)

    @property
    def _is_possible(self) -> bool:
        return STATURES_M[0] < self.stature_m < STATURES_M[1]

    def up_axis(self) -> str:
        """Return the axis along the standing person, such as '-y'. Return 'z' if no axis is clear."""
        axis = int(np.argmax(np.abs(np.nan_to_num(self.upright))))
        name = ("-" if self.upright[axis] < 0 else "") + "xyz"[axis]
        up = rotation_to_z_up(name)[2]  # A person along it is lying if the cameras are level in the present world.
        lies = roll_gain(self.least_rolled(up), up) <= -BOUND
        return name if abs(self.upright[axis]) > LEAST_UPRIGHT and self._is_possible and not lies else "z"

    def least_rolled(self, up: np.ndarray) -> np.ndarray:
        """Return the camera rotations for the recorded or for the calibrated images, whichever roll less."""
        both = (self.R, unrolled(self.R, self.rolls)) if any(self.rolls) and np.isfinite(up).all() else (self.R,)
        return max(both, key=lambda rotations: roll_gain(rotations, up))


def check_world(cameras: Cameras, keypoints: Keypoints2D, rolls: Sequence[int] = ()) -> WorldCheck:
    """Triangulate a person in up to ``FRAMES`` frames, and measure the result. One view gives no measurements."""
    if len(cameras) == 1:
        nowhere = np.full((keypoints.num_frames, keypoints.xy.shape[2], 3), np.nan)
        return WorldCheck(nowhere, keypoints.joint_set, keypoints.fps, cameras.R)
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, FRAMES).round().astype(int))
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
    found = triangulate(cameras, xy, confidence)
    points, inliers = np.asarray(found.points), np.asarray(found.inliers)
    in_others = (inliers.sum(axis=0) - inliers >= 2) & (confidence > 0)
    shift = np.where(in_others[..., None], xy - predict_views(cameras, xy, confidence, found).px, np.nan)
    known, apart = points[np.isfinite(points).all(-1)], np.pi / 2
    if len(cameras) == 2 and len(known):
        one, other = unit(cameras.centres - np.median(known, axis=0))
        apart = float(np.arccos(np.clip(one @ other, -1.0, 1.0)))
    return WorldCheck(
        points,
        keypoints.joint_set,
        keypoints.fps * len(frames) / keypoints.num_frames,
        cameras.R,
        residual_px=float(quantile(np.asarray(found.residual_px).ravel(), 0.5, axis=0)),
        off_px=tuple(np.linalg.norm(quantile(shift, 0.5, axis=(1, 2)), axis=-1).tolist()),
        person_px=tuple(person_size(np.where((confidence > 0)[..., None], xy, np.nan)).tolist()),
        views=cameras.names,
        apart=apart,
        rolls=rolls,
    )


@dataclass(frozen=True)
class WorldFit:
    """Cameras in a corrected world, the measured person, and the corrections."""

    cameras: Cameras
    check: WorldCheck
    found: tuple[Diagnostic, ...] = ()  # Corrections. Requested corrections are notes, others are warnings.
    from_person: bool = False  # True if up and floor of a single camera's world come from the person.


def scale_world(
    cameras: Cameras, keypoints: Keypoints2D, settings: WorldSettings
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Scale the world by the factor or the stature in the settings. Return notes and warnings too.

    A scale ``s`` changes no image: ``x_cam = R x + t`` becomes ``R x + s t``.

    Args:
        keypoints: detections of the person with the stated stature.

    Raises:
        JobInvalid: both settings are given, the stature is impossible, or too little of the person is visible.
    """
    if not settings.stature or len(cameras) == 1:  # a single camera does not determine the scale
        if settings.scale == 1.0:
            return cameras, ()
        return cameras.scaled(settings.scale), (diagnostic("world_scaled", reason="scale", scale=settings.scale),)
    if settings.scale != 1.0:
        raise JobInvalid("Both --stature and --scale set the scale of the world.", hint="Use only one of them.")
    scale, share = scale_from_stature(check_world(cameras, keypoints).points, keypoints.joint_set, settings.stature)
    found = [diagnostic("world_scaled", reason="stature", scale=scale, percent=100 * share, stature=settings.stature)]
    calibrated = settings.stature / scale
    contradicts = abs(np.log(scale)) > max(STATURE_SPREAD_M / MEAN_STATURE_M, SIGMAS * share)
    if contradicts and STATURES_M[0] < calibrated < STATURES_M[1]:
        found.append(diagnostic("stature_contradicts", size=calibrated, stature=settings.stature, scale=scale))
    return cameras.scaled(scale), tuple(found)


def find_people(
    cameras: Cameras,
    select: Callable[[Cameras], tuple[SelectedPerson, ...]],
    settings: WorldSettings,
    to_plausible: float = 1.0,
) -> tuple[Cameras, tuple[SelectedPerson, ...], tuple[Diagnostic, ...]]:
    """Select the people, and scale the world. Return the cameras, the people and notes.

    People are selected again after a change of scale, because their distances are compared in metres.

    Args:
        select: returns the people in front of the cameras, the main person first.
        to_plausible: factor of all lengths for the first selection (see ``in_persons_unit``).
    """
    people = select(cameras.scaled(to_plausible))
    scaled, notes = scale_world(cameras, people[0].keypoints, settings)
    return scaled, select(scaled) if notes else people, notes


def fit_world(
    cameras: Cameras,
    keypoints: Keypoints2D,
    settings: WorldSettings = WorldSettings(),
    up_axis: str | None = None,
    rolls: Sequence[int] = (),
) -> WorldFit:
    """Transform the cameras to a world where the person is upright.

    A calibration without a floor often has the axes of its first camera, with y down, or of a calibration board.

    Args:
        cameras: C cameras in metres.
        up_axis: up axis from the user, which is final.
        rolls: quarter turns from the calibrated to the recorded images. Either of these images may be upright.

    Raises:
        NoDetections: levelling was requested, and no person is upright.
        JobInvalid: a camera path is given for several cameras, or is invalid (see ``read_camera_path``).
    """
    if len(cameras) == 1:
        return _fit_one_camera(cameras, keypoints, settings)
    if settings.camera_path:
        hint = "Omit --camera-path, or solve the moving camera separately."
        raise JobInvalid("A camera path can only be used with one camera.", where=settings.camera_path, hint=hint)
    world = check_world(cameras, keypoints, rolls)
    axis, problems = world.up_axis(), ()
    if up_axis is None and axis != "z" and settings.level != OFF:
        cameras, world = _moved(cameras, world, rotation_to_z_up(axis))
        problems = (diagnostic("up_by_person", basis="axis", axis=axis.upper()),)
    cameras, world, found = _level(cameras, world, settings.level)
    return WorldFit(cameras, world, (*problems, *found))


def _level(cameras: Cameras, world: WorldCheck, how: str) -> tuple[Cameras, WorldCheck, tuple[Diagnostic, ...]]:
    if how == OFF:
        return cameras, world, ()
    try:
        level = measure_level(world.points, world.joint_set, world.least_rolled(world.upright), world.fps)
    except NoDetections:
        if how == AUTO:
            return cameras, world, ()
        raise
    if level.is_tilted or how != AUTO:
        tilt, sigma = np.degrees([level.tilt, level.sigma])
        witnesses = "the person and the cameras" if level.gains[2] > 0 else "the person"
        asked = {"reason": "asked", "severity": Severity.NOTE}
        why: dict[str, Any] = {"reason": "shown", "witnesses": witnesses} if how == AUTO else asked
        found = diagnostic("world_levelled", tilt=tilt, sigma=sigma, floor=level.floor_upright_m, **why)
        return *_moved(cameras, world, level.turn, level.floor_upright_m), (found,)
    if level.is_above_feet:
        return *_moved(cameras, world, np.eye(3), level.floor_m), (diagnostic("floor_by_feet", depth=-level.floor_m),)
    return cameras, world, ()


def _moved(cameras: Cameras, world: WorldCheck, turn: np.ndarray, floor_m: float = 0.0) -> tuple[Cameras, WorldCheck]:
    """Transform the cameras and the person to the world ``x' = turn x - (0, 0, floor)``."""
    R = cameras.R @ turn.T
    world = replace(world, points=world.points @ turn.T - (0.0, 0.0, floor_m), R=R)
    return replace(cameras, R=R, t=cameras.t + floor_m * R[..., 2]), world


def _fit_one_camera(camera: Cameras, keypoints: Keypoints2D, settings: WorldSettings) -> WorldFit:
    """Keep the camera's world if the person is upright in it. Otherwise use the person's world."""
    check = check_world(camera, keypoints)
    if settings.camera_path or camera.path is not None:
        return _fit_carried_camera(camera, keypoints, settings, check)
    if settings.level == OFF:
        return WorldFit(camera, check)
    stood, note = stand_camera(camera, keypoints, settings.stature)
    if settings.level != ON:
        upright = float(camera.R[0, :, 2] @ stood.R[0, :, 2])
        if upright > LEAST_UPRIGHT:
            return WorldFit(camera, check)
        note = diagnostic("up_by_person", basis="single", angle=np.degrees(np.arccos(max(upright, -1.0))))
    return WorldFit(stood, check, (note,), from_person=True)


def _fit_carried_camera(
    camera: Cameras, keypoints: Keypoints2D, settings: WorldSettings, check: WorldCheck
) -> WorldFit:
    """Apply a camera path from a file, or level the path of the capture."""
    count = keypoints.num_frames
    if settings.camera_path:
        path = read_camera_path(settings.camera_path, count, keypoints.fps)
        if settings.scale != 1.0:
            path = replace(path, metres=(path.metres or 1.0) * settings.scale)
    elif settings.level == ON:
        R, t = camera.poses(0, count)
        path = FilmedPath(R.swapaxes(-1, -2), -np.einsum("fba,fb->fa", R, t), 1.0, None, "the capture")
    else:
        return WorldFit(camera, check)
    cameras, found = fit_path(camera, keypoints, path, settings.stature)
    return WorldFit(cameras, check, (found,), from_person=True)


def stand_camera(camera: Cameras, keypoints: Keypoints2D, stature_m: float = 0.0) -> tuple[Cameras, Diagnostic]:
    """Place a single camera above the floor of the filmed person. A stature of 0 means an average adult."""
    body = load_body()
    landmarks = keypoint_landmarks(body, keypoints.joint_set)
    lifted = lift_take(camera, keypoints, body)
    points = lifted.placed(body, landmarks, np.zeros(10))[0]
    up = up_by_floor(lifted, points, landmarks.names)
    R = turn_to_z(up).T
    size = stature_m / body.stature_m if stature_m else 1.0
    height = -size * (lowest_feet(points @ R, landmarks.names, lifted.confidence > 0) or 0.0)
    tilt = float(np.degrees(np.arcsin(np.clip(-up[2], -1.0, 1.0))))
    note = diagnostic("one_camera_placed", height=height, angle=abs(tilt), way="down" if tilt > 0 else "up")
    place = np.array([0.0, 0.0, height])
    return replace(camera, R=R[None], t=(R @ -place)[None]), note
