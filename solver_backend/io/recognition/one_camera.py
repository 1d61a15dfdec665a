"""Find up and floor of a single camera from the lifted person, if the calibration has neither."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.reading_settings import OFF, ON, WorldSettings
from solver_backend.priors.lifted_take import lift_take, lowest_feet, up_by_floor
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Cameras, Keypoints2D

TILT_DEG = 30.0  # Between the up of calibration and person. The lifter errs by 3 to 10 degrees.


@dataclass(frozen=True)
class OneCameraWorld:
    """A single camera in a world with an upright person."""

    camera: Cameras  # One camera.
    notes: tuple[Diagnostic, ...] = ()  # Changes that the settings asked for.
    problems: tuple[Diagnostic, ...] = ()  # Changes that nobody asked for.
    from_person: bool = False  # Up, floor and scale are the person's.


def fit_one_camera(camera: Cameras, keypoints: Keypoints2D, settings: WorldSettings) -> OneCameraWorld:
    """Return the camera in its own world, or in the person's if the calibration's up is impossible.

    Args:
        camera: one calibrated camera, metres.
        keypoints: of one person.
        settings: whether the world is levelled; the stature is the person's.
    """
    if settings.level == ON:
        return replace(stand_camera(camera, keypoints, settings.stature), problems=())
    body = load_body()
    lifted = lift_take(camera, keypoints, body, prior_on_body(load_sposer(), body.layout), None)
    off = float(np.degrees(np.arccos(np.clip(lifted.up @ camera.R[0, :, 2], -1.0, 1.0))))
    if off < TILT_DEG or settings.level == OFF:
        return OneCameraWorld(camera)
    stood = stand_camera(camera, keypoints, settings.stature)
    return replace(stood, notes=(), problems=(diagnostic("up_by_person", basis="single", angle=off),))


def stand_camera(camera: Cameras, keypoints: Keypoints2D, stature_m: float = 0.0) -> OneCameraWorld:
    """Return the camera above the origin of a world with the up and floor of the person.

    Args:
        camera: one camera. Its pose is not used.
        keypoints: of one person.
        stature_m: of the person, metres; 0: the average's.
    """
    body = load_body()
    landmarks = keypoint_landmarks(body, keypoints.joint_set)
    lifted = lift_take(camera, keypoints, body, prior_on_body(load_sposer(), body.layout), None)
    points = lifted.placed(body, landmarks, np.zeros(10))[0]
    up = up_by_floor(lifted, points, landmarks.names)
    R = _level_axes(up)
    points = points @ R
    lowest = lowest_feet(points, landmarks.names, lifted.confidence > 0)
    size = stature_m / body.stature_m if stature_m else 1.0
    height = -size * lowest if lowest is not None else 0.0
    centre = np.array([0.0, 0.0, height])
    stood = replace(camera, R=R[None], t=-(R @ centre)[None])
    tilt = float(np.degrees(np.arcsin(np.clip(-up[2], -1.0, 1.0))))
    way = "down" if tilt > 0 else "up"
    note = diagnostic("one_camera_placed", height=height, angle=abs(tilt), way=way)
    return OneCameraWorld(stood, (note,), from_person=True)


def _level_axes(up: np.ndarray) -> np.ndarray:
    """Return (3, 3) a rotation from a world, Z up and the camera looking along Y, to the camera."""
    forward = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.95 else np.array([0.0, -np.sign(up[2]), 0.0])
    forward = forward - (forward @ up) * up
    forward /= np.linalg.norm(forward)
    return np.stack([np.cross(forward, up), forward, up], axis=1)
