"""Pose-NDF: the distance to the manifold of plausible poses as a neural field over quaternions (Tiwari et al. 2022)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.quaternions import matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_left_tangent
from solver_backend.priors.base import PosePrior, check_codes, check_rotations
from solver_backend.priors.softplus_stack import SoftplusStack
from solver_backend.priors.weights import ASSETS, PriorWeights, read_weights
from solver_backend.types.joint_sets import NUM_BODY_JOINTS, SMPL_PARENTS

FEATURES = 6
"""Length of a joint's feature (Tiwari et al. 2022, 4.1)."""
ENCODER_HIDDEN = 6
_DIM = 4 * NUM_BODY_JOINTS
_PARENT: tuple[int, ...] = tuple(p - 1 for p in SMPL_PARENTS[1 : 1 + NUM_BODY_JOINTS])
"""Column of each body joint's parent; -1 where that is the pelvis."""


@dataclass(frozen=True)
class ProjectionSettings:
    """Gradient descent to the manifold (eq. 6)."""

    steps: int = 50
    """At most."""
    step_size: float = 1.0
    """The factor α: one for a field whose gradient has unit length."""
    tolerance: float = 1e-3
    """Distance, rad, at which a pose counts as on the manifold."""


class PoseNDF(PosePrior):
    """``f(θ) = f_df([v_1 .. v_21])``, ``v_k = f_enc_k(θ_k, v_parent)``: zero on plausible poses, rad elsewhere.

    Quaternions enter with ``w >= 0``, so that q and -q are the same pose by construction.
    """

    def __init__(self, encoders: tuple[SoftplusStack, ...], field: SoftplusStack, metadata: dict[str, Any]) -> None:
        self._encoders, self._field, self.metadata = encoders, field, metadata

    @property
    def name(self) -> str:
        """``"pose_ndf"``."""
        return "pose_ndf"

    @property
    def latent_dim(self) -> int:
        """84: the code is the 21 unit quaternions."""
        return _DIM

    def encode(self, rotations: Array) -> Array:
        """Return the unit quaternions, wxyz with ``w >= 0``, (N, 84).

        Raises:
            PoseInvalid: NaN, matrices off SO(3) or another number of joints.
        """
        check_rotations(rotations)
        xp = array_namespace(rotations)
        return xp.reshape(_upper(quat_from_matrix(rotations)), (rotations.shape[0], _DIM))

    def decode(self, z: Array) -> Array:
        """Return (N, 21, 3, 3) rotations of (N, 84) quaternions of any length but zero."""
        check_codes(z, _DIM)
        return matrix_from_quat(_unit(array_namespace(z).reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))))

    def decode_with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return ``decode(z)`` and its left tangents (N, 21, 3, 84), ``dω = 2 (dq q⁻¹)`` at unit quaternions."""
        xp = array_namespace(z)
        rotations = self.decode(z)
        quats = xp.reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))
        square = xp.sum(quats * quats, axis=-1)[..., None, None]
        blocks = 4.0 * xp.permute_dims(quat_left_tangent(quats), (0, 1, 3, 2)) / square
        own = constant(np.eye(NUM_BODY_JOINTS)[None, :, None, :, None], z)
        return rotations, xp.reshape(own * blocks[:, :, :, None, :], (z.shape[0], NUM_BODY_JOINTS, 3, _DIM))

    def energy(self, rotations: Array) -> Array:
        """Return the predicted distance of (N, 21, 3, 3) poses to the manifold, rad: (N,)."""
        return self.distance_with_gradient(self.encode(rotations))[0]

    def distance_with_gradient(self, z: Array) -> tuple[Array, Array]:
        """Return ``f`` (N,) and ``df/dz`` (N, 84) of (N, 84) quaternions, by reverse accumulation through the tree."""
        check_codes(z, _DIM)
        xp = array_namespace(z)
        quats = xp.reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4))
        sign = xp.where(quats[..., :1] < 0, -xp.ones_like(quats[..., :1]), xp.ones_like(quats[..., :1]))
        features: list[Array] = []
        tapes = []
        for joint, encoder in enumerate(self._encoders):
            own = sign[:, joint] * quats[:, joint]
            parent = _PARENT[joint]
            value, tape = encoder.forward(own if parent < 0 else xp.concat((own, features[parent]), axis=-1))
            features.append(value)
            tapes.append(tape)
        distance, tape = self._field.forward(xp.concat(features, axis=-1))
        by_all = self._field.backward(tape, xp.ones_like(distance))
        by_feature = [by_all[:, FEATURES * j : FEATURES * (j + 1)] for j in range(NUM_BODY_JOINTS)]
        by_quat: list[Array] = [by_all] * NUM_BODY_JOINTS
        for joint in range(NUM_BODY_JOINTS - 1, -1, -1):
            by_input = self._encoders[joint].backward(tapes[joint], by_feature[joint])
            by_quat[joint] = sign[:, joint] * by_input[:, :4]
            if _PARENT[joint] >= 0:
                by_feature[_PARENT[joint]] = by_feature[_PARENT[joint]] + by_input[:, 4:]
        return distance[:, 0], xp.concat(by_quat, axis=-1)

    def project(self, rotations: Array, settings: ProjectionSettings = ProjectionSettings()) -> Array:
        """Return (N, 21, 3, 3) poses moved down the field, ``θ - α f ∇f`` and back to unit length (eq. 6).

        A pose takes only steps that lower its distance; its step is halved where it would rise.
        """
        z = self.encode(rotations)
        xp = array_namespace(z)
        distance, gradient = self.distance_with_gradient(z)
        alpha = settings.step_size * xp.ones_like(distance)
        for _ in range(settings.steps):
            if bool(xp.all(distance < settings.tolerance)):
                break
            trial = _normalised(z - (alpha * distance)[:, None] * gradient)
            trial_distance, trial_gradient = self.distance_with_gradient(trial)
            better = trial_distance < distance
            z, gradient = (xp.where(better[:, None], a, b) for a, b in ((trial, z), (trial_gradient, gradient)))
            distance = xp.where(better, trial_distance, distance)
            alpha = xp.where(better, alpha, 0.5 * alpha)
        return self.decode(z)

    def sample(self, count: int, seed: int) -> np.ndarray:
        """Return ``count`` random poses (60° about random axes, at one sigma) projected to the manifold."""
        rotvecs = np.radians(60.0) * np.random.default_rng(seed).standard_normal((count, NUM_BODY_JOINTS, 3)) / 3**0.5
        return self.project(matrix_from_quat(quat_from_rotvec(rotvecs)))


def load_pose_ndf(path: Path | str = ASSETS / "pose_ndf.npz") -> PoseNDF:
    """Load Pose-NDF's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: wrong prior, body, version or shapes, or a damaged file.
    """
    stored = read_weights(Path(path), "pose_ndf")
    encoders = tuple(
        _stack(stored, f"joint{k}", (4 if _PARENT[k] < 0 else 4 + FEATURES, ENCODER_HIDDEN, FEATURES))
        for k in range(NUM_BODY_JOINTS)
    )
    hidden = tuple(int(n) for n in stored.metadata.get("field_hidden", ()))
    field = _stack(stored, "field", (FEATURES * NUM_BODY_JOINTS, *hidden, 1))
    return PoseNDF(encoders, field, {**stored.metadata, "sha256": stored.sha256})


def _stack(stored: PriorWeights, part: str, widths: tuple[int, ...]) -> SoftplusStack:
    pairs = list(pairwise(widths))
    matrices = tuple(stored.array(f"{part}_w{i}", (b, a)) for i, (a, b) in enumerate(pairs))
    biases = tuple(stored.array(f"{part}_b{i}", (b,)) for i, (_, b) in enumerate(pairs))
    return SoftplusStack(matrices, biases, last_is_positive=part == "field")


def _upper(quats: Array) -> Array:
    xp = array_namespace(quats)
    return xp.where(quats[..., :1] < 0, -quats, quats)


def _unit(quats: Array) -> Array:
    xp = array_namespace(quats)
    return quats / xp.sqrt(xp.sum(quats * quats, axis=-1, keepdims=True))


def _normalised(z: Array) -> Array:
    xp = array_namespace(z)
    return xp.reshape(_upper(_unit(xp.reshape(z, (z.shape[0], NUM_BODY_JOINTS, 4)))), z.shape)
