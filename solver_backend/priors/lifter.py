"""Estimate the initial pose of a solve from a frame's 3D keypoints with a small network, the lifter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.arrays import Array, array_namespace, constant, device_of
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.geometry.rotations import matrix_from_6d
from solver_backend.priors.autoencoder import DenseStack
from solver_backend.priors.sposer import LATENT_DIM, load_sposer
from solver_backend.priors.weights import ASSETS, PriorWeights, read_stack, read_weights
from solver_backend.types import NUM_BETAS

DEFAULT_WEIGHTS: Path = ASSETS / "lifter.npz"
SIDES = ("left", "right")
TRUNK: tuple[str, ...] = tuple(f"{side}_{part}" for part in ("shoulder", "hip") for side in SIDES)  # Required.
POINTS: tuple[str, ...] = (
    *TRUNK,
    *(f"{side}_{part}" for part in ("elbow", "wrist", "knee", "ankle", "ear", "big_toe", "heel") for side in SIDES),
    "nose",
)  # Inputs of the network. Points that a detector does not provide are missing.
OUTPUTS = LATENT_DIM + 6 + 3 + NUM_BETAS  # Code, root rotation (6 numbers), translation and shape.
_SMALLEST_M = 1e-3  # Smallest trunk width in metres for which the front is known. Chosen by hand.


@dataclass(frozen=True)
class Lifted:
    """Initial poses that the network estimates in F frames, valid only where ``usable``."""

    z: Array  # (F, 32) unit zero-mean codes of SPoser.
    root: Array  # (F, 3, 3) body to world.
    pelvis: Array  # (F, 3) metres.
    betas: Array  # (F, 10) shape estimated from each frame alone.
    usable: Array  # (F,) bool: shoulders and hips are known.


@dataclass(frozen=True)
class TrunkFrame:
    """Coordinate axes of a person's trunk in F frames: ``x_world = R x + origin``."""

    R: Array  # (F, 3, 3): x to the person's left, y up the spine, z to the front.
    origin: Array  # (F, 3) centre of shoulders and hips in metres.
    valid: Array  # (F,) bool.


def trunk_frame(points: Array, seen: Array) -> TrunkFrame:
    """Compute the trunk frames from finite (F, 19, 3) ``POINTS`` in metres."""
    xp = array_namespace(points)
    left_shoulder, right_shoulder, left_hip, right_hip = (points[:, i] for i in range(4))
    up = 0.5 * (left_shoulder + right_shoulder - left_hip - right_hip)
    across = 0.5 * (left_shoulder - right_shoulder + left_hip - right_hip)
    R = matrix_from_6d(xp.concat([across, up], axis=-1))
    front = xp.linalg.vector_norm(xp.linalg.cross(across, up), axis=-1)
    valid = xp.all(seen[:, :4], axis=-1) & (front > _SMALLEST_M * xp.linalg.vector_norm(up, axis=-1))
    return TrunkFrame(R, xp.mean(points[:, :4], axis=1), valid)


def features(points: Array, seen: Array, trunk: TrunkFrame) -> Array:
    """Return the network's (F, 76) input: points in trunk axes (0 if unknown), and a mask of known points."""
    xp = array_namespace(points)
    local = xp.matmul(points - trunk.origin[:, None], trunk.R)
    mask = xp.astype(seen, points.dtype)[..., None]
    local = xp.where(seen[..., None], local, xp.zeros_like(local))
    return xp.reshape(xp.concat([local, mask], axis=-1), (points.shape[0], 4 * len(POINTS)))


def interpreted(output: Array, trunk: TrunkFrame) -> Lifted:
    """Convert the network's (F, 51) output to code, root rotation, pelvis position and shape."""
    xp = array_namespace(output)
    upright = constant((1.0, 0.0, 0.0, 0.0, 1.0, 0.0), output)
    turn, end = output[:, LATENT_DIM : LATENT_DIM + 6] + upright, LATENT_DIM + 6
    pelvis = trunk.origin + xp.matmul(trunk.R, output[:, end : end + 3, None])[..., 0]
    root = xp.matmul(trunk.R, matrix_from_6d(turn))
    return Lifted(spherical_normalisation(output[:, :LATENT_DIM]), root, pelvis, output[:, end + 3 :], trunk.valid)


@dataclass(frozen=True)
class Lifter:
    """Network, with its metadata, that estimates a pose from 3D keypoints."""

    stack: DenseStack
    metadata: dict[str, Any]  # Training command, data and evaluation.

    def __call__(self, points: Array, seen: Array, names: tuple[str, ...]) -> Lifted:
        """Estimate initial poses from named (F, L, 3) world points in metres."""
        xp = array_namespace(points)
        device = device_of(points)
        known = xp.asarray([name in names for name in POINTS], device=device)
        index = xp.asarray([names.index(name) if name in names else 0 for name in POINTS], device=device)
        chosen, there = points[:, index], seen[:, index] & known
        trunk = trunk_frame(chosen, there)
        return interpreted(self.stack.like(points)(features(chosen, there, trunk)), trunk)


@cache
def load_lifter(path: Path = DEFAULT_WEIGHTS) -> Lifter:
    """Load the lifter's weights. Raises the errors of ``read_lifter_weights``."""
    weights = read_lifter_weights(path, "lifter")
    return Lifter(read_stack(weights, "network", 4 * len(POINTS), OUTPUTS), weights.metadata)


def read_lifter_weights(path: Path, kind: str) -> PriorWeights:
    """Read the weights of a network that maps keypoints to SPoser's codes.

    Raises:
        FileMissing: the file does not exist.
        WeightsInvalid: it is damaged, or is for another body, version or SPoser.
    """
    weights = read_weights(path, kind)
    trained_for, ours = weights.metadata.get("sposer_sha256"), load_sposer().metadata["sha256"]
    if trained_for != ours or tuple(weights.metadata.get("points", ())) != POINTS:
        message = f"The {kind.replace('_', ' ')} was trained for other codes or points."
        raise WeightsInvalid(message, where=path.name, hint="Train the network again, or reinstall the program.")
    return weights
