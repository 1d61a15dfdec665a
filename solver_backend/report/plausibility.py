"""What a result shows of itself: who would be of such a size, stand so and be seen so; and what is surely useless."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.agreement.detections import MIN_POINTS
from solver_backend.agreement.left_out import left_out_views
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.quantiles import quantile
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.world_check import LEG_SHARE
from solver_backend.report.floor_plausibility import floor_plausibility, joints_of, rests
from solver_backend.report.marker_plausibility import centres_of, hips_never_move, marker_plausibility, useless
from solver_backend.report.statistics import KeypointResiduals
from solver_backend.types import Capture, JointSet, Motion

STATURES_M = (1.2, 2.2)
"""Of people who are recorded: children of seven years to the tallest athletes."""
IMPOSSIBLE_STATURES_M = (0.65, 2.8)
"""Beyond babies who stand and the tallest man who was measured (2.72 m): the scale is wrong by half or more."""
LEAST_AGREEMENT_PERCENT = 75.0
"""Of the detections that are no outliers; where the tile of the report turns red."""
LEAST_VIEWS_PERCENT = 75.0
"""Of the views that should see the person and see somebody. Real captures and the demo reach 100 %."""
USELESS_VIEWS_PERCENT, USELESS_VIEWS = 62.5, 2.75
"""Share and number of agreeing views below which, both, a result is useless: two of four can meet by chance (cameras
started seconds apart: 56 %, 2.2 views), two of three or three of five hardly. Of two cameras, less than three quarters
leave half of the frames to one of them (the demo with one mirrored: 65 %, 201 mm off)."""
AGREES_SHARE = 0.06
"""A view agrees with the body up to this median distance over the person's extent in the picture; detectors are off by
0.8 to 1.5 %."""
DETECTOR_SHARE, USELESS_SHARE = 0.04, 0.1
"""Median distance over the person's extent that no detector has, and that makes a result useless."""
TILT_DEGREES, TILT_SIGMAS = 8.0, 3.0
"""Between a person's stance and the world's up; both must be surpassed. Levelled takes stay within 5 degrees."""
STANDS_SHARE = 0.5
"""Of the frames: who is upright within half a right angle for less is no witness of what is up."""


def plausibility(capture: Capture, motion: Motion, residuals: KeypointResiduals | None) -> Iterator[Diagnostic]:
    """Yield what makes a result doubtful or useless.

    Args:
        capture: what was solved.
        motion: the solve.
        residuals: of the motion in the capture, None where nothing was seen in pictures.
    """
    yield from _stature(motion)
    if residuals is not None:
        yield from _residual(capture, motion, residuals)
        yield from _views(capture, motion, residuals)
    if residuals is not None or centres_of(motion):  # laboratories of markers are level
        yield from _tilt(motion)
    yield from marker_plausibility(motion)
    if hips_never_move(capture, motion):
        yield diagnostic("hips_never_move")
    else:
        yield from floor_plausibility(motion)


def _stature(motion: Motion) -> Iterator[Diagnostic]:
    """The stature by the legs, which every body of the family has in the same joints."""
    leg = joints_of(motion, "left_hip", "left_knee", "left_ankle")
    if leg is None:
        return
    stature = float(np.linalg.norm(np.diff(leg[0], axis=0), axis=-1).sum()) / LEG_SHARE
    for severity, (least, most) in ((Severity.ERROR, IMPOSSIBLE_STATURES_M), (Severity.WARNING, STATURES_M)):
        if not least <= stature <= most:
            yield diagnostic("stature_odd", severity=severity, size=stature, least=least, most=most)
            return


@dataclass(frozen=True)
class ViewAgreement:
    """Which views have the person where the body is."""

    counted: np.ndarray
    """(C, F) bool: the view sees the person, or somebody else where the person should be seen."""
    agrees: np.ndarray
    """(C, F) bool: what it sees is the person."""

    @property
    def percent(self) -> float:
        """Share of the views that agree; NaN where nobody is seen."""
        return 100.0 * self.agrees.sum() / self.counted.sum() if self.counted.any() else float("nan")

    @property
    def views(self) -> float:
        """How many views agree in a frame, the mean over frames in which somebody is seen."""
        return float(self.agrees.sum() / max(1, self.counted.any(0).sum()))


def view_agreement(capture: Capture, motion: Motion, residuals: KeypointResiduals) -> ViewAgreement:
    """Return which views agree with the body, frame by frame.

    A view of others counts against the person only where her body lies in its picture: two people in two corners, each
    in the pictures of two cameras, contradict nobody. Views that the user left out do not count.
    """
    assert capture.cameras is not None and capture.keypoints is not None
    px = _body_px(capture, motion)
    inside = ((px >= 0) & (px < capture.cameras.image_size[:, None, None])).all(-1).mean(-1) > 0.5
    seen = (capture.keypoints.confidence > 0).sum(-1) >= MIN_POINTS
    with np.errstate(invalid="ignore"):
        off = quantile(np.moveaxis(residuals.error_px, -1, 0), 0.5, axis=0) / _extents(px)
    others = np.zeros_like(seen)
    for person in capture.people:
        if person.name != capture.person:
            others |= inside & ((person.keypoints.confidence > 0).sum(-1) >= MIN_POINTS)
    settings = motion.provenance.get("settings")
    texts = settings.get("leave_out", ()) if isinstance(settings, dict) else ()
    taken = ~left_out_views(texts or (), capture.cameras.names, motion.num_frames)
    return ViewAgreement((seen | others) & taken, seen & taken & (off < AGREES_SHARE))


def _body_px(capture: Capture, motion: Motion) -> np.ndarray:
    """Return (C, F, K, 2) where the views have the body's keypoints; detections where the motion holds none."""
    assert capture.cameras is not None and capture.keypoints is not None
    c = capture.cameras
    if motion.keypoints3d is None:
        return np.where(capture.keypoints.confidence[..., None] > 0, capture.keypoints.xy, np.nan)
    return project(c, motion.keypoints3d)


def _extents(px: np.ndarray) -> np.ndarray:
    """Return (C, F) the diagonal of the box around (C, F, K, 2) pixels, NaN where too few are known."""
    known = np.isfinite(px)
    size = np.where(known, px, -np.inf).max(-2) - np.where(known, px, np.inf).min(-2)
    return np.where(known.all(-1).sum(-1) >= MIN_POINTS, np.hypot(size[..., 0], size[..., 1]), np.nan)


def _views(capture: Capture, motion: Motion, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    percent = float(residuals.agreement_percent((0, 1, 2)))
    if percent < LEAST_AGREEMENT_PERCENT:
        yield diagnostic("views_disagree_with_result", percent=percent)
    agreement = view_agreement(capture, motion, residuals)
    if agreement.percent < LEAST_VIEWS_PERCENT:
        assert capture.cameras is not None
        few = agreement.percent < USELESS_VIEWS_PERCENT and agreement.views < USELESS_VIEWS
        severity = useless(few or len(capture.cameras) == 2)
        counted = np.maximum(agreement.counted.sum(1), 1)
        poor = agreement.agrees.sum(1) / counted < LEAST_VIEWS_PERCENT / 100
        names = [name for name, bad in zip(capture.cameras.names, poor, strict=True) if bad]
        yield diagnostic("views_contradict", severity=severity, cameras=names, percent=agreement.percent)


def _residual(capture: Capture, motion: Motion, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    extents = _extents(_body_px(capture, motion))[..., None]
    share = float(quantile((residuals.error_px / extents).ravel(), 0.5, axis=0))
    if share > DETECTOR_SHARE:
        figures: dict[str, Any] = {"size": residuals.median_px, "share": 100 * share, "limit": 100 * DETECTOR_SHARE}
        yield diagnostic("residual_large", severity=useless(share > USELESS_SHARE), **figures)


_STANCE = JointSet.COCO_17


def _tilt(motion: Motion) -> Iterator[Diagnostic]:
    """The angle of a person's stance with Z, by her trunk, balance and feet."""
    limbs = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    names = [f"{side}_{limb}" for limb in limbs for side in ("left", "right")]
    joints = joints_of(motion, *names)
    if joints is None or motion.num_frames < 2 or rests(motion, *names):
        return
    along = joints[:, 0:2].mean(1) - joints[:, -2:].mean(1)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    if (along[:, 2] > np.sqrt(0.5)).mean() < STANDS_SHARE:
        return
    points = np.full((motion.num_frames, len(_STANCE.keypoints), 3), np.nan)
    points[:, [_STANCE.keypoints.index(name) for name in names]] = joints
    step = max(1, motion.num_frames // 240)
    try:
        upright = upright_from_person(points[::step], _STANCE)
    except NoDetections:
        return
    tilt, sigma = np.degrees(np.arccos(np.clip(upright.R[2, 2], -1.0, 1.0))), np.degrees(upright.tilt_sigma)
    if centres_of(motion):  # a suit that sinks has no floor to witness: the body has to lean, too
        mean = along.mean(axis=0)
        lean = np.degrees(np.arccos(np.clip(mean[2] / max(float(np.linalg.norm(mean)), 1e-9), -1.0, 1.0)))
        tilt = tilt if lean > max(TILT_DEGREES, 0.5 * tilt) else 0.0
    if tilt > max(TILT_DEGREES, TILT_SIGMAS * sigma):
        yield diagnostic("person_tilted", size=float(tilt), sigma=float(sigma))
