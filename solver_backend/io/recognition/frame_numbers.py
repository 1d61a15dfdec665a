"""Read frame numbers from file names, and find the common frame range of the cameras."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from solver_backend.agreement.reading import ENOUGH
from solver_backend.exchange.errors import FileDamaged, FrameCountMismatch

_DIGITS = re.compile(r"\d+")
_MOST_DIGITS = len(str(np.iinfo(np.int64).max)) - 1  # Longer hashes or serial numbers overflow an integer.
_STEP_OF_TIMES = 10  # Smallest median step of time stamps.
_SPARSEST = 100  # Smallest range of time stamps per file.


def frame_numbers(stems: Sequence[str], *, where: str) -> np.ndarray:
    """Extract the frame numbers from one camera's file names (without suffix).

    Names may contain other numbers (``cam01.0012``, ``take2_cam1_000012_keypoints``). The frame number is the last
    number that differs between all files.

    Raises:
        FileDamaged: a name has no number, two files have the same number, or the numbers are time stamps.
    """
    groups = [[digits for digits in _DIGITS.findall(stem) if len(digits) <= _MOST_DIGITS] for stem in stems]
    for stem, found in zip(stems, groups, strict=True):
        if not found:
            hint = "Name the files like camera_000012_keypoints.json."
            raise FileDamaged(
                f"'{stem}' contains no frame number of up to {_MOST_DIGITS} digits.", where=where, hint=hint
            )
    width = min(len(found) for found in groups)
    for group in range(1, width + 1):
        numbers = np.array([int(found[-group]) for found in groups], dtype=np.int64)
        if len(np.unique(numbers)) == len(numbers):
            ordered = np.sort(numbers)
            step = float(np.median(np.diff(ordered))) if len(ordered) > 2 else 1.0
            if step < _STEP_OF_TIMES and not spans_too_much(ordered.tolist()):
                return numbers
            span = int(ordered[-1]) - int(ordered[0]) + 1
            how = f"in steps of {step:g}, as times do" if step >= _STEP_OF_TIMES else f"over {span:,} frames"
            what = f"The numbers in the names of the {len(ordered)} files run from {ordered[0]} to {ordered[-1]} {how}."
            hint = "Number the files 0, 1, 2 ... in each camera's folder."
            raise FileDamaged(f"{what} Numbers that count the frames are expected.", where=where, hint=hint)
    numbers = np.array([int(found[-1]) for found in groups])
    values, counts = np.unique(numbers, return_counts=True)
    what = f"{counts.max()} files have the frame number {values[counts.argmax()]}."
    raise FileDamaged(what, where=where, hint="Keep one camera and one take in each folder.")


def counted_together(numbers: Sequence[np.ndarray]) -> list[np.ndarray] | None:
    """Return the (N,) frame numbers of each camera if a single counter numbered all images, otherwise None.

    Such a counter gives the first of four cameras the numbers 0, 4, 8 ..., and the second camera 1, 5, 9 ....
    """
    steps = np.unique(np.concatenate([np.diff(of_camera) for of_camera in numbers]))
    firsts = [int(of_camera[0]) for of_camera in numbers]
    one_each = len(set(firsts)) == len(firsts) and len(steps) == 1 and max(firsts) - min(firsts) < steps[0]
    if len(numbers) < 2 or not one_each:
        return None
    return [(of_camera - min(firsts)) // steps[0] for of_camera in numbers]


def spans_too_much(ordered: Sequence[int]) -> bool:
    """Return whether ascending numbers are too far apart for the frames of one take."""
    return bool(len(ordered)) and ordered[-1] - ordered[0] >= _SPARSEST * max(len(ordered), ENOUGH)


def shared_range(spans: Mapping[str, tuple[int, int]], *, trim: bool) -> tuple[int, int]:
    """Return the first and the last frame number that all cameras have.

    Raises:
        FrameCountMismatch: the ranges differ without ``trim``, or the cameras have no common frame.
    """
    firsts, lasts = zip(*spans.values(), strict=True)
    first, last = max(firsts), min(lasts)
    if first > last or (len(set(spans.values())) > 1 and not trim):
        raise different_frames(spans)
    return first, last


def different_frames(spans: Mapping[str, tuple[int, int]], why: str = "") -> FrameCountMismatch:
    """Return an error that lists the frames of each camera. ``why`` is an additional sentence with the reason."""
    listing = "; ".join(f"{name}: {b - a + 1} (numbers {a} to {b})" for name, (a, b) in spans.items())
    common = min(b for _, b in spans.values()) - max(a for a, _ in spans.values()) + 1
    what = "recorded different numbers of frames" if common > 0 else "have no frame number in common"
    start = f"Synchronise them, or pass --trim to keep the {common} frames that all have,"
    start = start if common > 0 else "Number the frames of all cameras from the same time, or pass"
    hint = f"{start} --by-order to count them from each camera's first frame, or --offset CAMERA=FRAMES."
    return FrameCountMismatch(f"The cameras {what}. {listing}.{' ' * bool(why)}{why}", hint=hint)
