"""Bring cameras that started apart, or are numbered differently, to one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.starts import CameraStarts, StartEvidence, align_rows, common_rows, find_starts
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, word
from solver_backend.exchange.errors import JobInvalid, NotSynchronised
from solver_backend.exchange.reading_settings import offsets_by_camera
from solver_backend.exchange.solve_settings import SYNC_OFF, SYNC_ON
from solver_backend.io.camera_names import listing, name_key
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.frame_numbers import cut_frames, different_frames
from solver_backend.types import Cameras, Capture, stacked_hands

SOLVED_S, SOLVED_FRAMES = 0.2, 10  # The solve corrects smaller delays, to parts of a frame.


@dataclass(frozen=True)
class InTime:
    """Detections with one moment of all cameras per row."""

    detections: Detections  # The kept frames.
    first_rows: tuple[int, ...] = ()  # First row of each camera. Empty if all begin with their first.
    notes: tuple[Diagnostic, ...] = ()  # Assumptions.
    problems: tuple[Diagnostic, ...] = ()  # Warnings for the user.


def reads_apart(options: ReadOptions) -> bool:
    """Return whether every camera is read from its own first frame, if frames differ."""
    return options.sync != SYNC_OFF or options.by_order or bool(options.offset)


def bring_to_one_time(cameras: Cameras, detections: Detections, fps: float, options: ReadOptions) -> InTime:
    """Return the detections at moments that all cameras recorded.

    The user's offsets always win. Otherwise cameras move if they agree far better at other offsets than as numbered,
    and at no further ones (``find_starts``). Everything uncertain stays as numbered and is reported.

    Args:
        cameras: C calibrated cameras.
        detections: each camera from its own first frame, if frames differ.
        fps: frames per second.
        options: how the capture is read.

    Raises:
        JobInvalid: an offset names no recorded camera.
        NotSynchronised: synchronisation is required, and the views do not confirm any.
        FrameCountMismatch: the cameras' frames differ and nothing shows which belong together.
    """
    numbered = _numbered(detections, options)
    given = _given_offsets(detections.cameras, options.offset)
    if given is not None:
        notes = tuple(
            diagnostic("start_given", cameras=[name], size=abs(by), direction=_direction(by))
            for name, by in _named(detections, given)
        )
        return _aligned(detections, numbered - given, options, notes, ())
    if options.sync == SYNC_OFF:
        return _aligned(detections, numbered, options, (), ())
    found = find_starts(cameras, detections, fps, numbered)
    if found.evidence is StartEvidence.APART:
        if np.abs(found.offsets - numbered).max() > max(SOLVED_S * fps, SOLVED_FRAMES):
            return _moved(detections, found, numbered, options)
    elif found.evidence is not StartEvidence.IN_STEP:
        doubt = _doubt(detections, found)
        why = word(doubt).what
        if options.sync == SYNC_ON:
            raise NotSynchronised(
                why, where=listing(detections.cameras), hint="Give --offset CAMERA=FRAMES, or --sync auto."
            )
        if detections.first_frames and not (options.trim or options.by_order):
            raise different_frames(_spans(detections), why)
        if found.evidence is StartEvidence.AMBIGUOUS:
            return _aligned(detections, numbered, options, (), (doubt,))
        return _aligned(detections, numbered, options, (doubt,) if len(found.doubtful) == len(cameras) else (), ())
    return _aligned(detections, numbered, options, (), ())


def bring_capture_to_one_time(capture: Capture, options: ReadOptions) -> Capture:
    """Return a capture of keypoints with its cameras brought to one time, on the first camera's clock.

    Args:
        capture: of all people.
        options: how it is read.

    Raises:
        JobInvalid, NotSynchronised, FrameCountMismatch: see ``bring_to_one_time``.
    """
    if capture.cameras is None or capture.keypoints is None:
        return capture
    everybody = [person.keypoints for person in capture.people] or [capture.keypoints]
    detections = Detections(
        capture.cameras.names,
        np.stack([person.xy for person in everybody], axis=2),
        np.stack([person.confidence for person in everybody], axis=2),
        capture.keypoints.joint_set,
        stacked_hands([person.hands for person in everybody], axis=2),
        own=capture.keypoints.own,
    )
    found = bring_to_one_time(capture.cameras, detections, capture.fps, options)
    capture = replace(capture, notes=(*capture.notes, *found.notes), problems=(*capture.problems, *found.problems))
    if not found.first_rows:
        return capture
    first = max(found.first_rows[0], 0)
    stop = min(found.first_rows[0] + found.detections.num_frames, capture.num_frames)
    rows = slice(first - found.first_rows[0], stop - found.first_rows[0])
    cut = cut_frames(capture, first, stop - 1)
    aligned = found.detections
    moved = [
        replace(
            person, xy=aligned.xy[:, rows, p], confidence=aligned.confidence[:, rows, p],
            hands=None if person.hands is None or aligned.hands is None else aligned.hands[:, rows, p],
        )
        for p, person in enumerate(everybody)
    ]  # fmt: skip
    people = tuple(replace(person, keypoints=moved[p]) for p, person in enumerate(capture.people))
    solved = next((p for p, person in enumerate(capture.people) if person.name == capture.person), 0)
    late = [row - found.first_rows[0] for row in found.first_rows]
    pictures = [picture + by for picture, by in zip(cut.footage_first, late, strict=False)]
    return replace(cut, keypoints=moved[solved], people=people, footage_first=tuple(pictures))


def as_numbered(detections: Detections, options: ReadOptions) -> Detections:
    """Return the rows with equal frame numbers.

    Args: those of ``bring_to_one_time``.
    """
    offsets = _numbered(detections, options)
    lengths = np.array(detections.lengths or [detections.num_frames] * len(offsets))
    first, stop = common_rows(offsets, lengths)
    return align_rows(detections, offsets, first, stop) if stop > first else detections


def _numbered(detections: Detections, options: ReadOptions) -> np.ndarray:
    """Return (C,) offsets by the numbers of the frames."""
    firsts = np.array(detections.first_frames or [detections.first_frame] * len(detections.cameras))
    return np.zeros(len(firsts), int) if options.by_order else firsts[0] - firsts


def _moved(detections: Detections, found: CameraStarts, numbered: np.ndarray, options: ReadOptions) -> InTime:
    """Return the detections with cameras moved, without cameras that show no start."""
    late = numbered - found.offsets
    late = late - late[0]
    moved = _named(detections, late)
    starts = [f"{name} {abs(by)} frames {_direction(by)}" for name, by in moved]
    problems = [
        diagnostic(
            "starts_apart", cameras=[name for name, _ in moved], reference=detections.cameras[0], starts=starts,
            late=[by for _, by in moved], remedy=Remedy.REPAIRED,
        )
    ]  # fmt: skip
    if found.doubtful:
        names = [detections.cameras[c] for c in found.doubtful]
        problems.append(diagnostic("start_left_out", cameras=names, remedy=Remedy.EXCLUDED))
        confidence = detections.confidence.copy()
        confidence[list(found.doubtful)] = 0.0
        lengths = np.array(detections.lengths or [detections.num_frames] * len(late))
        lengths[list(found.doubtful)] = 0
        detections = replace(detections, confidence=confidence, lengths=tuple(lengths.tolist()))
    return _aligned(detections, found.offsets, options, (), tuple(problems))


def _doubt(detections: Detections, found: CameraStarts) -> Diagnostic:
    """Return the reason for moving no camera."""
    names = [detections.cameras[c] for c in found.doubtful]
    if found.evidence is StartEvidence.STILL:
        return diagnostic("start_unknown", cameras=names)
    one, other = (-offset for offset in found.rivals)
    return diagnostic("start_ambiguous", cameras=[names[0], detections.cameras[0]], one=one, other=other)


def _aligned(
    detections: Detections, offsets: np.ndarray, options: ReadOptions, notes: tuple[Diagnostic, ...],
    problems: tuple[Diagnostic, ...],
) -> InTime:  # fmt: skip
    """Return the rows that belong together."""
    if not detections.first_frames and not (offsets - offsets[0]).any():
        return InTime(detections, (), notes, problems)
    lengths = np.array(detections.lengths or [detections.num_frames] * len(offsets))
    first, stop = common_rows(offsets, lengths, every=options.trim)
    if stop <= first:
        raise different_frames(_spans(detections), "With these offsets no two cameras recorded at the same time.")
    rows = tuple(int(first + offset) for offset in offsets)
    starts = [f"{row} of {name}" for name, row in zip(detections.cameras, rows, strict=True)]
    kept = diagnostic("take_in_common", cameras=detections.cameras, count=stop - first, starts=starts, rows=rows)
    notes = (*notes, kept)
    return InTime(align_rows(detections, offsets, first, stop), rows, notes, problems)


def _given_offsets(cameras: Sequence[str], texts: Sequence[str]) -> np.ndarray | None:
    """Return (C,) frames by which cameras started late, as the user gives them. None where none is given."""
    given = offsets_by_camera(texts)
    late = np.zeros(len(cameras), int)
    keys = [name_key(name) for name in cameras]
    for name, frames in given.items():
        same = [c for c, camera in enumerate(cameras) if camera == name or keys[c] == name_key(name)]
        if len(same) != 1:
            raise JobInvalid(
                f"The offset of '{name}' belongs to no camera.", where="offset", hint=f"Cameras are {listing(cameras)}."
            )
        late[same[0]] = frames
    return late if given else None


def _named(detections: Detections, late: np.ndarray) -> list[tuple[str, int]]:
    return [(name, int(by)) for name, by in zip(detections.cameras, late, strict=True) if by]


def _direction(frames: int) -> str:
    return "later" if frames > 0 else "earlier"


def _spans(detections: Detections) -> dict[str, tuple[int, int]]:
    firsts = detections.first_frames or (detections.first_frame,) * len(detections.cameras)
    lengths = detections.lengths or (detections.num_frames,) * len(detections.cameras)
    return {
        name: (first, first + length - 1)
        for name, first, length in zip(detections.cameras, firsts, lengths, strict=True)
    }
