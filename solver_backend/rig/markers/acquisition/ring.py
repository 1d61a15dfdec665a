"""The ring of valid depth around a blind patch: its pixels, and the depth that they agree on.

A retro-reflector saturates the pixels that see it, which then have no depth; light that spills from it gives the
pixels around the sphere's depth (thesis 5.3.2). The paper's appendix K takes their mean after rejecting outliers by
the median absolute deviation; so is it here, about the median.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.rig.markers.acquisition.blobs import Blobs
from solver_backend.rig.markers.acquisition.settings import DEFAULT, AcquisitionSettings

NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution by its median absolute deviation."""


@dataclass(frozen=True)
class Ring:
    """R pixels of all rings."""

    pixel: np.ndarray
    """(R,) flat indices."""
    owner: np.ndarray
    """(R,) which blob."""
    depth: np.ndarray
    """(R,) metres."""


@dataclass(frozen=True)
class RingDepths:
    """What the rings of N blobs agree on."""

    depth: np.ndarray
    """(N,) metres along the axis, NaN where too few pixels have a depth."""
    count: np.ndarray
    """(N,) depths that agree."""
    spread: np.ndarray
    """(N,) metres, standard deviation of them by their median absolute deviation."""


def ring_of(
    blobs: Blobs, depth_mm: np.ndarray, saturated: np.ndarray, scratch: np.ndarray,
    settings: AcquisitionSettings = DEFAULT,
) -> Ring:  # fmt: skip
    """Return the pixels with a depth within ``ring_px`` of each blob's blind patch; of two blobs the nearer has it.

    Args:
        blobs: the blobs.
        depth_mm: (h, w) uint16, 0 where there is none.
        saturated: (P,) whether a pixel of a blob is saturated; those and the ones without depth are blind.
        scratch: (h * w,) int32, any content; spares a new array for each frame.
        settings: the constants.
    """
    flat, (height, width) = depth_mm.reshape(-1), depth_mm.shape
    blind = saturated | (flat[blobs.pixel] == 0)
    # A blob that is dim all over has its depth in itself.
    has_patch = np.bincount(blobs.owner, blind, minlength=blobs.count) > 0
    core = blind | ~has_patch[blobs.owner]
    y, x = np.divmod(blobs.pixel[core], width)
    reach = np.arange(-settings.ring_px, settings.ring_px + 1)
    dy, dx = (g.ravel() for g in np.meshgrid(reach, reach, indexing="ij"))
    far_first = np.argsort(-(dx * dx + dy * dy), kind="stable")
    dy, dx = dy[far_first, None], dx[far_first, None]
    inside = ((y + dy >= 0) & (y + dy < height) & (x + dx >= 0) & (x + dx < width)).ravel()
    pixel = ((y + dy) * width + x + dx).ravel()[inside]
    owner = np.broadcast_to(blobs.owner[core], (len(dy), len(y))).ravel()[inside]
    valid = flat[pixel] > 0
    pixel, owner = pixel[valid], owner[valid]
    # Of several that want a pixel, the last written has it: the nearest.
    order = np.arange(len(pixel), dtype=np.int32)
    scratch[pixel] = order
    once = scratch[pixel] == order
    pixel, owner = pixel[once], owner[once]
    return Ring(pixel, owner, flat[pixel] * 1e-3)


def ring_depths(ring: Ring, count: int, settings: AcquisitionSettings = DEFAULT) -> RingDepths:
    """Return the depth each of ``count`` rings agrees on: the mean within ``mad_limit`` spreads of its median.

    Reference: Leys et al. 2013, "Detecting outliers: Do not use standard deviation around the mean, use absolute
    deviation around the median".
    """
    sizes = np.bincount(ring.owner, minlength=count)
    median = medians(ring.depth, ring.owner, sizes)
    off = np.abs(ring.depth - median[ring.owner])
    spread = np.maximum(NORMAL_MAD * medians(off, ring.owner, sizes), settings.mad_floor_m)
    good = off <= settings.mad_limit * spread[ring.owner]
    kept = np.bincount(ring.owner[good], minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(ring.owner[good], ring.depth[good], minlength=count) / kept
    return RingDepths(np.where(kept >= settings.least_ring, mean, np.nan), kept, spread)


def medians(values: np.ndarray, owner: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the median of each group, NaN of an empty one.

    Args:
        values: (R,).
        owner: (R,) group of each.
        sizes: (N,) values of each group.
    """
    if not len(values):
        return np.full(len(sizes), np.nan)
    ordered = values[np.lexsort((values, owner))]
    first = np.cumsum(sizes) - sizes
    last = len(values) - 1
    low, high = np.minimum(first + (sizes - 1) // 2, last), np.minimum(first + sizes // 2, last)
    return np.where(sizes > 0, 0.5 * (ordered[low] + ordered[high]), np.nan)
