"""Studio people who move their hands in front of four cameras, and the errors of a solve."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF, finger_overlap
from solver_backend.body.hands import by_finger, hand_of_shape, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cameras.projection import project
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.hands.measured_hands import sort_hands
from solver_backend.fitters.hands.shown_hands import HandViews
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.synthesis.studio.person_hands import (
    HandFaults,
    MovingHands,
    detect_hands,
    hidden_points,
    move_hands,
)
from solver_backend.synthesis.studio.perturb import clean_capture, perturbed_capture
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import Stage, list_shots, set_up
from solver_backend.synthesis.studio.truth import find_truth, true_motion
from solver_backend.types import Capture, Motion

FLEXIONS = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF < 2))
"""Flexion angles of knuckles and middle joints of the four fingers, as the criterion uses them."""
CHI2_95 = 7.815  # 95 % quantile for three dimensions.


@dataclass(frozen=True)
class HandTake:
    """A take and its truth."""

    capture: Capture
    stage: Stage
    hands: MovingHands
    palm_px: float
    """Median size of a palm in the pictures, in pixels."""


def draw_take(seed: int, frames: int, fps: float, radius_m: float, faults: HandFaults | None = None) -> HandTake:
    """Return a random studio person with its choreography, in four views with detector errors."""
    array = {
        "layout": "ring", "count": 4, "size": [1920, 1080], "radius_m": radius_m,
        "distortion": [-0.09, 0.06, 0.0005, -0.0004, 0.0],
    }  # fmt: skip
    values = {"seed": seed, "frames": frames, "fps": fps, "camera_arrays": [array], "perturb": "detector"}
    spec = spec_of(values)
    stage = set_up(spec, list_shots(spec)[0])
    truth = find_truth(stage, fps)
    motion = true_motion(stage.person, stage.joints, truth.contacts, fps)
    capture = perturbed_capture(spec, stage, truth, clean_capture(spec, stage, truth, motion))
    assert capture.keypoints is not None and capture.cameras is not None
    rng = np.random.default_rng(seed)
    hands = move_hands(stage.person, fps, rng)
    hidden = hidden_points(stage.person, stage.cameras, hands.points)
    found = detect_hands(stage.cameras, hands.points, hidden, fps, faults or HandFaults(), rng)
    capture = replace(capture, keypoints=replace(capture.keypoints, hands=found))
    centres, wrists = stage.cameras.centres, hands.points[:, :, 0]
    far = np.linalg.norm(wrists[None] - centres[:, None, None], axis=-1)
    palm = np.linalg.norm(hands.points[:, :, 9] - wrists, axis=-1).mean()
    return HandTake(capture, stage, hands, float(np.median(stage.cameras.K[:, 0, 0, None, None] * palm / far)))


@dataclass(frozen=True)
class HandErrors:
    """Errors of a solve of both hands, in frames in which at least two views show the hand."""

    tips_mm: np.ndarray  # (n, 5) errors of fingertips in the world.
    own_tips_mm: np.ndarray  # (n, 5) errors of fingertips relative to the wrist and the palm's rotation.
    angles_deg: np.ndarray  # (n, 8) errors of the flexion of knuckles and middle joints.
    wrists_mm: np.ndarray  # (n,) errors of wrists.
    held: np.ndarray  # (n, 15) mask of finger joints inside their 95 % ellipsoids.
    overlap_mm: np.ndarray  # (n,) largest overlap of two fingers.
    seen: float  # Share of evaluated frames.


def errors_of(take: HandTake, motion: Motion) -> HandErrors:
    """Return the errors of a solved motion with fingers."""
    body, person = with_fingers(take.stage.person.body), take.stage.person
    size = motion.provenance["hands"]["size"]
    turns = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3))
    posed = forward_kinematics(body, motion.betas, exp_so3(motion.global_orient), turns, motion.transl)
    true_pose = forward_kinematics(person.body, person.betas, person.orient, person.local, person.transl)
    parts: list[list[np.ndarray]] = []
    keypoints = take.capture.keypoints
    assert keypoints is not None and keypoints.hands is not None and motion.joint_covariance is not None
    for side, name in enumerate(SIDES):
        hand = hand_of_shape(body, motion.betas, side).scaled(size)
        columns, wrist = list(SMPL_HANDS.group(f"{name}_hand")), SMPL_HANDS.joints.index(f"{name}_wrist")
        local = turns[:, np.array(columns) - 1]
        angles = hand.angles_of(by_finger(local))
        own = hand.sites(hand.pose(angles), hand.keypoints())
        points = motion.joints[:, None, wrist] + (posed.G[:, None, wrist] @ own[..., None])[..., 0]
        truth = take.hands.points[:, side]
        true_own = (np.swapaxes(true_pose.G[:, None, wrist], -1, -2) @ (truth - truth[:, :1])[..., None])[..., 0]
        tips = [4, 8, 12, 16, 20]
        shown = (keypoints.hands[:, :, side, :, 2] > 0).any(-1).sum(0) >= 2
        joints = np.delete(np.arange(1, 21), [3, 7, 11, 15, 19])
        from_smpl = points[:, joints] - truth[:, joints]
        covariance = unpacked(motion.joint_covariance[:, columns])
        ordered = by_finger(covariance).reshape(len(points), 15, 3, 3)
        square = (from_smpl * np.linalg.solve(ordered, from_smpl[..., None])[..., 0]).sum(-1)
        parts.append([
            1000 * np.linalg.norm(points[:, tips] - truth[:, tips], axis=-1)[shown],
            1000 * np.linalg.norm(own[:, tips] - true_own[:, tips], axis=-1)[shown],
            np.rad2deg(angles - take.hands.angles[:, side])[shown][:, FLEXIONS],
            1000 * np.linalg.norm(points[:, 0] - truth[:, 0], axis=-1)[shown],
            (square < CHI2_95)[shown],
            1000 * finger_overlap(points)[shown],
            shown,
        ])  # fmt: skip
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return HandErrors(*joined[:6], float(joined[6].mean()))


def sides_right(take: HandTake, motion: Motion) -> tuple[int, int]:
    """Return the numbers of hands with the correct side and of all hands, over all views, sorted by the solved wrists.

    A detected hand belongs to the side with the smaller mean distance of its true points.
    """
    cameras, keypoints = take.stage.cameras, take.capture.keypoints
    assert keypoints is not None
    views = HandViews.of(cameras, keypoints)
    assert views is not None
    columns = [[SMPL_HANDS.joints.index(f"{side}_{part}") for side in SIDES] for part in ("wrist", "elbow")]
    kept = sort_hands(views, *(motion.joints[:, part].astype(float) for part in columns)).views
    px = project(cameras, take.hands.points)
    seen = kept.confidence > 0
    far = np.linalg.norm(kept.xy[:, :, :, None] - px[:, :, None], axis=-1)
    far = np.where(seen[:, :, :, None], far, 0.0).sum(-1) / np.maximum(seen.sum(-1), 1)[..., None]
    right = far.argmin(axis=-1) == np.arange(len(SIDES))
    shown = seen.any(axis=-1)
    return int((right & shown).sum()), int(shown.sum())
