"""When does a view contradict the others: frame ranges in which most of its detections are outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.cameras.view_checks.two_state_viterbi import best_states
from solver_backend.geometry.runs import true_runs
from solver_backend.types import Cameras

OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING = 0.15, 0.7
"""Share of outliers in a view that agrees, and in one that does not; chance lets some keypoints agree."""
FRAME_WEIGHT = 6.0
"""A frame's keypoints count as so many independent ones."""
SWITCH_COST = 15.0
"""Cost of a change between the two."""
TRIED_FRAMES = 16
"""Frames of a range on which explanations are tried."""
DISAGREEING_SIGMAS = 3.0
"""Residual that counts half in the misfit."""


@dataclass(frozen=True)
class ViewRange:
    """Frames first..last of a view."""

    view: int
    first: int
    last: int

    @property
    def length(self) -> int:
        """Number of frames."""
        return self.last - self.first + 1

    @property
    def frames(self) -> slice:
        """The frames as a slice."""
        return slice(self.first, self.last + 1)

    def sample(self, count: int = TRIED_FRAMES) -> np.ndarray:
        """Return up to ``count`` frames spread over the range."""
        return np.unique(np.linspace(self.first, self.last, min(count, self.length)).round().astype(int))


def inconsistent_ranges(triangulation: Triangulation, confidence: np.ndarray, least_frames: float) -> list[ViewRange]:
    """Return the frame ranges in which a view contradicts the others, the longest first.

    A two-state Markov chain for each view; the outliers of a frame are binomial with the one or the other share. A
    keypoint that three views see and no two agree on is an outlier in each.

    Args:
        triangulation: of all detections.
        confidence: (C, F, K), 0 where missing.
        least_frames: shorter ranges are left out.

    Reference: Viterbi 1967; Rabiner 1989, "A tutorial on hidden Markov models".
    """
    inliers = np.asarray(triangulation.inliers)
    located = np.isfinite(np.asarray(triangulation.residual_px))
    checked = (confidence > 0) & (located | ((confidence > 0).sum(axis=0) >= 3))
    good, bad = (checked & inliers).sum(-1), (checked & ~inliers).sum(-1)
    weight = FRAME_WEIGHT / np.maximum(good + bad, FRAME_WEIGHT)
    unary = np.stack(
        [-weight * (good * np.log(1 - p) + bad * np.log(p)) for p in (OUTLIERS_AGREEING, OUTLIERS_CONTRADICTING)],
        axis=-1,
    )
    transition = np.zeros((*unary.shape, 2))
    transition[..., 0, 1] = transition[..., 1, 0] = SWITCH_COST
    found = [ViewRange(*run) for run in view_runs(best_states(unary, transition))]
    long = [s for s in found if s.length >= least_frames]
    return sorted(long, key=lambda s: (s.first - s.last, s.view))


def view_runs(states: np.ndarray) -> list[tuple[int, int, int]]:
    """Return view, first and last frame of each run of true states (C, F)."""
    return [(view, *run) for view, mask in enumerate(states) for run in true_runs(mask)]


def misfit(cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, sigma_px: np.ndarray) -> np.ndarray:
    """Return (C,) mean of ``r²/(r² + (3σ)²)`` over each view's detections, 1 where no point is located.

    Args:
        cameras: C cameras.
        xy: (C, F, K, 2) px.
        confidence: (C, F, K), 0 where missing.
        sigma_px: (K,) standard deviation of the detections, px.

    Reference: Geman and McClure 1987.
    """
    square = np.asarray(triangulate(cameras, xy, confidence, sigma_px).residual_px) ** 2
    share = np.where(np.isfinite(square), square / (square + (DISAGREEING_SIGMAS * sigma_px) ** 2), 1.0)
    seen = confidence > 0
    return np.where(seen, share, 0.0).sum(axis=(1, 2)) / np.maximum(seen.sum(axis=(1, 2)), 1)
