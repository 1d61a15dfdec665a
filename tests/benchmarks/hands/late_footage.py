"""Effect of the limits of ``footage_shift``: found, missed and wrong shifts on takes with a known shift.

``python -m tests.benchmarks.hands.late_footage`` uses segments of 1.5 s of the embedded demo with hands, with four
detector seeds and footage that is late by -3 to 3 pictures, and as many segments of resting hands with the same
detectors.
"""

from __future__ import annotations

import itertools
import sys
from unittest.mock import patch

import numpy as np

from solver_backend.videos.detect import find_hands as module
from solver_backend.videos.detect.find_hands import arms_of
from tests.support.handed_take import handed_take

SEEDS, FRAMES, PIECE, SHIFTS = range(4), 180, 45, range(-3, 4)
MOVES, AGREE = (0.3, 0.5, 0.7, 1.0), (0.0, 0.5, 0.75, 0.9)
HAND_PX, WRIST_PX = 3.0, 4.0
"""Standard deviations in pixels per axis of a resting hand's wrist and the body's wrist, as in the demo's detectors."""


def pieces(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return hands and wrists of segments of a take, each moving and at rest."""
    capture, rng = handed_take(FRAMES, seed=seed).capture, np.random.default_rng(seed)
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    hands, wrists = capture.keypoints.hands, arms_of(capture)[0].detected[:, :, 1]
    found = []
    for part in (slice(a, a + PIECE) for a in range(0, FRAMES - PIECE + 1, PIECE)):
        hand, wrist = hands[:, part], wrists[:, part]
        still, held = (np.repeat(np.nanmedian(x, axis=1, keepdims=True), PIECE, axis=1) for x in (hand, wrist))
        still[..., :2] += rng.normal(0.0, HAND_PX, (*still.shape[:3], 1, 2))
        held[..., :2] += rng.normal(0.0, WRIST_PX, held[..., :2].shape)
        found += [(hand, wrist), (still, held)]
    return found


def main() -> None:
    """Print counts by pairs of limits."""
    cut = [piece for seed in SEEDS for piece in pieces(seed)]
    moving, resting = cut[::2], cut[1::2]
    sys.stdout.write(
        f"MOVES AGREE  found missed wrong of {len(moving) * len(SHIFTS)}  invented at rest of {len(resting)}\n"
    )
    for moves, agree in itertools.product(MOVES, AGREE):
        with patch.multiple(module, MOVES=moves, AGREE=agree):
            pairs = [
                (late, module.footage_shift(module.in_time(hands, -late), wrists))
                for (hands, wrists), late in itertools.product(moving, SHIFTS)
            ]
            invented = sum(module.footage_shift(hands, wrists) != 0 for hands, wrists in resting)
        right = sum(late == found for late, found in pairs)
        missed = sum(found == 0 != late for late, found in pairs)
        wrong = len(pairs) - right - missed
        sys.stdout.write(f"{moves:5.2f} {agree:5.2f}  {right:5d} {missed:6d} {wrong:5d}  {invented:8d}\n")


if __name__ == "__main__":
    main()
