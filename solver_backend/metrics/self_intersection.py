"""Measure how deeply limbs, head and trunk of a pose intersect, using capsules inside the skin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.types.shapes import Float

TOLERANCE_M = 0.03  # Depth in metres to which soft tissue lets capsules overlap (1.2 % of recorded frames exceed it).
BONES: tuple[tuple[str, str], ...] = (
    ("pelvis", "spine1"), ("spine1", "spine2"), ("spine2", "spine3"), ("spine3", "neck"), ("neck", "head"),
    *(
        (f"{side}_{a}", f"{side}_{b}")
        for side in ("left", "right")
        for a, b in (
            ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("shoulder", "elbow"), ("elbow", "wrist"),
            ("wrist", "hand"),
        )
    ),
)  # fmt: skip
"""Joints at the two ends of each capsule's axis."""
_INNER = 0.1  # Fraction of a bone's skin that is inside its capsule, so that capsules stay within the body.
_APART = 3  # Fewest joints between two compared bones: an upper arm touches the chest that it is attached to.
_AT_A_TIME = 2000  # Number of poses processed at a time, which limits memory.


@dataclass(frozen=True)
class Capsules:
    """Capsules along the bones of a body in its rest shape, and the pairs of capsules to check."""

    ends: tuple[tuple[int, int], ...]  # SMPL joints at the ends of each axis.
    radii: Float[np.ndarray, " bones"]  # Metres.
    pairs: tuple[tuple[int, int], ...]  # Capsules that are at least three bones apart and do not touch in the T-pose.


@lru_cache(maxsize=4)
def capsules_of(body: Body) -> Capsules:
    """Fit one capsule per bone to SMPL's mean shape. A tenth of the bone's skin vertices are inside its capsule."""
    ends = tuple((SMPL.joints.index(a), SMPL.joints.index(b)) for a, b in BONES)
    own = list(body.layout.standing_for(SMPL))
    rest, owner = body.joints_template[own], np.argmax(body.weights[:, own], axis=1)
    radii = np.array([_inner_radius(body.v_template[owner == a], rest[a], rest[b]) for a, b in ends])
    every = tuple(
        (i, j) for i, j in combinations(range(len(ends)), 2) if _steps(ends[i], ends[j], SMPL.parents) >= _APART
    )
    depth = _depths(rest[None], Capsules(ends, radii, every))[0]
    return Capsules(ends, radii, tuple(pair for pair, deep in zip(every, depth, strict=True) if deep < 0.0))


def self_intersection_m(body: Body, joints: Float[np.ndarray, "poses 24 3"]) -> Float[np.ndarray, " poses"]:
    """Return depths (N,) in metres of the deepest capsule intersection in each pose.

    ``joints`` are (N, 24, 3) in metres, of an SMPL body of mean shape. The depth is ``max(0, r_a + r_b - d(a, b))``
    over all pairs of capsules with radii r, where d is the distance between their axes (Ericson 2005, 5.1.9).
    """
    capsules = capsules_of(body)
    parts = [joints[first : first + _AT_A_TIME] for first in range(0, len(joints), _AT_A_TIME)]
    deepest = [_depths(part, capsules).max(axis=1, initial=0.0) for part in parts]
    return np.concatenate(deepest) if deepest else np.zeros(0)


def self_intersection_percent(body: Body, joints: Float[np.ndarray, "poses 24 3"]) -> float:
    """Return the percentage of poses in which two capsules overlap by over ``TOLERANCE_M``."""
    return 100.0 * float(np.mean(self_intersection_m(body, joints) > TOLERANCE_M))


def _inner_radius(skin: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    bone = end - start
    share = np.clip((skin - start) @ bone / (bone @ bone), 0.0, 1.0)
    return float(np.quantile(np.linalg.norm(skin - start - share[:, None] * bone, axis=1), _INNER))


def _steps(a: tuple[int, int], b: tuple[int, int], parents: tuple[int, ...]) -> int:
    return min(_climbed(i, j, parents) for i in a for j in b)


def _climbed(i: int, j: int, parents: tuple[int, ...]) -> int:
    ways = [[joint] for joint in (i, j)]
    for way in ways:
        while parents[way[-1]] >= 0:
            way.append(parents[way[-1]])
    shared = len(set(ways[0]) & set(ways[1]))
    return len(ways[0]) + len(ways[1]) - 2 * shared


def _depths(joints: np.ndarray, capsules: Capsules) -> np.ndarray:
    """Return (N, P) intersection depths of capsule pairs in metres, negative if apart."""
    ends = np.array(capsules.ends)
    first, second = (np.array([pair[side] for pair in capsules.pairs], dtype=int) for side in (0, 1))
    p, u = joints[:, ends[first, 0]], joints[:, ends[first, 1]] - joints[:, ends[first, 0]]
    q, v = joints[:, ends[second, 0]], joints[:, ends[second, 1]] - joints[:, ends[second, 0]]
    return capsules.radii[first] + capsules.radii[second] - segment_distance(p, u, q, v)


def segment_distance(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the distances (...) between the line segments ``p + s u`` and ``q + t v`` (Ericson 2005, 5.1.9).

    All arrays are (..., 3), and s and t are between 0 and 1. A segment with ``u = 0`` or ``v = 0`` is a point.
    """
    w = p - q
    a, b, c = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    d, e = (u * w).sum(-1), (v * w).sum(-1)
    across = a * c - b * b
    s = np.clip(np.where(across > 1e-12, (b * e - c * d) / np.maximum(across, 1e-12), 0.0), 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, 1e-12), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, 1e-12), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
