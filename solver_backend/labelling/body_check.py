"""Likelihoods of labels by a body: laid over the markers that are sure, it predicts where the others should be."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.tracklets import Tracklets

CHECK_FPS = 8.0
"""Frames a second that a body is laid over."""
SIGMA_M = 0.03
"""How far a marker is from where an uncalibrated body has it, per axis."""
GHOST_M = 0.12
"""A point this far from every place is as likely none of the markers."""
GUESS_WIDER, STEPS = 3.0, 5
"""Where the network has markers that are not sure counts for little; steps that a frame takes."""
BAD_FIT_M = 0.06
"""A body this far from the markers that it is laid over is not used: of all, in the median, or of a limb's."""
FREEDOM = 3.0
"""Degrees of freedom of Student's distribution of these distances: where a limb is posed wrongly, all are off."""
_FARTHEST_M = 0.2
_FEWEST = 12
"""Sure markers that a frame needs."""


class FittedBody(Protocol):
    """A body laid over a frame's markers."""

    @property
    def landmarks(self) -> np.ndarray:
        """(53, 3) metres: where it has the markers."""
        ...

    @property
    def off_m(self) -> float:
        """Median distance of the markers that were seen; NaN where none was."""
        ...


class BodyFit(Protocol):
    """Whatever lays a body over one frame after the other: ``fitters/recipes/live.py``, which may import this."""

    def restart(self) -> None:
        """Forget the pose."""
        ...

    def step(
        self, points: np.ndarray, guess: np.ndarray, guess_sigma: np.ndarray, dt: float, steps: int | None = None
    ) -> FittedBody:
        """Fit a frame's (53, 3) points, NaN where unseen; guesses with (53,) deviations stand in for those."""
        ...


def body_evidence(
    positions: np.ndarray, frames: np.ndarray, guesses: np.ndarray, sigmas: np.ndarray, tracklets: Tracklets,
    labels: np.ndarray, trusted: np.ndarray, fps: float, fit: BodyFit,
) -> np.ndarray:  # fmt: skip
    """Return (C, 54) mean log likelihoods of each chain's labels by the body; 0 where it is not used.

    Args:
        positions: (F, N, 3) metres, NaN where missing.
        frames: (K,) frames that the network read.
        guesses: (K, 53, 3) where it has the markers, and
        sigmas: (K, 53) how surely, metres.
        tracklets: T stretches in C chains.
        labels: (C,) label of each chain.
        trusted: (C,) bool: those that the body is laid over.
        fps: of the take.
        fit: of a body, from its start.
    """
    step = max(1, round(fps / CHECK_FPS / max(1.0, float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0)))
    body, chains = load_body(), tracklets.num_chains
    moved = _moved_with(marker_landmarks(body, MARKERS).weights, body.parents)
    total, count, before = np.zeros((chains, GHOST)), np.zeros(chains), -1
    for row in range(0, len(frames), step):
        frame = int(frames[row])
        columns = np.flatnonzero(tracklets.number[frame] >= 0)
        chain = tracklets.chain[tracklets.number[frame, columns]]
        sure = trusted[chain] & (labels[chain] < GHOST)
        if sure.sum() < _FEWEST:
            continue
        markers = np.full((len(MARKERS), 3), np.nan)
        markers[labels[chain[sure]]] = positions[frame, columns[sure]]
        dt = 0.2 if before < 0 else min((frame - before) / fps, 0.5)
        if before < 0 or (frame - before) / fps > 1.0:
            fit.restart()
        found = fit.step(markers, guesses[row], GUESS_WIDER * sigmas[row], dt, STEPS)
        before = frame
        if not found.off_m < BAD_FIT_M:
            before = -1
            continue
        apart = np.linalg.norm(positions[frame, columns][:, None] - found.landmarks, axis=-1)
        apart = np.where(_limbs_fit(markers, found.landmarks, moved), apart, GHOST_M)
        np.add.at(total, chain, np.minimum(apart, _FARTHEST_M))
        np.add.at(count, chain, 1.0)
    distance = np.where(count[:, None] > 0, total / np.maximum(count, 1.0)[:, None], np.nan)
    far = np.concatenate([distance, np.full((chains, 1), GHOST_M)], axis=1)
    log = -0.5 * (FREEDOM + 1.0) * np.log1p((np.nan_to_num(far) / SIGMA_M) ** 2 / FREEDOM)
    return np.where(count[:, None] > 0, log, 0.0)


def _moved_with(weights: np.ndarray, parents: tuple[int, ...]) -> np.ndarray:
    """Return (53, 53) bool: the second marker hangs on the first one's joint, or farther out on the limb.

    Args:
        weights: (53, J) shares of the joints in the markers.
        parents: (J,) of the joints.
    """
    within = np.eye(len(parents), dtype=bool)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            within[:, joint] |= within[:, parent]
    hangs_on = weights.argmax(axis=1)
    return within[hangs_on][:, hangs_on]


def _limbs_fit(markers: np.ndarray, places: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return (53,) bool: what the body is laid over from a marker's joint on outwards is near it, or is not there.

    A wrist with a bar is no wrist of this body: laid over both ends, it takes a hand for one of them.

    Args:
        markers: (53, 3) metres, NaN where the body is not laid over one.
        places: (53, 3) where the body has them.
        moved: see ``_moved_with``.
    """
    squared = ((markers - places) ** 2).sum(axis=-1)
    laid = moved & np.isfinite(squared)
    mean = (laid * np.nan_to_num(squared)).sum(axis=1) / np.maximum(laid.sum(axis=1), 1)
    return mean < BAD_FIT_M**2
