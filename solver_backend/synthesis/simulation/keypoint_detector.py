"""Simulate a 2D pose detector: bias, drift, jitter, self-occlusion, outliers and swapped limbs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.view_faults import EXCHANGED, limb_columns
from solver_backend.body.body import Body
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import DetectorFaults, autoregressive, bursts
from solver_backend.types import SMPL_JOINTS, Cameras, JointSet

_HARMONICS = np.sqrt([0.2, 0.4, 0.4, 0.4, 0.4])  # Amplitudes of a bias over the heading: 1, cos, sin, cos 2, sin 2.


@dataclass(frozen=True)
class DetectorOutput:
    """Simulated detections, and masks of their faults."""

    xy: np.ndarray  # (C, F, K, 2) pixels, NaN where missing.
    confidence: np.ndarray  # (C, F, K) confidences, 0 where missing.
    swapped: np.ndarray  # (C, F, K) bool, True if the detection shows the opposite side.
    outlier: np.ndarray  # (C, F, K) bool, True for outliers.
    swaps: np.ndarray  # (N, 4) integers: view, index into ``EXCHANGED``, first frame, frame after the last.


@dataclass(frozen=True)
class Sight:
    """True positions and visibility of K keypoints in C cameras, the input of a simulated detector."""

    px: np.ndarray  # (C, F, K, 2) true pixels.
    px_per_mm: np.ndarray  # (C, F, K) pixels per millimetre at each point.
    seen_from: np.ndarray  # (C, F) angle in radians of each camera about the body's vertical axis, 0 in front.
    occluded: np.ndarray  # (C, F, K) bool, True for occluded points.
    image_size: np.ndarray  # (C, 2) image width and height.


def detect_keypoints(
    sight: Sight, joint_set: JointSet, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> DetectorOutput:
    """Simulate the detections of a joint set's K keypoints with the given faults."""
    px, occluded = sight.px, sight.occluded
    shape = px.shape[:-1]
    uneven = np.exp(faults.unevenness * rng.normal(size=(shape[0], 1, shape[2], 1)) - faults.unevenness**2)
    drift = faults.drift_mm * autoregressive(px.shape, float(np.exp(-1.0 / (faults.drift_s * fps))), rng)
    moving = uneven * (drift + faults.jitter_mm * rng.normal(size=px.shape))
    moving = moving * np.where(occluded, faults.occluded_jitter, 1.0)[..., None]
    error_mm = moving + faults.view_bias_mm * bias_by_direction(sight.seen_from, shape[2], rng)
    outlier = bursts(rng.random(shape), faults.outliers, max(1.0, faults.outlier_s * fps))
    confidence = _confidence(np.linalg.norm(error_mm, axis=-1), outlier, occluded, rng)
    error_mm = error_mm + np.where(outlier[..., None], _elsewhere(shape, faults, rng), 0.0)
    xy = px + error_mm * sight.px_per_mm[..., None]
    swapped, swaps = _swaps(shape, joint_set, fps, faults, rng)
    mirrored = list(joint_set.mirrored())
    xy = np.where(swapped[..., None], xy[:, :, mirrored], xy)
    confidence = np.where(swapped, confidence[:, :, mirrored], confidence)
    frames = max(1.0, faults.burst_s * fps)
    gives_up = occluded & bursts(rng.random(shape), faults.occluded_missing, 2 * frames)
    inside = ((xy >= 0) & (xy < sight.image_size[:, None, None])).all(-1)
    missing = gives_up | bursts(rng.random(shape), faults.missing, frames) | ~inside
    xy, confidence = np.where(missing[..., None], np.nan, xy), np.where(missing, 0.0, confidence)
    return DetectorOutput(xy, confidence, swapped & ~missing, outlier & ~missing, swaps)


def bias_by_direction(seen_from: np.ndarray, num_keypoints: int, rng: np.random.Generator) -> np.ndarray:
    """Draw a (C, F, K, 2) bias of unit variance that varies smoothly with the viewing direction."""
    waves = rng.normal(size=(5, num_keypoints, 2)) * _HARMONICS[:, None, None]
    one, double = seen_from, 2 * seen_from
    basis = np.stack([np.ones_like(one), np.cos(one), np.sin(one), np.cos(double), np.sin(double)], axis=-1)
    return np.tensordot(basis, waves, axes=1)


def _elsewhere(shape: tuple[int, ...], faults: DetectorFaults, rng: np.random.Generator) -> np.ndarray:
    """Return (C, F, K, 2) offsets of outliers in millimetres. Each offset lasts for six frames."""
    hold = np.repeat(np.arange(0, shape[1], 6), 6)[: shape[1]]
    angle, factor = rng.uniform(0, 2 * np.pi, shape)[:, hold], rng.uniform(0.5, 1.5, shape)[:, hold]
    return faults.outlier_mm * factor[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _confidence(
    error_mm: np.ndarray, outlier: np.ndarray, occluded: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return confidences that partly reflect the error, with a rank correlation of -0.29."""
    inlier = 0.68 - 0.0022 * error_mm - 0.15 * occluded + 0.09 * rng.normal(size=error_mm.shape)
    return np.clip(np.where(outlier, rng.uniform(0.1, 0.55, error_mm.shape), inlier), 0.05, 1.0)


def _swaps(
    shape: tuple[int, ...], joint_set: JointSet, fps: float, faults: DetectorFaults, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw left-right swaps of limbs. Return a mask (C, F, K), and the (view, limb, start, stop) of each swap."""
    mask, swaps = np.zeros(shape, dtype=bool), []
    for limb, columns in enumerate(exchanged_columns(joint_set).values()):
        for view in range(shape[0]):
            for _ in range(rng.poisson(faults.swaps_per_minute * shape[1] / fps / 60.0)):
                start = int(rng.integers(shape[1]))
                length = int(rng.integers(faults.swap_frames[0], faults.swap_frames[1] + 1))
                stop = min(start + length, shape[1])
                free = not mask[view, max(0, start - 1) : stop + 1, columns].any()
                if free and stop - start >= faults.swap_frames[0]:
                    mask[view, start:stop, columns] = True
                    swaps.append((view, limb, start, stop))
    return mask, np.array(swaps, dtype=np.int64).reshape(-1, 4)


def exchanged_columns(joint_set: JointSet) -> dict[str, list[int]]:
    """Return the keypoint columns of both sides of each limb pair, which a detector swaps together."""
    return {limb: sorted(np.concatenate(limb_columns(joint_set, limb)).tolist()) for limb in EXCHANGED}


def direction_seen_from(cameras: Cameras, orient: np.ndarray, pelvis: np.ndarray) -> np.ndarray:
    """Return the (C, F) angle of each camera about a body's vertical axis in radians, 0 in front."""
    way = np.einsum("fij,cfi->cfj", orient, cameras.centres[:, None] - pelvis)
    return np.arctan2(way[..., 0], way[..., 2])


def miscalibrated(cameras: Cameras, centre: np.ndarray, error_mm: float, rng: np.random.Generator) -> Cameras:
    """Rotate each camera randomly. A point at ``centre`` appears shifted by about ``error_mm`` per axis.

    The common shift of all cameras is removed, because it would only move the world.
    """
    right, down = cameras.R[:, 0], cameras.R[:, 1]
    shift = 1e-3 * error_mm * rng.normal(size=(len(cameras), 2))
    directions = np.concatenate([right, down])
    room = np.linalg.lstsq(directions, shift.T.ravel(), rcond=None)[0]
    across, along = shift[:, 0] - right @ room, shift[:, 1] - down @ room
    distance = np.linalg.norm(cameras.centres - centre, axis=1)
    roll = 1e-3 * error_mm * rng.normal(size=len(cameras))
    turn = exp_so3(np.stack([-along, across, roll], axis=1) / distance[:, None])
    return replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])


def delayed(track: np.ndarray, frames: float) -> np.ndarray:
    """Delay a track (F, ...) by a number of frames with linear interpolation. Beyond its ends, it is constant."""
    at = np.clip(np.arange(len(track)) - frames, 0, len(track) - 1)
    first = np.minimum(np.floor(at).astype(int), len(track) - 2)
    share = (at - first).reshape(-1, *([1] * (track.ndim - 1)))
    return (1 - share) * track[first] + share * track[first + 1]


def px_per_mm(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return the (C, F, K) image scale in pixels per millimetre at points (F, K, 3)."""
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return cameras.K[:, 0, 0, None, None] / (1000.0 * np.maximum(depth, 0.1))


_CLEARANCE_M = 0.035  # Distance (m) from a sight line's end to its point, which is on or below the skin.
_NECK = ("neck", "head", "spine3", "left_collar", "right_collar")
_FOOT = ("ankle", "foot")
_AROUND: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("neck", "upper_neck"), _NECK),
    "thorax": ("neck", "spine3", "spine2", "left_collar", "right_collar"),
    "spine": ("spine1", "spine2", "spine3"),
    "mid_hip": ("pelvis", "spine1", "spine2", "left_hip", "right_hip"),
    "hip": ("pelvis", "spine1", "hip"),
    "knee": ("hip", "knee"),
    "ankle": ("knee", "ankle", "foot"),
    **dict.fromkeys(("big_toe", "small_toe", "heel"), _FOOT),
    "shoulder": ("collar", "shoulder", "spine3"),
    "elbow": ("shoulder", "elbow"),
    "wrist": ("elbow", "wrist", "hand"),
}
"""Body parts around each keypoint that cannot hide it, by joint name. Names without a side mean the same side."""


def stabbed_faces(skin: np.ndarray, faces: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (face, target) pairs for all faces that block the line of sight to a target.

    In the plane z = 1, a face covers a target if all three barycentric coordinates are positive. These coordinates also
    interpolate the inverse depths of the corners (perspective-correct). ``skin`` (V, 3) and ``targets`` (K, 3) are in
    the camera's frame. ``faces`` (T, 3) are counter-clockwise when seen from outside.
    """
    flat, goal = skin[:, :2] / skin[:, 2:], targets[:, :2] / targets[:, 2:]
    a, b, c = (flat[faces[:, i]] for i in range(3))
    facing = np.flatnonzero(cross_2d(b - a, c - a) < 0)
    a, b, c = a[facing], b[facing], c[facing]
    low, high = np.minimum(np.minimum(a, b), c).T[:, None], np.maximum(np.maximum(a, b), c).T[:, None]
    x, y = goal.T[:, :, None]
    target, near = np.nonzero((low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1]))
    a, b, c, p, face = a[near], b[near], c[near], goal[target], facing[near]
    u, v = cross_2d(p - a, c - a), cross_2d(b - a, p - a)
    area = cross_2d(b - a, c - a)
    weights = np.stack([area - u - v, u, v], axis=-1) / area[:, None]
    with np.errstate(divide="ignore"):
        depth = 1.0 / (weights / skin[faces[face], 2]).sum(-1)
    reach = np.linalg.norm(targets[target], axis=-1)
    before = (depth > 0) & (depth / targets[target, 2] * reach < reach - _CLEARANCE_M)
    stabs = (weights > -1e-5).all(-1) & before
    return face[stabs], target[stabs]


def own_faces(body: Body, keypoints: tuple[str, ...]) -> np.ndarray:
    """Return a (K, T) mask of the faces around each keypoint. These faces cannot hide the keypoint."""
    part = body.weights[body.faces].sum(axis=1).argmax(axis=-1)
    own = np.zeros((len(keypoints), len(part)), dtype=bool)
    for k, name in enumerate(keypoints):
        side, _, rest = name.partition("_")
        sided = side in ("left", "right")
        for joint in _AROUND.get(rest if sided else name, ()):
            full = joint if joint in SMPL_JOINTS else f"{side}_{joint}"
            own[k] |= part == body.recorded_joints[SMPL_JOINTS.index(full)]
    return own


def cross_2d(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the (...) z components of the cross products of (..., 2) vectors."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
