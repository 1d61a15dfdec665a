"""The ring of valid depth around a blind patch: its pixels, and the depth that they agree on.

A retro-reflector saturates the pixels that see it, which then have no depth; light that spills from it gives the
pixels around the sphere's depth (thesis 5.3.2). The paper's appendix K takes their mean after rejecting outliers by
the median absolute deviation; so is it here, about the median.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from solver_backend.sensors.acquisition.blobs import Blobs
from solver_backend.sensors.acquisition.settings import DEFAULT, AcquisitionSettings

GROUP_M = 128.0
"""More than any depth of 16 bits in millimetres."""
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
    """(N,) metres, the ring's middle even where it agrees on nothing; gives a blob's size, no marker's place."""

    def with_parts(self, other: RingDepths, parts: np.ndarray) -> RingDepths:
        """Return these with the other's for the (N',) blobs that are parts, N' >= N."""
        size = len(self.depth)
        names = ("depth", "count", "spread", "rough")
        found = {name: getattr(other, name).copy() for name in names}
        for name in names:
            found[name][:size] = np.where(parts[:size], found[name][:size], getattr(self, name))
        return RingDepths(**found)

    def without(self, slivers: np.ndarray) -> RingDepths:
        """Return these with no depth for the (N,) blobs whose rings are not theirs."""
        return replace(self, depth=np.where(slivers, np.nan, self.depth))


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
    blind, blob = blobs.pixel[core], blobs.owner[core]
    dy, dx = _far_first(settings.ring_px)
    around = (blind + (dy * width + dx)).ravel()
    y, x = np.divmod(blind, width)
    reach = settings.ring_px
    if len(y) and not (y[0] >= reach and y[-1] < height - reach and x.min() >= reach and x.max() < width - reach):
        inside = ((y + dy >= 0) & (y + dy < height) & (x + dx >= 0) & (x + dx < width)).ravel()
        valid = np.flatnonzero(inside & (flat.take(around, mode="clip") > 0))
    else:
        valid = np.flatnonzero(flat[around])
    pixel, owner = around[valid], blob[valid % max(len(blob), 1)]
    # Of several that want a pixel, the last written has it: the nearest.
    order = np.arange(len(pixel), dtype=np.int32)
    scratch[pixel] = order
    once = scratch[pixel] == order
    pixel, owner = pixel[once], owner[once]
    return Ring(pixel, owner, flat[pixel] * 1e-3)


@cache
def _far_first(reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 1) rows and columns from a pixel to those around it, the farthest first."""
    steps = np.arange(-reach, reach + 1)
    dy, dx = (g.ravel() for g in np.meshgrid(steps, steps, indexing="ij"))
    order = np.argsort(dx * dx + dy * dy, kind="stable")[::-1]
    return dy[order, None], dx[order, None]


def slivers_of(blobs: Blobs, saturated: np.ndarray) -> np.ndarray:
    """Return which (N,) blobs blind no pixel, where most do: slivers of markers, whose light makes no ring.

    A sensor whose markers do not saturate has their depths in the blobs themselves.

    Args:
        blobs: N blobs.
        saturated: (P,) whether a pixel of a blob is saturated.
    """
    blind = np.bincount(blobs.owner, saturated, minlength=blobs.count) > 0
    return ~blind & (2 * blind.sum() > blobs.count)


def ring_depths(ring: Ring, count: int, settings: AcquisitionSettings = DEFAULT) -> RingDepths:
    """Return the depth each of ``count`` rings agrees on: the mean within ``mad_limit`` spreads of its median.

    A ring of which a part lies on another surface (an arm before the marker, the room behind it) has no use for its
    median; there the closest half of its depths counts. A marker's light covers what lies behind it: a ring of which a
    part lies behind the depth it agrees on is its occluder's, and the marker, somewhere behind, has no depth.

    Reference: Leys et al. 2013, "Detecting outliers: Do not use standard deviation around the mean, use absolute
    deviation around the median".
    """
    sizes = np.bincount(ring.owner, minlength=count)
    owner = np.repeat(np.arange(count), sizes)
    depth = _sorted_in_groups(ring.depth, ring.owner)
    middle = sorted_medians(depth, sizes)
    spread = _spread(depth, owner, middle, sizes, settings)
    two = spread > settings.two_depths_m
    if two.any():
        middle[two] = _closest_half(depth[two[owner]], sizes[two])
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
        behind = np.bincount(owner[depth > mean[owner] + settings.behind_m], minlength=count)
    known = (kept >= settings.least_ring) & (spread <= settings.most_spread_m)
    known &= behind <= settings.most_behind * sizes
    return RingDepths(np.where(known, mean, np.nan), kept, spread, middle)


def _spread(
    depth: np.ndarray, owner: np.ndarray, middle: np.ndarray, sizes: np.ndarray, settings: AcquisitionSettings
) -> np.ndarray:
    """Return each ring's standard deviation by the median absolute deviation from its middle, at least a floor."""
    off = np.abs(depth - middle[owner])
    return np.maximum(NORMAL_MAD * sorted_medians(_sorted_in_groups(off, owner), sizes), settings.mad_floor_m)


def _sorted_in_groups(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return (R,) values, 0 to ``GROUP_M``, by rising group and rising in each: one sort, faster than by two keys."""
    return values[np.argsort(GROUP_M * group + values)]


def _closest_half(depth: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the middle of the shortest interval that holds half of each group's sorted values (Rousseeuw 1984).

    Args:
        depth: (R,) ordered by group, and rising within each.
        sizes: (N,) values of each group, 1 or more.
    """
    ends = np.cumsum(sizes)
    owner = np.repeat(np.arange(len(sizes)), sizes)
    last = np.arange(len(depth)) + ((sizes + 1) // 2)[owner] - 1
    inside = last < ends[owner]
    last = np.minimum(last, len(depth) - 1)
    width = np.where(inside, depth[last] - depth, np.inf)
    shortest = np.flatnonzero(width == np.minimum.reduceat(width, ends - sizes)[owner])
    first = shortest[np.diff(owner[shortest], prepend=-1) > 0]
    return 0.5 * (depth[first] + depth[last[first]])


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
