"""Extract frame numbers from file names, and find the common frame range."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.agreement.reading import ENOUGH
from solver_backend.exchange.errors import FileDamaged, FrameCountMismatch, JobInvalid
from solver_backend.types import Capture, MarkerCloud

_DIGITS = re.compile(r"\d+")
_MOST_DIGITS = len(str(np.iinfo(np.int64).max)) - 1  # Longer hashes or serial numbers overflow an integer.
_STEP_OF_TIMES = 10  # Smallest typical step between numbers that do not count frames.
_SPARSEST = 100  # Largest range of frame numbers per file, for at least ``ENOUGH`` files.


def frame_numbers(stems: Sequence[str], *, where: str) -> np.ndarray:
    """Return the frame number of each file of one camera, from the names without suffix.

    Names may contain other numbers (``cam01.0012``, ``take2_cam1_000012_keypoints``). The frame number is the last
    group of digits that differs between all files.

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
            return _counted(numbers, where)
    numbers = np.array([int(found[-1]) for found in groups])
    values, counts = np.unique(numbers, return_counts=True)
    what = f"{counts.max()} files have the frame number {values[counts.argmax()]}."
    raise FileDamaged(what, where=where, hint="Keep one camera and one take in each folder.")


def _counted(numbers: np.ndarray, where: str) -> np.ndarray:
    """Return the numbers if they can count frames.

    Raises:
        FileDamaged: the numbers are too far apart. They are time stamps, or some have another meaning.
    """
    ordered = np.sort(numbers)
    step = float(np.median(np.diff(ordered))) if len(ordered) > 2 else 1.0
    if step < _STEP_OF_TIMES and not spans_too_much(ordered.tolist()):
        return numbers
    span = int(ordered[-1]) - int(ordered[0])
    how = f"in steps of {step:g}, as times do" if step >= _STEP_OF_TIMES else f"over {span + 1:,} frames"
    what = f"The numbers in the names of the {len(ordered)} files run from {ordered[0]} to {ordered[-1]} {how}. "
    hint = "Number the files 0, 1, 2 ... in each camera's folder."
    raise FileDamaged(f"{what}Numbers that count the frames are expected.", where=where, hint=hint)


def counted_together(numbers: Sequence[np.ndarray]) -> list[np.ndarray] | None:
    """Return the (N,) frames of each camera if one counter numbered all images, or None.

    The first camera then has 0, 4, 8 ..., the second one 1, 5, 9 .... The steps are equal, and no two cameras share a
    number.
    """
    steps = np.unique(np.concatenate([np.diff(of_camera) for of_camera in numbers]))
    firsts = [int(of_camera[0]) for of_camera in numbers]
    if len(numbers) < 2 or len(steps) != 1 or steps[0] < len(numbers) or len(set(firsts)) < len(firsts):
        return None
    if max(firsts) - min(firsts) >= steps[0]:
        return None
    return [(of_camera - min(firsts)) // steps[0] for of_camera in numbers]


def spans_too_much(ordered: Sequence[int]) -> bool:
    """Return whether ascending numbers are too far apart for the frames of one take."""
    return bool(len(ordered)) and ordered[-1] - ordered[0] >= _SPARSEST * max(len(ordered), ENOUGH)


def shared_range(spans: Mapping[str, tuple[int, int]], *, trim: bool) -> tuple[int, int]:
    """Return the first and last frame number that all cameras use, or have if ``trim`` is true.

    Raises:
        FrameCountMismatch: the ranges differ and ``trim`` is False, or the cameras have no common frame.
    """
    firsts, lasts = zip(*spans.values(), strict=True)
    if len(set(spans.values())) == 1:
        return firsts[0], lasts[0]
    first, last = max(firsts), min(lasts)
    if first > last or not trim:
        raise different_frames(spans)
    return first, last


def different_frames(spans: Mapping[str, tuple[int, int]], why: str = "") -> FrameCountMismatch:
    """Return the error about cameras with different frames, with the reason ``why`` as a sentence."""
    listing = "; ".join(f"{name}: {b - a + 1} (numbers {a} to {b})" for name, (a, b) in spans.items())
    common = min(b for _, b in spans.values()) - max(a for a, _ in spans.values()) + 1
    what = "recorded different numbers of frames" if common > 0 else "have no frame number in common"
    start = f"Synchronise them, or pass --trim to keep the {common} frames that all have,"
    start = start if common > 0 else "Number the frames of all cameras from the same time, or pass"
    hint = f"{start} --by-order to count them from each camera's first frame, or --offset CAMERA=FRAMES."
    return FrameCountMismatch(f"The cameras {what}. {listing}.{' ' * bool(why)}{why}", hint=hint)


def cut_frames(capture: Capture, first: int, last: int) -> Capture:
    """Return the frames ``first`` to ``last`` of a capture, with truth and footage.

    Raises:
        JobInvalid: the take has no such frames.
    """
    count = capture.num_frames
    if not 0 <= first <= last < count:
        what = f"Frames {first} to {last} are not a valid range in this take of {count} frames."
        raise JobInvalid(what, where="frames", hint=f"Choose frames from 0 to {count - 1}, the earlier one first.")
    stop = last + 1
    keypoints, markers, others = capture.keypoints, capture.markers, capture.others
    people = tuple(replace(p, keypoints=p.keypoints.frames(first, stop)) for p in capture.people)
    footage_first = capture.footage_first or (0,) * len(capture.footage)
    return replace(
        capture,
        cameras=None if capture.cameras is None else capture.cameras.at(slice(first, stop)),
        keypoints=None if keypoints is None else keypoints.frames(first, stop),
        markers=None if markers is None else _cut_markers(markers, first, stop),
        others=None if others is None else _cut_markers(others, first, stop),
        people=people,
        footage_first=tuple(picture + first for picture in footage_first),
        truth={name: _cut_truth(values, count, first, stop) for name, values in capture.truth.items()},
    )


def _cut_markers(markers: MarkerCloud, first: int, stop: int) -> MarkerCloud:
    residual, covariance = (None if v is None else v[first:stop] for v in (markers.residual, markers.covariance))
    return replace(markers, positions=markers.positions[first:stop], residual=residual, covariance=covariance)


def _cut_truth(values: np.ndarray, count: int, first: int, stop: int) -> np.ndarray:
    """Cut ground truth, (F, ...) or (C, F, ...), to frames ``first`` to ``stop``."""
    if values.ndim and len(values) == count:
        return values[first:stop]
    return values[:, first:stop] if values.ndim > 1 and values.shape[1] == count else values
