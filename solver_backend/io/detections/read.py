"""Read everybody in every frame of every camera, from whatever files hold them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import KeypointCountMismatch, NoDetections, NonFiniteData
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People, cleaned_hands, hands_of
from solver_backend.io.detections.named_keypoints import NamedKeypoints, OwnKeypoints, match_cameras, with_named_hands
from solver_backend.io.detections.search import CameraSource
from solver_backend.io.recognition.confidence import on_unit_scale, placeholder
from solver_backend.io.recognition.frame_numbers import counted_together, shared_range
from solver_backend.io.recognition.joint_sets import HANDS_ALONE, choose_joint_set, require_known_count
from solver_backend.types import JointSet, OwnPoint

MAX_PEOPLE = 12
"""People kept in a frame of a view: those with the most keypoints."""
_PROGRESS_STEP = 250
"""Frames from one report of progress to the next; chosen by hand."""


@dataclass(frozen=True)
class _Picture:
    """Everybody in one frame of one camera."""

    camera: int
    frame: int
    where: str
    people: People
    hands: Hands


def read_detections(
    sources: Mapping[str, CameraSource],
    *,
    joint_set: JointSet | None = None,
    configured: JointSet | None = None,
    trim: bool = False,
    apart: bool = False,
    own: OwnKeypoints | None = None,
    progress: Progress = silent,
) -> Detections:
    """Read everybody in every frame of every camera.

    Frames whose file is missing count as frames in which nobody was found.

    Args:
        sources: where each camera's detections lie, by the camera's name.
        joint_set: what the keypoints are; None takes the names in the files or ``configured``, or recognises it.
        configured: what the recording's settings state, believed unless the keypoints clearly contradict.
        trim: cut to the frames every camera has.
        apart: read each camera from its own first frame to its last, where they differ.
        own: what the user's own keypoint names mean.
        progress: called with how many frames were read.

    Raises:
        FileDamaged: a file is truncated, or of no program that is known.
        FrameCountMismatch: the cameras' frames differ, and both ``trim`` and ``apart`` are off.
        KeypointCountMismatch: people differ in their number of keypoints, or no joint set fits it.
        NoDetections: no file holds anybody.
        NonFiniteData: a coordinate is infinite.
    """
    listed = {name: source.frames() for name, source in sources.items()}
    if own is not None:
        listed = {name: own.apply(frames) for name, frames in listed.items()}
    listed = {name: with_named_hands(frames) for name, frames in listed.items()}
    counted = counted_together([frames.numbers for frames in listed.values()])
    if counted is not None:
        listed = {n: replace(frames, numbers=of_n) for (n, frames), of_n in zip(listed.items(), counted, strict=True)}
    spans = {name: (int(frames.numbers[0]), int(frames.numbers[-1])) for name, frames in listed.items()}
    apart = apart and len(set(spans.values())) > 1
    if not apart:
        spans = dict.fromkeys(spans, shared_range(spans, trim=trim))
    lengths = tuple(last - first + 1 for first, last in spans.values())
    where = str(next(iter(sources.values())).path.parent)
    pictures = _pictures(list(listed.values()), list(spans.values()), progress)
    columns_named = [frames.keypoints for frames in listed.values()]
    points = () if own is None or not all(columns_named) else own.points
    named = match_cameras(columns_named, joint_set, [point.name for point in points], where=where)
    if named:
        _require_counts(pictures, [len(frames.keypoints) for frames in listed.values()])
        pictures = [replace(p, people=[named[p.camera].ordered(person) for person in p.people]) for p in pictures]
        joint_set = named[0].joint_set
    written = _keypoint_count(pictures)
    if written == 0:
        hint = f"Run the detector again. {HANDS_ALONE}"
        raise NoDetections("Nobody was detected: every list of people in the files is empty.", where=where, hint=hint)
    count = written - len(points)
    require_known_count(count, joint_set, where=where)
    _require_finite(pictures)
    xy, confidence, notes, problems = _arrays(len(sources), pictures, (max(lengths), written))
    body, sure = xy[..., :count, :], confidence[..., :count]
    chosen, found, doubts = choose_joint_set(body, sure, joint_set, configured, where=where)
    if named:
        source, file = ("file", own.where) if own else ("names", "")
        found = (diagnostic("joint_set_chosen", source=source, file=file, joint_set=chosen.value),)
        if unknown := dict.fromkeys(name for camera in named for name in camera.unknown):
            found += (diagnostic("keypoints_unknown", joints=list(unknown), joint_set=chosen.value),)
        doubts += _lacking(tuple(sources), named)
        doubts += _absent(points, columns_named)
    hands = hands_of(body, sure, chosen)
    hands = _written_hands(len(sources), pictures, max(lengths)) if hands is None else hands
    columns = np.r_[: chosen.num_keypoints, count:written]
    if counted is not None:
        notes += (diagnostic("frames_counted_together"),)
    missing = sum(lengths) - len(pictures)
    if missing:
        doubts += (diagnostic("frame_files_missing", count=missing),)
    return Detections(
        tuple(sources),
        xy[..., columns, :],
        confidence[..., columns],
        chosen,
        hands,
        min(first for first, _ in spans.values()),
        tuple(first for first, _ in spans.values()) if apart else (),
        lengths if apart else (),
        points,
        (*notes, *found),
        (*problems, *doubts),
    )


def _pictures(cameras: list[CameraFrames], spans: list[tuple[int, int]], progress: Progress) -> list[_Picture]:
    used = [
        (c, row, int(number) - first)
        for c, (frames, (first, last)) in enumerate(zip(cameras, spans, strict=True))
        for row, number in enumerate(frames.numbers)
        if first <= number <= last
    ]
    pictures = []
    for done, (c, row, frame) in enumerate(used):
        frames = cameras[c]
        pictures.append(_Picture(c, frame, frames.where(row), *_strongest(frames, row)))
        if done % _PROGRESS_STEP == 0:
            progress("Reading the detections", done, len(used))
    progress("Reading the detections", len(used), len(used))
    return pictures


def _absent(points: Sequence[OwnPoint], named: Sequence[Sequence[str]]) -> tuple[Diagnostic, ...]:
    absent = [point.name for point in points if not any(point.name in camera for camera in named)]
    return (diagnostic("own_points_absent", joints=absent),) if absent else ()


def _lacking(cameras: Sequence[str], named: Sequence[NamedKeypoints]) -> tuple[Diagnostic, ...]:
    everything = set().union(*(camera.found for camera in named))
    lacks = {name: sorted(everything - camera.found) for name, camera in zip(cameras, named, strict=True)}
    return tuple(
        diagnostic("keypoints_lacking", cameras=[name], joints=missing) for name, missing in lacks.items() if missing
    )


def _require_counts(pictures: list[_Picture], counts: list[int]) -> None:
    for picture in pictures:
        count = counts[picture.camera]
        odd = next((len(person) for person in picture.people if len(person) != count), None)
        if odd is not None:
            hint = "Use one detector with one model for the whole take."
            what = f"A person has {odd} keypoints where {count} are named."
            raise KeypointCountMismatch(what, where=picture.where, hint=hint)


def _require_finite(pictures: list[_Picture]) -> None:
    everybody = [person for picture in pictures for person in picture.people]
    if not np.isinf(np.concatenate(everybody)).any():
        return
    for picture in pictures:
        for person in picture.people:
            if np.isinf(person).any():
                what = f"Keypoint {int(np.isinf(person).any(1).argmax())} of a person is infinite."
                raise NonFiniteData(what, where=picture.where, hint="Write 0 0 0 for a keypoint that was not seen.")


def _strongest(frames: CameraFrames, row: int) -> tuple[People, Hands]:
    people = frames.people(row)
    listed = [] if frames.hands is None else frames.hands(row)
    hands: Hands = listed or [None] * len(people)
    if len(people) <= MAX_PEOPLE:
        return people, hands
    strength = [float(np.nansum(person[:, 2])) for person in people]
    keep = sorted(np.argsort(strength)[::-1][:MAX_PEOPLE])
    return [people[i] for i in keep], [hands[i] for i in keep]


def _keypoint_count(pictures: list[_Picture]) -> int:
    count = 0
    for picture in pictures:
        for person in picture.people:
            if count and len(person) != count:
                hint = "Use one detector with one model for the whole take."
                what = f"A person has {len(person)} keypoints where those before have {count}."
                raise KeypointCountMismatch(what, where=picture.where, hint=hint)
            count = len(person)
    return count


def _written_hands(cameras: int, pictures: list[_Picture], frames: int) -> np.ndarray | None:
    """Return (C, F, P, 2, 21, 3) hands that files list beside their bodies; None where none does."""
    if all(hand is None for picture in pictures for hand in picture.hands):
        return None
    most = max(len(picture.people) for picture in pictures)
    hands = np.full((cameras, frames, most, 2, NUM_HAND_POINTS, 3), np.nan, dtype=np.float32)
    with np.errstate(over="ignore"):
        for picture in pictures:
            for p, hand in enumerate(picture.hands):
                if hand is not None:
                    hands[picture.camera, picture.frame, p] = hand
    return cleaned_hands(_within_reach(hands))


def _arrays(
    cameras: int, pictures: list[_Picture], size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return xy (C, F, P, K, 2), confidence (C, F, P, K), notes and problems; ``size`` is (F, K)."""
    most = max(len(picture.people) for picture in pictures)
    values = np.full((cameras, size[0], most, size[1], 3), np.nan, dtype=np.float32)
    with np.errstate(over="ignore"):
        for picture in pictures:
            if picture.people:
                values[picture.camera, picture.frame, : len(picture.people)] = picture.people
    return _cleaned(_within_reach(values))


def _within_reach(values: np.ndarray) -> np.ndarray:
    """Return values with NaN for what lies beyond any picture, in place."""
    values[np.abs(values) > FARTHEST_PX] = np.nan
    return values


def _cleaned(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Split into pixels and confidence; what a detector writes for 'not seen' becomes NaN with confidence 0."""
    xy, confidence = values[..., :2].copy(), values[..., 2].copy()
    contradictory = np.isnan(xy).any(-1) & (confidence > 0)
    missing = np.isnan(values).any(-1) | ~(confidence > 0) | (xy == 0).all(-1)
    xy[missing], confidence[missing] = np.nan, 0.0
    if (place := placeholder(xy, confidence)) is not None:
        nothing = (xy == place).all(-1)
        xy[nothing], confidence[nothing] = np.nan, 0.0
    confidence, notes, problems = on_unit_scale(confidence)
    if place is not None:
        u, v = place.tolist()
        notes += (diagnostic("placeholder_unseen", u=u, v=v),)
    if contradictory.any():
        problems = (diagnostic("keypoints_nan", count=int(contradictory.sum())), *problems)
    return xy, confidence, notes, problems
