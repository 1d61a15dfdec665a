"""Which frames deserve a look: nobody saw them, the body or a limb is far off, a joint is hardly known or at rest."""

from __future__ import annotations

import numpy as np

from solver_backend.types import FLAG_RESTING, FLAG_UNSEEN, FLAG_UNSURE

FAR, FAR_SIGMAS = 3.0, 2.0
"""A frame's median residual is far above the take's from so many times that on, and so many standard deviations."""
LOOSE, LOOSE_M = 2.0, 0.03
"""A joint is hardly known where its standard deviation is so many times its usual one in the take, and this large."""


def flagged(
    normalised: np.ndarray,
    seen: np.ndarray,
    sigma: np.ndarray | None,
    lost: np.ndarray | None = None,
    resting: np.ndarray | None = None,
) -> np.ndarray:
    """Return (F,) flags of the frames.

    Args:
        normalised: (C, F, K) residuals in standard deviations, NaN where nothing was detected.
        seen: (F,) bool, enough views see the person.
        sigma: (F, 24) standard deviation of each joint in metres, if the method knows it.
        lost: (F,) bool, a limb is far from points that are well located, see ``lost_landmarks``.
        resting: (F, 24) bool, joints that nothing informs; they are flagged as such and make no frame unsure.
    """
    flags = np.where(seen, 0, FLAG_UNSEEN).astype(np.uint8)
    unsure = _far(normalised)
    if resting is not None:
        flags[resting.any(axis=1)] |= FLAG_RESTING
    if sigma is not None:
        unsure |= _loose(sigma, resting).any(axis=1)
    if lost is not None:
        unsure |= lost
    flags[unsure] |= FLAG_UNSURE
    return flags


def _loose(sigma: np.ndarray, resting: np.ndarray | None) -> np.ndarray:
    """Return (F, J) bool: the joint is hardly known for one that is informed."""
    if resting is None:
        return sigma > np.maximum(LOOSE * np.median(sigma, axis=0), LOOSE_M)
    usual = np.full(sigma.shape[1], np.inf)
    for j in np.flatnonzero(~resting.all(axis=0)):
        usual[j] = np.median(sigma[~resting[:, j], j])
    return ~resting & (sigma > np.maximum(LOOSE * usual, LOOSE_M))


def _far(normalised: np.ndarray) -> np.ndarray:
    """Return (F,) bool: the frame's median residual is far above the take's."""
    frames = normalised.shape[1]
    ordered = np.sort(normalised.swapaxes(0, 1).reshape(frames, -1), axis=1)  # what is missing comes last
    count = np.isfinite(ordered).sum(axis=1)
    row, least = np.arange(frames), np.maximum(count, 1)
    per_frame = 0.5 * (ordered[row, (least - 1) // 2] + ordered[row, least // 2])
    measured = count > 0
    if not measured.any():
        return measured
    return measured & (per_frame > max(FAR * float(np.median(per_frame[measured])), FAR_SIGMAS))
