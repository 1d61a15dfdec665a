"""Everybody that a detector found in one camera's pictures, whatever files hold them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.exchange.hand_points import HAND_COLUMNS, NUM_HAND_POINTS
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.frame_numbers import spans_too_much
from solver_backend.types import UNSEEN_POINT, JointSet

People = list[np.ndarray]
"""(K, 3) x, y in pixels and confidence of each person in one picture, as written."""

Hands = list[np.ndarray | None]
"""(2, 21, 3) x, y and confidence of each person's left and right hand, as written; None where there is none."""


@dataclass(frozen=True)
class CameraFrames:
    """The frames of one camera; people are read when they are asked for."""

    numbers: np.ndarray
    """(N,) frame numbers, ascending."""
    people: Callable[[int], People]
    """People of the frame in this row of ``numbers``."""
    where: Callable[[int], str]
    """The file of the frame in this row, for messages."""
    keypoints: tuple[str, ...] = ()
    """Names of the K keypoints where the files state them."""
    hands: Callable[[int], Hands] | None = None
    """Hands of the people of the frame in this row; None where files hold them in the people's columns, or none."""

    @classmethod
    def in_memory(cls, frames: Mapping[int, People], path: Path, keypoints: tuple[str, ...] = ()) -> CameraFrames:
        """Return frames that one file holds.

        Raises:
            FileDamaged: there are none, or their numbers lie too far apart.
        """
        if not frames:
            raise FileDamaged("The file holds no frames.", where=str(path), hint="Run the detector again.")
        numbers = sorted(frames)
        if spans_too_much(numbers):
            run = f"run from {numbers[0]} to {numbers[-1]}; frames are counted."
            hint = "Number the frames of each camera 0, 1, 2 ..."
            raise FileDamaged(f"The numbers of the {len(numbers)} frames {run}", where=str(path), hint=hint)
        return cls(np.array(numbers, np.int64), lambda row: frames[numbers[row]], lambda _: str(path), keypoints)


def triples(values: object, name: str, where: str) -> np.ndarray:
    """Return (K, 3) from a list of 3 K numbers or of K triples.

    Args:
        values: what the file holds under ``name``.
        name: of the list, for messages.

    Raises:
        FileDamaged: it is no list of numbers.
        KeypointCountMismatch: the list is not made of triples.
    """
    if not isinstance(values, list):
        raise FileDamaged(f"A person in the file lacks '{name}'.", where=where)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged(f"'{name}' holds values that are not numbers.", where=where) from error
    if array.size % 3 or (array.ndim == 2 and array.shape[1] != 3) or array.ndim > 2:
        what = f"'{name}' holds {array.size} numbers; x, y and confidence of each keypoint are expected."
        raise KeypointCountMismatch(what, where=where)
    return array.reshape(-1, 3)


_X, _Y, SCORES = "x", "y", ("score", "confidence", "visibility", "likelihood", "conf", "c", "v", "p")
"""Names of a point's numbers where it is an object of its own, as in MediaPipe's and MoveNet's JSON."""


def are_objects(values: object) -> bool:
    """Whether a list holds points that are objects with x and y."""
    return isinstance(values, list) and bool(values) and isinstance(values[0], dict) and {_X, _Y} <= values[0].keys()


def objects(values: list[Any], where: str) -> np.ndarray:
    """Return (K, 3) from a list of points that are objects with x, y and a score; without one a point is sure.

    Raises:
        FileDamaged: a point lacks x or y, or holds what is no number.
    """
    try:
        points = [
            (point[_X], point[_Y], next((point[name] for name in SCORES if name in point), 1.0)) for point in values
        ]
        return np.array(points, dtype=np.float64).reshape(-1, 3)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("A point in the file lacks x or y, or they are not numbers.", where=where) from error


def names_of_objects(values: list[Any]) -> tuple[str, ...]:
    """Return the names of points that are objects, () where any has none."""
    names = [point.get("name", point.get("part")) if isinstance(point, dict) else None for point in values]
    return tuple(map(str, names)) if all(names) else ()


def points_with_scores(points: object, scores: object, where: str) -> np.ndarray:
    """Return (K, 3) from lists of K points and of K scores.

    Raises:
        FileDamaged: they are no numbers.
        KeypointCountMismatch: the lists differ in length.
    """
    try:
        xy, confidence = np.array(points, dtype=np.float64), np.array(scores, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("'keypoints' or 'keypoint_scores' holds values that are not numbers.", where=where) from error
    if xy.ndim != 2 or xy.shape[1] < 2 or confidence.shape != (len(xy),):
        raise KeypointCountMismatch(
            f"'keypoints' has the shape {xy.shape} and 'keypoint_scores' {confidence.shape}; K points and K scores are "
            "expected.",
            where=where,
        )
    return np.column_stack([xy[:, :2], confidence])


def hands_of(xy: np.ndarray, confidence: np.ndarray, joint_set: JointSet) -> np.ndarray | None:
    """Return the (..., 2, 21, 3) hands of whole bodies, left first; None where the joint set has none.

    Args:
        xy: (..., K, 2) pixels of all K keypoints that were written.
        confidence: (..., K).
        joint_set: what they are.
    """
    firsts = HAND_COLUMNS.get((joint_set, xy.shape[-2]))
    if firsts is None:
        return None
    columns = np.array(firsts)[:, None] + np.arange(NUM_HAND_POINTS)
    return cleaned_hands(np.concatenate([xy[..., columns, :], confidence[..., columns, None]], axis=-1))


def cleaned_hands(hands: np.ndarray) -> np.ndarray:
    """Return hands with confidences in 0..1 and unseen points (0, 0 or NaN) as NaN with confidence 0.

    Args:
        hands: (..., 2, 21, 3) as written.
    """
    unseen = np.isnan(hands).any(-1) | ~(hands[..., 2] > 0) | (hands[..., :2] == 0).all(-1)
    sure, _, _ = on_unit_scale(np.where(unseen, 0.0, hands[..., 2]))
    cleaned = np.concatenate([hands[..., :2], sure[..., None]], axis=-1).astype(np.float32)
    cleaned[unseen] = UNSEEN_POINT
    return cleaned
