"""A time-of-flight depth sensor: noise that grows with distance, flying pixels, and blind patches at markers.

Chapter 5.3.2 of the thesis lives on the last: a retro-reflector saturates the pixels that see it, which then have no
depth; light spilling from it gives the pixels around a "ring" at the depth of the sphere's surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.studio.scene.marker_spheres import RADIUS_M, Spheres
from solver_backend.synthesis.studio.sensors.infrared import FULL


@dataclass(frozen=True)
class TimeOfFlightModel:
    """The sensor's errors; of the size that Tölgyessy et al. 2021 measured on Azure Kinects, up to 3.9 m."""

    constant_mm: float = 0.8
    """Standard deviation at no distance."""
    quadratic_mm: float = 0.55
    """Added standard deviation at 1 m, growing with the square of the distance."""
    grazing: float = 0.25
    """Share by which noise grows with the tangent of the angle of incidence."""
    edge_m: float = 0.06
    """Neighbouring pixels farther apart than this are an edge."""
    flying: float = 0.5
    """Share of pixels at an edge whose depth lies between both surfaces."""
    lost: float = 0.25
    """Share of pixels at an edge that give no depth."""
    range_m: tuple[float, float] = (0.5, 3.86)
    """Nearest and farthest depth."""
    ring_noise: float = 1.5
    """Times the noise in the ring of a marker."""
    surface_radii: float = 2.0 / 3.0
    """How far before its middle a sphere sends light back, in radii: the mean over its disc."""

    def sigma_m(self, depth: np.ndarray) -> np.ndarray:
        """Return the standard deviation in metres of a surface square on, at depths in metres."""
        return 1e-3 * (self.constant_mm + self.quadratic_mm * depth**2)


def measure_depth(
    depth: np.ndarray, cosine: np.ndarray, retro: np.ndarray, spheres: Spheres, model: TimeOfFlightModel,
    rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """Return (h, w) uint16 millimetres along the axis, 0 where the sensor gives none.

    Args:
        depth: (h, w) true metres, inf where nothing is.
        cosine: (h, w) of the angle between normal and sight line.
        retro: (h, w) counts from ``sphere_light``.
        spheres: whose ring lies where.
        model: the sensor.
        rng: seeded source of randomness.
    """
    low, high = model.range_m
    true = np.minimum(depth, np.float32(100.0))
    blind = retro >= FULL
    if blind.any():
        true, ring = _with_rings(true, blind, spheres, model.surface_radii * RADIUS_M)
    else:
        ring = np.zeros_like(blind)
    slope = np.clip(1.0 / np.maximum(cosine, np.float32(0.1)), 1.0, 6.0) - 1.0
    factor = np.where(ring, np.float32(model.ring_noise), 1.0 + np.float32(model.grazing) * slope)
    sigma = np.float32(1e-3) * (np.float32(model.constant_mm) + np.float32(model.quadratic_mm) * true**2)
    found = true + (sigma * factor).astype(np.float32) * rng.standard_normal(true.shape, np.float32)
    # Edges are few: only they are looked at one by one.
    near, far = _neighbours(true)
    edge = np.flatnonzero(((far - near > np.float32(model.edge_m)) & ~ring).ravel())
    draw, mix = rng.random(len(edge), np.float32), rng.random(len(edge), np.float32)
    flat, near, far = found.reshape(-1), near.reshape(-1)[edge], np.minimum(far.reshape(-1)[edge], np.float32(high))
    between = near + mix * np.maximum(far - near, 0.0)
    flat[edge] = np.where(draw < model.flying, between, np.where(draw < model.flying + model.lost, 0.0, flat[edge]))
    found[blind | (found < low) | (found > high)] = 0.0
    return np.round(found * np.float32(1000.0)).astype(np.uint16)


def _with_rings(
    depth: np.ndarray, blind: np.ndarray, spheres: Spheres, before_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth with the nearest sphere's two pixels around blind patches, and (h, w) where that is.

    A sphere's light comes from ``before_m`` before its middle.
    """
    height, width = depth.shape
    owner = np.full(height * width, np.inf, np.float32)
    np.minimum.at(owner, spheres.pixel, (spheres.depth[spheres.owner] - before_m).astype(np.float32))
    around = owner.reshape(height, width)
    grown = blind
    for step in range(3):
        around = np.minimum(around, _lowest_around(around))
        if step < 2:
            grown = ~(_lowest_around((~grown).astype(np.float32)) > 0) | grown
    ring = grown & ~blind & np.isfinite(around) & (around < depth + 0.1)
    return np.where(ring, around, depth), ring


def _lowest_around(values: np.ndarray) -> np.ndarray:
    """Return the least of each pixel's 3 x 3 neighbourhood."""
    padded = np.pad(values, 1, mode="edge")
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


def _neighbours(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest and the farthest of each pixel and its four neighbours."""
    low, high = depth.copy(), depth.copy()
    for here, there in (
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
    ):
        np.minimum(low[here], depth[there], out=low[here])
        np.minimum(low[there], depth[here], out=low[there])
        np.maximum(high[here], depth[there], out=high[here])
        np.maximum(high[there], depth[here], out=high[there])
    return low, high
