"""Store the people that one camera shows in each frame, independent of the file format."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.joint_sets import HAND_COLUMNS, NUM_HAND_POINTS
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.frame_numbers import spans_too_much
from solver_backend.types import UNSEEN_POINT, JointSet

People = list[np.ndarray]  # Per person in an image: (K, 3) x and y in pixels, and the confidence in the file.

NOBODY = -1.0  # Confidence that some programs write for undetected points.

Hands = list[np.ndarray | None]
"""Per person in an image: hands (2, 21, 3), left first, x and y in pixels and confidence in the file, or None."""


@dataclass(frozen=True)
class CameraFrames:
    """The detections in one camera's frames. Each frame is only read when ``people`` is called for it."""

    numbers: np.ndarray
    """(N,) frame numbers, ascending."""
    people: Callable[[int], People]
    """Function that returns the people in the frame at a given row of ``numbers``."""
    where: Callable[[int], str]
    """Function that returns the file of the frame at a given row, for messages."""
    keypoints: tuple[str, ...] = ()
    """Names of the K keypoints, or empty if the files do not state them."""
    hands: Callable[[int], Hands] | None = None
    """Function that returns the people's hands at a given row. None without hands or if the keypoints include them."""

    @classmethod
    def in_memory(cls, frames: Mapping[int, People], path: Path, keypoints: tuple[str, ...] = ()) -> CameraFrames:
        """Build camera frames from a mapping of frame numbers to the people in each frame."""
        if not frames:
            raise FileDamaged("The file has no frames.", where=str(path), hint="Run the detector again.")
        numbers = sorted(frames)
        if spans_too_much(numbers):
            run = f"run from {numbers[0]} to {numbers[-1]}, far beyond the number of frames."
            hint = "Number the frames of each camera 0, 1, 2 ..."
            raise FileDamaged(f"The numbers of the {len(numbers)} frames {run}", where=str(path), hint=hint)
        return cls(np.array(numbers, np.int64), lambda row: frames[numbers[row]], lambda _: str(path), keypoints)

    @classmethod
    def of_array(
        cls, points: np.ndarray, path: Path, keypoints: tuple[str, ...] = (), numbers: Sequence[int] | None = None
    ) -> CameraFrames:
        """Build camera frames from points (F, P, K, 3). People without any confident point are omitted."""
        seen = has_score(points[..., 2]).any(-1)
        counted = zip(numbers or range(len(points)), points, seen, strict=True)
        frames = {number: list(people[there]) for number, people, there in counted}
        return cls.in_memory(frames, path, keypoints)

    @classmethod
    def of_people(
        cls, found: Iterable[tuple[int, np.ndarray]], path: Path, keypoints: tuple[str, ...] = ()
    ) -> CameraFrames:
        """Build camera frames from pairs of a frame number and a person (K, 3)."""
        frames: dict[int, People] = {}
        for number, person in found:
            here = frames.setdefault(number, [])
            if is_seen(person):
                here.append(person)
        return cls.in_memory(frames, path, keypoints)


def is_seen(person: np.ndarray) -> bool:
    """Return whether a detector found at least one point of a person (K, 3)."""
    return bool(has_score(person[:, 2]).any())


def has_score(written: np.ndarray) -> np.ndarray:
    """Return a mask of the detected points, given their confidences or log-confidences in the file."""
    return (np.nan_to_num(written) != 0) & (written != NOBODY)


def hands_of(xy: np.ndarray, confidence: np.ndarray, joint_set: JointSet) -> np.ndarray | None:
    """Extract hands (..., 2, 21, 3) from whole-body keypoints, left first, or return None if there are no hand points.

    Args:
        xy: (..., K, 2) pixels of all K keypoints in the file.
        confidence: (..., K) confidences in the file.
        joint_set: joint set of the keypoints.
    """
    firsts = HAND_COLUMNS.get((joint_set, xy.shape[-2]))
    if firsts is None:
        return None
    columns = np.array(firsts)[:, None] + np.arange(NUM_HAND_POINTS)
    return cleaned_hands(np.concatenate([xy[..., columns, :], confidence[..., columns, None]], axis=-1))[0]


def cleaned_hands(hands: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Replace undetected points in hands (..., 2, 21, 3) by NaN. Also return notes and warnings."""
    unseen = np.isnan(hands).any(-1) | ~(hands[..., 2] > 0) | (hands[..., :2] == 0).all(-1)
    sure, notes, problems = on_unit_scale(np.where(unseen, 0.0, hands[..., 2]))
    cleaned = np.concatenate([hands[..., :2], sure[..., None]], axis=-1).astype(np.float32)
    cleaned[unseen] = UNSEEN_POINT
    return cleaned, notes, problems
