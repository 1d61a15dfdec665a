"""Put frames that were solved again into their motion; all other frames stay bit for bit."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.partial_body.rest_parts import rest_parts
from solver_backend.fitters.problem import Problem, SolvedFrames
from solver_backend.fitters.subject_calibration.foot_contacts import Contacts, find_contacts
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.small_matrices import mean_sigma
from solver_backend.types import FLAG_UNSURE, Motion

MOVED_M = 0.02
"""A joint that a pin moved farther than this from the views is uncertain near the pinned frame; chosen by hand."""
DOUBTFUL_M = 0.046  # Smallest standard deviation of such a joint: confidence 0.3, as of an unsure frame.
_DIAGONAL = [0, 3, 5]  # Entries xx, yy and zz of ``packed`` matrices.


def express_pin_doubts(again: Motion, before: Motion, frame_range: FrameRange, frames: np.ndarray) -> Motion:
    """Replace frame flags caused by pins by larger deviations of the moved joints.

    A pinned pose disagrees with the measurements, which flags its frame and its neighbours as unsure.

    Args:
        again: motion with some frames solved again.
        before: earlier motion.
    """
    pinned = np.array(sorted({pin.frame for pin in frame_range.pins}), dtype=int)
    if not len(pinned) or again.flags is None or again.joints is None or before.joints is None:
        return again
    flags, known = again.flags.copy(), np.zeros_like(again.flags) if before.flags is None else before.flags
    new = np.zeros(len(flags), bool)
    new[frames] = (flags[frames] & FLAG_UNSURE > 0) & (known[frames] & FLAG_UNSURE == 0)
    new[pinned] = False
    moved = np.linalg.norm(again.joints - before.joints, axis=-1) > MOVED_M
    moved[~new] = False
    flags[moved.any(axis=1)] &= ~np.uint8(FLAG_UNSURE)
    flags[pinned] = 0
    covariance, sigma = again.joint_covariance, again.joint_sigma
    if covariance is not None and sigma is not None:
        missing = np.where(moved, np.maximum(DOUBTFUL_M**2 - np.square(sigma), 0.0), 0.0)
        covariance = covariance.copy()
        covariance[..., _DIAGONAL] += missing[..., None]
        sigma = np.where(moved, mean_sigma(covariance), sigma)
    return replace(again, flags=flags, joint_covariance=covariance, joint_sigma=sigma)


@dataclass(frozen=True)
class SolvedRange:
    """A frame range solved again, with the windows on both sides of it."""

    frame_range: FrameRange
    layout: KeyframeLayout
    free: np.ndarray  # (2N + 1,) bool: keys that moved.
    frames: PosedFrames  # Poses of the frames of the layout.
    contacts: Contacts | None  # Of the whole take, if standing feet were detected.
    status: str  # How the last pass ended.

    @property
    def moved(self) -> np.ndarray:
        """Numbers of the frames that take their new poses: all of the range but ends that no person pinned."""
        wanted, frames = self.frame_range, self.layout.frames
        inside = (frames >= wanted.first) & (frames <= wanted.last)
        pinned = {pin.frame for pin in wanted.pins}
        fixed = set(self.layout.key_times[~self.free]) & {wanted.first, wanted.last} - pinned
        return frames[inside & ~np.isin(frames, list(fixed))]


_OF_THE_TAKE = ("betas", "offsets", "marker_sigma")  # Arrays of a motion that are not one value a frame.


def contacts_in_place(
    problem: Problem,
    subject: Subject,
    before: PosedFrames,
    frames: PosedFrames,
    layout: KeyframeLayout,
    frame_range: FrameRange,
) -> Contacts:
    """Return which points of the feet stand in the earlier motion with the new frames in their places."""
    points = to_numpy(pose(subject, before).points)
    points[layout.frames] = to_numpy(pose(subject, frames).points)
    number = np.arange(problem.num_frames)
    return find_contacts(
        points, subject.landmarks.names, problem.fps, (number < frame_range.first) | (number > frame_range.last)
    )


def frames_in_place(
    problem: Problem, subject: Subject, motion: Motion, before: PosedFrames, solved: SolvedRange, covariance: np.ndarray
) -> SolvedFrames:
    """Return the poses of the whole take: the earlier ones, and in the frames that moved the new ones.

    Args:
        before: its poses.
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


def range_layout(frame_range: FrameRange, num_frames: int, window: int) -> tuple[KeyframeLayout, np.ndarray]:
    """Return windows from one before the range to one after it, and the (K,) keys that move.

    Keys stand at the range's ends and at the pins, and evenly between. Those at pins stay, and so do those at the
    ends and beyond, except at the ends of the take.

    Args:
        num_frames: F of the take.
        window: frames of a window.
    """
    stops = sorted({frame_range.first, frame_range.last, *(pin.frame for pin in frame_range.pins)})
    parts = [KeyframeLayout.even(b - a + 1, window, a).bounds for a, b in itertools.pairwise(stops)]
    low, high = max(0, frame_range.first - window), min(num_frames - 1, frame_range.last + window)
    bounds = np.unique(np.concatenate([[low], *parts, [high]]))
    layout = KeyframeLayout(bounds)
    times = layout.key_times
    free = (times > frame_range.first) & (times < frame_range.last)
    free |= (times == 0) & (frame_range.first == 0) | (times == num_frames - 1) & (frame_range.last == num_frames - 1)
    return layout, free & ~np.isin(times, [pin.frame for pin in frame_range.pins])
