"""Locate the markers that one sensor sees in one frame, with covariances."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

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
    """(N, 2) pixels of the middles."""
    depth: np.ndarray
    """(N,) metres along the axis to the middles, NaN where there is none."""
    points: np.ndarray
    """(N, 3) world metres, NaN where there is no depth."""
    covariance: np.ndarray
    """(N, 3, 3) m², NaN where there is no depth."""
    origin: np.ndarray
    """(3,) the sensor's place."""
    direction: np.ndarray
    """(N, 3) unit directions of the rays in the world."""
    sigma_ray: np.ndarray
    """(N,) radians, how sure the rays are across."""
    finding: str = ""
    """Code of what is wrong with the frame, where something is."""
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
"""Code where there are no markers for sunlight, a window or a lamp."""
MEDIAN_LOSS = 1.25
"""Standard deviation of a median by that of a mean. The ring's mean about it is no worse."""


class Acquisition:
    """Finds markers in the frames of one sensor.

    Args:
        mask: (h, w) bool of what is bright with nobody there, see ``learned_mask``.

    Raises:
        SensorUnknown: the calibration does not name the sensor.
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
        threshold = threshold_of(infrared, settings)
        blobs = find_blobs(infrared, threshold, self._mask, settings)
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
            raise PicturesDiffer(
                f"A sensor's pictures are of different sizes: {message}.",
                where=frame.sensor,
                hint="Record infrared and depth in one mode, aligned, and calibrate in the same.",
            )
        if frame.infrared.dtype not in (np.uint8, np.uint16) or (
            frame.depth is not None and frame.depth.dtype != np.uint16
        ):
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
            shapes = shapes_of(blobs)
            rings = rings.with_parts(ring_depths(of_parts, blobs.count, settings), parts)
        return shapes, rings.without(slivers_of(blobs, saturated)), parts

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
        return SensorSightings(
            self.index,
            frame.device_s,
            shapes.centre[keep],
            depth,
            lens.points(flat, depth),
            lens.covariances(flat, depth, sigma_px, sigma_depth),
            lens.centre,
            lens.directions(flat),
            sigma_px / lens.focal.mean(),
            "",
            frame.number,
            frame.host_s,
        )
