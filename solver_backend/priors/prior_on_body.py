"""Apply a prior to a body with joints that differ from the prior's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.errors import PoseInvalid, PriorInvalid
from solver_backend.geometry.arrays import Array, array_namespace, constant, index, zeros
from solver_backend.priors.base import AutoencodingPrior, CodeJacobian, Codes, Energies, Poses

UNCOVERED_SIGMA_RAD = 0.5  # Standard deviation from rest of joints without a prior. Not tuned.


def prior_on_body(prior: AutoencodingPrior, layout: BodyLayout) -> AutoencodingPrior:
    """Extend a prior to all joints that a solve of this body rotates. A prior for exactly these joints is not changed.

    Raises:
        PriorInvalid: the prior's arrays do not match its joints or codes, or the body has none of its joints.
    """
    _check(prior, layout)
    return prior if prior.joints == layout.solved else PriorOnBody(prior, layout.solved)


class PriorOnBody(AutoencodingPrior):
    """Adapter of a prior to a body with other joints. Joints that the wrapped prior does not model stay at rest."""

    def __init__(self, prior: AutoencodingPrior, joints: tuple[str, ...]) -> None:
        self._prior, self.name, self.metadata, self.joints = prior, prior.name, prior.metadata, joints
        shared = [name for name in joints if name in prior.joints]
        self._own = np.array([joints.index(name) for name in shared])
        """Columns of the body's poses that the wrapped prior models."""
        self._theirs = np.array([prior.joints.index(name) for name in shared])
        """The same joints' columns in the wrapped prior's poses."""
        self.uncovered = tuple(column for column in range(len(joints)) if column not in self._own)
        self.residual_sigma = np.full((len(joints), 3), UNCOVERED_SIGMA_RAD)
        self.residual_sigma[self._own] = prior.residual_sigma[self._theirs]

    @property
    def latent_dim(self) -> int:
        """Number of entries in a code."""
        return self._prior.latent_dim

    def encode(self, rotations: Poses) -> Codes:
        """Encode the joints that the prior models. Joints that the body does not have are at rest."""
        return self._prior.encode(self._as_prior(rotations))

    def decode(self, z: Codes) -> Poses:
        """Decode codes with the wrapped prior, and arrange the rotations for the body."""
        return self._on_body(self._prior.decode(z))

    def decode_with_jacobian(self, z: Codes) -> tuple[Poses, CodeJacobian]:
        """Return ``decode(z)`` and its Jacobian, which is zero at joints outside the prior."""
        rotations, by_code = self._prior.decode_with_jacobian(z)
        jacobian = zeros((z.shape[0], len(self.joints), *by_code.shape[2:]), by_code)
        jacobian[:, index(self._own, z)] = by_code[:, index(self._theirs, z)]
        return self._on_body(rotations), jacobian

    def decode_with_vjp(self, z: Codes) -> tuple[Poses, Callable[[Array], Array]]:
        """Return ``decode(z)`` and the function ``v -> J_zᵀ v``."""
        rotations, prior_vjp = self._prior.decode_with_vjp(z)

        def vjp(cotangent: Array) -> Array:
            by_joints = zeros((z.shape[0], len(self._prior.joints), 3), cotangent)
            by_joints[:, index(self._theirs, z)] = cotangent[:, index(self._own, z)]
            return prior_vjp(by_joints)

        return self._on_body(rotations), vjp

    def energy(self, rotations: Poses) -> Energies:
        """Return the wrapped prior's energy for the joints that it models."""
        return self._prior.energy(self._as_prior(rotations))

    def sample(self, count: int, seed: int) -> Poses:
        """Draw poses from the wrapped prior, and arrange them for the body."""
        return self._on_body(self._prior.sample(count, seed))

    def _on_body(self, rotations: Array) -> Array:
        return _placed(rotations, self._theirs, len(self.joints), self._own)

    def _as_prior(self, rotations: Array) -> Array:
        return _placed(rotations, self._own, len(self._prior.joints), self._theirs)


def _placed(rotations: Array, taken: np.ndarray, count: int, put: np.ndarray) -> Array:
    """Return poses of ``count`` joints. Columns ``put`` get the input columns ``taken``. All others are at rest."""
    xp = array_namespace(rotations)
    rest = constant(np.eye(3), rotations) + zeros((rotations.shape[0], count, 3, 3), rotations)
    rest[:, index(put, rotations)] = xp.asarray(rotations)[:, index(taken, rotations)]
    return rest


def _check(prior: AutoencodingPrior, layout: BodyLayout) -> None:
    if not set(prior.joints) & set(layout.solved):
        message = f"The prior {prior.name} models none of the joints of {layout.name}."
        raise PriorInvalid(message, where=prior.name, hint="Use a prior with the body's joint names.")
    count, width = len(prior.joints), prior.latent_dim

    def require(name: str, found: Any, shape: tuple[int, ...]) -> Any:
        if np.shape(found) == shape:
            return found
        raise PriorInvalid(
            f"{name} of the prior {prior.name} has shape {np.shape(found)}, but {shape} is expected of {count} joints "
            f"and codes of {width} numbers.",
            where=prior.name,
        )

    require("residual_sigma", prior.residual_sigma, (count, 3))
    try:
        code = require("encode", prior.encode(np.tile(np.eye(3), (1, count, 1, 1))), (1, width))
        require("decode", prior.decode(code), (1, count, 3, 3))
    except (PoseInvalid, ValueError) as error:
        raise PriorInvalid(
            f"The prior {prior.name} cannot encode and decode the rest pose: {error}", where=prior.name
        ) from error
    mean, length = float(code.mean()), float((code * code).sum())
    if abs(mean) > 1e-3 or abs(length - 1.0) > 1e-3:
        message = f"The codes of the prior {prior.name} are not unit vectors with zero mean."
        hint = "Normalise the codes to mean 0 and length 1 in `encode`, as SPoser does."
        raise PriorInvalid(message, where=prior.name, hint=hint)
