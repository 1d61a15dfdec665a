"""Which way the bones of limbs point along the line of sight, with chances: a small network behind the view lifter.

A picture hardly shows whether a forearm points at the camera or away from it, and the view lifter decides for one of
the two. This network has learned, from what the lifter makes of a window, how often that is the wrong one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.priors.networks.attention import softmax
from solver_backend.priors.networks.dense import DenseStack
from solver_backend.priors.view_lifter import load_view_lifter
from solver_backend.priors.weights import ASSETS, read_stack, read_weights

DEFAULT_WEIGHTS: Path = ASSETS / "limb_slants.npz"
PARTS = {"left arm": "left", "left leg": "left", "right arm": "right", "right leg": "right"}
"""Limbs, in the order of the results, and their sides."""
_CHAINS = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle")}
BONES: tuple[tuple[int, int], ...] = tuple(
    (SMPL.joints.index(f"{side}_{first}"), SMPL.joints.index(f"{side}_{last}"))
    for part, side in PARTS.items()
    for first, last in zip(_CHAINS[part.split()[1]][:-1], _CHAINS[part.split()[1]][1:], strict=True)
)
"""Joints at the ends of the eight bones, upper before lower."""
SLANT = float(np.sin(np.radians(20.0)))
"""Sine of the angle to the picture's plane from which a bone points towards the camera or away from it."""
CLASSES = 3
"""Towards the camera, across, away from it."""


@dataclass(frozen=True)
class LimbSlants:
    """The network and what is known of it."""

    stack: DenseStack
    """The lifter's features to 8 x 3 logits."""
    metadata: dict[str, Any]
    """Training command, data, figures."""

    def __call__(self, hidden: np.ndarray) -> np.ndarray:
        """Return (N, 8, 3) chances that each bone points towards the camera, across or away, for (N, d) features."""
        logits = np.asarray(self.stack(np.asarray(hidden, dtype=float)))
        return softmax(logits.reshape(len(hidden), len(BONES), CLASSES).copy())


def bone_slants(joints: np.ndarray, sight: np.ndarray) -> np.ndarray:
    """Return (F, 8) sines of the angles by which bones point away from the camera: ``u · s``.

    Args:
        joints: (F, J, 3), SMPL's first.
        sight: (F, 3) unit lines of sight.
    """
    first, last = np.array(BONES).T
    bones = joints[:, last] - joints[:, first]
    length = np.maximum(np.linalg.norm(bones, axis=-1), 1e-9)
    return np.einsum("fba,fa->fb", bones, sight) / length


def slant_classes(slants: np.ndarray) -> np.ndarray:
    """Return 0 where a bone points towards the camera, 1 across, 2 away."""
    return np.where(slants < -SLANT, 0, np.where(slants > SLANT, 2, 1))


def flip_chances(chances: np.ndarray, slants: np.ndarray) -> np.ndarray:
    """Return (F, 4) chances that a bone of a limb points the other way than it was solved.

    ``1 - Π_b (1 - p_b)`` over its two bones, p the chance of the opposite class; 0 of a bone that lies across.

    Args:
        chances: (F, 8, 3), see ``LimbSlants``.
        slants: (F, 8) as solved.
    """
    opposite = np.where(slants > SLANT, chances[..., 0], np.where(slants < -SLANT, chances[..., 2], 0.0))
    return 1.0 - (1.0 - opposite[:, 0::2]) * (1.0 - opposite[:, 1::2])


@cache
def load_limb_slants(path: Path = DEFAULT_WEIGHTS) -> LimbSlants:
    """Load the network's weights.

    Raises:
        FileMissing: there is no such file.
        WeightsInvalid: it is for another body, version or view lifter, or damaged.
    """
    weights = read_weights(path, "limb_slants")
    lifter = load_view_lifter()
    if weights.metadata.get("view_lifter_sha256") != lifter.metadata["sha256"]:
        raise WeightsInvalid("The limbs' slants are of another view lifter.", where=path.name, hint="Train them again.")
    return LimbSlants(read_stack(weights, "network", lifter.width, len(BONES) * CLASSES), weights.metadata)
