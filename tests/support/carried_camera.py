"""A person filmed by a camera that somebody carries, with a simulated detector and known poses of the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from research.simulation.filming import FilmSettings, film
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from solver_backend.synthesis.simulation.cast import Person, Take, cast_person
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D
from tests.support.standing_people import grounded

JOINT_SET = JointSet.BODY_25
SIZE = (1280, 720)
FOCAL_PX = 1000.0


@dataclass(frozen=True)
class Carried:
    """A capture of one carried camera. Its cameras hold the true path, its truth the person."""

    capture: Capture
    person: Person
    R: np.ndarray  # (F, 3, 3) world to camera.
    t: np.ndarray  # (F, 3) metres.


def camera_way(pelvis: np.ndarray, fps: float, style: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return camera poses (F, 3, 3) and (F, 3) that follow a pelvis (F, 3): hand-held, dolly or orbit."""
    rng, count = np.random.default_rng(seed), len(pelvis)
    time, slow = np.arange(count) / fps, smooth(pelvis, 0.5 * fps)
    side = rng.uniform(0, 2 * np.pi)
    if style == "orbit":
        angle = side + np.radians(35.0) * time
        centre = slow + 3.6 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    elif style == "dolly":
        along = unit(slow[-1] - slow[0]) * [1, 1, 0]
        across = np.array([-along[1], along[0], 0.0])
        centre = slow.mean(axis=0) + 4.0 * across + (time[:, None] - time.mean()) * 0.6 * along
    else:
        centre = smooth(slow, 0.5 * fps) + 3.5 * np.array([np.cos(side), np.sin(side), 0.0])
    centre[:, 2] = 1.5
    aim = smooth(pelvis, 0.4 * fps) - centre
    shake = np.zeros((count, 3))
    if style != "dolly":
        step = 2 * np.pi * 1.8 * time
        centre = centre + np.stack([0.02 * np.sin(step / 2), 0.02 * np.cos(step / 2), 0.02 * np.sin(step)], axis=1)
        centre += smooth(rng.normal(size=(count, 3)), 0.3 * fps) * 0.05
        shake = smooth(rng.normal(size=(count, 3)), 0.1 * fps)
        shake *= np.radians(0.8) / shake.std()
    forward = unit(aim)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    R = exp_so3(shake) @ np.stack([right, np.cross(forward, right), forward], axis=1)
    return R, -np.einsum("fab,fb->fa", R, centre)


def before_still_camera(person: Person, R: np.ndarray, t: np.ndarray) -> Person:
    """Return the person in the axes of a camera with these poses, so that the camera stands at the origin."""
    rest = person.body.rest_joints(person.betas)[0]
    transl = np.einsum("fab,fb->fa", R, rest + person.transl) + t - rest
    return replace(person, orient=R @ person.orient, transl=transl)


def film_carried(take: Take, style: str, seed: int = 0, detector: DetectorFaults = MEASURED_DETECTOR) -> Carried:
    """Film a take with a carried camera."""
    rng = np.random.default_rng(seed)
    return film_person(take.name, grounded(cast_person(take, rng), take.fps), take.fps, style, seed, detector, rng)


def film_person(
    name: str, person: Person, fps: float, style: str, seed: int, detector: DetectorFaults, rng: np.random.Generator
) -> Carried:
    """Film a person with a carried camera."""
    posed = person.landmarks(JOINT_SET)
    R, t = camera_way(posed.skeleton.joints[:, 0], fps, style, seed)
    K = np.array([[[FOCAL_PX, 0, (SIZE[0] - 1) / 2], [0, FOCAL_PX, (SIZE[1] - 1) / 2], [0, 0, 1.0]]])
    camera = Cameras(("phone",), K, np.zeros((1, 8)), np.eye(3)[None], np.zeros((1, 3)), np.array([SIZE]))
    offsets = 0.008 * rng.normal(size=(JOINT_SET.num_keypoints, 3))
    found = film(before_still_camera(person, R, t), camera, FilmSettings(JOINT_SET, fps, detector, offsets), rng)
    keypoints = Keypoints2D(found.xy, found.confidence, JOINT_SET, fps)
    truth = {"betas": person.betas, "joints": posed.skeleton.joints, "keypoints3d": posed.points}
    return Carried(Capture(name, camera.carried(R, t), keypoints, truth=truth), person, R, t)
