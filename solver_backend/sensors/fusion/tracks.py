"""Points followed over time: a constant velocity, the Hungarian method, and log-odds of being a marker at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.sensors.fusion.clusters import FusedPoints, chi_square
from solver_backend.sensors.fusion.matching import matched
from solver_backend.sensors.fusion.settings import DEFAULT, FusionSettings

_LONGEST_STEP_S = 0.5
"""Seconds from one frame to the next, above which tracks begin anew; chosen by hand."""


@dataclass(frozen=True)
class TrackedPoints:
    """N points of one moment with the tracks that they belong to."""

    time: float
    points: np.ndarray
    """(N, 3) world metres, as measured in this frame."""
    covariance: np.ndarray
    """(N, 3, 3) m²."""
    track: np.ndarray
    """(N,) number of the track; it stays with a marker while it is seen."""
    score: np.ndarray
    """(N,) log-odds that the track is a marker; ghosts are below 0."""


class MarkerTracks:
    """Kalman filters of constant velocity, all at once (Bar-Shalom and Li 1993; white noise of acceleration)."""

    def __init__(self, settings: FusionSettings = DEFAULT) -> None:
        self._settings = settings
        self._next = 0
        self.clear()

    def clear(self) -> None:
        """Forget all tracks; numbers are not used again."""
        self._time: float | None = None
        self._state = np.zeros((0, 6))
        self._covariance = np.zeros((0, 6, 6))
        self._number = np.zeros(0, int)
        self._score, self._unseen_s = np.zeros(0), np.zeros(0)

    def update(self, found: FusedPoints) -> TrackedPoints:
        """Return the points of a moment with their tracks.

        Args:
            found: later than the moment before; where time ran back or stood still, tracks begin anew.
        """
        settings = self._settings
        dt = 0.0 if self._time is None else found.time - self._time
        if self._time is not None and not 0.0 < dt <= _LONGEST_STEP_S:
            self.clear()
        self._time = found.time
        if len(self._state):
            self._predict(dt)
        points, covariance = found.points, found.covariance
        off = self._state[:, None, :3] - points
        reach = 3.0 * np.sqrt(np.trace(self._covariance[:, :3, :3], axis1=1, axis2=2)) + settings.reach_m
        i, j = np.nonzero((off * off).sum(-1) < reach[:, None] ** 2)
        square = chi_square(off[i, j], self._covariance[i, :3, :3] + covariance[j])
        near = square < settings.follow
        i, j = matched(i[near], j[near], square[near])
        self._correct(i, points[j], covariance[j])
        gained = np.where(found.depths >= 2, settings.hit_together, settings.hit_alone)
        gained = np.where((found.depths == 1) & (found.rays > 0), settings.hit_together, gained)
        gained = np.where(found.depths == 0, settings.hit_rays, gained)
        hit = np.zeros(len(self._state), dtype=bool)
        hit[i] = True
        self._score[i] += gained[j]
        self._score[~hit] -= settings.miss
        self._score = np.minimum(self._score, settings.most)
        self._unseen_s = np.where(hit, 0.0, self._unseen_s + dt)
        row = np.full(len(points), -1)
        row[j] = i
        row[row < 0] = self._begin(points[row < 0], covariance[row < 0], gained[row < 0])
        tracked = TrackedPoints(found.time, points, covariance, self._number[row], self._score[row])
        self._keep(self._unseen_s <= settings.lost_s)
        return tracked

    def _predict(self, dt: float) -> None:
        F = np.eye(6)
        F[:3, 3:] = dt * np.eye(3)
        noise = self._settings.acceleration_m_s2**2
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
        """Add tracks and return their rows."""
        count, first = len(points), len(self._state)
        state = np.concatenate([points, np.zeros((count, 3))], axis=1)
        P = np.zeros((count, 6, 6))
        P[:, :3, :3] = covariance
        P[:, 3:, 3:] = self._settings.start_speed_m_s**2 * np.eye(3)
        self._state = np.concatenate([self._state, state])
        self._covariance = np.concatenate([self._covariance, P])
        self._number = np.concatenate([self._number, self._next + np.arange(count)])
        self._score = np.concatenate([self._score, self._settings.start + gained])
        self._unseen_s = np.concatenate([self._unseen_s, np.zeros(count)])
        self._next += count
        return first + np.arange(count)

    def _keep(self, rows: np.ndarray) -> None:
        for name in ("_state", "_covariance", "_number", "_score", "_unseen_s"):
            setattr(self, name, getattr(self, name)[rows])
