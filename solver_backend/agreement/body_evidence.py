"""Compute the log-likelihood of the person that an interpretation of the files triangulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.evidence import TakeEvidence, count_in_bins, expected_density, fit_noise
from solver_backend.agreement.reading import Pose, Reading
from solver_backend.cameras.refinement import resected
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.types import Cameras

LEAST_BONE_NOISE, UNRELATED_BONES, BONE_OUTLIERS = 0.03, 0.35, 0.3
"""Log length: least noise, noise beyond which nothing is rigid, and its outlier rate and density."""
BONES = (
    ("shoulder", "hip", 0.50), ("hip", "knee", 0.42), ("knee", "ankle", 0.42), ("shoulder", "elbow", 0.29),
    ("elbow", "wrist", 0.25), ("ankle", "big_toe", 0.18),
)  # fmt: skip
"""Bones of each side and their usual lengths in metres, of adults of 1.75 m (Drillis and Contini 1966)."""
BREADTHS = ("shoulder", 0.35), ("hip", 0.22)  # Distances of both sides.
USUAL_STATURE_M = 1.75
MEAN_STATURE_M, STATURE_SPREAD_M = 1.71, 0.09  # Of adults, where it is not given (NCD-RisC 2016, both sexes).
STATURES_M = (1.0, 2.3)  # Plausible statures, which confirm a unit, a size or a turn.
POSSIBLE_M = (0.6, 2.9)  # Statures of children and giants, which keep the unit that the cameras' distance suggests.
PROPORTION_SPREAD, SIDE_SPREAD = 0.2, 0.1
"""Log spread of people's proportions, joint definitions included, and of the two sides of one person."""
LEVEL_CONCENTRATION, LEVEL_OUTLIERS = 4.0, 0.03
"""Concentration of the trunk's direction in upright pictures (von Mises), share of tilted cameras."""
FORWARD_WRONG = 0.01  # Probability of a joint definition on the wrong side of the body.
BENT = 0.06  # Knees bent less, in metres of the usual stature, may lie behind the line from hip to ankle by definition.
SAME_BODY = 0.04  # Two readings give the same body up to this share of its height.


@dataclass(frozen=True)
class BodyEvidence:
    """Evidence of the triangulated person for a reading."""

    terms: dict[str, float]  # Log-likelihoods in nats.
    height: float  # Of the person in the calibration's unit, as long as the bones show.
    points: np.ndarray  # (P, J, 3) in the calibration's unit, NaN where unknown.
    effect: float  # Number of bone lengths per independent one.

    @property
    def total(self) -> float:
        """Return the sum of all terms."""
        return sum(self.terms.values())

    def is_same(self, other: BodyEvidence) -> bool:
        """Return whether two readings give one body up to place, turn and size, without mirroring (Umeyama 1991)."""
        both = np.isfinite(self.points).all(-1) & np.isfinite(other.points).all(-1)
        if both.sum() < 8:
            return True
        a = self.points[both] - np.median(self.points[both], 0)
        b = other.points[both] - np.median(other.points[both], 0)
        U, S, Vt = np.linalg.svd(b.T @ a)
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        fit = (S * signs).sum() / max((b**2).sum(), 1e-12) * b @ (U * signs) @ Vt
        return bool(np.median(np.linalg.norm(fit - a, axis=-1)) < SAME_BODY * self.height)


def judge_body(evidence: TakeEvidence, reading: Reading, effect: float | None = None) -> BodyEvidence:
    """Return the evidence of the triangulated person for a reading.

    Its terms: ``bones`` (rigid over time), ``proportions`` (of people), ``upright`` (trunks in the pictures),
    ``handed`` (toes, knees and faces point forward), ``in front`` (of the cameras), ``inside`` (the pictures).

    Args:
        effect: bone lengths per independent one. Readings are compared with the same number, because the smaller the
            errors of a reading are, the more of them the bones of a pose share. By default it is this reading's own.
    """
    points, behind = triangulate_rays(evidence, reading)
    place = {name: points[:, k] for k, name in enumerate(evidence.names)}
    lengths, usual, sides = _lengths(place)
    terms: dict[str, float] = {}
    height, own = USUAL_STATURE_M, 1.0
    if len(lengths):
        with np.errstate(divide="ignore", invalid="ignore"):
            log = np.log(np.stack(lengths))
        mean = np.array([np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else 0.0 for x in log])
        gain, own = _rigid(evidence, log - mean[:, None])
        terms["bones"] = gain / (own if effect is None else effect)
        ratio = mean - np.log(usual)
        scale = float(np.median(ratio))
        height = USUAL_STATURE_M * float(np.exp(scale))
        unequal = np.array([mean[a] - mean[b] for a, b in sides])
        terms["proportions"] = 0.5 * (_heavy(ratio - scale, PROPORTION_SPREAD) + _heavy(unequal, SIDE_SPREAD))
    terms["upright"] = _upright(evidence, reading)
    terms["handed"] = _handed(place, height)
    poses = min(evidence.poses, 10) * evidence.views
    terms["in front"] = float(np.log(0.01) * behind * poses)
    outside = np.mean([evidence.points(evidence.key(reading, v)[0]).outside for v in range(evidence.views)])
    terms["inside"] = float(np.log(0.01) * outside * poses)
    return BodyEvidence(terms, height, points, own)


def _lengths(place: dict[str, np.ndarray]) -> tuple[list[np.ndarray], np.ndarray, list[tuple[int, int]]]:
    """Return lengths (P,) of the seen bones, their usual lengths, and which pairs of bones belong to both sides."""
    lengths, usual, sides = list[np.ndarray](), list[float](), list[tuple[int, int]]()
    for upper, lower, length in BONES:
        ends = [(f"{side}_{upper}", f"{side}_{lower}") for side in ("left", "right")]
        if all(name in place for pair in ends for name in pair):
            sides.append((len(lengths), len(lengths) + 1))
            lengths += [np.linalg.norm(place[a] - place[b], axis=-1) + 1e-12 for a, b in ends]
            usual += [length, length]
    for part, length in BREADTHS:
        if f"left_{part}" in place and f"right_{part}" in place:
            lengths.append(np.linalg.norm(place[f"left_{part}"] - place[f"right_{part}"], axis=-1) + 1e-12)
            usual.append(length)
    return lengths, np.array(usual), sides


def _rigid(evidence: TakeEvidence, off: np.ndarray) -> tuple[float, float]:
    """Return the log-likelihood of log lengths (bones, P) less their medians, and lengths per independent one.

    A single pose has none.
    """
    counts = count_in_bins(off.T.reshape(1, *off.T.shape), evidence.weight[:, None])
    noise = fit_noise(counts, LEAST_BONE_NOISE, BONE_OUTLIERS)
    z = evidence.per_pose(np.nan_to_num(np.clip(off / noise.sigma[0], -3, 3)), 1)
    effect = max(1.0, float((z.sum(0) ** 2).sum() / max(z.size, 1)))
    count = float((np.isfinite(off) * evidence.weight).sum()) * (evidence.poses - 1) / max(evidence.poses, 1)
    shared = 1 if evidence.views == 2 else 2  # with more views the same errors already show between views
    unrelated = expected_density(UNRELATED_BONES, BONE_OUTLIERS, BONE_OUTLIERS)
    return float((noise.density[0] - unrelated) * count / shared), effect


def _heavy(off: np.ndarray, spread: float) -> float:
    """Return the log-likelihood of deviations with heavy tails, because one unusual bone proves nothing."""
    return float((-2.0 * np.log1p((off / spread) ** 2 / 3)).sum())


def _upright(evidence: TakeEvidence, reading: Reading) -> float:
    """Return the log-likelihood of the trunks' directions. It counts once per take, because cameras stay mounted."""
    names, found = evidence.names, []
    trunk = [(f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")]
    if any(name not in names for pair in trunk for name in pair):
        return 0.0
    columns = [(names.index(a), names.index(b)) for a, b in trunk]
    for view in range(evidence.views):
        rays = evidence.points(evidence.key(reading, view)[0]).rays
        up = sum((rays[:, a] - rays[:, b] for a, b in columns), np.zeros(3))
        tilt = np.arctan2(up[:, 0], -up[:, 1])
        tilt = tilt[np.isfinite(tilt)]
        if len(tilt):
            level = np.exp(LEVEL_CONCENTRATION * np.cos(tilt)) / (2 * np.pi * float(np.i0(LEVEL_CONCENTRATION)))
            found.append(float(np.log((1 - LEVEL_OUTLIERS) * level + LEVEL_OUTLIERS / (2 * np.pi)).mean()))
    return 2.0 * float(np.mean(found)) if found else 0.0


def _handed(place: dict[str, np.ndarray], height: float) -> float:
    """Return the log-likelihood that toes, knees and faces point forward. Each kind counts once per take.

    With left ``l`` and up ``u`` of the trunk, ``n = l x u`` points forward in a body and backward in its mirror image.
    """
    trunk = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if any(name not in place for name in trunk):
        return 0.0
    shoulder_l, shoulder_r, hip_l, hip_r = (place[name] for name in trunk)
    up, left = shoulder_l + shoulder_r - hip_l - hip_r, shoulder_l - shoulder_r + hip_l - hip_r
    forward = np.cross(left, up)
    with np.errstate(invalid="ignore", divide="ignore"):
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    metre, total = height / USUAL_STATURE_M, 0.0
    for parts, usual in _forward_parts(place, metre):
        along = np.concatenate([(part * forward).sum(-1) for part in parts]) / (usual * metre)
        along = along[np.isfinite(along)]
        if len(along):
            right = 1 / (1 + np.exp(-4 * np.clip(np.median(along), -3, 3)))
            total += float(np.log(FORWARD_WRONG + (1 - 2 * FORWARD_WRONG) * right))
    return total


def _forward_parts(place: dict[str, np.ndarray], metre: float) -> list[tuple[list[np.ndarray], float]]:
    """Return kinds of vectors (P, 3) that point forward in every person, each with its usual length in metres."""
    sides = "left", "right"
    kinds: list[tuple[list[np.ndarray], float]] = []
    toes = [place[f"{s}_big_toe"] - place[f"{s}_ankle"] for s in sides if {f"{s}_big_toe", f"{s}_ankle"} <= set(place)]
    kinds.append((toes, 0.12))
    knees = []
    for side in sides:
        if {f"{side}_{part}" for part in ("hip", "knee", "ankle")} <= set(place):
            bend = place[f"{side}_knee"] - (place[f"{side}_hip"] + place[f"{side}_ankle"]) / 2
            with np.errstate(invalid="ignore"):
                bent = np.linalg.norm(bend, axis=-1) > BENT * metre
            knees.append(np.where(bent[:, None], bend, np.nan))
    kinds.append((knees, 0.08))
    for part, usual in (("ear", 0.1), ("eye", 0.03)):
        if "nose" in place:
            kinds.append(([place["nose"] - place[f"{s}_{part}"] for s in sides if f"{s}_{part}" in place], usual))
    return [(parts, usual) for parts, usual in kinds if parts]


def triangulate_rays(evidence: TakeEvidence, reading: Reading) -> tuple[np.ndarray, float]:
    """Return points (P, J, 3), NaN where fewer than two views see them, and the share of views from behind.

    Linear triangulation with two rounds of weights against outliers (Hartley and Zisserman 2004, sec. 12.2).
    """
    keys = [evidence.key(reading, view) for view in range(evidence.views)]
    views = [evidence.points(points) for points, _ in keys]
    poses = [evidence.pose_of(pose) for _, pose in keys]
    unit = float(np.mean([np.linalg.norm(t) for _, t in poses])) + 1e-9
    matrices = np.stack([np.concatenate([R, t[:, None] / unit], axis=1) for R, t in poses])
    rays = np.stack([view.rays for view in views])
    seen = np.isfinite(rays[..., 0])
    seen[list(reading.left_out)] = False
    rays = np.where(seen[..., None], rays, 0.0)
    size = np.array([view.size for view in views])[:, None, None]
    # (V, P, J, 2, 4): two equations per view
    rows = rays[..., :2, None] * matrices[:, None, None, 2:3] - matrices[:, None, None, :2]
    weight = seen.astype(float)
    X, camera = _meeting_points(rows, weight, matrices)
    for _ in range(2):
        depth = camera[..., 2]
        plane = camera[..., :2] / np.where(np.abs(depth) < 1e-6, 1e-6, depth)[..., None]
        off = np.linalg.norm(plane - rays[..., :2], axis=-1) / size
        weight = seen / (1 + (off / 0.05) ** 2) / np.maximum(np.abs(depth), 0.05)
        X, camera = _meeting_points(rows, weight, matrices)
    several = seen.sum(0) >= 2
    behind = (camera[..., 2] < 0) & seen & several
    return np.where(several[..., None], X * unit, np.nan), float(behind.sum() / max((seen & several).sum(), 1))


def _meeting_points(rows: np.ndarray, weight: np.ndarray, matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (P, J, 3) nearest to their rays, and the same (V, P, J, 3) in each camera's coordinates."""
    weighted = rows * weight[..., None, None] ** 2
    normal = np.einsum("vpjac,vpjad->pjcd", rows[..., :3], weighted)
    normal[..., :3] += 1e-9 * np.eye(3)  # unseen points
    X = -np.linalg.solve(normal[..., :3], normal[..., 3:])[..., 0]
    return X, np.einsum("vac,pjc->vpja", matrices[:, :, :3], X) + matrices[:, None, None, :, 3]


LEAST_POINTS = 24  # Points that a pose is fitted to at least.
MATERIAL = 0.05  # Median distance in person's sizes by which a camera must see the person elsewhere to count as moved.
SCALES = 0.3, 0.1, 0.03  # Scales of the robust weights, in person's sizes.


def refit_pose(evidence: TakeEvidence, reading: Reading, view: int, *, turned: bool = False) -> Pose | None:
    """Return the pose of a view that fits the points which the others see, None if it fits already."""
    points, _ = triangulate_rays(evidence, replace(reading, left_out=(*reading.left_out, view)))
    points_key, pose_key = evidence.key(reading, view)
    seen = evidence.points(points_key)
    R, t = evidence.pose_of(pose_key)
    known = np.isfinite(points).all(-1) & np.isfinite(seen.rays).all(-1)
    X, rays = points[known], seen.rays[known]
    if len(X) < LEAST_POINTS or np.median(_distances(R, t, X, rays, seen.size)) < MATERIAL:
        return None
    starts = [(R, t), _turned(R, t, X, rays)]
    if turned:
        R, t = starts[1]
    else:
        plain = _unit_camera(evidence.cameras.subset([points_key[1]]))
        first = [_fit(replace(plain, R=R[None], t=t[None]), X, rays, seen.size, SCALES[:1]) for R, t in starts]
        best = min(first, key=lambda c: float(np.median(_distances(c.R[0], c.t[0], X, rays, seen.size))))
        fitted = _fit(best, X, rays, seen.size, SCALES[1:])
        R, t = fitted.R[0], fitted.t[0]
    return (*R.ravel().round(9).tolist(), *t.round(9).tolist()) if np.isfinite(t).all() else None


def _distances(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray, size: float) -> np.ndarray:
    camera = X @ R.T + t
    ahead = np.where(camera[:, 2] > 1e-6, camera[:, 2], np.nan)
    return np.nan_to_num(np.linalg.norm(camera[:, :2] / ahead[:, None] - rays[:, :2], axis=-1) / size, nan=9.0)


def _turned(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of a camera in its place that looks where the others see what it sees (Kabsch 1976)."""
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


def _unit_camera(camera: Cameras) -> Cameras:
    return replace(camera, K=np.eye(3)[None], distortion=np.zeros_like(camera.distortion), models=(DEFAULT_MODEL,))


def _fit(camera: Cameras, X: np.ndarray, rays: np.ndarray, size: float, scales: Sequence[float]) -> Cameras:
    """Return the camera with the least reprojection error of a pose on the unit plane, for scales of the weights."""
    for scale in scales:
        camera = resected(camera, rays[None, :, None, :2], np.ones((1, len(X), 1)), X[:, None], scale * size, steps=4)
    return camera
