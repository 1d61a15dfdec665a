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
    rough: np.ndarray
    """(N,) metres, the ring's middle even where it agrees on nothing; tells a blob's size, no marker's place."""


def ring_of(
    blobs: Blobs, depth_mm: np.ndarray, saturated: np.ndarray, scratch: np.ndarray,
    settings: AcquisitionSettings = DEFAULT,
) -> Ring:  # fmt: skip
    """Return the pixels with a depth within ``ring_px`` of each blob's blind patch; of two blobs the nearer has it.

    Args:
        blobs: the blobs.
        depth_mm: (h, w) uint16, 0 where there is none.
        saturated: (P,) whether a pixel of a blob is saturated; those are blind, or without any the ones without depth.
        scratch: (h * w,) int32, any content; spares a new array for each frame.
        settings: the constants.
    """
    flat, (height, width) = depth_mm.reshape(-1), depth_mm.shape
    core = saturated
    # What does not saturate is blind where it has no depth; a blob that is dim all over has its depth in itself.
    for other in (flat[blobs.pixel] == 0, np.ones(len(core), dtype=bool)):
        without = np.bincount(blobs.owner, core, minlength=blobs.count) == 0
        core = core | (other & without[blobs.owner])
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

    A ring of which a part lies on another surface (an arm before the marker, the room behind it) has no use for its
    median; there the closest half of its depths counts.

    Reference: Leys et al. 2013, "Detecting outliers: Do not use standard deviation around the mean, use absolute
    deviation around the median".
    """
    sizes = np.bincount(ring.owner, minlength=count)
    ordered = np.lexsort((ring.depth, ring.owner))
    owner, depth = ring.owner[ordered], ring.depth[ordered]
    middle = sorted_medians(depth, sizes)
    spread = _spread(depth, owner, middle, sizes, settings)
    two = spread > settings.two_depths_m
    if two.any():
        middle = np.where(two, _closest_half(depth, owner, sizes), middle)
        chosen = np.abs(depth - middle[owner]) <= settings.two_depths_m
        of_chosen = np.bincount(owner[chosen], minlength=count)
        narrow = _spread(depth[chosen], owner[chosen], middle, of_chosen, settings)
        # What is left of a ring on two surfaces must still be most of it.
        spread = np.where(two, np.where(of_chosen * 2 > sizes, narrow, np.inf), spread)
    with np.errstate(invalid="ignore"):
        good = np.abs(depth - middle[owner]) <= settings.mad_limit * spread[owner]
    kept = np.bincount(owner[good], minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(owner[good], depth[good], minlength=count) / kept
    known = (kept >= settings.least_ring) & (spread <= settings.most_spread_m)
    return RingDepths(np.where(known, mean, np.nan), kept, spread, middle)


def _spread(
    depth: np.ndarray, owner: np.ndarray, middle: np.ndarray, sizes: np.ndarray, settings: AcquisitionSettings
) -> np.ndarray:
    """Return each ring's standard deviation by the median absolute deviation from its middle, at least a floor."""
    off = np.abs(depth - middle[owner])
    return np.maximum(NORMAL_MAD * sorted_medians(off[np.lexsort((off, owner))], sizes), settings.mad_floor_m)


def _closest_half(depth: np.ndarray, owner: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the middle of the shortest interval that holds half of each group's sorted values (Rousseeuw 1984)."""
    half = np.maximum((sizes + 1) // 2, 1)
    last = np.arange(len(depth)) + half[owner] - 1
    inside = last < np.cumsum(sizes)[owner]
    last = np.minimum(last, len(depth) - 1)
    width = np.where(inside, depth[last] - depth, np.inf)
    best = np.lexsort((width, owner))
    found = np.full(len(sizes), np.nan)
    full = sizes > 0
    first = best[(np.cumsum(sizes) - sizes)[full]]
    found[full] = 0.5 * (depth[first] + depth[last[first]])
    return found


def sorted_medians(values: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the median of each group, NaN of an empty one.

    Args:
        values: (R,) ordered by group, and rising within each.
        sizes: (N,) values of each group.
    """
    if not len(values):
        return np.full(len(sizes), np.nan)
    first, last = np.cumsum(sizes) - sizes, len(values) - 1
    low, high = np.minimum(first + (sizes - 1) // 2, last), np.minimum(first + sizes // 2, last)
    return np.where(sizes > 0, 0.5 * (values[low] + values[high]), np.nan)
