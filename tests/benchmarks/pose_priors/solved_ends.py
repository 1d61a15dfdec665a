"""Test whether a solve reaches the limits of feet, toes and hands. Its residual rotations extend its prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.joint_limits import from_swing_and_twist, swing_and_twist
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.cameras.projection import project
from solver_backend.fitters import solve
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import SPoser
from solver_backend.synthesis.embedded.demo import demo_capture, detect
from solver_backend.synthesis.faults import DEMO_DETECTOR
from solver_backend.types import Capture, JointSet, Keypoints2D, MarkerCloud
from tests.benchmarks.pose_priors.joint_ends import ends
from tests.benchmarks.pose_priors.prior_tables import Table

_FRAMES, _FPS = 120, 60.0
_HELD = slice(48, 73)
"""Evaluated frames. The angle is at its limit in frames 40 to 80."""
_NOISE = replace(DEMO_DETECTOR, drift_mm=6.25, missing=0.02, outliers=0.0)
_LAYOUT, _STRAY_M, _SHIVER_M = "CMU_41", 0.008, 0.0005


def solved_at_ends(prior: SPoser) -> Table:
    """Return each limit's angle for the left foot and hand, and the angles that solves of a take find, in degrees.

    One angle moves to its limit and stays there for 0.7 s. Four cameras with 2 px of noise see the person (BODY_25,
    without points on the hand). In CMU's 41 markers, placed 8 mm off, the person is calibrated from the same take with
    that angle at 0.
    """
    rows: Table = {}
    for name, column, axis, end in ends():
        betas, frames = _take(column, axis, end)
        person = calibrate_person([_worn(betas, _take(column, axis, 0.0)[1])])
        motions = {
            "views °": solve(_seen(betas, frames), prior=prior).motion,
            "markers °": solve(_worn(betas, frames), prior=prior, person=person).motion,
        }
        rows[name] = {"end °": np.degrees(end)}
        for kind, motion in motions.items():
            angles = swing_and_twist(exp_so3(motion.body_pose[_HELD, :63].reshape(-1, 21, 3)))
            rows[name][kind] = float(np.degrees(np.median(angles[:, column, axis])))
    return rows


def _take(column: int, axis: int, end: float) -> tuple[np.ndarray, PosedFrames]:
    """Return a shape, and the demo's first two seconds with one angle at its limit in the middle."""
    truth, chosen = demo_capture().truth, slice(0, _FRAMES)
    local = exp_so3(truth["body_pose"][chosen, :63].reshape(-1, 21, 3))
    share = np.clip((40 - np.abs(np.arange(_FRAMES) - 60)) / 20, 0.0, 1.0)
    angles = swing_and_twist(local)
    angles[:, column, axis] += (share * share * (3.0 - 2.0 * share)) * (end - angles[:, column, axis])
    local[:, column] = from_swing_and_twist(angles)[:, column]
    return truth["betas"], PosedFrames(exp_so3(truth["global_orient"][chosen]), local, truth["transl"][chosen])


def _seen(betas: np.ndarray, frames: PosedFrames) -> Capture:
    """Return the take as a detector's keypoints."""
    body, cameras = load_body(), demo_capture().cameras
    assert cameras is not None
    landmarks = keypoint_landmarks(body, JointSet.BODY_25)
    points = pose(Subject(body, landmarks, betas, np.zeros((len(landmarks), 3))), frames).points
    px = project(cameras, points)
    xy, confidence = detect(px, cameras.image_size, 60.0, _NOISE, np.random.default_rng(1))
    return Capture("end", cameras=cameras, keypoints=Keypoints2D(xy, confidence, JointSet.BODY_25, _FPS))


def _worn(betas: np.ndarray, frames: PosedFrames) -> Capture:
    """Return the take as markers."""
    body, labels, rng = load_body(), marker_layout(_LAYOUT), np.random.default_rng(2)
    stray = _STRAY_M * rng.normal(size=(len(labels), 3))
    points = pose(Subject(body, marker_landmarks(body, labels), betas, stray), frames).points
    cloud = MarkerCloud(points + _SHIVER_M * rng.normal(size=points.shape), _FPS, labels)
    return Capture("end", markers=cloud)
