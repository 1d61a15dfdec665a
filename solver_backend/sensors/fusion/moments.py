"""Group the frames of all sensors into moments, fuse their markers, and track them in a marker cloud.

A moment consists of the frames that the sensors took at the same time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.sensors.acquisition.acquire import SensorSightings
from solver_backend.sensors.acquisition.blobs import joined
from solver_backend.sensors.devices.device import RecordingInvalid
from solver_backend.types import MarkerCloud
from solver_backend.videos.detect.detect_videos import least_cost_assignment


@dataclass(frozen=True)
class FusionSettings:
    """Constants for fusing and tracking markers."""

    radius_m: float = 0.01  # Radius of clusters in the published method, in metres (Noise-In, Bias-Out, appendix K).
    calibration_m: float = 0.0012
    """Standard deviation per axis of a sensor's calibration in metres. It affects tests but not results."""
    joined: float = 16.27  # Largest χ² between two sightings of the same marker: 0.999 with three degrees of freedom.
    joined_ray: float = 13.82  # Largest χ² between a point and a ray: 0.999 with two degrees of freedom.
    joined_rays: float = 6.63
    """Largest χ² between two rays: 0.99 with one degree of freedom. Rays often meet by chance, so it is strict."""
    reach_m: float = 0.05  # Largest distance in metres between two sightings of one marker, even if they are uncertain.
    closest_m: float = 0.028
    """Smallest distance between two markers in metres. If two points are closer, only the more certain one is kept."""
    ray_range_m: tuple[float, float] = (0.3, 6.0)
    """Range of distances in metres from either sensor to the intersection of two rays."""
    least_angle: float = 0.17  # Smallest angle in radians between two rays that determine a point.

    acceleration_m_s2: float = 40.0  # Standard deviation of a marker's acceleration between frames.
    start_speed_m_s: float = 2.0  # Standard deviation of a new marker's speed per axis.
    follow: float = 16.27  # Largest χ² between a point and the track it continues.
    lost_s: float = 0.12  # Seconds without a point after which a track ends.

    hit_alone: float = 0.8  # Increase of a track's log-odds of being a marker if one sensor sees the marker.
    hit_together: float = 3.0  # Increase if two or more sensors see the marker.
    hit_rays: float = 1.0  # Increase if the marker is only the intersection of two rays.
    miss: float = 1.0  # Decrease if no sensor sees the marker.
    start: float = -2.0  # Initial log-odds of a new point.
    most: float = 6.0  # Largest log-odds.


SETTINGS = FusionSettings()

_NEVER = 1e6  # Cost of an impossible pair, which exceeds any sum of possible costs.


def matched(a: np.ndarray, b: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Select as many candidate pairs (a, b) as possible with the smallest total cost. Each element is used once.

    ``a`` and ``b`` are indices of elements, with one entry per pair. Costs are far below 1e6. The candidates are
    divided into groups without common elements. Groups of several pairs are solved by the Hungarian method (Kuhn 1955).
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
"""Rays of a sensor: origin (3,), unit directions (R, 3), standard deviations (R,) in radians."""


def met_rays(rays: list[Rays]) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) intersections of rays from exactly two sensors, and their covariances.

    A point is the midpoint of the shortest line between two rays (Hartley and Sturm 1997), provided that the errors of
    the rays explain the length of that line. Rays that meet more than one other ray give no point, because at most one
    of the intersections is real.
    """
    begin = np.cumsum([0, *(len(direction) for _, direction, _ in rays)])
    found = [
        (begin[a] + i, begin[b] + j, point, covariance)
        for a, b in combinations(range(len(rays)), 2)
        for i, j, point, covariance in [_meetings(rays[a], rays[b])]
        if len(i)
    ]
    if not found:
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    one, other, points, covariances = map(np.concatenate, zip(*found, strict=True))
    met = np.bincount(np.concatenate([one, other]), minlength=int(begin[-1]))
    only = (met[one] == 1) & (met[other] == 1)
    return points[only], covariances[only]


def _meetings(a: Rays, b: Rays) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    (at_a, way_a, sigma_a), (at_b, way_b, sigma_b) = a, b
    cosine = way_a @ way_b.T
    between = at_b - at_a
    sine2 = np.maximum(1.0 - cosine**2, 1e-9)
    of_a, of_b = way_a @ between, way_b @ between
    far_a = (of_a[:, None] - cosine * of_b) / sine2
    far_b = (cosine * of_a[:, None] - of_b) / sine2
    near, far = SETTINGS.ray_range_m
    inside = (far_a > near) & (far_a < far) & (far_b > near) & (far_b < far)
    inside &= sine2 > np.sin(SETTINGS.least_angle) ** 2
    i, j = np.nonzero(inside)
    on_a = at_a + far_a[i, j, None] * way_a[i]
    on_b = at_b + far_b[i, j, None] * way_b[j]
    width = np.stack([sigma_a[i] * far_a[i, j], sigma_b[j] * far_b[i, j]])
    gap2 = ((on_a - on_b) ** 2).sum(-1)
    good = gap2 < SETTINGS.joined_rays * ((width**2).sum(0) + 2.0 * SETTINGS.calibration_m**2)
    i, j, on_a, on_b, width = i[good], j[good], on_a[good], on_b[good], width[:, good]
    planes = [np.eye(3) - way[k][:, :, None] * way[k][:, None, :] for way, k in ((way_a, i), (way_b, j))]
    weights = [p / (w**2)[:, None, None] for p, w in zip(planes, width, strict=True)]
    covariance = np.linalg.inv(weights[0] + weights[1]) if len(i) else np.zeros((0, 3, 3))
    pulled = weights[0] @ on_a[..., None] + weights[1] @ on_b[..., None]
    return i, j, (covariance @ pulled)[..., 0], covariance


@dataclass(frozen=True)
class FusedPoints:
    """N points fused from all sensors at one time."""

    time: float
    points: np.ndarray  # (N, 3) world positions in metres.
    covariance: np.ndarray  # (N, 3, 3) covariances in m².
    depths: np.ndarray  # (N,) number of sensors that saw each point and its depth.
    rays: np.ndarray  # (N,) number of sensors that saw each point but not its depth.


def fuse(sightings: list[SensorSightings], clusters: str = "test") -> FusedPoints:
    """Fuse markers seen at one time if their covariances agree ("test"), or if within ``radius_m`` ("radius")."""
    time = float(np.mean([s.time for s in sightings])) if sightings else 0.0
    if clusters == "radius":
        return _within_radius(time, sightings)
    found = _Clusters()
    for seen in sightings:
        deep = np.flatnonzero(np.isfinite(seen.depth))
        found.join_points(seen.points[deep], seen.covariance[deep])
    left: list[Rays] = []
    for seen in sightings:
        flat = np.flatnonzero(~np.isfinite(seen.depth))
        rest = flat[found.join_rays(seen, flat)]
        left.append((seen.origin, seen.direction[rest], seen.sigma_ray[rest]))
    found.drop_doubles()
    points, covariance = found.estimates()
    met, met_covariance = met_rays(left)
    points, covariance = np.concatenate([points, met]), np.concatenate([covariance, met_covariance])
    depths = np.concatenate([found.depths, np.zeros(len(met), int)])
    return FusedPoints(time, points, covariance, depths, np.concatenate([found.rays, np.full(len(met), 2)]))


class _Clusters:
    """Groups of markers in information form, ``Λ = Σ⁻¹`` and ``η = Λ p``."""

    def __init__(self) -> None:
        self.information = np.zeros((0, 3, 3))
        self.vector = np.zeros((0, 3))
        self.depths, self.rays = np.zeros(0, int), np.zeros(0, int)

    def estimates(self) -> tuple[np.ndarray, np.ndarray]:
        covariance = np.linalg.inv(self.information)
        return (covariance @ self.vector[..., None])[..., 0], covariance

    def join_points(self, points: np.ndarray, covariance: np.ndarray) -> None:
        information = np.linalg.inv(covariance)
        vector = (information @ points[..., None])[..., 0]
        own = np.ones(len(points), dtype=bool)
        if len(self.vector) and len(points):
            at, spread = self.estimates()
            off = at[:, None] - points
            i, j = np.nonzero((off * off).sum(-1) < SETTINGS.reach_m**2)
            both = spread[i] + covariance[j] + 2.0 * SETTINGS.calibration_m**2 * np.eye(3)
            square = chi_square(off[i, j], both)
            near = square < SETTINGS.joined
            i, j = matched(i[near], j[near], square[near])
            self.information[i] += information[j]
            self.vector[i] += vector[j]
            self.depths[i] += 1
            own[j] = False
        self.information = np.concatenate([self.information, information[own]])
        self.vector = np.concatenate([self.vector, vector[own]])
        self.depths = np.concatenate([self.depths, np.ones(int(own.sum()), int)])
        self.rays = np.concatenate([self.rays, np.zeros(int(own.sum()), int)])

    def join_rays(self, seen: SensorSightings, rows: np.ndarray) -> np.ndarray:
        """Add each of a sensor's rays to a group that it passes closely. Return a mask of the remaining rays."""
        origin, direction, sigma = seen.origin, seen.direction[rows], seen.sigma_ray[rows]
        rest = np.ones(len(direction), dtype=bool)
        if not len(self.vector) or not len(direction):
            return rest
        at, spread = self.estimates()
        way = at - origin
        along = way @ direction.T
        across = way[:, None] - along[..., None] * direction
        i, j = np.nonzero(((across * across).sum(-1) < SETTINGS.reach_m**2) & (along > SETTINGS.ray_range_m[0]))
        off, far = across[i, j], along[i, j]
        flat = np.eye(3) - direction[j, :, None] * direction[j, None, :]
        width = (sigma[j] * far) ** 2 + SETTINGS.calibration_m**2
        # A standard deviation of a metre along the ray restricts the test to the distance from the ray.
        both = spread[i] + width[:, None, None] * flat + direction[j, :, None] * direction[j, None, :]
        square = chi_square(off, both)
        # A ray cannot show a marker that the same sensor also sees with depth.
        near = np.flatnonzero(square < SETTINGS.joined_ray)
        own = seen.points[np.isfinite(seen.depth)]
        mine = (((at[i[near]][:, None] - own) ** 2).sum(-1) < SETTINGS.radius_m**2).any(1)
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

    def drop_doubles(self) -> None:
        at, spread = self.estimates()
        variance = np.trace(spread, axis1=1, axis2=2)
        off = at[:, None] - at
        close = (off * off).sum(-1) < SETTINGS.closest_m**2
        kept = ~(close & (variance[:, None] > variance)).any(1)
        for name in ("information", "vector", "depths", "rays"):
            setattr(self, name, getattr(self, name)[kept])


def chi_square(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the (N,) values ``Δᵀ Σ⁻¹ Δ`` of differences (N, 3) with covariances (N, 3, 3)."""
    return (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(-1)


def _within_radius(time: float, sightings: list[SensorSightings]) -> FusedPoints:
    """Fuse markers within ``radius_m`` to their mean, as in "Noise-In, Bias-Out", appendix K."""
    deep = [np.isfinite(s.depth) for s in sightings]
    points = np.concatenate([np.zeros((0, 3)), *(s.points[d] for s, d in zip(sightings, deep, strict=True))])
    covariance = np.concatenate([np.zeros((0, 3, 3)), *(s.covariance[d] for s, d in zip(sightings, deep, strict=True))])
    off = points[:, None] - points
    i, j = np.nonzero(np.triu((off * off).sum(-1) < SETTINGS.radius_m**2, 1))
    cluster, count = joined(len(points), i, j)
    size = np.bincount(cluster, minlength=count)
    mean, spread = np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(mean, cluster, points)
    np.add.at(spread, cluster, covariance)
    mean, spread = mean / size[:, None], spread / (size**2)[:, None, None]
    return FusedPoints(time, mean, spread, size, np.zeros(count, int))


SILENT_S = 0.25  # Seconds without a frame after which a sensor counts as silent. The others then continue.
JUMP_S = 0.5
"""Largest difference between the time steps of sensor and host in seconds. Beyond it, the host's step is used."""
WAITING, MOST_FINDINGS = 30, 1000  # Maximum numbers of frames per queue and of findings. Older ones are dropped.


@dataclass(frozen=True)
class Finding:
    """A diagnostic about a sensor at some time."""

    kind: str  # 'sensor_silent', 'sensor_back', 'time_jumped', 'sunlight', 'recording_ended', or an error code.
    sensor: int
    time: float
    found: Diagnostic

    @property
    def message(self) -> str:
        """The diagnostic as a sentence."""
        return sentence(self.found)


class Gatherer:
    """Groups frames of different sensors that are less than half of ``period_s`` apart into moments.

    A moment waits for its last sensor for at most ``wait_s`` seconds on the host's clock. If ``wait_s`` is None, it
    waits without limit.
    """

    def __init__(self, names: tuple[str, ...], period_s: float, wait_s: float | None = None) -> None:
        self._names, self._period, self._wait = names, period_s, wait_s
        self._queues: list[deque[SensorSightings]] = [deque() for _ in names]
        self._last: list[SensorSightings | None] = [None] * len(names)
        self._offset = [0.0] * len(names)
        self._expected = [True] * len(names)
        self._ended = [False] * len(names)
        self._gone: float | None = None
        """Time of the most recent moment."""
        self.findings: list[Finding] = []

    def push(self, seen: SensorSightings) -> None:
        """Add a sensor's frame. If its times are invalid, it is reported and dropped."""
        if not (math.isfinite(seen.time) and math.isfinite(seen.host_s)):
            self._report("time_jumped", seen, "sensor_time_wrong", problem="missing")
            return
        seen = self._on_our_clock(seen)
        index = seen.sensor
        if not self._expected[index]:
            self._expected[index] = True
            self._report("sensor_back", seen, "sensor_back")
        if seen.finding:
            self._report("sunlight", seen, seen.finding)
        if self._gone is not None and seen.time < self._gone + 0.5 * self._period:
            return  # its moment has already been completed
        self._queues[index].append(seen)
        if len(self._queues[index]) > WAITING:
            self._queues[index].popleft()

    def _on_our_clock(self, seen: SensorSightings) -> SensorSightings:
        index = seen.sensor
        seen = replace(seen, time=seen.time + self._offset[index])
        before, self._last[index] = self._last[index], seen
        if before is None:
            return seen
        step, host = seen.time - before.time, max(seen.host_s - before.host_s, 0.0)
        if step <= 0.0 or step > JUMP_S + host:
            moved = max(host, self._period) - step
            self._offset[index] += moved
            self._last[index] = replace(seen, time=seen.time + moved)
            self._report("time_jumped", before, "sensor_time_wrong", problem="jump", step=step)
            return replace(seen, time=seen.time + moved)
        if step > SILENT_S and self._expected[index]:
            self._report("sensor_silent", before, "sensor_silent", pause="over", gap=step)
        return seen

    def waiting(self, index: int) -> int:
        """Return the number of frames from a sensor that are waiting for frames of other sensors."""
        return len(self._queues[index])

    def ended(self, index: int) -> None:
        """Mark a sensor as ended, so that no moment waits for its frames."""
        self._ended[index] = True

    def moments(self, now: float | None = None) -> list[list[SensorSightings]]:
        """Return the moments that are complete, or that have waited long enough at the host time ``now``."""
        found = []
        while (moment := self._next(now)) is not None:
            found.append(moment)
        return found

    def _next(self, now: float | None) -> list[SensorSightings] | None:
        heads = [queue[0] for queue in self._queues if queue]
        if not heads:
            return None
        lacking = [k for k, queue in enumerate(self._queues) if not queue and self._expected[k] and not self._ended[k]]
        for k in lacking:
            last = self._last[k]
            if now is not None and last is not None and now - last.host_s > SILENT_S:
                self._expected[k] = False
                self._report("sensor_silent", last, "sensor_silent", pause="now")
        lacking = [k for k in lacking if self._expected[k]]
        first = min(head.time for head in heads)
        waited = now is not None and self._wait is not None and now - min(h.host_s for h in heads) > self._wait
        if lacking and not waited:
            return None
        # Always take the earliest frame, because rounding errors of very large times can exceed half a period.
        moment = [min((queue for queue in self._queues if queue), key=lambda queue: queue[0].time).popleft()]
        others = (queue for queue in self._queues if queue and queue[0].sensor != moment[0].sensor)
        moment += [queue.popleft() for queue in others if queue[0].time < first + 0.5 * self._period]
        moment.sort(key=lambda seen: seen.sensor)
        self._gone = first
        return moment

    def _report(self, kind: str, seen: SensorSightings, code: str, **values: Any) -> None:
        found = diagnostic(code, cameras=[self._names[seen.sensor]], when="", **values)
        self.findings.append(Finding(kind, seen.sensor, seen.time, found))
        del self.findings[:-MOST_FINDINGS]


_LONGEST_STEP_S = 0.5  # Time step in seconds above which tracks restart. Chosen by hand.


@dataclass(frozen=True)
class TrackedPoints:
    """N points at one time with the tracks that they belong to."""

    time: float
    points: np.ndarray  # (N, 3) world positions in metres, as measured in this frame.
    covariance: np.ndarray  # (N, 3, 3) covariances in m².
    track: np.ndarray  # (N,) track number, which is constant while a marker stays visible.
    score: np.ndarray  # (N,) log-odds that the track is a marker. They are negative for ghosts.


class MarkerTracks:
    """Tracks markers with one constant-velocity Kalman filter each (Bar-Shalom and Li 1993)."""

    def __init__(self) -> None:
        self._next = 0
        self.clear()

    def clear(self) -> None:
        """Delete all tracks. Their numbers are not used again."""
        self._time: float | None = None
        self._state = np.zeros((0, 6))
        self._covariance = np.zeros((0, 6, 6))
        self._number = np.zeros(0, int)
        self._score, self._unseen_s = np.zeros(0), np.zeros(0)

    def update(self, found: FusedPoints) -> TrackedPoints:
        """Assign the points of a moment to tracks. If time does not advance, all tracks restart."""
        dt = 0.0 if self._time is None else found.time - self._time
        if self._time is not None and not 0.0 < dt <= _LONGEST_STEP_S:
            self.clear()
        self._time = found.time
        if len(self._state):
            self._predict(dt)
        points, covariance = found.points, found.covariance
        off = self._state[:, None, :3] - points
        reach = 3.0 * np.sqrt(np.trace(self._covariance[:, :3, :3], axis1=1, axis2=2)) + SETTINGS.reach_m
        i, j = np.nonzero((off * off).sum(-1) < reach[:, None] ** 2)
        square = chi_square(off[i, j], self._covariance[i, :3, :3] + covariance[j])
        near = square < SETTINGS.follow
        i, j = matched(i[near], j[near], square[near])
        self._correct(i, points[j], covariance[j])
        gained = np.where(found.depths >= 2, SETTINGS.hit_together, SETTINGS.hit_alone)
        gained = np.where((found.depths == 1) & (found.rays > 0), SETTINGS.hit_together, gained)
        gained = np.where(found.depths == 0, SETTINGS.hit_rays, gained)
        hit = np.zeros(len(self._state), dtype=bool)
        hit[i] = True
        self._score[i] += gained[j]
        self._score[~hit] -= SETTINGS.miss
        self._score = np.minimum(self._score, SETTINGS.most)
        self._unseen_s = np.where(hit, 0.0, self._unseen_s + dt)
        row = np.full(len(points), -1)
        row[j] = i
        row[row < 0] = self._begin(points[row < 0], covariance[row < 0], gained[row < 0])
        tracked = TrackedPoints(found.time, points, covariance, self._number[row], self._score[row])
        rows = self._unseen_s <= SETTINGS.lost_s
        for name in ("_state", "_covariance", "_number", "_score", "_unseen_s"):
            setattr(self, name, getattr(self, name)[rows])
        return tracked

    def _predict(self, dt: float) -> None:
        F = np.eye(6)
        F[:3, 3:] = dt * np.eye(3)
        noise = SETTINGS.acceleration_m_s2**2
        step = np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]]) * noise
        self._state = self._state @ F.T
        self._covariance = F @ self._covariance @ F.T + np.kron(step, np.eye(3))

    def _correct(self, rows: np.ndarray, points: np.ndarray, covariance: np.ndarray) -> None:
        P = self._covariance[rows]
        gain = P[:, :, :3] @ np.linalg.inv(P[:, :3, :3] + covariance)
        self._state[rows] += (gain @ (points - self._state[rows, :3])[..., None])[..., 0]
        updated = P - gain @ P[:, :3, :]
        self._covariance[rows] = 0.5 * (updated + np.swapaxes(updated, 1, 2))

    def _begin(self, points: np.ndarray, covariance: np.ndarray, gained: np.ndarray) -> np.ndarray:
        count, first = len(points), len(self._state)
        state = np.concatenate([points, np.zeros((count, 3))], axis=1)
        P = np.zeros((count, 6, 6))
        P[:, :3, :3] = covariance
        P[:, 3:, 3:] = SETTINGS.start_speed_m_s**2 * np.eye(3)
        self._state = np.concatenate([self._state, state])
        self._covariance = np.concatenate([self._covariance, P])
        self._number = np.concatenate([self._number, self._next + np.arange(count)])
        self._score = np.concatenate([self._score, SETTINGS.start + gained])
        self._unseen_s = np.concatenate([self._unseen_s, np.zeros(count)])
        self._next += count
        return first + np.arange(count)


_MOST_UNSEEN, _PAUSE = 20, 36_000
"""Maximum number of frames of a take: a multiple of the frames with markers, plus a constant. More frames mean that the
times are wrong. With milliseconds in place of seconds, three frames would need 6 GB. Chosen by hand."""


def build_cloud(moments: Sequence[TrackedPoints], fps: float) -> MarkerCloud:
    """Build a marker cloud with equal frame intervals from tracked points.

    A track is a marker if its log-odds ever exceeded 0. It occupies the first free column. The cloud's residual is the
    standard deviation of each point, ``√(tr Σ / 3)``.

    Raises:
        RecordingInvalid: the times are so far apart that most frames would be empty.
    """
    if not sum(len(moment.points) for moment in moments):
        return MarkerCloud(np.full((0, 0, 3), np.nan), fps)
    start, span_s = moments[0].time, moments[-1].time - moments[0].time
    rows = np.concatenate([np.full(len(m.points), round((m.time - start) * fps)) for m in moments])
    track, score, points, covariance = (
        np.concatenate([getattr(m, name) for m in moments]) for name in ("track", "score", "points", "covariance")
    )
    names, of_point = np.unique(track, return_inverse=True)
    best = np.full(len(names), -np.inf)
    np.maximum.at(best, of_point, score)
    kept = (best > 0)[of_point]
    rows, of_point, points, covariance = rows[kept], of_point[kept], points[kept], covariance[kept]
    column = _columns(rows, of_point, len(names))
    if span_s * fps > _MOST_UNSEEN * len(moments) + _PAUSE:
        message = (
            f"{len(moments)} frames with markers span {span_s:.0f} s, which is impossible at {fps:g} frames per second."
        )
        hint = "Write the times of an index in seconds. Record in parts if there are long pauses."
        raise RecordingInvalid(message, where="index.csv", hint=hint)
    shape = round(span_s * fps) + 1, int(column.max(initial=-1)) + 1
    positions, spread = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    positions[rows, column[of_point]] = points
    spread[rows, column[of_point]] = covariance
    residual = np.sqrt(np.trace(spread, axis1=-2, axis2=-1) / 3.0)
    return MarkerCloud(positions, fps, None, residual, spread)


def _columns(rows: np.ndarray, track: np.ndarray, count: int) -> np.ndarray:
    """Assign each of ``count`` tracks to the first column without a simultaneous track."""
    first, last = np.full(count, np.iinfo(int).max), np.full(count, -1)
    np.minimum.at(first, track, rows)
    np.maximum.at(last, track, rows)
    column, ends = np.full(count, -1), np.zeros(0, int)
    for one in np.argsort(first, kind="stable").tolist():
        if last[one] < 0:
            continue
        free = np.flatnonzero(ends < first[one])
        if len(free):
            column[one] = free[0]
            ends[free[0]] = last[one]
        else:
            column[one] = len(ends)
            ends = np.append(ends, last[one])
    return column
