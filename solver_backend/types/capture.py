"""Define recorded data: 2D keypoints, hands, user-defined points, markers, and captures."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import (
    CalibrationMismatch,
    CaptureInvalid,
    JobInvalid,
    KeypointCountMismatch,
    NoDetections,
    NonFiniteData,
    PersonUnknown,
    TooFewViews,
)
from solver_backend.exchange.joint_sets import HAND_POINTS, NUM_HAND_POINTS, SIDES, JointSet
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.exchange.rigs.skeleton import JOINT_OF
from solver_backend.types.cameras import Cameras
from solver_backend.types.marker_cloud import MarkerCloud
from solver_backend.types.shapes import Bool, Float

BONES = {role: SMPL.joints[joint] for role, joint in JOINT_OF.items()} | {
    name: name for name in ("spine1", "spine2", "spine3", "neck")
}  # The joint that rotates each bone, by the bone's usual name: ``left_forearm`` rotates at ``left_elbow``.


@dataclass(frozen=True)
class OwnPoint:
    """A user-defined point at an unknown, constant position on a bone."""

    name: str
    bone: str  # Key of ``BONES``.


UNSEEN_POINT = (np.nan, np.nan, 0.0)  # x, y and confidence of an undetected point.


def stacked_hands(hands: Sequence[np.ndarray | None], axis: int) -> np.ndarray | None:
    """Stack several people's hands along a new axis. Hands that are None become NaN. Return None if all are None."""
    like = next((hand for hand in hands if hand is not None), None)
    if like is None:
        return None
    return np.stack([np.full_like(like, np.nan) if hand is None else hand for hand in hands], axis=axis)


def checked_hands(hands: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Check hand points, and set undetected points to NaN with confidence 0.

    Raises:
        KeypointCountMismatch: the shape is not (*shape, 2, 21, 3).
        NonFiniteData: a point is infinite or too far away for any image.
    """
    hands = np.array(hands, dtype=np.float64)
    expected = (*shape, 2, NUM_HAND_POINTS, 3)
    if hands.shape != expected:
        raise KeypointCountMismatch(f"The hands have the shape {hands.shape}, but {expected} is expected.")
    beyond = (np.abs(hands) > FARTHEST_PX).any(-1)
    if beyond.any():
        view, frame, hand, point = np.argwhere(beyond)[0]
        hint = "Write NaN (or 0 0 0) for a point that was not seen."
        what = "A hand point is infinite or far outside any image."
        raise NonFiniteData(what, where=f"view {view}, frame {frame}, {SIDES[hand]} {HAND_POINTS[point]}", hint=hint)
    hands[~np.isfinite(hands).all(-1) | ~(hands[..., 2] > 0)] = UNSEEN_POINT
    return hands


@dataclass(frozen=True)
class Keypoints2D:
    """2D keypoints of one person in every view. Missing keypoints are NaN with confidence 0."""

    xy: Float[np.ndarray, "views frames keypoints 2"]
    """(views, frames, keypoints, 2) positions in pixels."""
    confidence: Float[np.ndarray, "views frames keypoints"]
    """(views, frames, keypoints) confidences in 0..1."""
    joint_set: JointSet
    fps: float
    hands: Float[np.ndarray, "views frames 2 21 3"] | None = None
    """(views, frames, 2, 21, 3) x, y in pixels and confidence of hand points, left first. Undetected: NaN and 0."""
    own: tuple[OwnPoint, ...] = ()
    """User-defined points, which follow the joint set's keypoints."""

    def __post_init__(self) -> None:
        xy = np.array(self.xy, dtype=np.float64)
        confidence = np.array(self.confidence, dtype=np.float64)
        if xy.ndim != 4 or xy.shape[-1] != 2 or confidence.shape != xy.shape[:-1]:
            shapes = f"xy {xy.shape} and confidence {confidence.shape}"
            raise KeypointCountMismatch(
                f"{shapes} must be (views, frames, keypoints, 2) and (views, frames, keypoints)."
            )
        if xy.shape[2] != self.joint_set.num_keypoints + len(self.own):
            fits = ", ".join(s.value for s in JointSet.fitting(xy.shape[2])) or "none"
            what = (
                f"{xy.shape[2]} keypoints do not fit {self.joint_set.value}, which has {self.joint_set.num_keypoints}."
            )
            raise KeypointCountMismatch(what, hint=f"Joint sets with {xy.shape[2]} keypoints: {fits}.")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise NonFiniteData(f"The frame rate must be a positive number, not {self.fps}.")
        beyond = (np.abs(xy) > FARTHEST_PX).any(-1) | (np.abs(confidence) > FARTHEST_PX)
        if beyond.any():
            view, frame, point = np.argwhere(beyond)[0]
            place = xy[view, frame, point]
            what = f"lies at {place[0]:.3g}, {place[1]:.3g} px" if np.isfinite(place).all() else "is infinite"
            hint = "Write NaN (or 0 0 0) for a keypoint that was not seen."
            what = f"A detection {what}."
            raise NonFiniteData(what, where=f"view {view}, frame {frame}, {self.names[point]}", hint=hint)
        missing = ~np.isfinite(xy).all(-1) | ~(confidence > 0)
        xy[missing] = np.nan
        confidence[missing] = 0.0
        object.__setattr__(self, "xy", xy)
        object.__setattr__(self, "confidence", confidence)
        if self.hands is not None:
            object.__setattr__(self, "hands", checked_hands(self.hands, xy.shape[:2]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all keypoints: the joint set's, followed by the user-defined points."""
        return (*self.joint_set.keypoints, *(point.name for point in self.own))

    @property
    def num_views(self) -> int:
        """Number of views, one per camera."""
        return self.xy.shape[0]

    @property
    def num_frames(self) -> int:
        """Number of recorded frames."""
        return self.xy.shape[1]

    @property
    def named(self) -> Keypoints2D:
        """The keypoints of the joint set, without user-defined points."""
        count = self.joint_set.num_keypoints
        return replace(self, xy=self.xy[:, :, :count], confidence=self.confidence[:, :, :count], own=())

    def frames(self, start: int, stop: int) -> Keypoints2D:
        """Return the keypoints in the frames from ``start`` to ``stop - 1``."""
        return self.at(slice(start, stop))

    def at(self, frames: slice | np.ndarray) -> Keypoints2D:
        """Return the keypoints in selected frames (indices or slice)."""
        hands = None if self.hands is None else self.hands[:, frames]
        return replace(self, xy=self.xy[:, frames], confidence=self.confidence[:, frames], hands=hands)

    def views(self, indices: list[int]) -> Keypoints2D:
        """Return the keypoints of the views at these indices."""
        hands = None if self.hands is None else self.hands[indices]
        return replace(self, xy=self.xy[indices], confidence=self.confidence[indices], hands=hands)


@dataclass(frozen=True)
class PersonInViews:
    """One of several people in a recording, with their keypoints in every view."""

    name: str
    keypoints: Keypoints2D

    @property
    def agreed(self) -> np.ndarray:
        """(F,) mask of frames in which at least two views show the person."""
        return (self.keypoints.confidence > 0).any(axis=-1).sum(axis=0) >= 2


@dataclass(frozen=True)
class Capture:
    """A recording in metres and seconds, with Z up and the floor at z = 0."""

    name: str
    """Name of the take."""
    cameras: Cameras | None = None
    """Calibrated cameras, in the order of the views."""
    keypoints: Keypoints2D | None = None
    """Detections of the person to solve."""
    markers: MarkerCloud | None = None
    others: MarkerCloud | None = None
    """Markers whose prefixes do not name a person, possibly props."""
    footage: tuple[Path | None, ...] = ()
    """Video file or image folder of each camera, or None."""
    footage_first: tuple[int, ...] = ()
    """Index of each camera's footage image at the first frame, or () if all are 0."""
    sources: tuple[str, ...] = ()
    """Files that the capture was read from."""
    notes: tuple[Diagnostic, ...] = ()
    """The reader's notes about findings and assumptions: units, axes, frame rate, ignored people."""
    problems: tuple[Diagnostic, ...] = ()
    """Warnings for the user before the solve."""
    people: tuple[PersonInViews, ...] = ()
    """Everyone visible in at least two views, if there are several people. ``keypoints`` are the solved person's."""
    person: str = ""
    """Name of the person in ``keypoints`` if there are several people."""
    stature_m: float = 0.0
    """Stated stature of the person in metres, or 0 if unknown."""
    floor_from_person: bool = False
    """True if the person's stated or average stature set the floor and scale of a single camera's world."""
    focal_sigma: float = 0.0
    """Relative standard deviation of a single camera's focal length if it was estimated."""
    detector: str = ""
    """Name of the keypoint detector, or empty if unknown."""
    noise_map: str = ""
    """Detector whose noise map weighted the confidences, or empty if they are unchanged."""
    world_checked: bool = False
    """True if the reader compared the calibrated world with the person. Not stored in files."""
    truth: dict[str, np.ndarray] = field(default_factory=dict)
    """Ground truth of a synthetic capture: betas, global_orient, body_pose, transl, joints, keypoints3d."""

    def __post_init__(self) -> None:
        cameras, found = self.cameras, self.keypoints
        if cameras is not None and found is not None and len(cameras) != found.num_views:
            what = f"There are {len(cameras)} cameras ({', '.join(cameras.names)}) and {found.num_views} views."
            raise CalibrationMismatch(what, where=self.name)
        if (
            cameras is not None
            and cameras.path is not None
            and (found is None or len(cameras.path) != found.num_frames)
        ):
            what = (
                f"The camera path has {len(cameras.path)} poses for {0 if found is None else found.num_frames} frames."
            )
            raise CaptureInvalid(what, where=self.name)
        if cameras is not None and self.footage and len(self.footage) != len(cameras):
            hint = "One entry per camera is expected, none without footage."
            what = f"{len(self.footage)} footage entries do not match {len(cameras)} cameras."
            raise CaptureInvalid(what, where=self.name, hint=hint)
        for person in self.people:
            if found is None or person.keypoints.xy.shape != found.xy.shape:
                what = f"The detections of {person.name} have different views or frames from the capture."
                raise CaptureInvalid(what, where=self.name)

    @property
    def named(self) -> Capture:
        """The capture without user-defined points, for comparison with a motion."""
        if self.keypoints is None or not self.keypoints.own:
            return self
        people = tuple(replace(person, keypoints=person.keypoints.named) for person in self.people)
        return replace(self, keypoints=self.keypoints.named, people=people)

    @property
    def num_frames(self) -> int:
        """Number of recorded frames, or 0 without keypoints and markers."""
        frames = self.keypoints.num_frames if self.keypoints is not None else 0
        return frames or (len(self.markers.positions) if self.markers is not None else 0)

    @property
    def fps(self) -> float:
        """Frame rate of the recording in Hz, or 0 without keypoints and markers."""
        source = self.keypoints or self.markers
        return float(source.fps) if source is not None else 0.0

    @property
    def is_one_view(self) -> bool:
        """True if exactly one camera detects a person."""
        found = self.keypoints
        return self.cameras is not None and found is not None and int((found.confidence > 0).any((1, 2)).sum()) == 1

    @property
    def least_views(self) -> int:
        """Number of views needed to locate a keypoint: 2, or 1 if only one camera detects a person."""
        return 1 if self.is_one_view else 2

    @property
    def placed(self) -> np.ndarray:
        """(F, K) mask of keypoints visible in enough views (see ``least_views``)."""
        assert self.keypoints is not None
        return (self.keypoints.confidence > 0).sum(axis=0) >= self.least_views

    @property
    def several_views(self) -> tuple[Cameras, Keypoints2D] | None:
        """Cameras and keypoints if more than one camera may show the person, otherwise None."""
        if self.cameras is None or self.keypoints is None or self.is_one_view:
            return None
        return self.cameras, self.keypoints

    def require_views(self) -> tuple[Cameras, Keypoints2D]:
        """Return the cameras and keypoints of a capture with one or more views.

        Raises:
            TooFewViews: the capture has no cameras or keypoints.
            NoDetections: no keypoint is detected, or no two of several cameras have detections in a frame.
        """
        cameras, keypoints = self._require_detections()
        return (cameras, keypoints) if self.is_one_view else self.require_multiview()

    def require_multiview(self) -> tuple[Cameras, Keypoints2D]:
        """Return the cameras and keypoints of a capture that can be triangulated.

        Raises:
            TooFewViews: fewer than two cameras have detections.
            NoDetections: no two cameras detect a keypoint in the same frame.
        """
        cameras, keypoints = self._require_detections()
        seen = keypoints.confidence > 0
        seeing = int(seen.any(axis=(1, 2)).sum())
        if seeing < 2:
            what = f"{seeing} of {len(cameras)} cameras have detections, but two are needed."
            raise TooFewViews(what, where=self.name, hint="Add the detections of another camera.")
        if not (seen.sum(axis=0) >= 2).any():
            raise NoDetections("No keypoint is seen by two cameras in the same frame.", where=self.name)
        return cameras, keypoints

    def _require_detections(self) -> tuple[Cameras, Keypoints2D]:
        if self.cameras is None or self.keypoints is None:
            raise TooFewViews("The capture has no calibrated 2D keypoints.", where=self.name)
        if not (self.keypoints.confidence > 0).any():
            hint = "Run the detector again, or choose other files."
            raise NoDetections("All confidences are zero, so no person was detected.", where=self.name, hint=hint)
        return self.cameras, self.keypoints

    def of_person(self, name: str) -> Capture:
        """Select a person by name or number. Raise PersonUnknown if there is no such person."""
        wanted = name.strip().casefold()
        for number, person in enumerate(self.people, 1):
            if wanted in (person.name.casefold(), str(number)):
                return replace(self, keypoints=person.keypoints, person=person.name)
        names = ", ".join(person.name for person in self.people)
        hint = f"It shows {names}." if names else "The capture has one person. Omit the name."
        raise PersonUnknown(f"The capture has no person '{name}'.", where=self.name, hint=hint)

    def frames(self, start: int, stop: int) -> Capture:
        """Return the capture's frames from ``start`` to ``stop`` - 1, including ground truth and footage."""

        def cut(values: np.ndarray) -> np.ndarray:  # (F, ...) or (C, F, ...)
            axis = next((n for n, size in enumerate(values.shape[:2]) if size == self.num_frames), None)
            return values if axis is None else values[(slice(None),) * axis + (slice(start, stop),)]

        first = self.footage_first or (0,) * len(self.footage)
        parts = {name: getattr(self, name) for name in ("keypoints", "markers", "others")}
        return replace(
            self,
            cameras=None if self.cameras is None else self.cameras.at(slice(start, stop)),
            **{name: None if part is None else part.frames(start, stop) for name, part in parts.items()},
            people=tuple(replace(person, keypoints=person.keypoints.frames(start, stop)) for person in self.people),
            footage_first=tuple(picture + start for picture in first),
            truth={name: cut(values) for name, values in self.truth.items()},
        )

    def without_views(self, texts: Sequence[str]) -> Capture:
        """Return the capture without the views that the user excludes, see ``left_out_views``.

        Raises:
            TooFewViews: no camera remains.
        """
        if not texts:
            return self
        cameras, keypoints = self.require_views()
        out = left_out_views(texts, cameras.names, keypoints.num_frames)
        confidence = np.where(out[..., None], 0.0, keypoints.confidence)
        if not (confidence > 0).any():
            raise TooFewViews("No camera with detections is left.", where=self.name, hint="Keep more cameras.")
        return replace(self, keypoints=replace(keypoints, confidence=confidence))

    def views(self, indices: list[int]) -> Capture:
        """Return the capture restricted to the cameras at these indices."""
        assert self.cameras is not None and self.keypoints is not None
        footage = tuple(self.footage[i] for i in indices) if self.footage else ()
        people = tuple(replace(person, keypoints=person.keypoints.views(indices)) for person in self.people)
        cameras, keypoints = self.cameras.subset(indices), self.keypoints.views(indices)
        return replace(self, cameras=cameras, keypoints=keypoints, footage=footage, people=people)


_FORM = re.compile(r"(?P<camera>.+?)(?::(?P<first>\d+)-(?P<last>\d+))?")


def left_out_views(texts: Sequence[str], names: Sequence[str], frames: int) -> Bool[np.ndarray, "views frames"]:
    """Return a (C, F) mask of views to exclude, given as ``CAMERA`` or ``CAMERA:FIRST-LAST`` (frames from 0)."""
    out = np.zeros((len(names), frames), bool)
    for text in texts:
        found = _FORM.fullmatch(text)
        first, last = (0, frames - 1) if found is None or not found["first"] else map(int, found.group("first", "last"))
        if found is None or (found["first"] and first > last):
            raise JobInvalid(
                f"'{text}' is not a camera to exclude.", where="leave_out", hint="Write CAMERA or CAMERA:FIRST-LAST."
            )
        if found["camera"] not in names:
            what, hint = f"There is no camera '{found['camera']}' to leave out.", f"Cameras: {', '.join(names)}."
            raise JobInvalid(what, where="leave_out", hint=hint)
        if found["first"] and first >= frames:
            raise JobInvalid(f"'{text}' begins after the last frame ({frames - 1}).", where="leave_out")
        out[list(names).index(found["camera"]), first : last + 1] = True
    return out


LIMBS: dict[str, tuple[str, ...]] = {"arms": ("shoulder", "elbow", "wrist"), "legs": ("hip", "knee", "ankle")}
"""Joints of each limb that every detector finds on both sides, from the trunk outwards."""
FEET: tuple[str, ...] = ("big_toe", "small_toe", "heel", "foot")  # Foot points per side in some joint sets.
