"""Bounds of possible numbers in motions and recordings, which the types of solver and add-on check."""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import MocapError

FRAME_RATES = (0.01, 30_000.0)  # Hz: a picture in 100 seconds, and the fastest cameras that film people.
FARTHEST_M = 1e5  # From the origin, 100 km: recordings in millimetres of a whole town lie within.
FARTHEST_IN_UNITS = 1e9  # The same in a tenth of a millimetre, the smallest unit of files of any length unit.
HIGHEST_STEP_M = 1.0  # Boxes, stairs and stages that people stand on reach at most this high over the floor.
FARTHEST_PX = 1e7  # Pixels from a picture's corner. The largest pictures have a hundredth of that.
LONGEST_S = 1e5
"""Longest recording, more than a day. Milliseconds mistaken for seconds would need all memory."""
LATEST_S = 1e10  # On any clock. Seconds since 1970 are fewer.
LARGEST_BETA = 100.0  # Standard deviations of people. Nobody has more than 5.
LARGEST_TURN = 1000.0  # Radians of an axis-angle vector. Tracks that count turns stay far below.


def require_rate(fps: float, error: type[MocapError], where: str) -> None:
    """Raise an error of the given class if a frame rate is impossible."""
    least, most = FRAME_RATES
    if not (isinstance(fps, int | float | np.number) and least <= fps <= most):
        raise error(f"The frame rate must be {least:g} to {most:g}, not {fps}.", where=where)


def largest_finite(values: np.ndarray) -> float:
    """Return the largest size of the finite numbers, 0 without any."""
    return float(np.abs(values).max(initial=0.0, where=np.isfinite(values)))


def require_within(name: str, values: np.ndarray, most: float, error: type[MocapError], where: str) -> None:
    """Raise an error of a class unless all numbers are finite and within a bound."""
    values = np.asarray(values)
    largest = float(max(values.max(initial=0.0), -values.min(initial=0.0)))
    if not np.isfinite(largest):
        raise error(f"{name} contains NaN or infinite values.", where=where)
    if largest > most:
        raise error(f"{name} contains {largest:.3g}. At most {most:g} is possible.", where=where)


def require_motion(motion: Any, turns: np.ndarray, error: type[MocapError], where: str) -> None:
    """Raise an error of a class unless a motion has frames and its rate, places, turns and shape are possible.

    Args:
        motion: has ``fps``, ``transl``, ``betas`` and ``joints``, (F, J, 3) metres or None.
        turns: axis-angle of the joints, frames first.
    """
    if not len(turns):
        raise error("The motion has no frames.", where=where)
    require_rate(motion.fps, error, where)
    require_within("The pose", turns, LARGEST_TURN, error, where)
    require_within("transl", motion.transl, FARTHEST_M, error, where)
    require_within("betas", motion.betas, LARGEST_BETA, error, where)
    if motion.joints is not None:
        require_within("joints", motion.joints, FARTHEST_M, error, where)
