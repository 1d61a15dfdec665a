"""Estimate the scale of a world from a person's stature or a distance between two keypoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from solver_backend.agreement.body_evidence import (
    BONES,
    MEAN_STATURE_M,
    POSSIBLE_M,
    STATURE_SPREAD_M,
    STATURES_M,
    judge_body,
)
from solver_backend.agreement.evidence import MOST_ROUNDS, TakeEvidence
from solver_backend.agreement.reading import Reading
from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.units_and_axes import METRES
from solver_backend.types import Detections, JointSet
from solver_backend.types.shapes import Float

SHARES = {
    (f"{side}_{a}", f"{side}_{b}"): share for side in ("left", "right") for a, b, share in (
        ("hip", "knee", 1.0), ("knee", "ankle", 1.0), ("shoulder", "elbow", 1.0), ("elbow", "wrist", 1.0),
        ("shoulder", "hip", 0.952),
    )
} | {("left_shoulder", "right_shoulder"): 0.97, ("left_hip", "right_hip"): 0.987}  # fmt: skip
"""Pairs of keypoints, and the ratio of their distance in moving people to their distance in the T-pose. Hanging arms
lower the shoulders. The medians of eight takes of walking, dance and exercises agree within 0.01."""
LEG_SHARE = sum(length for _, lower, length in BONES if lower in ("knee", "ankle"))
"""Length of thigh and shank relative to the stature."""
LENGTH_SIGMA_M = 0.012  # Standard deviation of a detected bone length or a stated stature from the body's, metres.


def bone_lengths(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> dict[tuple[str, str], float]:
    """Measure the median length of each bone in the joint set, in the unit of the points."""
    names = joint_set.keypoints
    found = {}
    for a, b in SHARES:
        if a in names and b in names:
            apart = np.linalg.norm(points[:, names.index(a)] - points[:, names.index(b)], axis=-1)
            if np.isfinite(apart).any():
                found[a, b] = float(np.nanmedian(apart))
    return found


def scale_from_stature(
    points: Float[np.ndarray, "frames keypoints 3"],
    joint_set: JointSet,
    stature_m: float | None,
    body: Body | None = None,
) -> tuple[float, float]:
    """Estimate the metres per unit of the points, and the relative standard deviation of this scale.

    Scale s and shape β minimise ``Σ (s l_i - L_i(β))²/σ² + |β|² + (h(β) - stature)²/σ_h²`` by robust least squares.
    Here l are measured lengths of limbs, trunk and breadths. L and h are the lengths and the stature of the body.

    Args:
        points: (F, K, 3) keypoints, NaN where unknown.
        stature_m: stature of the person in metres. None uses the distribution of adults.

    Raises:
        JobInvalid: there are too few bones, all bones have length zero, or the stature is impossible.
    """
    if stature_m is not None and not 0.5 < stature_m < 2.6:
        raise JobInvalid(f"A height of {stature_m:g} m is impossible.", hint="Specify it in metres, such as 1.78.")
    body = body or load_body()
    measured = bone_lengths(points, joint_set)
    if len(measured) < 3:
        raise JobInvalid(f"{joint_set.value} has too few bones to estimate the scale.", hint="Set a known length.")
    names, landmarks = joint_set.keypoints, keypoint_landmarks(body, joint_set)
    start, end = np.array([[names.index(a), names.index(b)] for a, b in measured]).T
    posed = np.array([SHARES[pair] for pair in measured])

    def bones(betas: np.ndarray) -> np.ndarray:
        points = rest_keypoints(body, landmarks, betas)
        return posed * np.linalg.norm(points[start] - points[end], axis=1)

    lengths, by_shape = _linear(bones)
    heights, height_by_shape = _linear(
        lambda betas: np.asarray(np.ptp((body.v_template + body.shapedirs[..., :10] @ betas)[:, 1]))
    )
    apart = np.array(list(measured.values()))
    if not apart.max() > np.finfo(np.float32).resolution * max(1.0, float(np.nanmax(np.abs(points)))):
        raise JobInvalid("All keypoints of the person are at one point.", hint="Set a known length, or detect again.")
    prior = (stature_m, LENGTH_SIGMA_M) if stature_m else (MEAN_STATURE_M, STATURE_SPREAD_M)
    J = np.zeros((len(apart) + 11, 11))
    J[: len(apart), 0], J[: len(apart), 1:] = apart / LENGTH_SIGMA_M, -by_shape / LENGTH_SIGMA_M
    J[len(apart) : -1, 1:] = np.eye(10)
    J[-1, 1:] = height_by_shape / prior[1]
    right = np.concatenate([lengths / LENGTH_SIGMA_M, np.zeros(10), [(prior[0] - heights) / prior[1]]])
    weight = np.ones(len(right))
    x = np.zeros(11)
    for _ in range(MOST_ROUNDS):  # bones that the detector defines differently lose their weight
        x = np.linalg.lstsq(J * weight[:, None], right * weight, rcond=None)[0]
        residual = (J @ x - right)[: len(apart)]
        weight[: len(apart)] = 1.0 / np.sqrt(1.0 + residual**2 / 4.0)
    weighted = J * weight[:, None]
    sigma = float(np.sqrt(np.linalg.inv(weighted.T @ weighted)[0, 0]))
    return float(x[0]), sigma / float(x[0])


def scale_from_length(
    points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, ends: tuple[str, str], length_m: float
) -> float:
    """Return the metres per unit of the points from a known distance between two keypoints.

    Raises:
        JobInvalid: a keypoint is not in the joint set, or both are never visible together.
    """
    names = joint_set.keypoints
    unknown = [name for name in ends if name not in names]
    if unknown:
        raise JobInvalid(f"{joint_set.value} has no {', '.join(unknown)}.", hint=f"It has {', '.join(names)}.")
    apart = np.linalg.norm(points[:, names.index(ends[0])] - points[:, names.index(ends[1])], axis=-1)
    if not np.isfinite(apart).any():
        raise JobInvalid(f"{ends[0]} and {ends[1]} are never visible at the same time. Choose other keypoints.")
    return length_m / float(np.nanmedian(apart))


def _linear(of: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Linearise a function of the betas. Return (N,) values for the mean body shape and (N, 10) derivatives."""
    return of(np.zeros(10)), np.stack([(of(e) - of(-e)) / 2 for e in np.eye(10)], axis=-1)


def rest_keypoints(body: Body, landmarks: Landmarks, betas: np.ndarray) -> Float[np.ndarray, "keypoints 3"]:
    """Return the keypoints of a body shape in the rest pose in metres, Y up."""
    still = np.eye(3)[None]
    return pose_landmarks(
        body, landmarks, betas, still, np.tile(np.eye(3), (1, NUM_BODY_JOINTS, 1, 1)), np.zeros((1, 3))
    ).points[0]


_UNITS = ("m", "cm", "mm", "inch")
"""Units that a stature distinguishes. Feet are absent, because a stature of 5.8 may also be in squares of a board."""


def in_persons_unit(calibration: Calibration, detections: Detections, *, keep: bool) -> tuple[Calibration, float]:
    """Return the calibration in a unit that makes the stature possible, and a factor of all lengths.

    The unit changes only if it was guessed from the distances between cameras, and never with ``keep``. If no unit
    fits, the factor makes the person an average adult. Otherwise it is 1.
    """
    cameras, guessed = calibration.cameras, "" if keep else calibration.guessed_unit
    evidence, written = TakeEvidence(cameras, detections), Reading.as_written(len(cameras))
    if evidence.views < 2 or not evidence.poses or not np.ptp(cameras.centres, axis=0).any():
        return calibration, 1.0
    stature = judge_body(evidence, written).height if evidence.noise([written]).is_related[0] else np.nan
    if not np.isfinite(stature) or POSSIBLE_M[0] <= stature <= POSSIBLE_M[1]:
        return calibration, 1.0
    factors = {unit: METRES[unit] / METRES[guessed] for unit in _UNITS} if guessed else {}
    fitting = [unit for unit, factor in factors.items() if STATURES_M[0] <= stature * factor <= STATURES_M[1]]
    if len(fitting) != 1:
        return calibration, MEAN_STATURE_M / stature
    (unit,) = fitting
    found = diagnostic("unit_by_person", unit=unit, stature=stature * factors[unit], read=stature, guessed=guessed)
    cameras = replace(cameras, t=cameras.t * factors[unit])
    notes = tuple(note for note in calibration.notes if note.code != "unit_read")
    return replace(calibration, cameras=cameras, notes=notes, problems=(*calibration.problems, found)), 1.0
