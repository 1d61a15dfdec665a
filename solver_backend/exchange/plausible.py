"""Define the limits of possible numbers in motions and recordings."""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import MocapError

FRAME_RATES = (0.01, 30_000.0)  # Hz, from an image every 100 seconds to the fastest cameras used to film people.
USUAL_FRAME_RATES = (1.0, 1000.0)  # Hz. Other rates are reported.
FARTHEST_M = 1e5  # Metres from the origin (100 km). Even a whole town recorded in millimetres is within this distance.
FARTHEST_IN_UNITS = 1e9  # The same distance in 0.1 mm, the smallest length unit used in files.
HIGHEST_STEP_M = 1.0  # Largest height of boxes, stairs and stages above the floor, in metres.
FARTHEST_PX = 1e7  # Pixels from the image corner. The largest images have 1 % of this.
LONGEST_S = 1e5
"""Longest recording in seconds, more than a day. Milliseconds mistaken for seconds would exhaust the memory."""
LATEST_S = 1e10  # Largest time stamp in seconds. The number of seconds since 1970 is smaller.
LARGEST_BETA = 100.0  # Largest shape coefficient in standard deviations. No person exceeds 5.
LARGEST_TURN = 1000.0  # Longest rotation vector in radians. Even tracks that count full turns stay far below it.


def require_rate(fps: float, error: type[MocapError], where: str) -> None:
    """Raise an error of the given class if a frame rate is impossible."""
    least, most = FRAME_RATES
    if not (isinstance(fps, int | float | np.number) and least <= fps <= most):
        raise error(f"The frame rate must be {least:g} to {most:g}, not {fps}.", where=where)


def largest_finite(values: np.ndarray) -> float:
    """Return the largest magnitude of the finite numbers, or 0 if there are none."""
    return float(np.abs(values).max(initial=0.0, where=np.isfinite(values)))


def require_within(name: str, values: np.ndarray, most: float, error: type[MocapError], where: str) -> None:
    """Raise the given error unless all numbers are finite and have magnitudes up to ``most``."""
    values = np.asarray(values)
    largest = float(max(values.max(initial=0.0), -values.min(initial=0.0)))
    if not np.isfinite(largest):
        raise error(f"{name} contains NaN or infinite values.", where=where)
    if largest > most:
        raise error(f"{name} contains {largest:.3g}. At most {most:g} is possible.", where=where)


def require_motion(motion: Any, turns: np.ndarray, error: type[MocapError], where: str) -> None:
    """Raise the given error unless all numbers in a motion are possible.

    Args:
        motion: object with ``fps``, ``transl``, ``betas`` and ``joints`` ((F, J, 3) metres or None).
        turns: rotation vectors of the joints, frames first.
    """
    if not len(turns):
        raise error("The motion has no frames.", where=where)
    require_rate(motion.fps, error, where)
    require_within("The pose", turns, LARGEST_TURN, error, where)
    require_within("transl", motion.transl, FARTHEST_M, error, where)
    require_within("betas", motion.betas, LARGEST_BETA, error, where)
    if motion.joints is not None:
        require_within("joints", motion.joints, FARTHEST_M, error, where)
