"""How far limbs are from where they should be: after a similarity, about the hips, and in their own ellipsoids."""

from __future__ import annotations

import numpy as np

from solver_backend.biomechanics.segments import segment_turns
from solver_backend.body.body import Body
from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.types import Motion

LIMBS = tuple(
    SMPL_JOINTS.index(f"{side}_{part}")
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)  # fmt: skip
TOES = [SMPL_JOINTS.index(f"{side}_foot") for side in ("left", "right")]
HIPS = [LIMBS[6], LIMBS[7]]
CHI2_95 = 7.815
"""Of three degrees of freedom."""
SLANT = np.sin(np.radians(20.0))
"""A bone is flipped where it points the other way along the line of sight and is at least so slanted in both."""
BONES = tuple(
    tuple(SMPL_JOINTS.index(f"{side}_{part}") for part in parts)
    for side in ("left", "right") for parts in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
)  # fmt: skip
"""Joints of each limb."""


def limb_errors(joints: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Return mean distances of 12 limb joints in mm: after the best similarity, and about the middle of the hips."""
    about = [points[:, LIMBS] - points[:, HIPS].mean(axis=1, keepdims=True) for points in (joints, truth)]
    hip = 1000 * np.linalg.norm(about[0] - about[1], axis=-1)
    return pa_mpjpe_mm(joints[:, LIMBS], truth[:, LIMBS]), float(hip.mean())


def coverage(motion: Motion, truth: np.ndarray) -> float:
    """Return the share of limb joints inside their 95 % ellipsoids, percent."""
    assert motion.joint_covariance is not None
    off = (motion.joints - truth)[:, LIMBS]
    covariance = unpacked(motion.joint_covariance.astype(float))[:, LIMBS]
    deviation = np.einsum("fja,fja->fj", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    return 100 * float((deviation < CHI2_95).mean())


def turn_coverage(motion: Motion, body: Body, orient: np.ndarray, local: np.ndarray) -> float:
    """Return the share of segments with their turn inside the 95 % ellipsoid, percent.

    Args:
        orient: (F, 3, 3) true rotations of the root.
        local: (F, 21, 3, 3) of the joints.
    """
    assert motion.turn_covariance is not None
    pose = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3))
    true, found = segment_turns(body, orient, local), segment_turns(body, exp_so3(motion.global_orient), pose)
    off = np.asarray(log_so3(true @ np.swapaxes(found, -1, -2)))
    covariance = unpacked(motion.turn_covariance.astype(float)) + 1e-12 * np.eye(3)
    square = np.einsum("fsa,fsa->fs", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    return 100 * float((square < CHI2_95).mean())


def flipped(joints: np.ndarray, truth: np.ndarray, sight: np.ndarray) -> np.ndarray:
    """Return (F, 4) bool, limbs of which a bone points the other way along the line of sight than it should.

    Args:
        joints: (F, 24, 3).
        truth: (F, 24, 3).
        sight: (3,) unit direction in which the camera looks.
    """
    flips = []
    for first, middle, last in BONES:
        turned = np.zeros(len(joints), dtype=bool)
        for a, b in ((first, middle), (middle, last)):
            found, true = (_slant(points[:, b] - points[:, a], sight) for points in (joints, truth))
            turned |= (found * true < 0) & (np.abs(found) > SLANT) & (np.abs(true) > SLANT)
        flips.append(turned)
    return np.stack(flips, axis=1)


def flagged(motion: Motion) -> np.ndarray:
    """Return (F, 4) bool, limbs of the same order whose depth the motion reports as open."""
    ends = [SMPL_JOINTS[limb[-1]] for limb in BONES]
    open_depth = np.zeros((motion.num_frames, len(ends)), dtype=bool)
    for item in read_diagnostics(motion.provenance["diagnostics"]):
        for joint in item.where.joints if item.code == "limb_depth_open" else ():
            for first, last in item.where.frames if joint in ends else ():
                open_depth[first : last + 1, ends.index(joint)] = True
    return open_depth


def _slant(bone: np.ndarray, sight: np.ndarray) -> np.ndarray:
    return bone @ sight / np.linalg.norm(bone, axis=-1)


def acceleration(joints: np.ndarray, fps: float) -> np.ndarray:
    """Return (F - 2, 12, 3) accelerations of the limb joints, m/s²."""
    return np.diff(joints[:, LIMBS], 2, axis=0) * fps**2
