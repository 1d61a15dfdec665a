"""Folders of OpenPose JSON: one folder a camera, one file a frame, several people a file."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch, NoDetections, NonFiniteData
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.files import LARGEST_TEXT, read_bytes
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.io.recognition.frame_numbers import frame_numbers, shared_range
from solver_backend.io.recognition.joint_sets import choose_joint_set, require_known_count
from solver_backend.people.detections import Detections
from solver_backend.types import JointSet

MAX_PEOPLE = 12
"""People kept in a frame of a view: those with the most keypoints."""
_PROGRESS_STEP = 250
_PADDING = re.compile(r"del_(\d{1,18})_\d+")
"""Files that Pose2Sim writes, without people, where a camera that it moved in time has no frame."""


@dataclass(frozen=True)
class FrameFiles:
    """The files of one camera."""

    paths: tuple[Path, ...]
    """One a frame, by number."""
    numbers: np.ndarray
    """(N,) frame numbers, ascending."""


def json_files(folder: Path) -> list[Path]:
    """Return the JSON files of a folder by name, without hidden ones."""
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if e.name.lower().endswith(".json") and not e.name.startswith(".")]
    return [folder / name for name in sorted(names)]


def list_frames(folder: Path) -> FrameFiles:
    """Return the frame files of a camera's folder in the order of their numbers; a padding file gives way to a frame.

    Raises:
        FileDamaged: the folder holds no JSON, or the names give no frame numbers.
    """
    paths = json_files(folder)
    if not paths:
        raise FileDamaged("The folder holds no JSON files.", where=str(folder), hint="Put one file a frame there.")
    padding = {int(found[1]): path for path in paths if (found := _PADDING.fullmatch(path.stem))}
    filmed = [path for path in paths if not _PADDING.fullmatch(path.stem)]
    by_number = dict(zip(frame_numbers([p.stem for p in filmed], where=str(folder)).tolist(), filmed, strict=True))
    by_number = dict(sorted((padding | by_number).items()))
    return FrameFiles(tuple(by_number.values()), np.array(list(by_number), dtype=np.int64))


def read_people(path: Path) -> list[np.ndarray]:
    """Return (K, 3) x, y, confidence of each person in one frame's file, as written.

    Raises:
        FileDamaged: the file is truncated, is not JSON or is not OpenPose's.
        KeypointCountMismatch: the list is not made of triples.
    """
    data = read_bytes(path, LARGEST_TEXT)
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FileDamaged(
            f"The file is truncated or is not JSON ({error}).",
            where=str(path),
            hint="Export this frame again or delete the file.",
        ) from error
    people = content.get("people") if isinstance(content, dict) else None
    if not isinstance(people, list):
        raise FileDamaged("The file lacks OpenPose's list 'people'.", where=str(path))
    return [person for entry in people if len(person := _person(entry, path))]


def _person(entry: Any, path: Path) -> np.ndarray:
    values = entry.get("pose_keypoints_2d") if isinstance(entry, dict) else None
    if not isinstance(values, list):
        raise FileDamaged("A person in the file lacks 'pose_keypoints_2d'.", where=str(path))
    if len(values) % 3:
        raise KeypointCountMismatch(
            f"'pose_keypoints_2d' holds {len(values)} numbers; x, y and confidence of each keypoint are expected.",
            where=str(path),
        )
    try:
        return np.array(values, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise FileDamaged("'pose_keypoints_2d' holds values that are not numbers.", where=str(path)) from error


def read_detections(
    folders: Mapping[str, Path],
    *,
    joint_set: JointSet | None = None,
    configured: JointSet | None = None,
    trim: bool = False,
    progress: Progress = silent,
) -> Detections:
    """Read everybody in every frame of every camera.

    Frames whose file is missing count as frames in which nobody was found.

    Args:
        folders: folder of each camera by the camera's name.
        joint_set: what the keypoints are; None takes ``configured``, or recognises it.
        configured: what the recording's settings say they are, believed unless the keypoints clearly contradict.
        trim: cut to the frames every camera has.
        progress: called with how many files were read.

    Raises:
        FileDamaged: a file is truncated, not JSON or not OpenPose's.
        FrameCountMismatch: the cameras' frames differ and ``trim`` is off.
        KeypointCountMismatch: people differ in their number of keypoints, or no joint set fits it.
        NoDetections: no file holds anybody.
        NonFiniteData: a coordinate is infinite.
    """
    listed = {name: list_frames(folder) for name, folder in folders.items()}
    first, last = shared_range({n: (int(f.numbers[0]), int(f.numbers[-1])) for n, f in listed.items()}, trim=trim)
    used = [
        (c, int(n) - first, p) for c, f in enumerate(listed.values()) for n, p in zip(f.numbers, f.paths, strict=True)
    ]
    used = [item for item in used if 0 <= item[1] <= last - first]
    people: list[tuple[int, int, list[np.ndarray]]] = []
    for done, (camera, frame, path) in enumerate(used):
        people.append((camera, frame, _strongest(read_people(path))))
        if done % _PROGRESS_STEP == 0:
            progress("Reading the detections", done, len(used))
    progress("Reading the detections", len(used), len(used))
    where = str(next(iter(folders.values())).parent)
    count = _keypoint_count(people, used)
    if count == 0:
        raise NoDetections(
            "The files hold nobody: every list of people is empty.", where=where, hint="Run the detector again."
        )
    require_known_count(count, joint_set, where=where)
    if np.isinf(np.concatenate([person for _, _, persons in people for person in persons])).any():
        _require_finite(people, used)
    xy, confidence, notes, problems = _arrays(len(folders), people, (last - first + 1, count))
    chosen, found, doubts = choose_joint_set(xy, confidence, joint_set, configured, where=where)
    columns = slice(0, chosen.num_keypoints)
    missing = (last - first + 1) * len(folders) - len(people)
    if missing:
        doubts += (f"{missing} frame files are missing; nobody is seen there.",)
    return Detections(
        tuple(folders),
        xy[..., columns, :],
        confidence[..., columns],
        chosen,
        first,
        (*notes, *found),
        (*problems, *doubts),
    )


def _require_finite(people: list[tuple[int, int, list[np.ndarray]]], used: list[tuple[int, int, Path]]) -> None:
    """Raise NonFiniteData with the first file that holds an infinite number."""
    for (_, _, persons), (_, _, path) in zip(people, used, strict=True):
        for person in persons:
            if np.isinf(person).any():
                raise NonFiniteData(
                    f"Keypoint {int(np.isinf(person).any(1).argmax())} of a person is infinite.",
                    where=str(path),
                    hint="Write 0 0 0 for a keypoint that was not seen.",
                )


def _strongest(people: list[np.ndarray]) -> list[np.ndarray]:
    if len(people) <= MAX_PEOPLE:
        return people
    strength = [float(np.nansum(person[:, 2])) for person in people]
    keep = sorted(np.argsort(strength)[::-1][:MAX_PEOPLE])
    return [people[i] for i in keep]


def _keypoint_count(people: list[tuple[int, int, list[np.ndarray]]], used: list[tuple[int, int, Path]]) -> int:
    count = 0
    for (_, _, persons), (_, _, path) in zip(people, used, strict=True):
        for person in persons:
            if count and len(person) != count:
                raise KeypointCountMismatch(
                    f"A person has {len(person)} keypoints where those before have {count}.",
                    where=str(path),
                    hint="Use one detector with one model for the whole take.",
                )
            count = len(person)
    return count


def _arrays(
    cameras: int, people: list[tuple[int, int, list[np.ndarray]]], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], tuple[str, ...]]:
    """Return xy (C, F, P, K, 2), confidence (C, F, P, K), notes and problems; ``size`` is (F, K)."""
    most = max(len(persons) for _, _, persons in people)
    values = np.full((cameras, size[0], most, size[1], 3), np.nan, dtype=np.float32)
    for camera, frame, persons in people:
        if persons:
            values[camera, frame, : len(persons)] = persons
    return _cleaned(values)


def _cleaned(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...], tuple[str, ...]]:
    """Split into pixels and confidence; what a detector writes for 'not seen' becomes NaN with confidence 0."""
    xy, confidence = values[..., :2].copy(), values[..., 2].copy()
    contradictory = np.isnan(xy).any(-1) & (confidence > 0)
    missing = np.isnan(values).any(-1) | ~(confidence > 0) | (xy == 0).all(-1)
    xy[missing], confidence[missing] = np.nan, 0.0
    confidence, notes, problems = on_unit_scale(confidence)
    if contradictory.any():
        count = int(contradictory.sum())
        problems = (f"{count} keypoints are NaN with a confidence; they are taken as not seen.", *problems)
    return xy, confidence, notes, problems
