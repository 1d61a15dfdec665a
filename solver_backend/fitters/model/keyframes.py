"""Latent keyframes: a code, the root's rotation and place, and rotations off the manifold (thesis 6.2.5)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.fitters.model.codes import CODES
from solver_backend.geometry.arrays import Array, astype, index, zeros
from solver_backend.geometry.rotations import quat_from_rotvec, quat_multiply
from solver_backend.geometry.sphere import spherical_normalisation


@dataclass(frozen=True)
class Keyframes:
    """K keyframes."""

    z: Array
    """(K, 32) unit zero-mean codes."""
    quat: Array
    """(K, 4) root rotations wxyz, neighbours in one hemisphere."""
    transl: Array
    """(K, 3) metres."""
    residual: Array
    """(K, 21, 3) rotations off the manifold, radians."""

    def select(self, keys: np.ndarray | slice) -> Keyframes:
        """Return the keys at these indices."""
        return Keyframes(self.z[keys], self.quat[keys], self.transl[keys], self.residual[keys])

    def where(self, mask: Array, other: Keyframes) -> Keyframes:
        """Return these keys where the (K,) mask is true, and the other's elsewhere."""
        xp = array_namespace(self.z)
        return Keyframes(
            xp.where(mask[:, None], self.z, other.z), xp.where(mask[:, None], self.quat, other.quat),
            xp.where(mask[:, None], self.transl, other.transl),
            xp.where(mask[:, None, None], self.residual, other.residual),
        )  # fmt: skip

    def of_windows(self, windows: np.ndarray, free: int = 2) -> Keyframes:
        """Return (W, n + 1) keys: those of each of these windows, which have n free ones each."""
        return self.select(index(free * windows[:, None] + np.arange(free + 1), self.z))

    def fives(self, windows: np.ndarray) -> Keyframes:
        """Return (W, 5) keys: of each of these windows, with one more on either side; the ends are repeated."""
        keys = np.clip(2 * windows[:, None] + np.arange(-1, 4), 0, self.z.shape[0] - 1)
        return self.select(index(keys, self.z))

    def replaced(self, keys: slice, new: Keyframes) -> Keyframes:
        """Return the keys with those of a range taken from ``new``."""
        xp = array_namespace(self.z)

        def spliced(name: str) -> Array:
            old = getattr(self, name)
            return xp.concat([old[: keys.start], getattr(new, name), old[keys.stop :]])

        return Keyframes(*(spliced(name) for name in ("z", "quat", "transl", "residual")))

    def astype(self, precision: Any) -> Keyframes:
        """Return the keys in a precision."""
        return Keyframes(*(astype(part, precision) for part in (self.z, self.quat, self.transl, self.residual)))

    def retract(self, step: Array, layout: StateLayout) -> Keyframes:
        """Return the keys moved by (K, n) steps of this layout; what it has no block for stays."""
        xp, z, residual = array_namespace(step), self.z, self.residual
        if CODE in layout:
            along = xp.matmul(CODES.tangent_basis(z), step[:, layout[CODE], None])[..., 0]
            z = spherical_normalisation(z + along)
        quat = quat_multiply(quat_from_rotvec(step[:, layout[ROOT]]), self.quat)
        quat = quat / xp.sqrt(xp.sum(quat * quat, axis=-1, keepdims=True))
        if layout.turned:
            residual = residual + rotations_of(step, layout, residual.shape[1])
        return Keyframes(z, quat, self.transl + step[:, layout[TRANSL]], residual)


def rotations_of(step: Array, layout: StateLayout, num_joints: int) -> Array:
    """Return (K, J, 3): the rotation vectors of (K, n) steps by joint, zero where a joint has none."""
    vectors = array_namespace(step).reshape(step[:, layout.turns], (step.shape[0], -1, 3))
    if layout.turned == tuple(range(num_joints)):
        return vectors
    by_joint = zeros((step.shape[0], num_joints, 3), step)
    by_joint[:, index(np.array(layout.turned, dtype=int), step)] = vectors
    return by_joint


def hemisphere_aligned(keys: Keyframes) -> Keyframes:
    """Return the keys with signs of the root quaternions chosen so that neighbours lie in one hemisphere."""
    xp = array_namespace(keys.quat)
    dots = xp.sum(keys.quat[1:] * keys.quat[:-1], axis=-1)
    signs = xp.where(dots < 0, -xp.ones_like(dots), xp.ones_like(dots))
    signs = xp.concat([xp.ones_like(keys.quat[:1, 0]), xp.cumulative_prod(signs)])
    return replace(keys, quat=keys.quat * signs[:, None])
