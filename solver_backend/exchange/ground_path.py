"""Compute the path on the ground that a root bone follows and that in-place motions omit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .so3 import matrix_from_rotvec, quat_from_matrix, sign_continuous

_SMOOTH_S = 0.25  # Standard deviation of the Gaussian filter in seconds. Sway remains in the hips.


@dataclass(frozen=True)
class GroundPath:
    """A person's path along the ground."""

    way: np.ndarray  # (F, 3) positions in metres relative to the stage's origin, z = 0.
    heading: np.ndarray  # (F,) continuous angles about Z in radians, 0 when facing -Y.

    @classmethod
    def of(cls, root: np.ndarray) -> GroundPath:
        """Build a path from a motion's ``root`` (F, 3): x and y in metres, and heading in radians."""
        return cls(np.column_stack([root[:, :2], np.zeros(len(root))]), root[:, 2])

    @property
    def turns(self) -> np.ndarray:
        """(F, 3, 3) rotations by the heading about Z."""
        return matrix_from_rotvec(self.heading[:, None] * [0.0, 0.0, 1.0])


def ground_path(hips: np.ndarray, turns: np.ndarray, fps: float) -> GroundPath:
    """Compute the smoothed ground path and heading of the hips.

    The heading of a rotation q is the twist in its swing-twist decomposition, ``2 atan2(q_z, q_w)``.

    Args:
        hips: (F, 3) positions in metres, Z up.
        turns: (F, 3, 3) rotations of the hips, with the identity facing -Y.
        fps: frames per second.
    """
    on_ground = hips * [1.0, 1.0, 0.0]
    quat = sign_continuous(quat_from_matrix(turns))
    heading = np.unwrap(2 * np.arctan2(quat[:, 3], quat[:, 0]))
    smooth = _smoothed(np.column_stack([on_ground, heading]), _SMOOTH_S * fps)
    return GroundPath(smooth[:, :3], smooth[:, 3])


def _smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth each column with a Gaussian. Beyond its ends, a column is reflected about its end points."""
    half = min(int(np.ceil(3 * sigma)), len(values) - 1)
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / max(sigma, 1e-6)) ** 2)
    longer = np.pad(values, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return np.stack([np.convolve(column, kernel / kernel.sum(), "valid") for column in longer.T], axis=1)
