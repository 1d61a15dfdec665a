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
    *((_HIPS, _SHOULDERS), (_SHOULDERS, SMPL.numbers("head"))),
)
"""Ends of the compared lengths: bones of the limbs, widths, trunk, and shoulders to head; of several joints the
middle."""
_STARTS, _ENDS = (np.array([(pair[end][0], pair[end][-1]) for pair in _PAIRS]) for end in (0, 1))
"""(12, 2) the one or two joints at each end."""
_SIGMA_M = np.array([0.004] * 8 + [0.008, 0.006, 0.008, 0.04])
"""Deviation of lengths, metres. Where widths and trunk may differ by 20 mm, collars fold to make up for it (44 degrees
on `cmu_daz_martial_07`); the head's joint is drawn anywhere."""
_ROUNDS = 4
_EXACT, _SAME_M, _PLAUSIBLE = 16.0, 0.001, 5.0
"""A skeleton is one of our body's own where these lengths, with so many times the certainty, leave at most a millimetre
with a shape of at most five standard deviations: then it is that shape, not one drawn to the mean."""


def shape_from_lengths(body: Body, rest: np.ndarray) -> np.ndarray:
    """Return the (10,) shape with the nearest lengths, ``min Σ (l(β) - l)² / σ² + |β|²`` by Gauss-Newton.

    ``rest`` are (24, 3) joints of a skeleton at rest, NaN where it has none.
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
    by_shape = _ways(body.joints_shapedirs)
    for _ in range(_ROUNDS):
        ways = _ways(body.rest_joints(betas))
        lengths = np.linalg.norm(ways, axis=1)
        J = np.einsum("pa,pab->pb", ways / lengths[:, None], by_shape)[known] * weight[:, None]
        r = (wanted - lengths)[known] * weight
        betas = betas + np.linalg.solve(J.T @ J + np.eye(len(betas)), J.T @ r - betas)
    return betas


def _lengths(joints: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(_ways(joints), axis=1))


def _ways(joints: np.ndarray) -> np.ndarray:
    """Return (12, ...) from the middle of the starts to the middle of the ends, of (J, ...) places or their slopes."""
    return np.asarray(joints[_ENDS].mean(axis=1) - joints[_STARTS].mean(axis=1))


_FEET = ((7, 10), (8, 11))
"""Ankle and ball of each foot."""
_LOWEST_SHARE = 2.0
"""Percentile of the frames' lowest soles that is the floor: single frames may lie deeper."""
_NEAR_M, _STILL_M_S = 0.04, 0.3
"""Largest height of a standing ball of the foot over its height at rest, and its largest speed."""


def floor_height(body: Body, betas: np.ndarray, joints: np.ndarray) -> float:
    """Return the height in metres at which the lowest soles stand.

    A sole is below ankle and ball by their height in the shaped body at rest; a foot that stands has both down. Joints
    are (F, 24, 3) in the world.
    """
    above = _rest_heights(body, betas)
    lowest = np.min([joints[:, joint, 2] - above[joint] for foot in _FEET for joint in foot], axis=0)
    return float(np.percentile(lowest, _LOWEST_SHARE))


def standing_feet(body: Body, betas: np.ndarray, joints: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2) bool: left and right ball of the foot are down and still, the floor at z = 0."""
    balls = joints[:, [foot[1] for foot in _FEET]]
    heights = _rest_heights(body, betas)[[foot[1] for foot in _FEET]]
    if len(balls) < 2:
        return balls[..., 2] < heights + _NEAR_M
    speed = np.linalg.norm(np.gradient(balls, axis=0), axis=-1) * fps
    return (balls[..., 2] < heights + _NEAR_M) & (speed < _STILL_M_S)


def _rest_heights(body: Body, betas: np.ndarray) -> np.ndarray:
    vertices = body.v_template + body.shapedirs @ betas
    return body.rest_joints(betas)[:NUM_JOINTS, 1] - vertices[:, 1].min()
