"""Frames that were solved again put into the motion that they belong to; all others stay bit for bit."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.pin_doubts import express_pin_doubts
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.output.build_motion import build_motion
from solver_backend.fitters.partial_body.rest_parts import rest_parts
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.types import Motion


@dataclass(frozen=True)
class SolvedRange:
    """A frame range solved again, with the windows on either side of it."""

    frame_range: FrameRange
    """What was asked for."""
    layout: KeyframeLayout
    """Windows."""
    free: np.ndarray
    """(2N + 1,) bool: the keys that moved."""
    frames: PosedFrames
    """Poses of the frames of the layout."""
    contacts: Contacts | None
    """Of the whole take, if standing feet were looked for."""
    status: str
    """How the last pass ended."""

    @property
    def moved(self) -> np.ndarray:
        """Numbers of the frames that take their new poses: all of the range but ends that no person pinned."""
        wanted, frames = self.frame_range, self.layout.frames
        inside = (frames >= wanted.first) & (frames <= wanted.last)
        pinned = {pin.frame for pin in wanted.pins}
        fixed = set(self.layout.key_times[~self.free]) & {wanted.first, wanted.last} - pinned
        return frames[inside & ~np.isin(frames, list(fixed))]


_OF_THE_TAKE = ("betas", "offsets", "marker_sigma")
"""Arrays of a motion that are not one value a frame."""


def contacts_in_place(
    problem: Problem, subject: Subject, before: PosedFrames, frames: PosedFrames, layout: KeyframeLayout,
    frame_range: FrameRange,
) -> Contacts:  # fmt: skip
    """Return which points of the feet stand in the earlier motion with the new frames in their places."""
    points = to_numpy(pose(subject, before).points)
    points[layout.frames] = to_numpy(pose(subject, frames).points)
    number = np.arange(problem.num_frames)
    return find_contacts(
        points, subject.landmarks.names, problem.fps, (number < frame_range.first) | (number > frame_range.last)
    )


def frames_in_place(
    problem: Problem, subject: Subject, motion: Motion, before: PosedFrames, solved: SolvedRange,
    covariance: np.ndarray,
) -> SolvedFrames:  # fmt: skip
    """Return the poses of the whole take: the earlier ones, and in the frames that moved the new ones.

    Args:
        problem: the measurements made ready.
        subject: the person.
        motion: the earlier solve.
        before: its poses.
        solved: the frames solved again.
        covariance: (n, 24, 6) of the joints in the frames of the layout (see ``packed``).
    """
    layout, wanted, moved = solved.layout, solved.frame_range, solved.moved
    whole = PosedFrames(*(_copied(getattr(before, n)) for n in ("root", "local", "transl")))
    for name in ("root", "local", "transl"):
        getattr(whole, name)[moved] = getattr(solved.frames, name)[moved - layout.bounds[0]]
    known = motion.joint_covariance
    everywhere = np.tile(covariance.mean(axis=0), (problem.num_frames, 1, 1)) if known is None else known.copy()
    everywhere[layout.frames] = covariance
    key_times = layout.key_times[(layout.key_times >= wanted.first) & (layout.key_times <= wanted.last)]
    contacts = None if solved.contacts is None else solved.contacts.feet(subject.landmarks.names)
    frames = SolvedFrames(subject, whole, key_times, everywhere, contacts)
    return rest_parts(problem.measurements, frames, [pin.frame for pin in wanted.pins])


def spliced(problem: Problem, motion: Motion, solved: SolvedRange, frames: SolvedFrames, scale: float) -> Motion:
    """Return the earlier motion with the frames that moved replaced; all others stay as they are, bit for bit.

    Args:
        problem: the measurements made ready.
        motion: the earlier solve.
        solved: the frames solved again.
        frames: poses of the whole take with these in their places.
        scale: see ``build_motion``.

    Raises:
        MotionInvalid: the motion is of other views, keypoints or markers than the recording.
    """
    wanted, moved = solved.frame_range, solved.moved
    again = build_motion(problem.measurements, frames, scale=scale, provenance={})
    again = express_pin_doubts(again, motion, wanted, moved)
    values: dict[str, Any] = {}
    for field in fields(Motion):
        old, new = getattr(motion, field.name), getattr(again, field.name)
        if isinstance(old, np.ndarray) and isinstance(new, np.ndarray) and field.name not in _OF_THE_TAKE:
            _require_alike(field.name, old, new)
            values[field.name] = old.copy()
            index = (slice(None), moved) if field.name == "reprojection_px" else moved
            values[field.name][index] = new[index]
    entry = {"first": wanted.first, "last": wanted.last, "pins": sorted({pin.frame for pin in wanted.pins})}
    record = {**motion.provenance, "resolved": [*motion.provenance.get("resolved", []), entry]}
    record |= {"statistics": again.provenance["statistics"], "status": solved.status}
    return replace(motion, **values, provenance=record)


def _require_alike(name: str, old: np.ndarray, new: np.ndarray) -> None:
    if old.shape != new.shape:
        raise MotionInvalid(
            f"The motion's {name} has the shape {old.shape}, this recording gives {new.shape}.",
            where="motion",
            hint="Solve frames again with the recording that the motion was solved from.",
        )


def _copied(values: Array) -> Array:
    return values.copy() if isinstance(values, np.ndarray) else values.clone()
