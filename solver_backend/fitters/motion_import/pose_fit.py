"""Poses of our body that put its joints where a skeleton has its own, turned as they are: all frames at once."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_JOINTS, SMPL_PARENTS
from solver_backend.fitters.motion_import.correspondence import NUM_TURNED, Measured
from solver_backend.geometry.rotations import exp_so3, log_so3

_PLACED = SMPL.both("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
"""Joints of the limbs. Those of head and toes are drawn at other places by every program: only their turns count."""
_PLACE_SIGMA_M = 0.004
"""Metres by which a joint of the limbs may be elsewhere."""
_TURN_SIGMA = np.full(NUM_TURNED, 0.12)
"""Radians by which a joint may be turned otherwise; the pelvis shows its tilt and stays."""
_TURN_SIGMA[0] = 0.06
_ROUNDS, _BLOCK = 12, 256
_LONGEST_STEP = 0.4
"""Radians that a joint turns in a round at most: farther off, the equations are not linear."""
_CONVERGED = 1e-3
"""Radians of a step from which the poses stay."""
_ABOVE = np.zeros((NUM_JOINTS, NUM_TURNED), dtype=bool)
"""Which turned joints each joint hangs from, itself included."""
for _joint, _parent in enumerate(SMPL_PARENTS):
    if _parent >= 0:
        _ABOVE[_joint] = _ABOVE[_parent]
    if _joint < NUM_TURNED:
        _ABOVE[_joint, _joint] = True
_MOVED = _ABOVE.copy()
_MOVED[range(NUM_TURNED), range(NUM_TURNED)] = False
"""(24, 22) which joints turning each one moves: those below it."""


def fit_poses(rest: np.ndarray, measured: Measured) -> tuple[np.ndarray, np.ndarray]:
    """Return global rotations (F, 22, 3, 3) of our joints and places (F, 24, 3), by Gauss-Newton.

    With a world rotation δ of each joint that takes all below along, places move by ``Σ δ_i × (p_k - p_i)`` and
    rotations by ``Σ δ_i`` over what is above, so that both are linear in δ and in the root's place.

    Args:
        rest: (24, 3) joints of the shaped body at rest.
        measured: what the skeleton states.
    """
    parts = [
        _fit_block(rest, measured.places[at : at + _BLOCK], measured.turns[at : at + _BLOCK])
        for at in range(0, len(measured.places), _BLOCK)
    ]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _fit_block(rest: np.ndarray, places: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    known = np.array([joint for joint in _PLACED if np.isfinite(places[0, joint, 0])])
    G, root = turns.copy(), np.zeros((len(places), 3))
    root += (places[:, known] - posed(rest, G, root)[:, known]).mean(1)
    above = _ABOVE[:NUM_TURNED] / _TURN_SIGMA[:, None]
    prior = np.zeros((3 * NUM_TURNED + 3, 3 * NUM_TURNED + 3))
    prior[: 3 * NUM_TURNED, : 3 * NUM_TURNED] = np.kron(above.T @ above, np.eye(3))
    for _ in range(_ROUNDS):
        joints = posed(rest, G, root)
        J = _slopes(joints, known) / _PLACE_SIGMA_M
        r = ((places[:, known] - joints[:, known]) / _PLACE_SIGMA_M).reshape(len(G), -1)
        turned = log_so3(turns @ np.swapaxes(G, -1, -2)) / _TURN_SIGMA[:, None]
        g = (np.swapaxes(J, -1, -2) @ r[..., None])[..., 0]
        g[:, : 3 * NUM_TURNED] += np.einsum("ki,fkc->fic", above, turned).reshape(len(G), -1)
        step = np.linalg.solve(np.swapaxes(J, -1, -2) @ J + prior, g[..., None])[..., 0]
        delta = step[:, : 3 * NUM_TURNED].reshape(len(G), NUM_TURNED, 3)
        farthest = np.linalg.norm(delta, axis=-1).max(axis=1)
        share = np.minimum(1.0, _LONGEST_STEP / np.maximum(farthest, 1e-12))[:, None]
        G, root = _turned(G, share[..., None] * delta), root + share * step[:, 3 * NUM_TURNED :]
        if farthest.max() < _CONVERGED:
            break
    return G, posed(rest, G, root)


def posed(rest: np.ndarray, G: np.ndarray, root: np.ndarray) -> np.ndarray:
    """Return the joints (F, 24, 3) of global rotations (F, 22, 3, 3) and the root's place (F, 3)."""
    joints = np.empty((len(G), NUM_JOINTS, 3))
    joints[:, 0] = root
    for j in range(1, NUM_JOINTS):
        parent = SMPL_PARENTS[j]
        joints[:, j] = joints[:, parent] + G[:, parent] @ (rest[j] - rest[parent])
    return joints


def _slopes(joints: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return (F, 3 K, 69): how the known places move with each joint's turn and with the root."""
    v = (joints[:, known, None] - joints[:, None, :NUM_TURNED]) * _MOVED[known][..., None]
    J = np.zeros((len(joints), len(known), 3, NUM_TURNED + 1, 3))
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        J[:, :, a, :NUM_TURNED, b] = v[..., c]
        J[:, :, b, :NUM_TURNED, a] = -v[..., c]
    J[:, :, range(3), NUM_TURNED, range(3)] = 1.0
    return J.reshape(len(joints), 3 * len(known), -1)


def _turned(G: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """Return global rotations after each joint has turned, with all below it, by world rotation vectors."""
    E, whole, new = exp_so3(delta), np.empty_like(G), np.empty_like(G)
    for j in range(NUM_TURNED):
        parent = SMPL_PARENTS[j]
        whole[:, j] = E[:, j] if parent < 0 else whole[:, parent] @ E[:, j]
        new[:, j] = whole[:, j] @ G[:, j]
    return new
