"""Locate the markers that one sensor sees in one frame, with covariances."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from solver_backend.sensors.acquisition.blobs import (
    DEFAULT,
    AcquisitionSettings,
    Blobs,
    Shapes,
    find_blobs,
    full_counts,
    shapes_of,
    threshold_of,
)
from solver_backend.sensors.acquisition.ring import (
    Ring,
    RingDepths,
    SensorLens,
    ring_depths,
    ring_of,
    slivers_of,
    split_merged,
)
from solver_backend.sensors.devices.device import PicturesDiffer, SensorFrame, SensorUnknown
from solver_backend.types import Cameras


@dataclass(frozen=True)
class SensorSightings:
    """N markers of one sensor at one moment."""

    sensor: int
    time: float
    px: np.ndarray
    """(N, 2) pixels of the centres."""
    depth: np.ndarray
    """(N,) metres along the axis to the centres, NaN where unknown."""
    points: np.ndarray
    """(N, 3) world metres, NaN without depth."""
    covariance: np.ndarray
    """(N, 3, 3) m², NaN without depth."""
    origin: np.ndarray
    """(3,) place of the sensor."""
    direction: np.ndarray
    """(N, 3) unit directions of the rays in the world."""
    sigma_ray: np.ndarray
    """(N,) standard deviation across the rays in radians."""
    finding: str = ""
    """Code of a problem of the frame, or an empty text."""
    number: int = 0
    host_s: float = field(default=0.0, compare=False)

    def __len__(self) -> int:
        return len(self.px)


def no_sightings(
    sensor: int, time: float, origin: np.ndarray, finding: str = "", *, number: int = 0, host_s: float = 0.0
) -> SensorSightings:
    """Return a frame without markers."""
    none = np.zeros((0, 3))
    empty = np.zeros((0, 2)), np.zeros(0), none, np.zeros((0, 3, 3)), origin, none, np.zeros(0)
    return SensorSightings(sensor, time, *empty, finding, number, host_s)


SUNLIGHT = "sensor_sunlight"
"""Code of a frame without markers because of sunlight, a window or a lamp."""
MEDIAN_LOSS = 1.25
"""Ratio of the standard deviations of a median and a mean. The ring's mean about the median is no worse."""


class Acquisition:
    """Find markers in the frames of one sensor.

    Args:
        mask: (h, w) bool of constant lights, see ``learned_mask``.

    Raises:
        SensorUnknown: the calibration has no such sensor.
    """

    def __init__(
        self, cameras: Cameras, sensor: str, mask: np.ndarray | None = None, settings: AcquisitionSettings = DEFAULT
    ) -> None:
        if sensor not in cameras.names:
            hint = f"It names {', '.join(cameras.names)}: rename the sensor, or calibrate again."
            raise SensorUnknown(f"The calibration does not name the sensor '{sensor}'.", where=sensor, hint=hint)
        self.index = cameras.names.index(sensor)
        self.lens = SensorLens(cameras, self.index)
        self.settings = settings
        self._mask, self._halo = mask, settings.halo_px
        self._beyond: deque[float] = deque(maxlen=settings.round_kept)
        width, height = self.lens.size
        if mask is not None and mask.shape != (height, width):
            message = f"The mask is {mask.shape[1]} x {mask.shape[0]} pixels, the sensor {width} x {height}."
            hint = "Film the empty scene again with the mode that is recorded in."
            raise PicturesDiffer(message, where=sensor, hint=hint)
        self._scratch = np.zeros(width * height, np.int32)

    def __call__(self, frame: SensorFrame) -> SensorSightings:
        """Return the markers of a frame."""
        self._require_size(frame)
        infrared, settings = frame.infrared, self.settings
        blobs = find_blobs(infrared, threshold_of(infrared, settings), self._mask, settings)
        if blobs is None or not blobs.count:
            found, when = "" if blobs is not None else SUNLIGHT, {"number": frame.number, "host_s": frame.host_s}
            return no_sightings(self.index, frame.device_s, self.lens.centre, found, **when)
        shapes, rings, parts = self._measured(frame, blobs)
        return self._lifted(frame, shapes, rings, parts)

    def _require_size(self, frame: SensorFrame) -> None:
        width, height = self.lens.size
        sizes = {"infrared": frame.infrared.shape, "calibration": (height, width)}
        if frame.depth is not None:
            sizes["depth"] = frame.depth.shape
        if len(set(sizes.values())) > 1:
            message = ", ".join(f"{what} {' x '.join(str(n) for n in shape[::-1])}" for what, shape in sizes.items())
            message = f"A sensor's pictures are of different sizes: {message}."
            hint = "Record infrared and depth in one mode, aligned, and calibrate in the same."
            raise PicturesDiffer(message, where=frame.sensor, hint=hint)
        depth_type = np.uint16 if frame.depth is None else frame.depth.dtype
        if frame.infrared.dtype not in (np.uint8, np.uint16) or depth_type != np.uint16:
            message = f"Infrared is {frame.infrared.dtype}; 8 or 16 bits are read, and depth of 16."
            raise PicturesDiffer(message, where=frame.sensor, hint="Record whole millimetres and counts.")

    def _measured(self, frame: SensorFrame, blobs: Blobs) -> tuple[Shapes, RingDepths, np.ndarray]:
        settings, shapes = self.settings, shapes_of(blobs)
        if frame.depth is None:
            nothing = np.full(blobs.count, np.nan)
            unknown = RingDepths(nothing, np.zeros(blobs.count), nothing, nothing)
            return shapes, unknown, np.zeros(blobs.count, dtype=bool)
        counts = frame.infrared.reshape(-1)[blobs.pixel]
        saturated = counts >= settings.saturated * full_counts(frame.infrared, settings)
        ring = ring_of(blobs, frame.depth, saturated, self._scratch, settings)
        rings = ring_depths(ring, blobs.count, settings)
        self._learn_halo(shapes, rings.depth)
        blobs, ring, parts = split_merged(blobs, shapes, ring, self._blob_radius(rings.rough), settings)
        if parts.any():
            changed = parts[ring.owner]
            of_parts = Ring(ring.pixel[changed], ring.owner[changed], ring.depth[changed])
            shapes, whole = shapes_of(blobs), rings
            rings = ring_depths(of_parts, blobs.count, settings)
            rings.take_over(whole, np.flatnonzero(~parts[: len(whole.depth)]))
        depth = np.where(slivers_of(blobs, saturated), np.nan, rings.depth)
        return shapes, replace(rings, depth=depth), parts

    def _learn_halo(self, shapes: Shapes, depth: np.ndarray) -> None:
        settings = self.settings
        disc = np.sqrt(shapes.area / np.pi)
        known = (shapes.long < settings.round * shapes.area / (4.0 * np.pi)) & np.isfinite(depth)
        self._beyond.extend((disc - self.lens.focal.mean() * settings.marker_radius_m / depth)[known].tolist())
        if self._beyond:
            self._halo = max(float(np.median(self._beyond)), 0.0)

    def _blob_radius(self, depth: np.ndarray) -> np.ndarray:
        """Return the radius in pixels of a single marker's blob at depths in metres."""
        return self.lens.focal.mean() * self.settings.marker_radius_m / depth + self._halo

    def _lifted(self, frame: SensorFrame, shapes: Shapes, rings: RingDepths, parts: np.ndarray) -> SensorSightings:
        settings, lens = self.settings, self.lens
        flat = lens.undistorted(shapes.centre)
        length = np.sqrt(1.0 + (flat**2).sum(1))
        depth = rings.depth + settings.surface_radii * settings.marker_radius_m / length
        radius = self._blob_radius(rings.rough)
        with np.errstate(invalid="ignore"):
            share = shapes.area / (np.pi * radius**2)
            near, far = settings.range_m
            believed = (depth >= near) & (depth <= far) & (share >= settings.least_share)
            depth = np.where(believed, depth, np.nan)
            odd = (share > settings.too_large) | (share < settings.too_small)
        keep = ~odd & np.isfinite(flat).all(1)
        hidden = np.nan_to_num(np.clip(1.0 - share, 0.0, 1.0), nan=0.0)
        sigma_px = settings.sigma_px + settings.split_sigma_px * parts
        sigma_px = sigma_px + settings.hidden_sigma * hidden * np.nan_to_num(radius, nan=0.0)
        pixel = MEDIAN_LOSS * np.maximum(settings.depth_sigma(rings.depth), rings.spread)
        with np.errstate(invalid="ignore", divide="ignore"):
            sigma_depth = np.hypot(pixel / np.sqrt(rings.count), settings.depth_floor_m)
        flat, depth, sigma_px, sigma_depth = flat[keep], depth[keep], sigma_px[keep], sigma_depth[keep]
        measured = lens.points(flat, depth), lens.covariances(flat, depth, sigma_px, sigma_depth)
        rays = lens.centre, lens.directions(flat), sigma_px / lens.focal.mean()
        place = shapes.centre[keep], depth
        times = {"number": frame.number, "host_s": frame.host_s}
        return SensorSightings(self.index, frame.device_s, *place, *measured, *rays, **times)
