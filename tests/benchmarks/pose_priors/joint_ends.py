"""Test whether a prior reproduces feet, toes and hands at the limits of their ranges."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.joint_limits import JOINT_LIMITS, MARGIN_DEG, from_swing_and_twist, swing_and_twist
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.priors.base import AutoencodingPrior
from tests.benchmarks.pose_priors.prior_tables import Table

_ENDS = {
    "on tiptoe": ("left_ankle", 0, 1), "foot drawn up": ("left_ankle", 0, 0), "toes bent up": ("left_foot", 0, 0),
    "toes curled": ("left_foot", 0, 1), "hand bent up": ("left_wrist", 2, 1), "hand bent down": ("left_wrist", 2, 0),
    "hand to the thumb": ("left_wrist", 1, 0), "hand to the little finger": ("left_wrist", 1, 1),
}  # fmt: skip
"""Joint, index of the angle (x, y or z), and 0 for its minimum or 1 for its maximum."""


def ends() -> Iterator[tuple[str, int, int, float]]:
    """Yield each limit: name, row of the joint in a pose, axis, and the angle in rad without the margin."""
    for name, (joint, axis, side) in _ENDS.items():
        column = SMPL_JOINTS.index(joint) - 1
        yield name, column, axis, float(JOINT_LIMITS[column, axis, side] - np.radians(MARGIN_DEG) * (2 * side - 1))


def held_at_ends(prior: AutoencodingPrior, poses: np.ndarray) -> Table:
    """Return each limit's angle for the left foot and hand, and the decoded angles, in degrees.

    Args:
        prior: encoder and decoder.
        poses: (N, 21, 3, 3) rotations. In each row, one angle of them is set to its limit, without the margin.
    """
    rows: Table = {}
    for name, column, axis, end in ends():
        angles = swing_and_twist(poses)
        angles[:, column, axis] = end
        asked = poses.copy()
        asked[:, column] = from_swing_and_twist(angles)[:, column]
        decoded = np.degrees(swing_and_twist(prior.reconstruct(asked))[:, column, axis])
        low, middle, high = np.percentile(decoded, (10, 50, 90))
        rows[name] = {"end °": np.degrees(end), "decoded °": middle, "10 % °": low, "90 % °": high}
    return rows
