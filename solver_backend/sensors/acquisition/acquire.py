"""Locate the markers in one frame from a sensor, with covariances (thesis 5.3.2)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.sensors.acquisition.blobs import (
    SETTINGS,
    Blobs,
    Shapes,
    find_blobs,
    full_counts,
    shapes_of,
    threshold_of,
)
from solver_backend.sensors.devices.device import PicturesDiffer, SensorFrame, SensorUnknown
from solver_backend.types import Cameras

GROUP_M = 128.0  # A length in metres that exceeds any 16-bit depth in millimetres (65.5 m).
NORMAL_MAD = 1.4826  # Ratio between the standard deviation and the median absolute deviation of a normal distribution.


@dataclass(frozen=True)
class Ring:
    """R pixels in rings around the marker blobs. They provide depths, because the blobs' saturated pixels have none."""

    pixel: np.ndarray  # (R,) flat pixel indices.
    owner: np.ndarray  # (R,) index of the blob that each pixel belongs to.
    depth: np.ndarray  # (R,) depths in metres.


@dataclass(frozen=True)
class RingDepths:
    """Depths of the N marker blobs, measured on the rings around them."""

    depth: np.ndarray  # (N,) depth in metres along the axis, NaN if too few pixels provide one.
    count: np.ndarray  # (N,) number of depths that agree.
    spread: np.ndarray  # (N,) standard deviation in metres, from the median absolute deviation.
    rough: np.ndarray  # (N,) median depth of the ring in metres. It sets a blob's size even if the depths disagree.


def ring_of(blobs: Blobs, depth_mm: np.ndarray, saturated: np.ndarray, scratch: np.ndarray) -> Ring:
    """Find the pixels around each blob that have a depth, up to ``ring_px`` from the blob's blind patch.

    The blind patch consists of the blob's saturated pixels (mask (P,)), or of its pixels without depth if none is
    saturated. A pixel near two blobs belongs to the nearer one. ``depth_mm`` is (h, w) uint16, 0 where unknown.
    ``scratch`` (h * w,) int32 may have any content. It avoids an allocation per frame.
    """
    flat, (height, width) = depth_mm.reshape(-1), depth_mm.shape
    core = saturated
    # Without saturated pixels, those without depth are blind. A dim blob can have depths inside.
    for other in (flat[blobs.pixel] == 0, np.ones(len(core), dtype=bool)):
        without = np.bincount(blobs.owner, core, minlength=blobs.count) == 0
        core = core | (other & without[blobs.owner])
    blind, blob = blobs.pixel[core], blobs.owner[core]
    dy, dx = _far_first(SETTINGS.ring_px)
    around = (blind + (dy * width + dx)).ravel()
    y, x = np.divmod(blind, width)
    reach = SETTINGS.ring_px
    if len(y) and not (y[0] >= reach and y[-1] < height - reach and x.min() >= reach and x.max() < width - reach):
        inside = ((y + dy >= 0) & (y + dy < height) & (x + dx >= 0) & (x + dx < width)).ravel()
        valid = np.flatnonzero(inside & (flat.take(around, mode="clip") > 0))
    else:
        valid = np.flatnonzero(flat[around])
    pixel, owner = around[valid], blob[valid % max(len(blob), 1)]
    # The index written last remains. It belongs to the nearest blob.
    order = np.arange(len(pixel), dtype=np.int32)
    scratch[pixel] = order
    once = scratch[pixel] == order
    pixel, owner = pixel[once], owner[once]
    return Ring(pixel, owner, flat[pixel] * 1e-3)


@cache
def _far_first(reach: int) -> tuple[np.ndarray, np.ndarray]:
    steps = np.arange(-reach, reach + 1)
    dy, dx = (g.ravel() for g in np.meshgrid(steps, steps, indexing="ij"))
    order = np.argsort(dx * dx + dy * dy, kind="stable")[::-1]
    return dy[order, None], dx[order, None]


def ring_depths(ring: Ring, count: int) -> RingDepths:
    """Compute the depth of each of ``count`` blobs as the mean of its ring without outliers.

    Outliers are depths far from the median. If part of a ring is on another surface, such as an arm in front or the
    room behind, the centre of the shortest interval with half of the depths replaces the median. If part of the ring is
    behind the mean, the mean is the depth of an occluder, and the blob gets no depth.

    Reference: Leys et al. 2013, "Detecting outliers: Do not use standard deviation around the mean, use absolute
    deviation around the median".
    """
    sizes = np.bincount(ring.owner, minlength=count)
    owner = np.repeat(np.arange(count), sizes)
    depth = _sorted_in_groups(ring.depth, ring.owner)
    middle = sorted_medians(depth, sizes)
    spread = _spread(depth, owner, middle, sizes)
    two = spread > SETTINGS.two_depths_m
    if two.any():
        middle[two] = _closest_half(depth[two[owner]], sizes[two])
        chosen = np.abs(depth - middle[owner]) <= SETTINGS.two_depths_m
        of_chosen = np.bincount(owner[chosen], minlength=count)
        narrow = _spread(depth[chosen], owner[chosen], middle, of_chosen)
        # The part of the ring that is used must be the larger one.
        spread = np.where(two, np.where(of_chosen * 2 > sizes, narrow, np.inf), spread)
    with np.errstate(invalid="ignore"):
        good = np.abs(depth - middle[owner]) <= SETTINGS.mad_limit * spread[owner]
    kept = np.bincount(owner[good], minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(owner[good], depth[good], minlength=count) / kept
        behind = np.bincount(owner[depth > mean[owner] + SETTINGS.behind_m], minlength=count)
    known = (kept >= SETTINGS.least_ring) & (spread <= SETTINGS.most_spread_m)
    known &= behind <= SETTINGS.most_behind * sizes
    return RingDepths(np.where(known, mean, np.nan), kept, spread, middle)


def _spread(depth: np.ndarray, owner: np.ndarray, middle: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    off = np.abs(depth - middle[owner])
    return np.maximum(NORMAL_MAD * sorted_medians(_sorted_in_groups(off, owner), sizes), SETTINGS.mad_floor_m)


def _sorted_in_groups(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Sort (R,) values between 0 and ``GROUP_M`` by group and value, with a single key for speed."""
    return values[np.argsort(GROUP_M * group + values)]


def _closest_half(depth: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the centre of the shortest interval with half of each group's values (Rousseeuw 1984).

    ``depth`` is sorted by group and value. ``sizes`` are the (N,) positive group sizes.
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
    """Return the median of each group, or NaN if it is empty. Values are sorted by group and value."""
    if not len(values):
        return np.full(len(sizes), np.nan)
    first, last = np.cumsum(sizes) - sizes, len(values) - 1
    low, high = np.minimum(first + (sizes - 1) // 2, last), np.minimum(first + sizes // 2, last)
    return np.where(sizes > 0, 0.5 * (values[low] + values[high]), np.nan)


class SensorLens:
    """A calibrated sensor with a lookup table of its undistorted pixels."""

    def __init__(self, cameras: Cameras, index: int) -> None:
        one = cameras.subset([index])
        self.name = one.names[0]
        self.size = (int(one.image_size[0, 0]), int(one.image_size[0, 1]))
        self.R, self.t = one.R[0], one.t[0]
        self.centre = one.centres[0]
        self.focal = np.array([one.K[0, 0, 0], one.K[0, 1, 1]])
        self._table = _undistorted_pixels(one.K.tobytes(), one.distortion.tobytes(), self.size, one.models[0])

    def undistorted(self, px: np.ndarray) -> np.ndarray:
        """Undistort (N, 2) pixels to x/z and y/z by interpolation in the table. Pixels outside the image give NaN."""
        width, height = self.size
        at = px + 1.0
        with np.errstate(invalid="ignore"):
            inside = (at >= 0.0).all(1) & (at <= np.array([width + 1.0, height + 1.0])).all(1)
        at = np.where(inside[:, None], at, 0.0)
        corner = np.minimum(at.astype(np.int64), np.array([width, height]))
        x, y = corner.T
        a, b = (at - corner).T[..., None]
        rows = self._table
        low, high = ((1 - a) * rows[y + k, x] + a * rows[y + k, x + 1] for k in (0, 1))
        return np.where(inside[:, None], (1 - b) * low + b * high, np.nan)

    def directions(self, flat: np.ndarray) -> np.ndarray:
        """Convert undistorted coordinates (N, 2) to (N, 3) unit directions in the world."""
        ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return (ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ self.R

    def points(self, flat: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Convert undistorted coordinates (N, 2) and depths (N,) in metres to (N, 3) world points."""
        ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return (ray * depth[:, None] - self.t) @ self.R

    def covariances(
        self, flat: np.ndarray, depth: np.ndarray, sigma_px: np.ndarray, sigma_depth: np.ndarray
    ) -> np.ndarray:
        """Return the (N, 3, 3) world covariances in m² of points ``p = z (x, y, 1)``."""
        J = np.zeros((len(depth), 3, 3))
        J[:, 0, 0] = depth / self.focal[0] * sigma_px
        J[:, 1, 1] = depth / self.focal[1] * sigma_px
        J[:, :2, 2] = flat * sigma_depth[:, None]
        J[:, 2, 2] = sigma_depth
        turned = self.R.T @ J
        return turned @ np.swapaxes(turned, 1, 2)


@lru_cache(maxsize=8)
def _undistorted_pixels(K: bytes, distortion: bytes, size: tuple[int, int], model: str) -> np.ndarray:
    """Return a lens's read-only lookup table (h + 2, w + 2, 2). It includes one pixel beyond each edge of the image."""
    width, height = size
    u, v = np.meshgrid(np.arange(-1.0, width + 1.0), np.arange(-1.0, height + 1.0))
    lens = Lens(np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion), size, model)
    table = undistort(lens.as_camera(), np.stack([u, v], axis=-1)[None])[0]
    table.flags.writeable = False
    return table


_STEPS = 6  # Number of k-means iterations. Chosen by hand.


def split_merged(blobs: Blobs, shapes: Shapes, ring: Ring, radius_px: np.ndarray) -> tuple[Blobs, Ring, np.ndarray]:
    """Split blobs that consist of several markers, together with their rings.

    A disc of radius R has a variance of ``R²/4`` along any axis. Two discs a distance s apart have ``R²/4 + s²/4``
    along the line between them. A blob is split if its variance exceeds a disc's by the factor ``merged``. The number
    of parts is at first the ratio of its area to a marker's area. It increases until all parts are round, up to a
    limit. The parts are seeded with the pixels furthest apart (Gonzalez 1985) and refined by k-means (Lloyd 1982).

    Args:
        radius_px: (N,) radius of a single marker's blob, or NaN where its depth is unknown.

    Returns:
        The N' blobs, their rings, and the (N',) mask of the parts of split blobs.
    """
    limit = SETTINGS.merged * 0.25 * radius_px**2 + SETTINGS.merged_px2
    with np.errstate(invalid="ignore"):
        merged = np.flatnonzero(shapes.long > limit)
    owner, ring_owner, count = blobs.owner.copy(), ring.owner.copy(), blobs.count
    parts = np.zeros(count + (SETTINGS.most_in_blob - 1) * len(merged), dtype=bool)
    for blob in merged.tolist():
        fits = round(float(shapes.area[blob] / (np.pi * radius_px[blob] ** 2)))
        mine = np.flatnonzero(blobs.owner == blob)
        alone = Blobs(blobs.pixel[mine], np.zeros(len(mine), np.int64), blobs.weight[mine], 1, blobs.width)
        centres, nearest = _round_parts(alone, shapes.middle[blob], fits, float(limit[blob]))
        number = len(centres)
        names = np.concatenate([[blob], np.arange(count, count + number - 1)])
        count += number - 1
        owner[mine] = names[nearest]
        of_ring = np.flatnonzero(ring.owner == blob)
        ring_owner[of_ring] = names[_nearest(_xy(ring.pixel[of_ring], blobs.width), centres)]
        parts[names] = True
    return replace(blobs, owner=owner, count=count), replace(ring, owner=ring_owner), parts[:count]


def _round_parts(blob: Blobs, middle: np.ndarray, fits: int, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Split a blob into parts with a variance of at most ``limit`` px². Return centres and each pixel's part."""
    xy = _xy(blob.pixel, blob.width)
    number = min(max(fits, 2), SETTINGS.most_in_blob)
    while True:
        centres, nearest = _parted(xy, middle, number)
        parts = replace(blob, owner=nearest, count=number)
        if number == SETTINGS.most_in_blob or shapes_of(parts).long.max() <= limit:
            return centres, nearest
        number += 1


def _parted(xy: np.ndarray, middle: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    chosen = [int(((xy - middle) ** 2).sum(1).argmax())]
    apart = np.full(len(xy), np.inf)
    while len(chosen) < number:
        apart = np.minimum(apart, ((xy - xy[chosen[-1]]) ** 2).sum(1))
        chosen.append(int(apart.argmax()))
    centres, nearest = xy[chosen], np.zeros(len(xy), np.int64)
    for step in range(_STEPS):
        before, nearest = nearest, _nearest(xy, centres)
        if step and np.array_equal(before, nearest):
            break
        size = np.bincount(nearest, minlength=number)[:, None]
        sums = np.stack([np.bincount(nearest, xy[:, i], minlength=number) for i in (0, 1)], axis=1)
        centres = np.where(size > 0, sums / np.maximum(size, 1), centres)
    return centres, nearest


def _xy(pixel: np.ndarray, width: int) -> np.ndarray:
    y, x = np.divmod(pixel, width)
    return np.stack([x, y], axis=1).astype(np.float64)


def _nearest(xy: np.ndarray, centres: np.ndarray) -> np.ndarray:
    return ((xy[:, None] - centres) ** 2).sum(-1).argmin(1)


@dataclass(frozen=True)
class SensorSightings:
    """N markers that one sensor saw in one frame."""

    sensor: int
    time: float
    px: np.ndarray  # (N, 2) centres in pixels.
    depth: np.ndarray  # (N,) depths of the centres along the axis in metres, NaN where unknown.
    points: np.ndarray  # (N, 3) world points in metres, NaN where the depth is unknown.
    covariance: np.ndarray  # (N, 3, 3) covariances in m², NaN where the depth is unknown.
    origin: np.ndarray  # (3,) position of the sensor.
    direction: np.ndarray  # (N, 3) unit directions of the rays in the world.
    sigma_ray: np.ndarray  # (N,) standard deviation perpendicular to each ray in radians.
    finding: str = ""  # Code of a problem in the frame, or "".
    number: int = 0
    host_s: float = field(default=0.0, compare=False)

    def __len__(self) -> int:
        return len(self.px)


SUNLIGHT = "sensor_sunlight"  # Code for a frame without markers because of sunlight, a window or a lamp.
_MOST_PIXELS = 1e7  # Maximum number of image pixels, ten times an Azure Kinect's. The lens table then takes 1 GB.
MEDIAN_LOSS = 1.25
"""Ratio between the standard deviations of a median and a mean. A ring's mean near its median is at least as good."""


class Acquisition:
    """Finds markers in the frames of one sensor. Constant lights in ``mask`` are ignored.

    Raises:
        SensorUnknown: the calibration does not contain the sensor.
        CalibrationInvalid: the images have more pixels than any known sensor's.
    """

    def __init__(self, cameras: Cameras, sensor: str, mask: np.ndarray | None = None) -> None:
        if sensor not in cameras.names:
            hint = f"The calibration has {', '.join(cameras.names)}. Rename the sensor, or calibrate again."
            raise SensorUnknown(f"The calibration does not name the sensor '{sensor}'.", where=sensor, hint=hint)
        self.index = cameras.names.index(sensor)
        width, height = cameras.image_size[self.index].tolist()
        if width * height > _MOST_PIXELS:
            message = f"The calibration gives the sensor images of {width:.0f} x {height:.0f} pixels."
            hint = f"At most {_MOST_PIXELS / 1e6:.0f} million pixels are possible. Calibrate again."
            raise CalibrationInvalid(message, where=sensor, hint=hint)
        self.lens = SensorLens(cameras, self.index)
        self._mask, self._halo = mask, SETTINGS.halo_px
        self._beyond: deque[float] = deque(maxlen=SETTINGS.round_kept)
        width, height = self.lens.size
        if mask is not None and mask.shape != (height, width):
            message = f"The mask has {mask.shape[1]} x {mask.shape[0]} pixels, but the sensor has {width} x {height}."
            hint = "Film the empty scene again in the mode of the recording."
            raise PicturesDiffer(message, where=sensor, hint=hint)
        self._scratch = np.zeros(width * height, np.int32)

    def __call__(self, frame: SensorFrame) -> SensorSightings:
        """Find the markers in a frame."""
        self._require_size(frame)
        blobs = find_blobs(frame.infrared, threshold_of(frame.infrared), self._mask)
        if blobs is None or not blobs.count:
            none, finding = np.zeros((0, 3)), SUNLIGHT if blobs is None else ""
            empty = np.zeros((0, 2)), np.zeros(0), none, np.zeros((0, 3, 3)), self.lens.centre, none, np.zeros(0)
            return SensorSightings(self.index, frame.device_s, *empty, finding, frame.number, frame.host_s)
        shapes, rings, parts = self._measured(frame, blobs)
        return self._lifted(frame, shapes, rings, parts)

    def _require_size(self, frame: SensorFrame) -> None:
        width, height = self.lens.size
        sizes = {"infrared": frame.infrared.shape, "calibration": (height, width)}
        if frame.depth is not None:
            sizes["depth"] = frame.depth.shape
        if len(set(sizes.values())) > 1:
            message = ", ".join(f"{what} {' x '.join(str(n) for n in shape[::-1])}" for what, shape in sizes.items())
            message = f"The images of a sensor have different sizes: {message}."
            hint = "Record aligned infrared and depth in one mode, and calibrate in the same mode."
            raise PicturesDiffer(message, where=frame.sensor, hint=hint)
        depth_type = np.uint16 if frame.depth is None else frame.depth.dtype
        if frame.infrared.dtype not in (np.uint8, np.uint16) or depth_type != np.uint16:
            message = f"Infrared is {frame.infrared.dtype}. Use 8 or 16 bits, and 16 for depth."
            raise PicturesDiffer(message, where=frame.sensor, hint="Record whole millimetres and counts.")

    def _measured(self, frame: SensorFrame, blobs: Blobs) -> tuple[Shapes, RingDepths, np.ndarray]:
        shapes = shapes_of(blobs)
        if frame.depth is None:
            nothing = np.full(blobs.count, np.nan)
            unknown = RingDepths(nothing, np.zeros(blobs.count), nothing, nothing)
            return shapes, unknown, np.zeros(blobs.count, dtype=bool)
        counts = frame.infrared.reshape(-1)[blobs.pixel]
        saturated = counts >= SETTINGS.saturated * full_counts(frame.infrared)
        ring = ring_of(blobs, frame.depth, saturated, self._scratch)
        rings = ring_depths(ring, blobs.count)
        self._learn_halo(shapes, rings.depth)
        blobs, ring, parts = split_merged(blobs, shapes, ring, self._blob_radius(rings.rough))
        if parts.any():
            changed = parts[ring.owner]
            of_parts = Ring(ring.pixel[changed], ring.owner[changed], ring.depth[changed])
            shapes, whole = shapes_of(blobs), rings
            rings, rest = ring_depths(of_parts, blobs.count), np.flatnonzero(~parts[: len(whole.depth)])
            for name in ("depth", "count", "spread", "rough"):
                getattr(rings, name)[rest] = getattr(whole, name)[rest]
        # If most blobs have saturated pixels, a blob without any is a fragment, and its ring belongs to another blob.
        blind = np.bincount(blobs.owner, saturated, minlength=blobs.count) > 0
        sliver = ~blind & (2 * blind.sum() > blobs.count)
        return shapes, replace(rings, depth=np.where(sliver, np.nan, rings.depth)), parts

    def _learn_halo(self, shapes: Shapes, depth: np.ndarray) -> None:
        disc = np.sqrt(shapes.area / np.pi)
        known = (shapes.long < SETTINGS.round * shapes.area / (4.0 * np.pi)) & np.isfinite(depth)
        self._beyond.extend((disc - self.lens.focal.mean() * SETTINGS.marker_radius_m / depth)[known].tolist())
        if self._beyond:
            self._halo = max(float(np.median(self._beyond)), 0.0)

    def _blob_radius(self, depth: np.ndarray) -> np.ndarray:
        """Return the radius in pixels of a single marker's blob at each depth in metres."""
        return self.lens.focal.mean() * SETTINGS.marker_radius_m / depth + self._halo

    def _lifted(self, frame: SensorFrame, shapes: Shapes, rings: RingDepths, parts: np.ndarray) -> SensorSightings:
        lens = self.lens
        flat = lens.undistorted(shapes.centre)
        length = np.sqrt(1.0 + (flat**2).sum(1))
        depth = rings.depth + SETTINGS.surface_radii * SETTINGS.marker_radius_m / length
        radius = self._blob_radius(rings.rough)
        with np.errstate(invalid="ignore"):
            share = shapes.area / (np.pi * radius**2)
            near, far = SETTINGS.range_m
            believed = (depth >= near) & (depth <= far) & (share >= SETTINGS.least_share)
            depth = np.where(believed, depth, np.nan)
            odd = (share > SETTINGS.too_large) | (share < SETTINGS.too_small)
        keep = ~odd & np.isfinite(flat).all(1)
        hidden = np.nan_to_num(np.clip(1.0 - share, 0.0, 1.0), nan=0.0)
        sigma_px = SETTINGS.sigma_px + SETTINGS.split_sigma_px * parts
        sigma_px = sigma_px + SETTINGS.hidden_sigma * hidden * np.nan_to_num(radius, nan=0.0)
        pixel = MEDIAN_LOSS * np.maximum(SETTINGS.ring_noise * SETTINGS.depth_sigma(rings.depth), rings.spread)
        with np.errstate(invalid="ignore", divide="ignore"):
            sigma_depth = np.hypot(pixel / np.sqrt(rings.count), SETTINGS.depth_floor_m)
        flat, depth, sigma_px, sigma_depth = flat[keep], depth[keep], sigma_px[keep], sigma_depth[keep]
        measured = lens.points(flat, depth), lens.covariances(flat, depth, sigma_px, sigma_depth)
        rays = lens.centre, lens.directions(flat), sigma_px / lens.focal.mean()
        place = shapes.centre[keep], depth
        times = {"number": frame.number, "host_s": frame.host_s}
        return SensorSightings(self.index, frame.device_s, *place, *measured, *rays, **times)
