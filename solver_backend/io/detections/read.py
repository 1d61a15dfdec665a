"""Read the detections of all cameras, in any format, into arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import KeypointCountMismatch, NoDetections, NonFiniteData
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.detections.camera_frames import CameraFrames, Hands, People, cleaned_hands, hands_of
from solver_backend.io.detections.named_keypoints import NamedKeypoints, OwnKeypoints, match_cameras, with_named_hands
from solver_backend.io.detections.search import CameraSource
from solver_backend.io.recognition.confidence import from_logarithms, on_unit_scale, placeholder
from solver_backend.io.recognition.frame_numbers import counted_together, shared_range
from solver_backend.io.recognition.joint_sets import HANDS_ALONE, choose_joint_set, require_known_count
from solver_backend.types import Detections, JointSet

MAX_PEOPLE = 12  # Largest number of people per frame and view. The most confident people are kept.
_PROGRESS_STEP = 250  # Frames between progress reports, chosen by hand.


@dataclass(frozen=True)
class _Picture:
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
    by_order: bool = False,
    own: OwnKeypoints | None = None,
    progress: Progress = silent,
) -> Detections:
    """Read all people in every frame of every camera. A frame without a file contains no people.

    Args:
        sources: source of each camera's detections, by camera name.
        joint_set: joint set of the keypoints. None determines it from the keypoint names in the files, else from
            ``configured``, else from the number and arrangement of the keypoints.
        configured: joint set in the recording's settings. It is ignored if the keypoints clearly contradict it.
        trim: keep only the frames that all cameras have.
        apart: read each camera from its first to its last frame, even if these differ between cameras.
        by_order: count the frames of each camera from 0, whatever their numbers are.
        own: keypoint definitions of the user.
        progress: called with the number of frames read.

    Raises:
        FrameCountMismatch: the cameras have different frames, and both ``trim`` and ``apart`` are False.
        KeypointCountMismatch: people differ in their number of keypoints, or no joint set has that number.
        NoDetections: the files contain no person.
        NonFiniteData: a coordinate is infinite.
    """
    listed = {name: source.frames() for name, source in sources.items()}
    if own is not None:
        listed = {name: own.apply(frames) for name, frames in listed.items()}
    cameras = [with_named_hands(frames) for frames in listed.values()]
    counted = counted_together([frames.numbers for frames in cameras])
    if counted is not None:
        cameras = [replace(frames, numbers=numbers) for frames, numbers in zip(cameras, counted, strict=True)]
    if by_order:
        cameras = [replace(frames, numbers=frames.numbers - frames.numbers[0]) for frames in cameras]
    spans = {name: (int(f.numbers[0]), int(f.numbers[-1])) for name, f in zip(sources, cameras, strict=True)}
    apart = apart and len(set(spans.values())) > 1
    if not apart:
        spans = dict.fromkeys(spans, shared_range(spans, trim=trim))
    lengths = tuple(last - first + 1 for first, last in spans.values())
    where = str(next(iter(sources.values())).path.parent)
    pictures = _pictures(cameras, list(spans.values()), progress)
    columns_named = [frames.keypoints for frames in cameras]
    points = () if own is None or not all(columns_named) else own.points
    named = match_cameras(columns_named, joint_set, [point.name for point in points], where=where)
    if named:
        for picture in pictures:
            _require_count(picture, len(columns_named[picture.camera]), "{} are named")
        pictures = [replace(p, people=[named[p.camera].ordered(person) for person in p.people]) for p in pictures]
        joint_set = named[0].joint_set
    written = next((len(person) for picture in pictures for person in picture.people), 0)
    for picture in pictures:
        _require_count(picture, written, "earlier people have {}")
    if written == 0:
        hint = f"Run the detector again. {HANDS_ALONE}"
        raise NoDetections("No person was detected. All lists of people are empty.", where=where, hint=hint)
    count = written - len(points)
    require_known_count(count, joint_set, where=where)
    _require_finite(pictures)
    xy, confidence, notes, problems = _arrays(pictures, (len(sources), max(lengths), written))
    body, sure = xy[..., :count, :], confidence[..., :count]
    chosen, found, doubts = choose_joint_set(body, sure, joint_set, configured, where=where)
    if named:
        source, file = ("file", own.where) if own else ("names", "")
        found = (diagnostic("joint_set_chosen", source=source, file=file, joint_set=chosen.value),)
        if unknown := dict.fromkeys(name for camera in named for name in camera.unknown):
            found += (diagnostic("keypoints_unknown", joints=list(unknown), joint_set=chosen.value),)
        doubts += _lacking(tuple(sources), named)
        if absent := [point.name for point in points if not any(point.name in camera for camera in columns_named)]:
            doubts += (diagnostic("own_points_absent", joints=absent),)
    hands = hands_of(body, sure, chosen)
    if hands is None:
        hands, more, wrong = _written_hands(pictures, (len(sources), max(lengths)))
        notes, problems = (*notes, *_unlike(more, notes)), (*problems, *_unlike(wrong, problems))
    columns = np.r_[: chosen.num_keypoints, count:written]
    if counted is not None:
        notes += (diagnostic("frames_counted_together"),)
    if missing := sum(lengths) - len(pictures):
        doubts += (diagnostic("frame_files_missing", count=missing),)
    firsts = tuple(first for first, _ in spans.values())
    return Detections(
        tuple(sources),
        xy[..., columns, :],
        confidence[..., columns],
        chosen,
        hands,
        min(firsts),
        firsts if apart else (),
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


def _strongest(frames: CameraFrames, row: int) -> tuple[People, Hands]:
    people = frames.people(row)
    listed = [] if frames.hands is None else frames.hands(row)
    hands: Hands = listed or [None] * len(people)
    if len(people) <= MAX_PEOPLE:
        return people, hands
    strength = [float(np.nansum(person[:, 2])) for person in people]
    keep = sorted(np.argsort(strength)[::-1][:MAX_PEOPLE])
    return [people[i] for i in keep], [hands[i] for i in keep]


def _lacking(cameras: Sequence[str], named: Sequence[NamedKeypoints]) -> tuple[Diagnostic, ...]:
    everything = set().union(*(camera.found for camera in named))
    lacks = {name: sorted(everything - camera.found) for name, camera in zip(cameras, named, strict=True)}
    return tuple(
        diagnostic("keypoints_lacking", cameras=[name], joints=joints) for name, joints in lacks.items() if joints
    )


def _require_count(picture: _Picture, count: int, expected: str) -> None:
    for person in picture.people:
        if len(person) != count:
            hint = "Use one detector with one model for the whole take."
            what = f"A person has {len(person)} keypoints, but {expected.format(count)}."
            raise KeypointCountMismatch(what, where=picture.where, hint=hint)


def _require_finite(pictures: list[_Picture]) -> None:
    if not np.isinf(np.concatenate([person for picture in pictures for person in picture.people])).any():
        return
    for picture in pictures:
        for person in picture.people:
            if np.isinf(person).any():
                what = f"Keypoint {int(np.isinf(person).any(1).argmax())} of a person is infinite."
                raise NonFiniteData(what, where=picture.where, hint="Write 0 0 0 for a keypoint that was not seen.")


def _unlike(found: Sequence[Diagnostic], bodies: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Return the diagnostics about hands that are not already reported for bodies."""
    said = {(item.code, item.values.get("how")) for item in bodies}
    return [item for item in found if (item.code, item.values.get("how")) not in said]


def _written_hands(
    pictures: list[_Picture], size: tuple[int, int]
) -> tuple[np.ndarray | None, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Collect the hands (C, F, P, 2, 21, 3) that files list separately from the body. Also return notes and warnings.

    The hands are None if no file lists hands.
    """
    if all(hand is None for picture in pictures for hand in picture.hands):
        return None, (), ()
    most = max(len(picture.people) for picture in pictures)
    hands = np.full((*size, most, 2, NUM_HAND_POINTS, 3), np.nan, dtype=np.float32)
    with np.errstate(over="ignore"):
        for picture in pictures:
            for p, hand in enumerate(picture.hands):
                if hand is not None:
                    hands[picture.camera, picture.frame, p] = hand
    hands = _within_reach(hands)
    written = np.isfinite(hands[..., :2]).all(-1) & (hands[..., :2] != 0).any(-1)
    hands[..., 2] = from_logarithms(hands[..., 2], written)
    return cleaned_hands(hands)


def _arrays(
    pictures: list[_Picture], size: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return pixels (C, F, P, K, 2), confidences (C, F, P, K), notes and warnings. ``size`` is (C, F, K).

    Undetected points become NaN and get confidence 0.
    """
    cameras, frames, keypoints = size
    most = max(len(picture.people) for picture in pictures)
    values = np.full((cameras, frames, most, keypoints, 3), np.nan, dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):  # signalling NaN
        for picture in pictures:
            if picture.people:
                values[picture.camera, picture.frame, : len(picture.people)] = picture.people
    values = _within_reach(values)
    xy, confidence = values[..., :2].copy(), values[..., 2].copy()
    confidence = from_logarithms(confidence, np.isfinite(xy).all(-1) & (xy != 0).any(-1))
    contradictory = np.isnan(xy).any(-1) & (confidence > 0)
    missing = np.isnan(xy).any(-1) | ~(confidence > 0) | (xy == 0).all(-1)
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


def _within_reach(values: np.ndarray) -> np.ndarray:
    """Set coordinates that no image can contain to NaN, in place."""
    values[np.abs(values) > FARTHEST_PX] = np.nan
    return values
