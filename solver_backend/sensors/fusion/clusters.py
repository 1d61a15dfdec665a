"""Sightings of all sensors at one moment, joined to points: by a test of their covariances, or by a radius."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.sensors.acquisition.components import joined
from solver_backend.sensors.acquisition.sightings import SensorSightings
from solver_backend.sensors.fusion.matching import matched
from solver_backend.sensors.fusion.settings import DEFAULT, FusionSettings
from solver_backend.sensors.fusion.triangulation import met_rays


@dataclass(frozen=True)
class FusedPoints:
    """N points of one moment."""

    time: float
    """Seconds on the sensors' clock."""
    points: np.ndarray
    """(N, 3) world metres."""
    covariance: np.ndarray
    """(N, 3, 3) m²."""
    depths: np.ndarray
    """(N,) sensors that saw each with a depth."""
    rays: np.ndarray
    """(N,) sensors that saw each without."""


def fuse(sightings: list[SensorSightings], settings: FusionSettings = DEFAULT) -> FusedPoints:
    """Return the points of one moment.

    Args:
        sightings: of each sensor that saw something, at most one entry a sensor.
        settings: the constants.
    """
    time = float(np.mean([s.time for s in sightings])) if sightings else 0.0
    if settings.clusters == "radius":
        return _within_radius(time, sightings, settings)
    found = _Clusters()
    for seen in sightings:
        deep = np.flatnonzero(np.isfinite(seen.depth))
        found.join_points(seen.points[deep], seen.covariance[deep], settings)
    left: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for seen in sightings:
        flat = np.flatnonzero(~np.isfinite(seen.depth))
        rest = found.join_rays(seen.origin, seen.direction[flat], seen.sigma_ray[flat], seen, settings)
        left.append((seen.origin, seen.direction[flat][rest], seen.sigma_ray[flat][rest]))
    found.drop_doubles(settings)
    points, covariance = found.estimates()
    met, met_covariance = met_rays(left, settings)
    return FusedPoints(
        time, np.concatenate([points, met]), np.concatenate([covariance, met_covariance]),
        np.concatenate([found.depths, np.zeros(len(met), int)]), np.concatenate([found.rays, np.full(len(met), 2)]),
    )  # fmt: skip


class _Clusters:
    """Points under way, in information form: ``Λ = Σ⁻¹``, ``η = Λ p``."""

    def __init__(self) -> None:
        self.information = np.zeros((0, 3, 3))
        self.vector = np.zeros((0, 3))
        self.depths, self.rays = np.zeros(0, int), np.zeros(0, int)

    def estimates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (K, 3) points and (K, 3, 3) covariances."""
        covariance = np.linalg.inv(self.information)
        return (covariance @ self.vector[..., None])[..., 0], covariance

    def join_points(self, points: np.ndarray, covariance: np.ndarray, settings: FusionSettings) -> None:
        """Take one sensor's points: each joins the cluster that it may be, or is one of its own."""
        information = np.linalg.inv(covariance)
        vector = (information @ points[..., None])[..., 0]
        own = np.ones(len(points), dtype=bool)
        if len(self.vector) and len(points):
            at, spread = self.estimates()
            off = at[:, None] - points
            i, j = np.nonzero((off * off).sum(-1) < settings.reach_m**2)
            both = spread[i] + covariance[j] + 2.0 * settings.calibration_m**2 * np.eye(3)
            square = chi_square(off[i, j], both)
            near = square < settings.joined
            i, j = matched(i[near], j[near], square[near])
            self.information[i] += information[j]
            self.vector[i] += vector[j]
            self.depths[i] += 1
            own[j] = False
        self.information = np.concatenate([self.information, information[own]])
        self.vector = np.concatenate([self.vector, vector[own]])
        self.depths = np.concatenate([self.depths, np.ones(int(own.sum()), int)])
        self.rays = np.concatenate([self.rays, np.zeros(int(own.sum()), int)])

    def join_rays(
        self,
        origin: np.ndarray,
        direction: np.ndarray,
        sigma: np.ndarray,
        seen: SensorSightings,
        settings: FusionSettings,
    ) -> np.ndarray:
        """Take one sensor's rays: each sharpens the cluster that it passes; return which pass none, (R,) bool."""
        rest = np.ones(len(direction), dtype=bool)
        if not len(self.vector) or not len(direction):
            return rest
        at, spread = self.estimates()
        way = at - origin
        along = way @ direction.T
        across = way[:, None] - along[..., None] * direction
        i, j = np.nonzero(((across * across).sum(-1) < settings.reach_m**2) & (along > settings.ray_range_m[0]))
        off, far = across[i, j], along[i, j]
        flat = np.eye(3) - direction[j, :, None] * direction[j, None, :]
        width = (sigma[j] * far) ** 2 + settings.calibration_m**2
        # Along the ray anything goes: a width of a metre there leaves a test across it.
        both = spread[i] + width[:, None, None] * flat + direction[j, :, None] * direction[j, None, :]
        square = chi_square(off, both)
        # The sensor's own points are other markers than its rays.
        near = np.flatnonzero(square < settings.joined_ray)
        own = seen.points[np.isfinite(seen.depth)]
        mine = (((at[i[near]][:, None] - own) ** 2).sum(-1) < settings.radius_m**2).any(1)
        near = near[~mine]
        ii, jj = matched(i[near], j[near], square[near])
        distance = along[ii, jj]
        planes = np.eye(3) - direction[jj, :, None] * direction[jj, None, :]
        gain = planes / ((sigma[jj] * distance) ** 2)[:, None, None]
        self.information[ii] += gain
        self.vector[ii] += gain @ origin
        self.rays[ii] += 1
        rest[jj] = False
        return rest

    def drop_doubles(self, settings: FusionSettings) -> None:
        """Drop points too close to a surer one: slivers of a marker behind, depths that an edge has spoiled."""
        at, spread = self.estimates()
        variance = np.trace(spread, axis1=1, axis2=2)
        off = at[:, None] - at
        close = (off * off).sum(-1) < settings.closest_m**2
        kept = ~(close & (variance[:, None] > variance)).any(1)
        for name in ("information", "vector", "depths", "rays"):
            setattr(self, name, getattr(self, name)[kept])


def chi_square(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return (N,) ``Δᵀ Σ⁻¹ Δ`` of (N, 3) and (N, 3, 3)."""
    return (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(-1)


def _within_radius(time: float, sightings: list[SensorSightings], settings: FusionSettings) -> FusedPoints:
    """Return the mean of each group of points that ``radius_m`` joins, as published; covariances of means."""
    deep = [np.flatnonzero(np.isfinite(s.depth)) for s in sightings]
    none = np.zeros((0, 3))
    points = np.concatenate([none, *(s.points[d] for s, d in zip(sightings, deep, strict=True))])
    covariance = np.concatenate([np.zeros((0, 3, 3)), *(s.covariance[d] for s, d in zip(sightings, deep, strict=True))])
    off = points[:, None] - points
    i, j = np.nonzero(np.triu((off * off).sum(-1) < settings.radius_m**2, 1))
    cluster, count = joined(len(points), i, j)
    size = np.bincount(cluster, minlength=count)
    mean, spread = np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(mean, cluster, points)
    np.add.at(spread, cluster, covariance)
    mean, spread = mean / size[:, None], spread / (size**2)[:, None, None]
    return FusedPoints(time, mean, spread, size, np.zeros(count, int))
