"""Cost and gradient of one window by its free keys, in reverse mode: two free keys with SIDER-2, one with SLERP.

A state is ``(z (n, 32), R (n, 3, 3), t (n, 3))``, the key before it is fixed. The cost is the data term (thesis eqs.
6.6-6.8) and, for Gaussian codes, the density of the codes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver_backend.fitters.model.codes import CODES
from solver_backend.fitters.model.keyframe_curve import lagrange
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.interpolation import Combination, sider_combination
from solver_backend.geometry.rotations import matrix_from_quat, quat_from_matrix, quat_left_tangent
from solver_backend.priors.base import PosePrior
from solver_backend.residuals.point_term import PointTerm
from solver_backend.solver.manifold import SO3, Euclidean, Product

SPHERICAL = Product((CODES, SO3(), Euclidean()))
"""Where the free keys of a window live: SPoser's."""
GAUSSIAN = Product((Euclidean(), SO3(), Euclidean()))
"""The same for VPoser's codes."""
KeyState = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Codes (n, 32), root rotations (n, 3, 3), translations (n, 3)."""
Pull = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Window:
    """The frames of a window and all that is fixed."""

    subject: Subject
    prior: PosePrior
    keys: Product
    """``SPHERICAL`` or ``GAUSSIAN``."""
    term: PointTerm
    """Data of the window's frames."""
    scale: float
    """Of Geman-McClure's penalty, in the term's standard deviations."""
    time: np.ndarray
    """(F,) positions in the window, 0..1."""
    first: KeyState
    """The key the window starts from, n = 1."""
    latent_weight: float = 0.0
    """Of ``|z|²/2`` in every frame."""
    root: Literal["sider", "slerp"] = "sider"
    """How the root turns between three keys: a spherical parabola, or from key to key."""

    def frames(self, state: KeyState) -> PosedFrames:
        """Return the frames between the keys."""
        return self._between(state)[0]

    def objective(self, state: KeyState) -> tuple[float, KeyState]:
        """Return the cost and its gradient by the free keys: ambient for codes, left tangent for rotations."""
        frames, z, pull = self._between(state)
        posed = pose(self.subject, frames, jacobian=True)
        evidence = self.term(posed.points, self.scale)
        assert posed.by_rotations is not None
        by_rotations = (posed.by_rotations * evidence.gradient[..., None]).sum(axis=(1, 2))
        cost = float(evidence.cost.sum()) + 0.5 * self.latent_weight * float((z**2).sum())
        return cost, pull(by_rotations, evidence.gradient.sum(axis=1), self.latent_weight * z)

    def _between(self, state: KeyState) -> tuple[PosedFrames, np.ndarray, Callable[..., KeyState]]:
        """Return the frames, their codes, and what carries derivatives by turns, translation and codes to the keys."""
        z_keys, R_keys, t_keys = (np.concatenate([a, b]) for a, b in zip(self.first, state, strict=True))
        z, pull_codes = self._codes(z_keys)
        quats = _one_hemisphere(quat_from_matrix(R_keys))
        quat, pull_quats = self._turns(quats)
        weights = np.stack(lagrange(self.time), 1) if len(t_keys) == 3 else np.stack([1 - self.time, self.time], 1)
        local, pull_decoder = self.prior.decode_with_pullback(z)

        def pull(by_rotations: np.ndarray, by_transl: np.ndarray, by_codes: np.ndarray) -> KeyState:
            by_z = pull_decoder(by_rotations[:, 3:].reshape(-1, 21, 3)) + by_codes
            by_quat = (4.0 * quat_left_tangent(quat) @ by_rotations[:, :3, None])[..., 0]
            turns = (quat_left_tangent(quats).swapaxes(-1, -2) @ pull_quats(by_quat)[..., None])[..., 0]
            return pull_codes(by_z)[1:], turns[1:], (weights.T @ by_transl)[1:]

        return PosedFrames(matrix_from_quat(quat), local, weights @ t_keys), z, pull

    def _codes(self, keys: np.ndarray) -> tuple[np.ndarray, Pull]:
        if self.keys is SPHERICAL:
            return _combined(keys, self.time)
        return stretched_slerp(keys, self.time)

    def _turns(self, keys: np.ndarray) -> tuple[np.ndarray, Pull]:
        if self.root == "sider" or len(keys) == 2:
            return _combined(keys, self.time)
        late = self.time > 0.5
        (early_quat, pull_early), (late_quat, pull_late) = (
            _combined(keys[i : i + 2], 2 * self.time - i) for i in (0, 1)
        )

        def pull(cotangent: np.ndarray) -> np.ndarray:
            by_early = pull_early(np.where(late[:, None], 0.0, cotangent))
            by_late = pull_late(np.where(late[:, None], cotangent, 0.0))
            return np.stack([by_early[0], by_early[1] + by_late[0], by_late[1]])

        return np.where(late[:, None], late_quat, early_quat), pull


def _combined(keys: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, Pull]:
    """Return SLERP (two keys) or SIDER-2 (three) at the times, and the map of cotangents (F, d) to the keys' (n, d)."""
    found: Combination = sider_combination(keys[None], time)
    return found.value, lambda cotangent: found.pull_back(keys[None], cotangent).sum(axis=0)


def stretched_slerp(keys: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, Pull]:
    """Return ``sin((1-t)ψ)/sinψ z_0 + sin(tψ)/sinψ z_1`` of two vectors of any length, and its pullback.

    The weights depend on the directions u alone: ``dw_i = Σ_jk M[j, i, k] u_k · du_j``, ``du = (I - uuᵀ) dz / |z|``.

    Args:
        keys: (2, d), not zero.
        time: (F,).
    """
    length = np.maximum(np.linalg.norm(keys, axis=-1, keepdims=True), 1e-9)
    unit = keys / length
    found = sider_combination(unit[None], time)

    def pull(cotangent: np.ndarray) -> np.ndarray:
        along = cotangent @ keys.T
        by_unit = np.einsum("fi,fjik,kd->jd", along, found.mixing, unit)
        by_unit = by_unit - (by_unit * unit).sum(-1, keepdims=True) * unit
        return found.weights.T @ cotangent + by_unit / length

    return found.weights @ keys, pull


def _one_hemisphere(quats: np.ndarray) -> np.ndarray:
    """Return (n, 4) with each in the hemisphere of the one before."""
    signs = np.cumprod(np.r_[1.0, np.where((quats[1:] * quats[:-1]).sum(-1) < 0, -1.0, 1.0)])
    return quats * signs[:, None]
