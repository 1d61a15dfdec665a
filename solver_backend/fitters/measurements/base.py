"""What a solve starts from and is evaluated by, whatever was measured: keypoints in views, or optical markers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.fitters.measurements.hand_clouds import HandClouds
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.fitters.measurements.own_views import OwnViews
from solver_backend.fitters.model.states import FrameStates
from solver_backend.fitters.model.subject import Subject
from solver_backend.residuals.point_term import DataTerm, PointTerm
from solver_backend.types import JointSet, MarkerCloud


class ResidualReport(Protocol):
    """How far a motion is from the measurements, in their own unit."""

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray | None, dict[str, float]]:
        """Return (C, F, L) reprojection errors in pixels, if there are images, and statistics, of (F, L, 3) points."""
        ...


@dataclass(frozen=True)
class RoughMotion:
    """Poses of some frames of a take."""

    frames: np.ndarray
    """(S,) frame numbers, ascending."""
    states: FrameStates
    """S poses as codes."""


@dataclass(frozen=True)
class OneView:
    """What a single camera leaves open."""

    camera: str
    """Its name."""
    centre: np.ndarray
    """(3,) place of the camera, metres."""
    size_sigma: float
    """Standard deviation of the person's size and distance, as a share: alike in all frames."""
    focal_sigma: float
    """The same of the focal length, by which distances alone are wrong."""
    size_source: str
    """What the size is from."""
    up_from_person: bool
    """Up and floor of the world were found from the person."""
    sight: np.ndarray
    """(F, 3) unit direction from the camera to the person."""
    sight_sigma_m: np.ndarray
    """(F, J) standard deviation along the line of sight of each recorded joint about the body's middle, as the lifter
    has it, metres."""
    slant_chances: np.ndarray
    """(F, 8, 3) chances that each bone of arms and legs points towards the camera, across or away from it."""


@dataclass(frozen=True)
class Measurements:
    """F frames of L points of one person."""

    landmarks: Landmarks
    """The L points on the body."""
    points: np.ndarray
    """(F, L, 3) world metres, NaN where a point was not located."""
    covariance: np.ndarray
    """(F, L, 3, 3) m²; NaN or anything where there is no point."""
    term: DataTerm
    """How far landmarks are from what was measured."""
    fps: float
    """Frames per second."""
    report: ResidualReport
    """The same for people to read."""
    joint_set: JointSet | None = None
    """Names of the points, where they are a detector's keypoints."""
    marker_labels: tuple[str, ...] | None = None
    """Names of the points, where they are optical markers."""
    marker_sigma: np.ndarray | None = None
    """(L,) standard deviation of each marker around where the body has it, per axis, metres."""
    marker_flags: np.ndarray | None = None
    """(F, L) bit mask of ``MARKER_*``."""
    subject: Subject | None = None
    """The person, where they are known before the solve: markers are calibrated first."""
    rough: RoughMotion | None = None
    """Where to start from, where that was found with the person."""
    beside: tuple[PointTerm, ...] = ()
    """What else holds the points: a floor."""
    relative: tuple[PointTerm, ...] = ()
    """What is known of the points but for a shift of all of them: a lifted pose."""
    one_view: OneView | None = None
    """What one camera leaves open, where there is but one."""
    hands: HandViews | HandClouds | None = None
    """The hands that views or markers show beside the points; None where none does."""
    own: OwnViews | None = None
    """The own points of the user that views show beside the keypoints; None where there are none."""
    loose: MarkerCloud | None = None
    """Markers of the recording that are no known places of the person."""
    others: MarkerCloud | None = None
    """Those that are nobody's, by their prefixes."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """What a motion records of them: noise, and faults that were found."""

    @property
    def num_frames(self) -> int:
        """F."""
        return len(self.points)

    @property
    def located(self) -> np.ndarray:
        """(F, L) bool: the points that are known."""
        return np.isfinite(self.points).all(-1)

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool: enough points are known to place a body."""
        return seen_frames(self.points)


def seen_frames(points: np.ndarray) -> np.ndarray:
    """Return (F,) bool: enough of the (F, L, 3) points, NaN where missing, are known to place a body."""
    located = np.isfinite(points).all(-1)
    return located.sum(-1) >= min(6, located.shape[1] // 2)
