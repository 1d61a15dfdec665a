"""Which pixels are bright: a threshold that follows the picture, and a mask of what is bright with nobody there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from solver_backend.sensors.acquisition.settings import DEFAULT, AcquisitionSettings


def full_counts(infrared: np.ndarray, settings: AcquisitionSettings = DEFAULT) -> float:
    """Return the counts at which a picture saturates."""
    return float(settings.full if settings.full is not None else np.iinfo(infrared.dtype).max)


def threshold_of(infrared: np.ndarray, settings: AcquisitionSettings = DEFAULT) -> float:
    """Return the counts above which a pixel is bright: ``contrast`` times the background, within limits.

    Args:
        infrared: (h, w) uint8 or uint16.
        settings: the constants.
    """
    full, step = full_counts(infrared, settings), settings.sample_step
    sample = infrared[step // 2 :: step, step // 2 :: step].ravel()
    rank = int(settings.background_quantile * (len(sample) - 1))
    background = float(np.partition(sample, rank)[rank])
    return min(max(settings.contrast * background, settings.least_threshold * full), settings.most_threshold * full)


def learned_mask(pictures: Iterable[np.ndarray], settings: AcquisitionSettings = DEFAULT) -> np.ndarray:
    """Return (h, w) bool: what is bright in a scene without markers (lamps, other sensors), grown a little.

    Args:
        pictures: (h, w) infrared pictures of the empty scene; the brightest value of each pixel counts.
        settings: the constants.

    Raises:
        ValueError: there is no picture.
    """
    brightest: np.ndarray | None = None
    for picture in pictures:
        brightest = picture.copy() if brightest is None else np.maximum(brightest, picture)
    if brightest is None:
        raise ValueError("The empty scene has no picture.")
    bright = brightest > settings.mask_contrast * threshold_of(brightest, settings)
    for _ in range(settings.mask_grow_px):
        grown = bright.copy()
        grown[1:] |= bright[:-1]
        grown[:-1] |= bright[1:]
        wide = grown.copy()
        wide[:, 1:] |= grown[:, :-1]
        wide[:, :-1] |= grown[:, 1:]
        bright = wide
    return bright
