"""Fuse the sightings of all sensors at one moment into one point per marker."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver_backend.sensors.acquisition.acquire import SensorSightings
from solver_backend.sensors.acquisition.blobs import joined
from solver_backend.videos.detect.detect_videos import least_cost_assignment


@dataclass(frozen=True)
class FusionSettings:
    """Constants of fusion."""

    clusters: str = "test"
    """'test' joins sightings within their covariances, 'radius' joins all within ``radius_m``."""
    radius_m: float = 0.01
    """Radius of the published clusters (paper, appendix K)."""
    calibration_m: float = 0.0012
    """Standard deviation per axis of a sensor's calibration. It counts in tests, not in results."""
    joined: float = 16.27
    """Largest χ² of two sightings of one marker: 0.999 with three degrees of freedom."""
    joined_ray: float = 13.82
    """Largest χ² of a point and a ray: 0.999 with two degrees of freedom."""
    joined_rays: float = 6.63
    """Largest χ² of two rays: 0.99 with one degree of freedom, because rays often meet by chance."""
    reach_m: float = 0.05
    """Largest distance of two sightings of one marker, however uncertain they are."""
    closest_m: float = 0.028
    """Smallest distance of two markers. Of two closer points, only the more certain one remains."""
    ray_range_m: tuple[float, float] = (0.3, 6.0)
    """Range of the intersection of two rays from either sensor, in metres."""
    least_angle: float = 0.17
    """Smallest angle between two rays that give a point, in radians."""

    acceleration_m_s2: float = 40.0
    """Standard deviation of a marker's acceleration from frame to frame."""
    start_speed_m_s: float = 2.0
    """Standard deviation of a new marker's speed."""
    follow: float = 16.27
    """Largest χ² of a point and its track."""
    lost_s: float = 0.12
    """A track ends after this time without a point, in seconds."""

    hit_alone: float = 0.8
    """Gain of a track's log-odds of being a marker if one sensor sees it."""
    hit_together: float = 3.0
    """Gain if two or more sensors see it."""
    hit_rays: float = 1.0
    """Gain if only two rays meet."""
    miss: float = 1.0
    """Loss if no sensor sees it."""
    start: float = -2.0
    """Log-odds of a new point."""
    most: float = 6.0
    """Largest log-odds."""


DEFAULT = FusionSettings()

_NEVER = 1e6
"""Cost of an impossible pair, more than any sum of possible ones."""


def matched(a: np.ndarray, b: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Select as many candidate pairs (a, b) as possible with the least ``Σ cost``, each name at most once.

    Candidates fall into components that share no name. Those with several pairs are solved by the Hungarian method
    (Kuhn 1955).

    Args:
        a: (P,) names of the first set, not negative.
        b: (P,) names of the second.
        cost: (P,) of each candidate, far below 1e6.
    """
    if not len(a):
        return a, b
    _, of_a = np.unique(a, return_inverse=True)
    _, of_b = np.unique(b, return_inverse=True)
    number = int(of_a.max()) + 1
    part, count = joined(number + int(of_b.max()) + 1, of_a, number + of_b)
    of_pair = part[of_a]
    size = np.bincount(of_pair, minlength=count)
    chosen = size[of_pair] == 1
    for several in np.flatnonzero(size > 1).tolist():
        rows = np.flatnonzero(of_pair == several)
        first, second = of_a[rows], of_b[rows]
        if (first == first[0]).all() or (second == second[0]).all():
            chosen[rows[cost[rows].argmin()]] = True
            continue
        _, i = np.unique(a[rows], return_inverse=True)
        _, j = np.unique(b[rows], return_inverse=True)
        table = np.full((int(i.max()) + 1, int(j.max()) + 1), _NEVER)
        table[i, j] = cost[rows]
        where = np.full(table.shape, -1)
        where[i, j] = rows
        pairs = np.array(least_cost_assignment(table))
        picked = where[pairs[:, 0], pairs[:, 1]]
        chosen[picked[picked >= 0]] = True
    return a[chosen], b[chosen]


Rays = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Origin (3,), unit directions (R, 3) and standard deviations (R,) in radians of one sensor's rays."""


def met_rays(rays: list[Rays], settings: FusionSettings = DEFAULT) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points and (N, 3, 3) covariances where rays of two sensors meet and fit no others.

    A point is the midpoint of the shortest line between two rays (Hartley and Sturm 1997), if that line is no longer
    than the rays' errors allow. Neither ray may meet a third one, because all but one of several meetings are ghosts.
    """
    begin = np.cumsum([0, *(len(direction) for _, direction, _ in rays)])
    found = [
        (begin[a] + i, begin[b] + j, point, covariance)
        for a, b in combinations(range(len(rays)), 2)
        for i, j, point, covariance in [_meetings(rays[a], rays[b], settings)]
        if len(i)
    ]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    one, other, points, covariances = map(np.concatenate, zip(*found, strict=True))
    met = np.bincount(np.concatenate([one, other]), minlength=int(begin[-1]))
    only = (met[one] == 1) & (met[other] == 1)
    return points[only], covariances[only]


def _meetings(a: Rays, b: Rays, settings: FusionSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    (at_a, way_a, sigma_a), (at_b, way_b, sigma_b) = a, b
    cosine = way_a @ way_b.T
    between = at_b - at_a
    sine2 = np.maximum(1.0 - cosine**2, 1e-9)
    of_a, of_b = way_a @ between, way_b @ between
    far_a = (of_a[:, None] - cosine * of_b) / sine2
    far_b = (cosine * of_a[:, None] - of_b) / sine2
    near, far = settings.ray_range_m
    inside = (far_a > near) & (far_a < far) & (far_b > near) & (far_b < far)
    inside &= sine2 > np.sin(settings.least_angle) ** 2
    i, j = np.nonzero(inside)
    on_a = at_a + far_a[i, j, None] * way_a[i]
    on_b = at_b + far_b[i, j, None] * way_b[j]
    width = np.stack([sigma_a[i] * far_a[i, j], sigma_b[j] * far_b[i, j]])
    gap2 = ((on_a - on_b) ** 2).sum(-1)
    good = gap2 < settings.joined_rays * ((width**2).sum(0) + 2.0 * settings.calibration_m**2)
    i, j, on_a, on_b, width = i[good], j[good], on_a[good], on_b[good], width[:, good]
    planes = [np.eye(3) - way[k][:, :, None] * way[k][:, None, :] for way, k in ((way_a, i), (way_b, j))]
    weights = [p / (w**2)[:, None, None] for p, w in zip(planes, width, strict=True)]
    covariance = np.linalg.inv(weights[0] + weights[1]) if len(i) else np.zeros((0, 3, 3))
    pulled = weights[0] @ on_a[..., None] + weights[1] @ on_b[..., None]
    return i, j, (covariance @ pulled)[..., 0], covariance


@dataclass(frozen=True)
class FusedPoints:
    """N points of one moment."""

    time: float
    points: np.ndarray
    """(N, 3) world metres."""
    covariance: np.ndarray
    """(N, 3, 3) m²."""
    depths: np.ndarray
    """(N,) number of sensors that saw each with depth."""
    rays: np.ndarray
    """(N,) number of sensors that saw each without depth."""


def fuse(sightings: list[SensorSightings], settings: FusionSettings = DEFAULT) -> FusedPoints:
    """Return the points of one moment."""
    time = float(np.mean([s.time for s in sightings])) if sightings else 0.0
    if settings.clusters == "radius":
        return _within_radius(time, sightings, settings)
    found = _Clusters()
    for seen in sightings:
        deep = np.flatnonzero(np.isfinite(seen.depth))
        found.join_points(seen.points[deep], seen.covariance[deep], settings)
    left: list[Rays] = []
    for seen in sightings:
        flat = np.flatnonzero(~np.isfinite(seen.depth))
        rest = flat[found.join_rays(seen, flat, settings)]
        left.append((seen.origin, seen.direction[rest], seen.sigma_ray[rest]))
    found.drop_doubles(settings)
    points, covariance = found.estimates()
    met, met_covariance = met_rays(left, settings)
    points, covariance = np.concatenate([points, met]), np.concatenate([covariance, met_covariance])
    depths = np.concatenate([found.depths, np.zeros(len(met), int)])
    return FusedPoints(time, points, covariance, depths, np.concatenate([found.rays, np.full(len(met), 2)]))


class _Clusters:
    """Points in information form, ``Λ = Σ⁻¹`` and ``η = Λ p``."""

    def __init__(self) -> None:
        self.information = np.zeros((0, 3, 3))
        self.vector = np.zeros((0, 3))
        self.depths, self.rays = np.zeros(0, int), np.zeros(0, int)

    def estimates(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (K, 3) points and (K, 3, 3) covariances."""
        covariance = np.linalg.inv(self.information)
        return (covariance @ self.vector[..., None])[..., 0], covariance

    def join_points(self, points: np.ndarray, covariance: np.ndarray, settings: FusionSettings) -> None:
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

    def join_rays(self, seen: SensorSightings, rows: np.ndarray, settings: FusionSettings) -> np.ndarray:
        """Add rows of a sensor's rays to the clusters that they pass. Return the (R,) mask of rays that pass none."""
        origin, direction, sigma = seen.origin, seen.direction[rows], seen.sigma_ray[rows]
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
        # A width of a metre along the ray leaves a test across it.
        both = spread[i] + width[:, None, None] * flat + direction[j, :, None] * direction[j, None, :]
        square = chi_square(off, both)
        # A sensor's rays cannot be markers that it also sees with depth.
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
    """Return the mean of each group of points joined by ``radius_m``, as published, and its covariance."""
    deep = [np.isfinite(s.depth) for s in sightings]
    points = np.concatenate([np.zeros((0, 3)), *(s.points[d] for s, d in zip(sightings, deep, strict=True))])
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
