"""Blobs of several markers taken apart: a disc of known radius has a known variance, and what exceeds it are two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.sensors.acquisition.blobs import Blobs, Shapes, shapes_of
from solver_backend.sensors.acquisition.ring import Ring
from solver_backend.sensors.acquisition.settings import DEFAULT, AcquisitionSettings

_STEPS = 6
"""Steps of k-means."""


def split_merged(
    blobs: Blobs, shapes: Shapes, ring: Ring, radius_px: np.ndarray, settings: AcquisitionSettings = DEFAULT
) -> tuple[Blobs, Ring, np.ndarray]:
    """Return blobs and rings with merged ones taken apart, and (N',) which are parts.

    A disc of radius R has the variance ``R²/4`` along any axis; two whose middles are s apart have ``R²/4 + s²/4``
    along the line between them. So a blob is several where its longer variance exceeds ``merged`` times a disc's:
    as many as its area holds and, until every part is as round as a disc, up to ``most_in_blob``; at first its
    pixels that are farthest apart (Gonzalez 1985), then moved by k-means (Lloyd 1982).

    Args:
        blobs: N blobs.
        shapes: their moments.
        ring: their rings.
        radius_px: (N,) radius that a single marker's blob has, NaN where its depth is unknown.
        settings: the constants.
    """
    limit = settings.merged * 0.25 * radius_px**2 + settings.merged_px2
    with np.errstate(invalid="ignore"):
        merged = np.flatnonzero(shapes.long > limit)
    owner, ring_owner, count = blobs.owner.copy(), ring.owner.copy(), blobs.count
    parts = np.zeros(count + (settings.most_in_blob - 1) * len(merged), dtype=bool)
    for blob in merged.tolist():
        fits = round(float(shapes.area[blob] / (np.pi * radius_px[blob] ** 2)))
        mine = np.flatnonzero(blobs.owner == blob)
        alone = Blobs(blobs.pixel[mine], np.zeros(len(mine), np.int64), blobs.weight[mine], 1, blobs.width)
        centres, nearest = _round_parts(alone, shapes.middle[blob], fits, float(limit[blob]), settings)
        number = len(centres)
        names = np.concatenate([[blob], np.arange(count, count + number - 1)])
        count += number - 1
        owner[mine] = names[nearest]
        of_ring = np.flatnonzero(ring.owner == blob)
        ring_owner[of_ring] = names[_nearest(_xy(ring.pixel[of_ring], blobs.width), centres)]
        parts[names] = True
    return replace(blobs, owner=owner, count=count), replace(ring, owner=ring_owner), parts[:count]


def _round_parts(
    blob: Blobs, middle: np.ndarray, fits: int, limit: float, settings: AcquisitionSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return middles and pixels' parts, as ``_parted``, of the fewest parts that vary by ``limit`` px² at most."""
    xy = _xy(blob.pixel, blob.width)
    number = min(max(fits, 2), settings.most_in_blob)
    while True:
        centres, nearest = _parted(xy, middle, number)
        parts = replace(blob, owner=nearest, count=number)
        if number == settings.most_in_blob or shapes_of(parts).long.max() <= limit:
            return centres, nearest
        number += 1


def _parted(xy: np.ndarray, middle: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (number, 2) middles of a blob's parts and (P,) which part each pixel is of."""
    centres = _far_apart(xy, middle, number)
    nearest = np.zeros(len(xy), np.int64)
    for step in range(_STEPS):
        before, nearest = nearest, _nearest(xy, centres)
        if step and np.array_equal(before, nearest):
            break
        size = np.bincount(nearest, minlength=number)[:, None]
        sums = np.stack([np.bincount(nearest, xy[:, i], minlength=number) for i in (0, 1)], axis=1)
        centres = np.where(size > 0, sums / np.maximum(size, 1), centres)
    return centres, nearest


def _far_apart(xy: np.ndarray, middle: np.ndarray, number: int) -> np.ndarray:
    """Return the pixel farthest from the middle, then again and again the one farthest from those chosen."""
    far = ((xy - middle) ** 2).sum(1)
    chosen = [int(far.argmax())]
    apart = np.full(len(xy), np.inf)
    while len(chosen) < number:
        apart = np.minimum(apart, ((xy - xy[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(apart.argmax()))
    return xy[chosen]


def _xy(pixel: np.ndarray, width: int) -> np.ndarray:
    y, x = np.divmod(pixel, width)
    return np.stack([x, y], axis=1).astype(np.float64)


def _nearest(xy: np.ndarray, centres: np.ndarray) -> np.ndarray:
    return ((xy[:, None] - centres) ** 2).sum(-1).argmin(1)
