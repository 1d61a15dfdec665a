"""Shape of our body from the lengths of a skeleton's bones."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS

_HIPS, _SHOULDERS = SMPL.both("hip"), SMPL.both("shoulder")
_BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_PAIRS = (
    *(((a,), (b,)) for start, end in _BONES for a, b in zip(SMPL.both(start), SMPL.both(end), strict=True)),
    *((pair[:1], pair[1:]) for pair in (_HIPS, _SHOULDERS)),
    (_HIPS, _SHOULDERS), (_SHOULDERS, SMPL.numbers("head")),
)  # fmt: skip
"""Ends of what is compared: bones of the limbs, widths, trunk, and shoulders to head; of several joints the middle."""
_SIGMA_M = np.array([0.004] * 8 + [0.008, 0.006, 0.008, 0.04])
"""Metres by which lengths may differ. Where widths and trunk may differ by 20 mm, collars fold to make up for it (44
degrees on `cmu_daz_martial_07`); the head's joint is drawn anywhere."""
_ROUNDS = 4
_EXACT, _SAME_M, _PLAUSIBLE = 16.0, 0.001, 5.0
"""A skeleton is one of our body's own where these lengths, so many times as certain, leave at most a millimetre with a
shape of at most five standard deviations: then it is that shape, not one drawn to the mean."""


def shape_from_lengths(body: Body, rest: np.ndarray) -> np.ndarray:
    """Return the (10,) shape whose lengths are nearest, ``min Σ (l(β) - l)² / σ² + |β|²`` by Gauss-Newton.

    Args:
        body: the body.
        rest: (24, 3) a skeleton's joints at rest, NaN where it has none.
    """
    wanted = _lengths(rest)
    known = np.isfinite(wanted)
    exact = _nearest(body, wanted, known, _EXACT)
    apart = np.abs(wanted - _lengths(body.rest_joints(exact)[:NUM_JOINTS]))[known]
    if known.all() and apart.max() < _SAME_M and np.abs(exact).max() < _PLAUSIBLE:
        return exact
    return _nearest(body, wanted, known, 1.0)


def _nearest(body: Body, wanted: np.ndarray, known: np.ndarray, certainty: float) -> np.ndarray:
    betas = np.zeros(body.joints_shapedirs.shape[-1])
    weight = certainty / _SIGMA_M[known]
    for _ in range(_ROUNDS):
        joints = body.rest_joints(betas)[:NUM_JOINTS]
        slopes = np.stack([_slope(joints, body.joints_shapedirs[:NUM_JOINTS], pair) for pair in _PAIRS])
        J = slopes[known] * weight[:, None]
        r = (wanted - _lengths(joints))[known] * weight
        betas = betas + np.linalg.solve(J.T @ J + np.eye(len(betas)), J.T @ r - betas)
    return betas


def _lengths(joints: np.ndarray) -> np.ndarray:
    return np.array([np.linalg.norm(joints[list(b)].mean(0) - joints[list(a)].mean(0)) for a, b in _PAIRS])


def _slope(joints: np.ndarray, shapedirs: np.ndarray, pair: tuple[tuple[int, ...], tuple[int, ...]]) -> np.ndarray:
    a, b = (list(ends) for ends in pair)
    way = joints[b].mean(0) - joints[a].mean(0)
    return (way / np.linalg.norm(way)) @ (shapedirs[b].mean(0) - shapedirs[a].mean(0))
