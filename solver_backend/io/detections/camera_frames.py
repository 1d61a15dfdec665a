"""Detected people in the frames of one camera, from any kind of file."""

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

People = list[np.ndarray]  # (K, 3) x, y in pixels and confidence of each person in one picture, as written.

NOBODY = -1.0  # Confidence that some programs write where they saw nothing.

Hands = list[np.ndarray | None]
"""(2, 21, 3) x, y and written confidence of each person's left and right hand, or None."""


@dataclass(frozen=True)
class CameraFrames:
    """The frames of one camera. They read people on demand."""

    numbers: np.ndarray
    """(N,) frame numbers, ascending."""
    people: Callable[[int], People]
    """People of the frame in this row of ``numbers``."""
    where: Callable[[int], str]
    """The file of the frame in this row, for messages."""
    keypoints: tuple[str, ...] = ()
    """Names of the K keypoints if the files state them."""
    hands: Callable[[int], Hands] | None = None
    """Hands of the people of the frame in this row, None if the people's columns include them or there are none."""

    @classmethod
    def in_memory(cls, frames: Mapping[int, People], path: Path, keypoints: tuple[str, ...] = ()) -> CameraFrames:
        """Return the frames of one file."""
        if not frames:
            raise FileDamaged("The file has no frames.", where=str(path), hint="Run the detector again.")
        numbers = sorted(frames)
        if spans_too_much(numbers):
            run = f"run from {numbers[0]} to {numbers[-1]}, but frames are counted."
            hint = "Number the frames of each camera 0, 1, 2 ..."
            raise FileDamaged(f"The numbers of the {len(numbers)} frames {run}", where=str(path), hint=hint)
        return cls(np.array(numbers, np.int64), lambda row: frames[numbers[row]], lambda _: str(path), keypoints)

    @classmethod
    def of_array(
        cls, points: np.ndarray, path: Path, keypoints: tuple[str, ...] = (), numbers: Sequence[int] | None = None
    ) -> CameraFrames:
        """Return the frames of (F, P, K, 3) points, without people with confidence 0 everywhere."""
        seen = has_score(points[..., 2]).any(-1)
        counted = zip(numbers or range(len(points)), points, seen, strict=True)
        frames = {number: list(people[there]) for number, people, there in counted}
        return cls.in_memory(frames, path, keypoints)

    @classmethod
    def of_people(
        cls, found: Iterable[tuple[int, np.ndarray]], path: Path, keypoints: tuple[str, ...] = ()
    ) -> CameraFrames:
        """Return the frames of pairs of frame number and person (K, 3). An unseen person leaves an empty frame."""
        frames: dict[int, People] = {}
        for number, person in found:
            here = frames.setdefault(number, [])
            if is_seen(person):
                here.append(person)
        return cls.in_memory(frames, path, keypoints)


def is_seen(person: np.ndarray) -> bool:
    """Return whether any point of a person (K, 3) has a confidence, or the logarithm of one."""
    return bool(has_score(person[:, 2]).any())


def has_score(written: np.ndarray) -> np.ndarray:
    """Return where values are confidences or logarithms. 0, NaN and -1 mean that there is no person."""
    return (np.nan_to_num(written) != 0) & (written != NOBODY)


def hands_of(xy: np.ndarray, confidence: np.ndarray, joint_set: JointSet) -> np.ndarray | None:
    """Return the (..., 2, 21, 3) hands of whole bodies, left first, None if the joint set has none.

    Args:
        xy: (..., K, 2) pixels of all K keypoints that were written.
        confidence: (..., K).
        joint_set: of the keypoints.
    """
    firsts = HAND_COLUMNS.get((joint_set, xy.shape[-2]))
    if firsts is None:
        return None
    columns = np.array(firsts)[:, None] + np.arange(NUM_HAND_POINTS)
    return cleaned_hands(np.concatenate([xy[..., columns, :], confidence[..., columns, None]], axis=-1))[0]


def cleaned_hands(hands: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return (..., 2, 21, 3) hands with confidences in 0..1, unseen points (0, 0 or NaN) as NaN, notes and problems."""
    unseen = np.isnan(hands).any(-1) | ~(hands[..., 2] > 0) | (hands[..., :2] == 0).all(-1)
    sure, notes, problems = on_unit_scale(np.where(unseen, 0.0, hands[..., 2]))
    cleaned = np.concatenate([hands[..., :2], sure[..., None]], axis=-1).astype(np.float32)
    cleaned[unseen] = UNSEEN_POINT
    return cleaned, notes, problems
