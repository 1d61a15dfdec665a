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
    """'test' joins sightings that differ no more than their covariances allow, 'radius' all within ``radius_m``."""
    radius_m: float = 0.01
    """Radius of the published clusters (paper, appendix K)."""
    calibration_m: float = 0.0012
    """Standard deviation, per axis, by which a sensor's place and lens are wrong. Added in tests, not in the result."""
    joined: float = 16.27
    """Largest χ² of two sightings of one marker: 0.999 with three degrees of freedom."""
    joined_ray: float = 13.82
    """The same of a point and a ray: 0.999 with two."""
    joined_rays: float = 6.63
    """The same of two rays: 0.99 with one. Chance brings rays together more often than points."""
    reach_m: float = 0.05
    """Sightings farther apart are never one marker, however unsure."""
    closest_m: float = 0.028
    """No two markers are closer: of two points that are, the surer one stays. Smaller for fingers."""
    ray_range_m: tuple[float, float] = (0.3, 6.0)
    """Range of the intersection of two rays from either sensor, in metres."""
    least_angle: float = 0.17
    """Radians between two rays that give a point."""

    acceleration_m_s2: float = 40.0
    """Standard deviation of a marker's acceleration from frame to frame."""
    start_speed_m_s: float = 2.0
    """Standard deviation of the speed of a marker that was not there before."""
    follow: float = 16.27
    """Largest χ² of a point and the track that it goes on from."""
    lost_s: float = 0.12
    """Time after which a track that is not seen is given up."""

    hit_alone: float = 0.8
    """Added to a track's log-odds of being a marker by a frame where one sensor sees it."""
    hit_together: float = 3.0
    """The same of two or more sensors."""
    hit_rays: float = 1.0
    """The same of two rays alone."""
    miss: float = 1.0
    """Taken from it by a frame where none does."""
    start: float = -2.0
    """Log-odds of a point that was not there before."""
    most: float = 6.0
    """Largest log-odds that are kept."""


DEFAULT = FusionSettings()


_NEVER = 1e6
"""Cost of a pair that may not be: more than any sum of those that may."""


def matched(a: np.ndarray, b: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs (a, b) of candidates, each name at most once, as many as can be and of least ``Σ cost``.

    Candidates fall into parts that share no name. A part of one pair is that pair, the others are solved by the
    Hungarian method (Kuhn 1955).

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
"""Origin (3,), unit directions (R, 3) and standard deviations across (R,) in radians, of one sensor."""


def met_rays(rays: list[Rays], settings: FusionSettings = DEFAULT) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) points and (N, 3, 3) covariances where rays of two sensors meet and fit no others.

    The midpoint of the shortest way between two rays (Hartley and Sturm 1997) stands if that way is no longer than
    the rays' errors allow, and if neither of both meets a third: of several meetings all but one are ghosts.
    """
    first, second, points, covariances = [], [], [], []
    begin = np.cumsum([0, *(len(direction) for _, direction, _ in rays)])
    for a, b in combinations(range(len(rays)), 2):
        i, j, point, covariance = _meetings(rays[a], rays[b], settings)
        first.append(begin[a] + i)
        second.append(begin[b] + j)
        points.append(point)
        covariances.append(covariance)
    if not points or not sum(map(len, points)):
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    one, other = np.concatenate(first), np.concatenate(second)
    met = np.bincount(np.concatenate([one, other]), minlength=int(begin[-1]))
    only = (met[one] == 1) & (met[other] == 1)
    return np.concatenate(points)[only], np.concatenate(covariances)[only]


def _meetings(a: Rays, b: Rays, settings: FusionSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    (at_a, way_a, sigma_a), (at_b, way_b, sigma_b) = a, b
    cosine = way_a @ way_b.T
    between = at_b - at_a
    sine2 = np.maximum(1.0 - cosine**2, 1e-9)
    of_a, of_b = way_a @ between, way_b @ between
    far_a = (of_a[:, None] - cosine * of_b) / sine2
    far_b = (cosine * of_a[:, None] - of_b) / sine2
    near, far = settings.ray_range_m
    inside = (
        (far_a > near) & (far_a < far) & (far_b > near) & (far_b < far) & (sine2 > np.sin(settings.least_angle) ** 2)
    )
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
    """(N,) sensors that saw each with a depth."""
    rays: np.ndarray
    """(N,) sensors that saw each without."""


def fuse(sightings: list[SensorSightings], settings: FusionSettings = DEFAULT) -> FusedPoints:
    """Return the points of one moment."""
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
        time,
        np.concatenate([points, met]),
        np.concatenate([covariance, met_covariance]),
        np.concatenate([found.depths, np.zeros(len(met), int)]),
        np.concatenate([found.rays, np.full(len(met), 2)]),
    )


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
        """Take one sensor's rays: each sharpens the cluster that it passes. Return which pass none, (R,) bool."""
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
    """Return the mean of each group of points that ``radius_m`` joins, as published. Covariances of means."""
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
