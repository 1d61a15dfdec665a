"""Bright blobs of an infrared picture: their pixels, sub-pixel centroids and shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.sensors.acquisition.components import connected
from solver_backend.sensors.acquisition.settings import DEFAULT, AcquisitionSettings


@dataclass(frozen=True)
class Blobs:
    """N blobs of P pixels."""

    pixel: np.ndarray
    """(P,) flat indices."""
    owner: np.ndarray
    """(P,) which blob."""
    weight: np.ndarray
    """(P,) counts above the threshold."""
    count: int
    """N."""
    width: int
    """Of the picture."""


@dataclass(frozen=True)
class Shapes:
    """Moments of N blobs."""

    centre: np.ndarray
    """(N, 2) px, weighted by what exceeds the threshold."""
    area: np.ndarray
    """(N,) pixels."""
    middle: np.ndarray
    """(N, 2) px, every pixel counting the same."""
    long: np.ndarray
    """(N,) px², variance along the longer axis."""
    axis: np.ndarray
    """(N, 2) unit vector of it."""


def find_blobs(
    infrared: np.ndarray, threshold: float, mask: np.ndarray | None, settings: AcquisitionSettings = DEFAULT
) -> Blobs | None:
    """Return the blobs of a picture, None where too much of it is bright (sunlight).

    Args:
        infrared: (h, w) counts.
        threshold: counts above which a pixel is bright.
        mask: (h, w) bool of pixels that never are, or None.
        settings: the constants.
    """
    flat = infrared.reshape(-1)
    bright = flat > infrared.dtype.type(threshold)
    pixel = np.flatnonzero(bright)
    if mask is not None:
        pixel = pixel[~mask.reshape(-1)[pixel]]
    if len(pixel) > settings.most_bright * len(flat):
        return None
    owner, count = connected(pixel, infrared.shape[1])
    size = np.bincount(owner, minlength=count)
    kept = size >= settings.least_pixels
    if kept.sum() > settings.most_blobs:
        return None
    number = np.cumsum(kept) - 1
    of_kept = kept[owner]
    pixel, owner = pixel[of_kept], number[owner[of_kept]]
    return Blobs(pixel, owner, flat[pixel].astype(np.float64) - threshold, int(kept.sum()), infrared.shape[1])


def shapes_of(blobs: Blobs) -> Shapes:
    """Return the moments of blobs."""
    y, x = np.divmod(blobs.pixel, blobs.width)
    owner, count = blobs.owner, blobs.count

    def total(values: np.ndarray | None = None) -> np.ndarray:
        return np.bincount(owner, values, minlength=count)

    mass, area = np.maximum(total(blobs.weight), 1e-9), total().astype(np.float64)
    centre = np.stack([total(blobs.weight * x), total(blobs.weight * y)], axis=1) / mass[:, None]
    some = np.maximum(area, 1.0)
    middle = np.stack([total(x.astype(float)), total(y.astype(float))], axis=1) / some[:, None]
    dx, dy = x - middle[owner, 0], y - middle[owner, 1]
    # A pixel is a square of variance 1/12.
    xx, yy, xy = total(dx * dx) / some + 1 / 12, total(dy * dy) / some + 1 / 12, total(dx * dy) / some
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return Shapes(centre, area, middle, half + apart, np.stack([np.cos(angle), np.sin(angle)], axis=1))
