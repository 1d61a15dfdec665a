"""41 optical markers of a real walk (CMU 02_01), fitted by plain least squares: pose, shape and marker offsets.

Distances of the body's joints to those of the recording's own skeleton, in mm, with nothing aligned. That skeleton is
itself an estimate with other joint centres: the "steady" figure takes out each joint's constant offset in the frame of
its bone and so shows the error of the motion alone. Needs ezc3d and the recordings kept beside the repository (or
MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.markers import marker_landmarks
from solver_backend.cameras.triangulation import Triangulation
from solver_backend.fitters.frame import fit_frames, posed
from solver_backend.fitters.initial import Observations, fit_to_points
from solver_backend.fitters.shape import ShapePrior, fit_shape, refit_shape
from solver_backend.fitters.subject import PosedFrames, Subject, frame_equations, pose
from solver_backend.geometry.rotations import exp_so3, left_jacobian_inverse_so3, log_so3
from solver_backend.io.bvh import read_bvh
from solver_backend.priors.base import PosePrior
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.positions import PositionTerm
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.solver.normal_equations import DenseBlocks
from solver_backend.types import SMPL_JOINTS
from tests.benchmarks.metric import BenchmarkSkipped, Metric

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
_PLAIN = (1000.0,)
_SIGMA_M, _SAMPLE = 0.004, 40
_SHAPE_PRIOR = ShapePrior(betas_sigma=1.0, offset_sigma_m=0.012, evidence=0.2)
_METRES_PER_UNIT, _THORAX_M, _WRIST_BONE = 0.0564444, 0.119, 0.5
"""Bones that this conversion of the skeleton lacks: the thorax's, and the wrist's, half as long as the radius's."""
_REFERENCE = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip


@dataclass(frozen=True)
class Take:
    """Markers and reference joints of the same frames, metres, Z up."""

    labels: tuple[str, ...]
    markers: np.ndarray
    """(F, L, 3)."""
    joints: dict[str, np.ndarray]
    """(F, 3) by SMPL's joint name."""


def run() -> list[Metric]:
    """Fit and compare."""
    take = read_take(Path(os.environ.get("MOCAP_SHARED_DATA", DATA)))
    subject, frames = fit(take, load_body(), load_sposer())
    residual = np.linalg.norm(pose(subject, frames).points - take.markers, axis=-1)
    skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
    distance, steady = {}, {}
    for name, reference in take.joints.items():
        j = SMPL_JOINTS.index(name)
        error = skeleton.joints[:, j] - reference
        bone = skeleton.G[:, subject.body.parents[j]]
        local = (np.swapaxes(bone, 1, 2) @ error[..., None])[..., 0]
        distance[name] = 1e3 * float(np.linalg.norm(error, axis=-1).mean())
        steady[name] = 1e3 * float(np.linalg.norm(local - local.mean(0), axis=-1).mean())
    return [
        Metric("mean_mm", float(np.mean([*distance.values()])), "mm"),
        Metric("steady_mean_mm", float(np.mean([*steady.values()])), "mm"),
        Metric("marker_residual_mm", 1e3 * float(residual.mean()), "mm"),
        *(Metric(f"{name}_mm", value, "mm", rel_tol=0.1) for name, value in distance.items()),
        *(Metric(f"{name}_steady_mm", value, "mm", rel_tol=0.1) for name, value in steady.items()),
    ]


def read_take(data: Path) -> Take:
    """Read markers and reference.

    Raises:
        BenchmarkSkipped: the recording or ezc3d is missing.
    """
    c3d, bvh = data / "markers" / "cmu_pairs" / "02_01.c3d", data / "bvh_samples" / "cmu_mb2_02_01.bvh"
    if not (c3d.is_file() and bvh.is_file()):
        raise BenchmarkSkipped("The recording is not here.", hint="Set MOCAP_SHARED_DATA to the folder of recordings.")
    try:
        import ezc3d
    except ImportError:
        raise BenchmarkSkipped("ezc3d is not installed.", hint="pip install ezc3d") from None
    content: Any = ezc3d.c3d(str(c3d))
    labels = tuple(label.split(":")[-1] for label in content["parameters"]["POINT"]["LABELS"]["value"])
    markers = 1e-3 * np.moveaxis(content["data"]["points"][:3], 0, -1).swapaxes(0, 1)
    clip = read_bvh(bvh, metres_per_unit=_METRES_PER_UNIT)
    offsets = clip.offsets.copy()
    for joint in ("Neck", "LeftShoulder", "RightShoulder"):
        offsets[clip.names.index(joint)] = (0.0, _THORAX_M, 0.0)
    positions = replace(clip, offsets=offsets, translations=None).positions()[1 : len(markers) + 1]
    joints = {
        f"{side}_{ours}": positions[:, clip.names.index(side.capitalize() + theirs)]
        for ours, theirs in _REFERENCE.items()
        for side in ("left", "right")
    }
    for side in ("left", "right"):
        elbow, hand = joints[f"{side}_elbow"], joints[f"{side}_wrist"]
        joints[f"{side}_wrist"] = hand + _WRIST_BONE * (hand - elbow)
    # Both have Z up; the skeleton's file has its axes a quarter turn about it.
    return Take(labels, np.stack([markers[..., 1], -markers[..., 0], markers[..., 2]], -1), joints)


def fit(take: Take, body: Body, prior: PosePrior) -> tuple[Subject, PosedFrames]:
    """Fit shape and offsets on a sample of frames, all frames with the prior, then every joint by itself."""
    count, num = take.markers.shape[:2]
    subject = Subject(body, marker_landmarks(body, take.labels), np.zeros(10), np.zeros((num, 3)))
    sample = np.unique(np.linspace(0, count - 1, _SAMPLE).astype(int))
    term = PositionTerm(take.markers, np.full((count, num), _SIGMA_M**-2))
    observations = _as_observations(take.markers)
    start = fit_to_points(subject, prior, observations, sample)
    loose = PositionTerm(take.markers[sample], np.full((len(sample), num), 0.015**-2))
    subject, start = fit_shape(subject, prior, loose, start, _PLAIN, 15, _SHAPE_PRIOR)
    frames = posed(prior, start)
    for _ in range(4):
        frames = free_joints(subject, frames, term.select(sample), prior)
        subject = refit_shape(subject, frames, term.select(sample), _PLAIN[0], _SHAPE_PRIOR)
    everywhere = fit_to_points(subject, prior, observations, np.arange(count))
    everywhere, _ = fit_frames(subject, prior, term, everywhere, _PLAIN, 12)
    return subject, free_joints(subject, posed(prior, everywhere), term, prior)


def free_joints(
    subject: Subject, start: PosedFrames, term: PositionTerm, prior: PosePrior, iterations: int = 12
) -> PosedFrames:
    """Fit every joint's rotation by itself, held to where it starts by the prior's own reconstruction error."""
    precision = 1.0 / np.asarray(prior.residual_sigma) ** 2

    def linearise(frames: PosedFrames) -> tuple[np.ndarray, DenseBlocks]:
        equations = frame_equations(subject, frames, term, _PLAIN[0])
        away = log_so3(frames.local @ np.swapaxes(start.local, -1, -2))
        back = left_jacobian_inverse_so3(away)
        pull = np.swapaxes(back, -1, -2) @ (precision * away)[..., None]
        hessian, gradient = equations.hessian.copy(), equations.gradient.copy()
        gradient[:, 3:66] += pull.reshape(len(away), -1)
        for j in range(away.shape[1]):
            block = slice(3 + 3 * j, 6 + 3 * j)
            hessian[:, block, block] += np.swapaxes(back[:, j], -1, -2) @ (precision[j, :, None] * back[:, j])
        cost = equations.cost + 0.5 * (precision * away * away).sum((1, 2))
        return cost, DenseBlocks(hessian + 1e-3 * np.eye(hessian.shape[-1]), gradient)

    def retract(frames: PosedFrames, step: np.ndarray) -> PosedFrames:
        turn = exp_so3(step[:, 3:66].reshape(-1, 21, 3))
        return PosedFrames(exp_so3(step[:, :3]) @ frames.root, turn @ frames.local, frames.transl + step[:, 66:])

    def select(mask: np.ndarray, new: PosedFrames, old: PosedFrames) -> PosedFrames:
        pick = mask[:, None, None]
        return PosedFrames(
            np.where(pick, new.root, old.root),
            np.where(pick[..., None], new.local, old.local),
            np.where(mask[:, None], new.transl, old.transl),
        )

    return levenberg_marquardt(start, linearise, retract, select, LMSettings(max_iterations=iterations)).state


def _as_observations(markers: np.ndarray) -> Observations:
    """Return markers as if they had been triangulated, without error."""
    count, num = markers.shape[:2]
    return Observations(
        Triangulation(
            markers, np.zeros((count, num, 3, 3)), np.ones((1, count, num), bool), np.zeros((1, count, num)),
            np.ones(num),
        ),
        np.ones(num), np.ones(count, bool),
    )  # fmt: skip
