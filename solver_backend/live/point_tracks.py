"""Points followed from frame to frame, with what the network has labelled each of them so far."""

from __future__ import annotations

import numpy as np

from solver_backend.labelling.outputs import GHOST

REACH_M, REACH_M_S = 0.03, 2.0
"""A point is the same as one of the frame before within 3 cm of where that was going, and 2 m/s more."""
MEMORY_S = 0.7
"""Time in which earlier labels fade."""
LOST_S = 0.15
"""Time for which a point that went away may come back."""
_FLOOR = -6.0
"""Evidence of one frame at least, a log-probability: one frame does not outweigh a track; chosen by hand."""


class PointTracks:
    """Which points of a frame are those of the frame before."""

    def __init__(self) -> None:
        self.position = np.zeros((0, 3))
        self.velocity = np.zeros((0, 3))
        self.evidence = np.zeros((0, GHOST + 1))
        self.unseen_s = np.zeros(0)

    def clear(self) -> None:
        """Forget all of them."""
        self.__init__()

    def update(self, points: np.ndarray, log_probability: np.ndarray, dt: float) -> np.ndarray:
        """Return the (N, 54) evidence of the points of a frame: what their tracks have gathered, and this frame's.

        Args:
            points: (N, 3) metres.
            log_probability: (N, 54) of this frame.
            dt: seconds since the last frame.
        """
        before = self._matched(points, dt)
        known = before >= 0
        evidence = np.maximum(log_probability, _FLOOR)
        fade = np.exp(-dt / MEMORY_S)
        evidence[known] += fade * self.evidence[before[known]]
        velocity = np.zeros_like(points)
        velocity[known] = 0.5 * self.velocity[before[known]] + 0.5 * (
            points[known] - self.position[before[known]]
        ) / np.maximum(dt + self.unseen_s[before[known], None], 1e-4)
        waiting = np.ones(len(self.position), dtype=bool)
        waiting[before[known]] = False
        waiting &= self.unseen_s + dt < LOST_S
        self.position = np.concatenate([points, self.position[waiting]])
        self.velocity = np.concatenate([velocity, self.velocity[waiting]])
        self.evidence = np.concatenate([evidence, self.evidence[waiting]])
        self.unseen_s = np.concatenate([np.zeros(len(points)), self.unseen_s[waiting] + dt])
        return evidence

    def _matched(self, points: np.ndarray, dt: float) -> np.ndarray:
        """Return (N,) the track that each point goes on from: pairs that are each other's nearest; -1 for none."""
        found = np.full(len(points), -1)
        if not len(self.position) or not len(points):
            return found
        ahead = self.position + self.velocity * (self.unseen_s + dt)[:, None]
        square = (points * points).sum(1)[:, None] + (ahead * ahead).sum(1)[None] - 2.0 * points @ ahead.T
        nearest, back = square.argmin(1), square.argmin(0)
        rows = np.arange(len(points))
        reach = REACH_M + REACH_M_S * (dt + self.unseen_s[nearest])
        mutual = (back[nearest] == rows) & (square[rows, nearest] < reach**2)
        found[mutual] = nearest[mutual]
        return found
