"""Build a motion from the solved poses, with joints, keypoints, residuals and flags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.body.kinematics import recorded_vectors
from solver_backend.fitters.keyframes.initial_keys import lost_landmarks
from solver_backend.fitters.model.subject import BLOCK_POSES, Subject, pose
from solver_backend.fitters.problem import Measurements, SolvedFrames, SolvedLayer, noted
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import mean_sigma
from solver_backend.types import FLAG_RESTING, FLAG_UNSEEN, FLAG_UNSURE, Motion

FAR, FAR_SIGMAS = 3.0, 2.0  # A far residual exceeds this multiple of the median, and this many deviations.
LOOSE, LOOSE_M = 2.0, 0.03  # A loose joint's deviation exceeds this multiple of its median, and this length.


def flagged(
    normalised: np.ndarray,
    seen: np.ndarray,
    sigma: np.ndarray | None,
    lost: np.ndarray | None = None,
    resting: np.ndarray | None = None,
) -> np.ndarray:
    """Return (F,) bit flags that mark doubtful frames.

    Args:
        normalised: (C, F, K) residuals of K points in C views, in standard deviations, NaN where undetected.
        seen: (F,) bool, true if enough views show the person.
        sigma: (F, J) standard deviation of each joint in metres, if known.
        lost: (F,) bool, true if a limb is lost (see ``lost_landmarks``).
        resting: (F, J) bool, true for joints without information. Frames with at least one of these joints get a
            separate flag.
    """
    flags = np.where(seen, 0, FLAG_UNSEEN).astype(np.uint8)
    unsure = _far(normalised)
    if resting is not None:
        flags[resting.any(axis=1)] |= FLAG_RESTING
    if sigma is not None:
        unsure |= _loose(sigma, resting).any(axis=1)
    if lost is not None:
        unsure |= lost
    flags[unsure] |= FLAG_UNSURE
    return flags


def _loose(sigma: np.ndarray, resting: np.ndarray | None) -> np.ndarray:
    if resting is None:
        return sigma > np.maximum(LOOSE * np.median(sigma, axis=0), LOOSE_M)
    usual = np.full(sigma.shape[1], np.inf)
    for j in np.flatnonzero(~resting.all(axis=0)):
        usual[j] = np.median(sigma[~resting[:, j], j])
    return ~resting & (sigma > np.maximum(LOOSE * usual, LOOSE_M))


def _far(normalised: np.ndarray) -> np.ndarray:
    """Return an (F,) mask of frames with a median residual far above the take's median."""
    frames = normalised.shape[1]
    ordered = np.sort(normalised.swapaxes(0, 1).reshape(frames, -1), axis=1)  # missing values come last
    count = np.isfinite(ordered).sum(axis=1)
    row, least = np.arange(frames), np.maximum(count, 1)
    per_frame = 0.5 * (ordered[row, (least - 1) // 2] + ordered[row, least // 2])
    measured = count > 0
    if not measured.any():
        return measured
    return measured & (per_frame > max(FAR * float(np.median(per_frame[measured])), FAR_SIGMAS))


@dataclass(frozen=True)
class PosedTake:
    """Solved body in all frames of a take: landmarks, joints, bones and residuals."""

    subject: Subject
    points: np.ndarray  # (F, L, 3) landmarks in metres, in the poses that explain the measurements.
    joints: np.ndarray  # (F, J, 3) metres.
    bones: np.ndarray  # (F, J, 3, 3) global rotations, empty if the source does not keep them.
    deviations: np.ndarray  # (C, F, K) residuals in standard deviations, NaN where nothing was measured.

    @classmethod
    def of(cls, measurements: Measurements, solved: SolvedFrames) -> PosedTake:
        """Pose the solved body in all frames. Frames are processed in blocks to limit memory use."""
        parts = []
        for start in range(0, len(solved.frames.transl), BLOCK_POSES):
            part = slice(start, start + BLOCK_POSES)
            posed = pose(solved.subject, solved.frames.select(part))
            fitted = posed if solved.fitted is None else pose(solved.subject, solved.fitted.select(part))
            bones = posed.skeleton.G if measurements.source.KEEPS_BONES else posed.skeleton.G[:0]
            left = measurements.term.select(part).residuals(fitted.points).deviations
            parts.append([to_numpy(a) for a in (fitted.points, posed.skeleton.joints, bones, left)])
        points, joints, bones, left = zip(*parts, strict=True)
        whole = [np.concatenate(part) for part in (points, joints, bones)]
        return cls(solved.subject, whole[0], whole[1], whole[2], np.concatenate(left, axis=1))

    @property
    def offsets(self) -> np.ndarray:
        """(L, 3) calibrated landmark offsets in metres."""
        return to_numpy(self.subject.offsets)


def build_motion(
    measurements: Measurements,
    solved: SolvedFrames,
    layers: Sequence[SolvedLayer] = (),
    *,
    scale: float,
    provenance: dict[str, Any],
) -> Motion:
    """Build the motion of F solved frames, and add the results of ``layers``, such as hands."""
    subject, frames, posed = solved.subject, solved.frames, PosedTake.of(measurements, solved)
    reprojection_px, statistics = measurements.source.report(posed.points)
    outliers = posed.deviations[np.isfinite(posed.deviations)] > 2 * scale
    figures = {name: _rounded(value) for name, value in statistics.items()}
    figures["outliers_percent"] = _rounded(100 * outliers.mean())
    offsets_mm = [_rounded(v) for v in 1000 * np.linalg.norm(posed.offsets, axis=-1)]
    record = noted(provenance, solved.diagnostics) if solved.diagnostics else provenance
    keyframes = np.zeros(measurements.num_frames, dtype=bool)
    keyframes[np.round(solved.key_times).astype(int)] = True
    covariance, turns = (None if part is None else to_numpy(part) for part in (solved.covariance, solved.turns))
    sigma = None if covariance is None else mean_sigma(covariance)
    lost = lost_landmarks(posed.points, measurements.points, measurements.covariance)
    motion = Motion(
        betas=to_numpy(subject.betas),
        global_orient=_turns(frames.root),
        body_pose=recorded_vectors(subject.body, _turns(frames.local)).reshape(measurements.num_frames, -1),
        transl=to_numpy(frames.transl),
        fps=measurements.fps,
        body=subject.body.id,
        joints=posed.joints[:, list(subject.body.recorded_joints)],
        body_layout=subject.body.layout.recorded,
        joint_sigma=sigma,
        joint_covariance=covariance,
        turn_covariance=turns if turns is not None and turns.shape[1] else None,
        keyframes=keyframes,
        contacts=solved.contacts,
        touches=solved.touches,
        flags=flagged(posed.deviations, measurements.seen, sigma, lost.any(axis=1), solved.resting),
        resting=solved.resting,
        reprojection_px=None if reprojection_px is None else reprojection_px.astype(np.float32),
        provenance={**record, "statistics": {**figures, "offsets_mm": offsets_mm}},
    )
    for layer in (measurements.source, *layers):
        motion = layer.record(motion, posed)
    return motion


def _turns(rotations: Array) -> np.ndarray:
    starts = range(0, rotations.shape[0], BLOCK_POSES)
    return np.concatenate([to_numpy(log_so3(rotations[start : start + BLOCK_POSES])) for start in starts])


def _rounded(value: float) -> float:
    return round(float(value), 3)
