"""A person of a given stature before one calibrated camera, and errors of a solve against truth and floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from research.simulation.benchmark import BenchmarkSettings
from research.simulation.filming import LENS, FilmSettings, film
from solver_backend.body.body import Body
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.stands import steps
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import BETAS_SIGMA, Person
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D
from tests.support.limb_errors import LIMBS, coverage, limb_errors, turn_coverage
from tests.support.scenes import look_at

SOLE_FRAMES = 3  # The mesh is posed in every third frame.
STANDING_M_S = 0.3  # A true foot that is slower and within 15 mm of the floor stands.


@dataclass(frozen=True)
class PersonTake:
    """A take of one camera with its truth."""

    name: str
    capture: Capture
    person: Person
    joints: np.ndarray  # (F, 24, 3) metres.


def betas_of_stature(body: Body, rng: np.random.Generator, stature: float) -> np.ndarray:
    """Return a random shape of this stature."""
    betas = np.clip(BETAS_SIGMA * rng.normal(size=10), -2.0, 2.0)
    ends = [int(pick(body.v_template[:, 1])) for pick in (np.argmax, np.argmin)]
    slope = body.shapedirs[ends[0], 1] - body.shapedirs[ends[1], 1]
    for _ in range(4):
        betas = betas + slope * (stature - body.stature_of(betas)) / (slope @ slope)
    return betas


def filmed(
    name: str,
    person: Person,
    fps: float,
    height: float,
    joint_set: JointSet,
    rng: np.random.Generator,
    angle: float | None = None,
) -> PersonTake:
    """Film a person by one camera so high above the floor, from an angle in radians, by default a random one."""
    true = person.landmarks(joint_set)
    pelvis = true.skeleton.joints[:, 0]
    middle = np.array([*(0.5 * (pelvis.min(axis=0) + pelvis.max(axis=0)))[:2], 0.5 * (height + 0.9)])
    reach = 4.2 + 0.5 * float(np.linalg.norm(np.ptp(pelvis[:, :2], axis=0)))
    angle = rng.uniform(0.0, 2.0 * np.pi) if angle is None else angle
    centre = middle + [reach * np.cos(angle), reach * np.sin(angle), height - middle[2]]
    R = look_at(centre, middle)
    K = np.array([[1350.0, 0.0, 960.0], [0.0, 1350.0, 540.0], [0.0, 0.0, 1.0]])
    cameras = Cameras(("cam01",), K[None], np.array([LENS]), R[None], -(R @ centre)[None], np.array([[1920, 1080]]))
    settings = BenchmarkSettings()
    offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(joint_set.num_keypoints, 3))
    found = film(person, cameras, FilmSettings(joint_set, fps, settings.detector, offsets), rng)
    capture = Capture(
        name=name,
        cameras=cameras,
        keypoints=Keypoints2D(found.xy, found.confidence, joint_set, fps),
        footage=(None,),
        sources=(name,),
    )
    return PersonTake(name, capture, person, true.skeleton.joints)


def figures(take: PersonTake) -> dict[str, float]:
    """Return the errors of a take in mm, percent and m/s."""
    motion = solve(take.capture).motion
    body, person = take.person.body, take.person
    off = np.linalg.norm(motion.joints - take.joints, axis=-1)[:, LIMBS]
    pa, _ = limb_errors(motion.joints, take.joints)
    frames = np.arange(0, motion.num_frames, SOLE_FRAMES)
    turns = [
        exp_so3(motion.global_orient[frames]),
        exp_so3(motion.body_pose[frames].reshape(len(frames), -1, 3)[:, :21]),
    ]
    solved = pose_mesh(body, motion.betas, *turns, motion.transl[frames])
    true = person.skin(frames)
    rest = body.v_template
    soles = [np.flatnonzero((rest[:, 1] < rest[:, 1].min() + 0.03) & (side * rest[:, 0] > 0)) for side in (1, -1)]
    low = np.stack([true[:, part, 2].min(axis=1) for part in soles], axis=1)
    way, seconds = steps(np.stack([true[:, part].mean(axis=1) for part in soles], axis=1), motion.fps / SOLE_FRAMES)
    standing = (np.linalg.norm(way, axis=-1) / seconds < STANDING_M_S) & (np.abs(low) < 0.015)
    height = np.stack([solved[:, part, 2].min(axis=1) for part in soles], axis=1)
    step, seconds = steps(np.stack([solved[:, part].mean(axis=1) for part in soles], axis=1), motion.fps / SOLE_FRAMES)
    speed = np.linalg.norm(step[..., :2], axis=-1) / seconds
    stature = body.stature_of(person.betas)
    return {
        "pa": pa,
        "world": 1000 * float(off.mean()),
        "inside_95": coverage(motion, take.joints),
        "turns_inside_95": turn_coverage(motion, body, person.orient, person.local),
        "stature": 100 * abs(body.stature_of(motion.betas) / stature - 1.0),
        "soles_within_10mm": 100 * float((np.abs(height - low)[standing] < 0.01).mean()),
        "sole_off": 1000 * float(np.abs((height - low)[standing]).mean()),
        "stance_speed": float(np.median(speed[standing])),
    }
