"""A hand that no body carries, from its markers: placed by those of the palm, then solved as a body's hand is."""

from __future__ import annotations

import numpy as np

from solver_backend.body.hand_markers import PLACES, HandMarkers, hand_markers
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.marker_hand import MarkerHand, calibrated_hand, marker_size
from solver_backend.fitters.hands.solve_hand import WristPath
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.types.shapes import Float

LAYOUTS: dict[str, tuple[str, ...]] = {
    "hand26": tuple(PLACES),
    "hand10": ("FT1", "FT2", "FT3", "FT4", "FT5", "PP2", "PP4", "MP2", "MP5", "CMC2"),
    "hand5": ("FT1", "FT2", "FT4", "MP2", "MP5"),
    "hand3": ("FT1", "FT2", "MP5"),
}
"""Labels of a hand by layout; wrist and forearm are a body's. Few markers leave most fingers to the prior."""


def solve_marker_hand(
    positions: Float[np.ndarray, "frames markers 3"], labels: tuple[str, ...], skeleton: HandSkeleton, fps: float
) -> MarkerHand:
    """Return a hand from markers that no body carries.

    Args:
        positions: (F, M, 3) metres, NaN where missing.
        labels: M labels of ``hand_markers.PLACES``; others are left out.
        skeleton: of a hand of the same side and common size.
        fps: frames per second.
    """
    known = [labels.index(label) for label in hand_markers(skeleton, labels).labels]
    positions = positions[:, known]
    own = tuple(labels[k] for k in known)
    skeleton = skeleton.scaled(marker_size(skeleton, own, positions))
    markers = hand_markers(skeleton, own)
    return calibrated_hand(positions, markers, skeleton, palm_path(markers, positions, fps), fps, SolveSettings())


def palm_path(markers: HandMarkers, positions: np.ndarray, fps: float) -> WristPath:
    """Return where the palm's markers put the wrist, smoothed over a tenth of a second; between frames that show it."""
    palm = markers.sites.segment == 0
    here, rest = positions[:, palm], markers.sites.offset[palm]
    seen = np.isfinite(here).all(-1)
    located = np.flatnonzero(seen.sum(1) >= 3)
    here, weight = here[located], seen[located][..., None]
    count = weight.sum(1, keepdims=True)
    middle = np.where(weight, here, 0.0).sum(1, keepdims=True) / count
    below = np.where(weight, rest, 0.0).sum(1, keepdims=True) / count
    turned = np.swapaxes(np.where(weight, here - middle, 0.0), 1, 2) @ np.where(weight, rest - below, 0.0)
    R = nearest_rotation(turned)
    t = (middle - np.swapaxes(R @ np.swapaxes(below, 1, 2), 1, 2))[:, 0]
    frames = np.arange(len(positions))
    near = np.exp(-0.5 * ((frames[:, None] - located) / (0.05 * fps)) ** 2)
    near += 1e-6 / (1.0 + np.abs(frames[:, None] - located)) ** 2
    near /= near.sum(1, keepdims=True)
    return WristPath(nearest_rotation((near @ R.reshape(len(R), 9)).reshape(-1, 3, 3)), near @ t)
