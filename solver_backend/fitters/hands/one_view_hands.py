"""Hands that one camera alone shows: nothing is located in space, and the detector's noise is what others measured."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.fitters.hands.hand_noise import PALM_M, pixels_per_metre
from solver_backend.fitters.hands.located_hands import HandNoise, LocatedHand
from solver_backend.fitters.measurements.hand_views import HandViews

OWN_PALMS, WHOLE_PALMS = 0.106, 0.05
"""Standard deviations per axis of a point about its hand and of the whole hand, in palms: those of MediaPipe's model on
palms of 35 to 60 px (``python -m tests.benchmarks.hands.real_noise``), which one view cannot measure."""


def hands_of_one_view(views: HandViews, wrists: np.ndarray) -> dict[int, LocatedHand]:
    """Return the hands that one view shows, by side, none of their points located in space.

    Args:
        views: of one camera.
        wrists: (F, 2, 3) metres, of the solved body, left first.
    """
    hands: dict[int, LocatedHand] = {}
    for side in np.flatnonzero((views.confidence > 0).any(axis=(0, 1, 3))).tolist():
        shown = (views.confidence[0, :, side] > 0).any(axis=-1)
        palm_px = PALM_M * float(np.median(pixels_per_metre(views, wrists[:, side])[0, shown]))
        noise = HandNoise(np.full(NUM_HAND_POINTS, OWN_PALMS * palm_px), np.full(1, WHOLE_PALMS * palm_px))
        nowhere = np.full((len(wrists), NUM_HAND_POINTS), np.nan)
        hands[side] = LocatedHand(np.repeat(nowhere[..., None], 3, axis=-1), nowhere, noise)
    return hands
