"""The shape of a sender whose body is ours: its bones in the T-pose give it to the last digit."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.vmc.t_pose import t_pose

_OURS_M = 1e-4
"""Metres by which no bone of our own body differs; other bodies differ by centimetres."""
_ROUNDS = 6
_PULL = 1e-11
"""Square metres by which shapes that joints hardly know of are held to the mean."""


def own_shape(body: Body, joints: np.ndarray) -> np.ndarray | None:
    """Return the (10,) shape whose T-pose has these joints, None where the sender's body is another.

    ``min Σ |b_j(β) - b_j|² + λ |β|²`` by Gauss-Newton over the bones b that the T-pose does not turn, and over the
    lengths ``|b_j|`` of those that it does: ``d|b| = b/|b| · db``.

    Args:
        body: ours.
        joints: (24, 3) of the sender's T-pose, NaN where it has none.
    """
    layout, count = body.layout, len(joints)
    child = np.array([j for j in range(1, count) if np.isfinite(joints[j]).all()])
    if len(child) < count - 3:  # our own has all but the knuckles
        return None
    parent = np.array(layout.parents)[child]
    wanted = joints[child] - joints[parent]
    slopes = body.joints_shapedirs[child] - body.joints_shapedirs[parent]
    still = np.abs(t_pose(layout, body.rest_joints(np.zeros(10)))[parent, 0] - 1.0) < 1e-12
    length = np.linalg.norm(wanted, axis=1)
    betas: np.ndarray = np.zeros(slopes.shape[-1])
    r: np.ndarray = np.zeros(0)
    for _ in range(_ROUNDS):
        bones = body.rest_joints(betas)[child] - body.rest_joints(betas)[parent]
        reach = np.linalg.norm(bones, axis=1)
        J = np.concatenate([
            slopes[still].reshape(-1, len(betas)),
            np.einsum("ni,nik->nk", bones / reach[:, None], slopes)[~still],
        ])  # fmt: skip
        r = np.concatenate([(wanted - bones)[still].ravel(), (length - reach)[~still]])
        betas = betas + np.linalg.solve(J.T @ J + _PULL * np.eye(len(betas)), J.T @ r - _PULL * betas)
    return betas if np.abs(r).max() < _OURS_M else None
