"""``keypoints.json``: what a user's own keypoints are on the body, beside the recording or in its session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.detections.named_hands import HAND_LANDMARKS
from solver_backend.io.files import read_json
from solver_backend.types import BONES, JointSet, OwnPoint

FILE = "keypoints.json"


@dataclass(frozen=True)
class OwnKeypoints:
    """What columns of detections are."""

    landmarks: Mapping[str, str | None]
    """Landmark of each own name, None for a point that is left out; other names are matched as usual."""
    order: tuple[str, ...] = ()
    """Names of the columns, where the files name none."""
    where: str = ""
    """The file, for errors."""
    points: tuple[OwnPoint, ...] = ()
    """Those that are no landmark, but at a constant place on a bone."""

    def apply(self, frames: CameraFrames) -> CameraFrames:
        """Return a camera's frames with landmarks for own points; several points that mean one become their mean.

        Raises:
            KeypointCountMismatch: a person has another number of points than there are names; with the first frame.
        """
        names = frames.keypoints or self.order
        if not names:
            return frames
        columns: dict[str, list[int]] = {}
        for column, name in enumerate(names):
            meant = self.landmarks.get(name, name)
            if meant is not None:
                columns.setdefault(meant, []).append(column)

        def people(row: int) -> People:
            found = frames.people(row)
            for person in found:
                if len(person) != len(names):
                    raise KeypointCountMismatch(
                        f"A person has {len(person)} keypoints; {self.where} names {len(names)}.",
                        where=frames.where(row), hint="List every column's name under 'order'.",
                    )  # fmt: skip
            return [_means(person, list(columns.values())) for person in found]

        return replace(frames, people=people, keypoints=tuple(columns))


def find_own_keypoints(levels: Sequence[Path]) -> OwnKeypoints | None:
    """Return the nearest ``keypoints.json``, None where there is none.

    Raises:
        FileDamaged: it is no JSON, or names a landmark or a bone that no body has.
    """
    path = next((level / FILE for level in levels if (level / FILE).is_file()), None)
    return None if path is None else read_own_keypoints(path)


def read_own_keypoints(path: Path) -> OwnKeypoints:
    """Read what own keypoints mean.

    Raises:
        FileDamaged: see ``find_own_keypoints``.
    """
    content = read_json(path)
    values: dict[str, Any] = content if isinstance(content, dict) else {}
    landmarks, order, points = values.get("landmarks", {}), values.get("order", []), values.get("points", {})
    well_formed = isinstance(landmarks, dict) and isinstance(points, dict) and _are_texts(order)
    if not well_formed or not (landmarks or order or points):
        raise FileDamaged(
            "The file does not define the keypoints.", where=str(path),
            hint='Such as {"landmarks": {"kneeR_lateral": "right_knee", "tail": null}, "points": {"watch": {"bone": '
            '"left_forearm"}}}; "order" lists column names.',
        )  # fmt: skip
    known = sorted({name for s in JointSet if s is not JointSet.SMPL_24 for name in s.keypoints} | {*HAND_LANDMARKS})
    unknown = [f"'{name}' is '{m}'" for name, m in landmarks.items() if m is not None and m not in known]
    if unknown:
        raise FileDamaged(
            f"There is no such landmark: {', '.join(unknown[:6])}.", where=str(path),
            hint=f"Landmarks are {', '.join(known)}; null leaves a point out.",
        )  # fmt: skip
    return OwnKeypoints(landmarks, tuple(order or ()), str(path), _own_points(points, landmarks, str(path)))


def _own_points(points: Mapping[str, Any], landmarks: Mapping[str, Any], where: str) -> tuple[OwnPoint, ...]:
    """Return the points on bones.

    Raises:
        FileDamaged: one names no bone, or is a landmark as well.
    """
    bones = {name: value.get("bone") if isinstance(value, dict) else None for name, value in points.items()}
    unknown = [f"'{name}' is on '{bone}'" for name, bone in bones.items() if bone not in BONES]
    if unknown:
        raise FileDamaged(
            f"There is no such bone: {', '.join(unknown[:6])}.", where=where, hint=f"Bones are {', '.join(BONES)}."
        )
    if both := sorted(set(bones) & set(landmarks)):
        raise FileDamaged(f"Both a landmark and a point on a bone: {', '.join(both)}.", where=where)
    return tuple(OwnPoint(name, str(bone)) for name, bone in bones.items())


def _means(person: np.ndarray, columns: Sequence[Sequence[int]]) -> np.ndarray:
    """Return (L, 3) each the mean of several of (K, 3) points, as sure as the least sure; unseen if one of them is."""
    return np.stack([np.concatenate([person[list(c), :2].mean(0), [person[list(c), 2].min()]]) for c in columns])


def _are_texts(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
