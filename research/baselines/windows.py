"""Cost and gradient of one window by its free keys, in reverse mode: n free keys with SIDER-n, one with SLERP.

A state is ``(z (n, 32), R (n, 3, 3), t (n, 3))``, the key before it is fixed. The cost is the data term (thesis eqs.
6.6-6.8) and, for Gaussian codes, the density of the codes; frames lie on the curve through the keys (eqs. 6.9, 6.10).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from research.descent.manifolds import SO3, CodeSphere, Euclidean, Product
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve, by_turns
from solver_backend.fitters.model.keyframe_layout import Interpolant
from solver_backend.fitters.model.subject import Keyframes, PosedFrames, Subject, hemisphere_aligned, pose
from solver_backend.geometry.interpolation import KeyWeights, sider_weights
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.terms import PointTerm

SPHERICAL = Product((CodeSphere(), SO3(), Euclidean()))  # Where the free keys of a window live: SPoser's.
GAUSSIAN = Product((Euclidean(), SO3(), Euclidean()))  # The same for VPoser's codes.
Root = Literal["sider", "slerp", "se3"]
"""Rotation and translation apart as SIDER-n or SLERP has it, or together on SE(3)."""
KeyState = tuple[np.ndarray, np.ndarray, np.ndarray]  # Codes (n, 32), root rotations (n, 3, 3), translations (n, 3).


@dataclass(frozen=True)
class Window:
    """The frames of a window and all that is fixed."""

    subject: Subject
    prior: PosePrior
    keys: Product  # ``SPHERICAL`` or ``GAUSSIAN``.
    term: PointTerm  # Data of the window's frames.
    scale: float  # Of Geman-McClure's penalty, in the term's standard deviations.
    time: np.ndarray  # (F,) positions in the window, 0..1.
    first: KeyState  # The key the window starts from, n = 1.
    latent_weight: float = 0.0  # Of ``|z|²/2`` in every frame.
    root: Root = "sider"
    """How the root moves between three keys: turning on a spherical parabola, or from key to key; or on a screw."""

    def frames(self, state: KeyState) -> PosedFrames:
        """Return the frames between the keys."""
        return self._curve(state).poses(self.prior)

    def objective(self, state: KeyState) -> tuple[float, KeyState]:
        """Return the cost and its gradient by the free keys: ambient for codes, left tangent for rotations."""
        curve = self._curve(state)
        frames, vjp = curve.poses_with_vjp(self.prior)
        posed, z = pose(self.subject, frames, jacobian=True), curve.codes.value[0]
        evidence = self.term(posed.points, self.scale)
        assert posed.by_rotations is not None
        by_rotations = (posed.by_rotations * evidence.gradient[..., None]).sum(axis=(1, 2))
        by_poses = np.concatenate([by_rotations, evidence.gradient.sum(axis=1)], axis=1)
        cost = float(evidence.cost.sum()) + 0.5 * self.latent_weight * float((z**2).sum())
        by_keys = vjp(by_poses, self.latent_weight * z)
        assert by_keys.z is not None
        return cost, (by_keys.z[0, 1:], by_turns(curve.keys.quat, by_keys.quat)[0, 1:], by_keys.transl[0, 1:])

    def _curve(self, state: KeyState) -> KeyframeCurve:
        z, R, transl = (np.concatenate([a, b]) for a, b in zip(self.first, state, strict=True))
        keys = hemisphere_aligned(Keyframes(z, quat_from_matrix(R), transl, np.zeros((len(z), NUM_BODY_JOINTS, 3))))
        return KeyframeCurve.through(
            keys.select(np.arange(len(z))[None]),
            self.time[None],
            residuals=False,
            codes=sider_weights if self.keys is SPHERICAL else StretchedSlerp.between,
            quats=KeyToKeySlerp.between if self.root == "slerp" and len(z) > 2 else sider_weights,
            screw=self.root == "se3",
        )


@dataclass(frozen=True)
class KeyToKeySlerp:
    """SLERP from the first of three keys to the second, and on to the third."""

    early: KeyWeights
    late: KeyWeights
    is_late: np.ndarray  # (W, n, 1).

    @classmethod
    def between(cls, keys: np.ndarray, time: np.ndarray) -> KeyToKeySlerp:
        """Take (W, 1, 3, d) keys and (W, n) times in 0..1."""
        early, late = (sider_weights(keys[..., i : i + 2, :], 2 * time - i) for i in (0, 1))
        return cls(early, late, (time > 0.5)[..., None])

    @property
    def value(self) -> np.ndarray:
        """(W, n, d)."""
        return np.where(self.is_late, self.late.value, self.early.value)

    def vjp(self, cotangent: np.ndarray) -> np.ndarray:
        """Return (W, n, 3, d) by each key."""
        early = self.early.vjp(np.where(self.is_late, 0.0, cotangent))
        late = self.late.vjp(np.where(self.is_late, cotangent, 0.0))
        middle = early[..., 1:, :] + late[..., :1, :]
        return np.concatenate([early[..., :1, :], middle, late[..., 1:, :]], axis=-2)

    def jacobian(self, key: int) -> np.ndarray:
        """Return (W, n, d, d), the derivative of the points by one of the keys."""
        return _jacobian(self, key)


@dataclass(frozen=True)
class StretchedSlerp:
    """``sin((1-t)ψ)/sinψ z_0 + sin(tψ)/sinψ z_1`` of two vectors of any length.

    The weights depend on the directions u alone: ``dw_i = Σ_jk M[j, i, k] u_k · du_j``, ``du = (I - uuᵀ) dz / |z|``.
    """

    keys: np.ndarray  # (W, 1, 2, d), not zero.
    length: np.ndarray  # (W, 1, 2, 1).
    unit: KeyWeights  # Of the directions.

    @classmethod
    def between(cls, keys: np.ndarray, time: np.ndarray) -> StretchedSlerp:
        """Take (W, 1, 2, d) keys and (W, n) times in 0..1."""
        length = np.maximum(np.linalg.norm(keys, axis=-1, keepdims=True), 1e-9)
        return cls(keys, length, sider_weights(keys / length, time))

    @property
    def value(self) -> np.ndarray:
        """(W, n, d)."""
        return self.unit.weights @ self.keys[:, 0]

    def vjp(self, cotangent: np.ndarray) -> np.ndarray:
        """Return (W, n, 2, d) by each key."""
        along, u = cotangent @ self.keys[:, 0].swapaxes(-1, -2), self.unit.keys
        by_unit = np.einsum("wfi,wfjik->wfjk", along, self.unit.mixing) @ u
        by_unit = by_unit - (by_unit * u).sum(-1, keepdims=True) * u
        return self.unit.weights[..., :, None] * cotangent[..., None, :] + by_unit / self.length

    def jacobian(self, key: int) -> np.ndarray:
        """Return (W, n, d, d), the derivative of the points by one of the keys."""
        return _jacobian(self, key)


def _jacobian(points: Interpolant, key: int) -> np.ndarray:
    """Return (W, n, d, d) of any points between keys: row i is the vector-Jacobian product of the i-th unit vector."""
    value = points.value
    rows = [points.vjp(np.broadcast_to(unit, value.shape))[..., key, :] for unit in np.eye(value.shape[-1])]
    return np.stack(rows, axis=-2)
