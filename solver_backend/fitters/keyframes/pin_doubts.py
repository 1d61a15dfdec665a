"""What a person's pins leave doubtful: the pinned frames are certain, and near them only joints that the pins moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.geometry.symmetric import mean_sigma
from solver_backend.types import FLAG_UNSURE, Motion

MOVED_M = 0.02
"""A joint that a pin moved by more than this, against the views, is doubtful beside the pinned frame; chosen
by hand."""
DOUBTFUL_M = 0.046
"""Standard deviation that such a joint has at least: confidence 0.3, that of an unsure frame."""
_DIAGONAL = [0, 3, 5]
"""Of six packed numbers (see ``packed``): xx, yy, zz."""


def express_pin_doubts(again: Motion, before: Motion, frame_range: FrameRange, frames: np.ndarray) -> Motion:
    """Return a motion whose doubts about pins are those of single joints instead of flags of whole frames.

    A pose that a person pinned disagrees with the measurements, which flags its frame and those beside it as unsure.

    Args:
        again: the motion with some frames solved again.
        before: the motion before.
        frame_range: with the pins.
        frames: numbers of the frames that were solved again.
    """
    pinned = np.array(sorted({pin.frame for pin in frame_range.pins}), dtype=int)
    if not len(pinned) or again.flags is None or again.joints is None or before.joints is None:
        return again
    flags, known = again.flags.copy(), np.zeros_like(again.flags) if before.flags is None else before.flags
    new = np.zeros(len(flags), bool)
    new[frames] = (flags[frames] & FLAG_UNSURE > 0) & (known[frames] & FLAG_UNSURE == 0)
    new[pinned] = False
    moved = np.linalg.norm(again.joints - before.joints, axis=-1) > MOVED_M
    moved[~new] = False
    flags[moved.any(axis=1)] &= ~np.uint8(FLAG_UNSURE)
    flags[pinned] = 0
    covariance, sigma = again.joint_covariance, again.joint_sigma
    if covariance is not None and sigma is not None:
        missing = np.where(moved, np.maximum(DOUBTFUL_M**2 - np.square(sigma), 0.0), 0.0)
        covariance = covariance.copy()
        covariance[..., _DIAGONAL] += missing[..., None]
        sigma = np.where(moved, mean_sigma(covariance), sigma)
    return replace(again, flags=flags, joint_covariance=covariance, joint_sigma=sigma)
