"""Compute the log-likelihood of the triangulated person for an interpretation of the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import (
    BLOCKS,
    MOVED,
    OUTLIER_DENSITY,
    SCALES,
    TakeEvidence,
    ViewRays,
    count_in_bins,
    fit_noise,
)
from solver_backend.agreement.reading import ENOUGH, Pose, Reading
from solver_backend.cameras.refinement import resected
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.geometry.alignment import nearest_rotation, umeyama
from solver_backend.types import Cameras

BONES = (
    ("shoulder", "hip", 0.286), ("hip", "knee", 0.24), ("knee", "ankle", 0.24), ("shoulder", "elbow", 0.166),
    ("elbow", "wrist", 0.143), ("ankle", "big_toe", 0.103), ("shoulder", "shoulder", 0.2), ("hip", "hip", 0.126),
)  # fmt: skip
"""Bones of each side, breadths from left to right, and their usual lengths in statures (Drillis and Contini 1966)."""
FORWARD = ("big_toe", "ankle"), ("knee", "hip", "ankle"), ("nose", "ear"), ("nose", "eye")
"""Joints that are in front of others, or of their middle."""
MEAN_STATURE_M, STATURE_SPREAD_M = 1.71, 0.09  # Of adults with unknown stature (NCD-RisC 2016, both sexes).
STATURES_M = (1.0, 2.3)  # Plausible statures, which confirm a unit, an image size or a rotation.
POSSIBLE_M = (0.6, 2.9)  # Limits of human stature, which confirm the unit suggested by the cameras' distance.
PROPORTION_SPREAD = 0.15  # Standard deviation of log proportions of people and their sides, with joint definitions.
CONCENTRATION = 4.0  # Concentration of the directions of trunks, toes, knees and faces (von Mises).
ODD = 0.01  # Probability of a tilted camera, a joint on the wrong side of the body, or a point where none can be.


@dataclass(frozen=True)
class BodyEvidence:
    """Log-likelihoods that the triangulated person is plausible, for one interpretation of the files."""

    terms: dict[str, float]  # Log-likelihoods in nats.
    height: float  # Height of the person in the calibration's unit, estimated from the bones.
    points: np.ndarray  # (P, J, 3) in the calibration's unit, NaN where unknown.
    effect: float  # Number of bone lengths per independent one.

    @property
    def total(self) -> float:
        """Return the sum of all terms."""
        return sum(self.terms.values())

    def is_same(self, other: BodyEvidence) -> bool:
        """Return whether rotation, translation and scaling map the other body to this one (Umeyama 1991)."""
        both = np.isfinite(self.points).all(-1) & np.isfinite(other.points).all(-1)
        if both.sum() < 8:
            return True
        scale, R, t = umeyama(other.points[both], self.points[both], with_scale=True)
        off = scale * other.points[both] @ R.T + t - self.points[both]
        return bool(np.median(np.linalg.norm(off, axis=-1)) < MOVED * self.height)


def judge_body(evidence: TakeEvidence, reading: Reading, effect: float | None = None) -> BodyEvidence:
    """Triangulate the person under one interpretation of the files, and rate how plausible the result is.

    The terms are ``bones`` (constant lengths), ``proportions`` (human proportions), ``upright`` (upright trunks in the
    images), ``handed`` (toes, knees and faces point forward), ``in front`` (points are in front of the cameras) and
    ``inside`` (keypoints are inside the images).

    Args:
        effect: number of bone lengths per independent length, because errors within a pose are correlated. If None, it
            is estimated. Interpretations that you compare need the same value.
    """
    points, behind = triangulate_rays(evidence, reading)
    views = [view for view, *_ in evidence.seen(reading)]
    place = {name: points[:, k] for k, name in enumerate(evidence.names)}
    lengths, usual, sides = _lengths(place)
    terms: dict[str, float] = {}
    height, own = MEAN_STATURE_M, 1.0
    if len(lengths):
        with np.errstate(divide="ignore", invalid="ignore"):
            log = np.log(np.stack(lengths))
        mean = np.array([np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else 0.0 for x in log])
        gain, own = _rigid(evidence, log - mean[:, None])
        terms["bones"] = gain / (own if effect is None else effect)
        ratio = mean - np.log(usual)
        scale = float(np.median(ratio))
        height = float(np.exp(scale))
        unequal = np.array([mean[a] - mean[b] for a, b in sides])
        terms["proportions"] = 0.5 * (_heavy(ratio - scale) + _heavy(unequal))
    terms["upright"] = _upright(evidence.names, views)
    terms["handed"] = _handed(place)
    poses = min(evidence.poses, BLOCKS) * evidence.views
    terms["in front"] = float(np.log(ODD) * behind * poses)
    terms["inside"] = float(np.log(ODD) * np.mean([view.outside for view in views]) * poses)
    return BodyEvidence(terms, height, points, own)


def _lengths(place: dict[str, np.ndarray]) -> tuple[list[np.ndarray], np.ndarray, list[tuple[int, int]]]:
    """Return the (P,) length of each known bone, the usual lengths, and index pairs of left and right bones."""
    lengths, usual, sides = list[np.ndarray](), list[float](), list[tuple[int, int]]()
    for upper, lower, length in BONES:
        ends = [(f"{side}_{upper}", f"{side}_{lower}") for side in ("left", "right")]
        ends = [(f"left_{upper}", f"right_{upper}")] if upper == lower else ends
        if all(name in place for pair in ends for name in pair):
            sides += [(len(lengths), len(lengths) + 1)] * (upper != lower)
            lengths += [np.linalg.norm(place[a] - place[b], axis=-1) + 1e-12 for a, b in ends]
            usual += [length] * len(ends)
    return lengths, np.array(usual), sides


def _rigid(evidence: TakeEvidence, off: np.ndarray) -> tuple[float, float]:
    """Return the log-likelihood that bone lengths are constant, and how many lengths count as one observation."""
    counts = count_in_bins(off.T.reshape(1, *off.T.shape), evidence.weight[:, None])
    noise = fit_noise(counts, MOVED)
    z = evidence.per_pose(np.nan_to_num(np.clip(off / noise.sigma[0], -3, 3)), 1)
    effect = max(1.0, float((z.sum(0) ** 2).sum() / max(z.size, 1)))
    count = float((np.isfinite(off) * evidence.weight).sum()) * (evidence.poses - 1) / max(evidence.poses, 1)
    shared = 1 if evidence.views == 2 else 2  # with more views the same errors already show between views
    return float((noise.density[0] - np.log(OUTLIER_DENSITY)) * count / shared), effect


def _heavy(off: np.ndarray) -> float:
    return float((-2.0 * np.log1p((off / PROPORTION_SPREAD) ** 2 / 3)).sum())


def _upright(names: Sequence[str], views: Sequence[ViewRays]) -> float:
    """Return the log-likelihood that trunks are upright in the images. A take counts once, as cameras are fixed."""
    trunk = [(f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")]
    if not {name for pair in trunk for name in pair} <= {*names}:
        return 0.0
    rays = np.stack([view.rays for view in views])
    up = sum((rays[:, :, names.index(a)] - rays[:, :, names.index(b)] for a, b in trunk), np.zeros(3))
    cosine = np.cos(np.arctan2(up[..., 0], -up[..., 1]))
    level = np.exp(CONCENTRATION * cosine) / (2 * np.pi * float(np.i0(CONCENTRATION)))
    log = np.log((1 - ODD) * level + ODD / (2 * np.pi))
    means = [row[np.isfinite(row)].mean() for row in log if np.isfinite(row).any()]
    return 2.0 * float(np.mean(means)) if means else 0.0


def _handed(place: dict[str, np.ndarray]) -> float:
    """Return the log-likelihood that toes, knees and faces point forward. Each of them counts once per take.

    The left direction ``l`` and the up direction ``u`` of the trunk give ``n = l x u``. It points forward, or backward
    in a mirror image. A toe, knee or face at an angle a to n has odds of ``exp(2 k cos a)`` for forward (von Mises).
    """
    trunk = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if any(name not in place for name in trunk):
        return 0.0
    shoulder_l, shoulder_r, hip_l, hip_r = (place[name] for name in trunk)
    up, left = shoulder_l + shoulder_r - hip_l - hip_r, shoulder_l - shoulder_r + hip_l - hip_r
    forward = np.cross(left, up)
    with np.errstate(invalid="ignore", divide="ignore"):
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    total = 0.0
    for front, *behind in FORWARD:
        parts = []
        for side in ("left", "right"):
            first, *others = (name if name in place else f"{side}_{name}" for name in (front, *behind))
            if {first, *others} <= place.keys():
                parts.append(place[first] - np.mean([place[other] for other in others], axis=0))
        vectors = np.concatenate(parts) if parts else np.zeros((0, 3))
        along = (vectors * np.concatenate([forward] * len(parts))).sum(-1) if parts else np.zeros(0)
        if np.isfinite(along).any():
            cosine = np.nanmedian(along) / max(float(np.nanmedian(np.linalg.norm(vectors, axis=-1))), 1e-12)
            right = 1 / (1 + np.exp(-2 * CONCENTRATION * cosine))
            total += float(np.log(ODD + (1 - 2 * ODD) * right))
    return total


def triangulate_rays(evidence: TakeEvidence, reading: Reading) -> tuple[np.ndarray, float]:
    """Triangulate (P, J, 3) points, and return the share of the points that are behind cameras.

    Points in fewer than two views are NaN. The method is linear triangulation with two rounds of robust weights
    (Hartley and Zisserman 2004, sec. 12.2).
    """
    views = evidence.seen(reading)
    unit = float(np.mean([np.linalg.norm(t) for *_, t in views])) + 1e-9
    matrices = np.stack([np.concatenate([R, t[:, None] / unit], axis=1) for _, R, t in views])
    rays = np.stack([view.rays for view, *_ in views])
    seen = np.isfinite(rays[..., 0])
    seen[list(reading.left_out)] = False
    rays = np.where(seen[..., None], rays, 0.0)
    size = np.array([view.size for view, *_ in views])[:, None, None]
    # (V, P, J, 2, 4): two equations per view
    rows = rays[..., :2, None] * matrices[:, None, None, 2:3] - matrices[:, None, None, :2]
    weight = seen.astype(float)
    X, camera = _meeting_points(rows, weight, matrices)
    for _ in range(2):
        depth = camera[..., 2]
        plane = camera[..., :2] / np.where(np.abs(depth) < 1e-6, 1e-6, depth)[..., None]
        off = np.linalg.norm((plane - rays[..., :2]) / size, axis=-1)
        weight = seen / (1 + (off / MOVED) ** 2) / np.maximum(np.abs(depth), 0.05)
        X, camera = _meeting_points(rows, weight, matrices)
    several = seen.sum(0) >= 2
    behind = (camera[..., 2] < 0) & seen & several
    return np.where(several[..., None], X * unit, np.nan), float(behind.sum() / max((seen & several).sum(), 1))


def _meeting_points(rows: np.ndarray, weight: np.ndarray, matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (P, J, 3) points nearest to their rays, and these points in the coordinates of each camera."""
    weighted = rows * weight[..., None, None] ** 2
    normal = np.einsum("vpjac,vpjad->pjcd", rows[..., :3], weighted)
    normal[..., :3] += 1e-9 * np.eye(3)  # unseen points
    X = -np.linalg.solve(normal[..., :3], normal[..., 3:])[..., 0]
    return X, np.einsum("vac,pjc->vpja", matrices[:, :, :3], X) + matrices[:, None, None, :, 3]


def refit_pose(evidence: TakeEvidence, reading: Reading, view: int, *, turned: bool = False) -> Pose | None:
    """Fit a view's pose to the points of the other views. Return None if it already fits, or with too few points."""
    points, _ = triangulate_rays(evidence, replace(reading, left_out=(*reading.left_out, view)))
    seen, R, t = evidence.seen(reading)[view]
    known = np.isfinite(points).all(-1) & np.isfinite(seen.rays).all(-1)
    X, rays = points[known], seen.rays[known]
    if len(X) < ENOUGH or np.median(_distances(R, t, X, rays, seen.size)) < MOVED:
        return None
    starts = [(R, t), _turned(R, t, X, rays)]
    if turned:
        R, t = starts[1]
    else:
        camera = evidence.cameras.subset([reading.owners[view]])
        plain = replace(camera, K=np.eye(3)[None], distortion=np.zeros_like(camera.distortion), models=(DEFAULT_MODEL,))
        first = [_fit(replace(plain, R=R[None], t=t[None]), X, rays, seen.size, SCALES[:1]) for R, t in starts]
        best = min(first, key=lambda c: float(np.median(_distances(c.R[0], c.t[0], X, rays, seen.size))))
        fitted = _fit(best, X, rays, seen.size, SCALES[1:])
        R, t = fitted.R[0], fitted.t[0]
    return (*R.ravel().round(9).tolist(), *t.round(9).tolist()) if np.isfinite(t).all() else None


def _distances(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray, size: np.ndarray) -> np.ndarray:
    camera = X @ R.T + t
    ahead = np.where(camera[:, 2] > 1e-6, camera[:, 2], np.nan)
    return np.nan_to_num(np.linalg.norm((camera[:, :2] / ahead[:, None] - rays[:, :2]) / size, axis=-1), nan=9.0)


def _turned(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate a camera about its centre so that its rays point at the triangulated points (Kabsch 1976)."""
    place = -R.T @ t
    ways = X - place
    ways /= np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-12)
    seen = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    near = np.ones(len(X), bool)
    turned = R
    for _ in range(4):
        turned = nearest_rotation(seen[near].T @ ways[near])
        off = np.linalg.norm(seen - ways @ turned.T, axis=-1)
        near = off <= 3 * np.median(off)
    return turned, np.negative(turned) @ place


def _fit(camera: Cameras, X: np.ndarray, rays: np.ndarray, size: np.ndarray, scales: Sequence[float]) -> Cameras:
    for width in size.mean() * np.array(scales):
        camera = resected(camera, rays[None, :, None, :2], np.ones((1, len(X), 1)), X[:, None], width, steps=4)
    return camera
