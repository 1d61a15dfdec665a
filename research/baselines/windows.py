"""Define windows for published methods: SLERP between Gaussian codes, and other root curves.

The cost is the published data term and, for Gaussian codes, the density of the codes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import Interpolant
from solver_backend.fitters.recipes.bundlemocap import KeyState, Window
from solver_backend.geometry.interpolation import KeyWeights, sider_weights
from solver_backend.solver.manifolds import SO3, Euclidean, Product

GAUSSIAN = Product((Euclidean(), SO3(), Euclidean()))  # Space of a window's free keys when codes are Gaussian.
Root = Literal["sider", "slerp", "se3"]
"""Separate curves of rotation and translation (SIDER-n or SLERP), or one curve on SE(3)."""


@dataclass(frozen=True)
class OtherWindow(Window):
    """A window of the solver with a different curve through its keys."""

    gaussian: bool = False  # True for codes from a Gaussian prior, whose lengths are interpolated.
    latent_weight: float = 0.0  # Weight of ``|z|²/2`` in every frame.
    root: Root = "sider"
    """Root motion between three keys: a spherical parabola, SLERP from key to key, or a screw motion."""

    def codes_cost(self, z: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the prior cost ``w |z|²/2`` of codes, summed over the frames, and its gradient."""
        return 0.5 * self.latent_weight * float((z**2).sum()), self.latent_weight * z

    def curve(self, state: KeyState) -> KeyframeCurve:
        """Return the curve of poses through the keys."""
        return KeyframeCurve.through(
            self.keys(state),
            self.time[None],
            residuals=False,
            codes=StretchedSlerp.between if self.gaussian else sider_weights,
            quats=KeyToKeySlerp.between if self.root == "slerp" and len(state[0]) > 1 else sider_weights,
            screw=self.root == "se3",
        )


@dataclass(frozen=True)
class KeyToKeySlerp:
    """SLERP from the first of three keys to the second, and then to the third."""

    early: KeyWeights
    late: KeyWeights
    is_late: np.ndarray  # (W, n, 1) mask of the frames in the second half.

    @classmethod
    def between(cls, keys: np.ndarray, time: np.ndarray) -> KeyToKeySlerp:
        """Interpolate keys (W, 1, 3, d) at times (W, n) in 0..1."""
        early, late = (sider_weights(keys[..., i : i + 2, :], 2 * time - i) for i in (0, 1))
        return cls(early, late, (time > 0.5)[..., None])

    @property
    def value(self) -> np.ndarray:
        """(W, n, d) interpolated points."""
        return np.where(self.is_late, self.late.value, self.early.value)

    def vjp(self, cotangent: np.ndarray) -> np.ndarray:
        """Return the (W, n, 3, d) vector-Jacobian products with respect to the keys."""
        early = self.early.vjp(np.where(self.is_late, 0.0, cotangent))
        late = self.late.vjp(np.where(self.is_late, cotangent, 0.0))
        middle = early[..., 1:, :] + late[..., :1, :]
        return np.concatenate([early[..., :1, :], middle, late[..., 1:, :]], axis=-2)

    def jacobian(self, key: int) -> np.ndarray:
        """Return the (W, n, d, d) derivatives of the interpolated points w.r.t. one key."""
        return _jacobian(self, key)


@dataclass(frozen=True)
class StretchedSlerp:
    """``sin((1-t)ψ)/sinψ z_0 + sin(tψ)/sinψ z_1`` for two vectors of any length.

    The weights depend only on the directions u: ``dw_i = Σ_jk M[j, i, k] u_k · du_j``, ``du = (I - uuᵀ) dz / |z|``.
    """

    keys: np.ndarray  # (W, 1, 2, d) keys, which must not be zero.
    length: np.ndarray  # (W, 1, 2, 1) lengths of the keys.
    unit: KeyWeights  # Weights computed from the directions.

    @classmethod
    def between(cls, keys: np.ndarray, time: np.ndarray) -> StretchedSlerp:
        """Interpolate keys (W, 1, 2, d) at times (W, n) in 0..1."""
        length = np.maximum(np.linalg.norm(keys, axis=-1, keepdims=True), 1e-9)
        return cls(keys, length, sider_weights(keys / length, time))

    @property
    def value(self) -> np.ndarray:
        """(W, n, d) interpolated points."""
        return self.unit.weights @ self.keys[:, 0]

    def vjp(self, cotangent: np.ndarray) -> np.ndarray:
        """Return the (W, n, 2, d) vector-Jacobian products with respect to the keys."""
        along, u = cotangent @ self.keys[:, 0].swapaxes(-1, -2), self.unit.keys
        by_unit = np.einsum("wfi,wfjik->wfjk", along, self.unit.mixing) @ u
        by_unit = by_unit - (by_unit * u).sum(-1, keepdims=True) * u
        return self.unit.weights[..., :, None] * cotangent[..., None, :] + by_unit / self.length

    def jacobian(self, key: int) -> np.ndarray:
        """Return the (W, n, d, d) derivatives of the interpolated points w.r.t. one key."""
        return _jacobian(self, key)


def _jacobian(points: Interpolant, key: int) -> np.ndarray:
    """Return the (W, n, d, d) Jacobian w.r.t. a key. Row i is the vector-Jacobian product of unit vector i."""
    value = points.value
    rows = [points.vjp(np.broadcast_to(unit, value.shape))[..., key, :] for unit in np.eye(value.shape[-1])]
    return np.stack(rows, axis=-2)
