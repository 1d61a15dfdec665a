"""Keypoints that calibrated cameras see: triangulated, checked, and evaluated by their reprojection."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SYNC_AUTO
from solver_backend.fitters.measurements.base import Measurements, seen_frames
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.fitters.measurements.model_error import fit_sigma_px
from solver_backend.fitters.measurements.own_views import OwnViews
from solver_backend.fitters.measurements.reprojection_report import ReprojectionReport
from solver_backend.fitters.measurements.sanitise import check_capture
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture


def measure_views(
    capture: Capture,
    body: Body,
    like: Array,
    progress: Progress,
    *,
    estimate_sync: bool = False,
    sync: str = SYNC_AUTO,
) -> Measurements:
    """Return what the views of a capture measure, after faults of single views were found and repaired.

    Args:
        capture: calibrated cameras and 2D keypoints.
        body: whose landmarks the keypoints are.
        like: array that sets kind, type and device.
        progress: called as stages advance.
        estimate_sync: see ``check_capture``.
        sync: see ``check_capture``.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
        NotSynchronised: see ``check_capture``.
    """
    cameras, keypoints = capture.require_multiview()
    triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence, progress=progress)
    checked = check_capture(capture, triangulation, progress, estimate_sync=estimate_sync, sync=sync)
    return measurements_of(checked.capture, checked.triangulation, body, like, checked.diagnostics)


def measurements_of(
    capture: Capture, triangulation: Triangulation, body: Body, like: Array, found: tuple[Diagnostic, ...] = (), *,
    model_error: bool = True,
) -> Measurements:  # fmt: skip
    """Return the measurements of a capture that is triangulated and taken as it is.

    Args:
        capture: calibrated cameras and 2D keypoints.
        triangulation: of these.
        body: whose landmarks the keypoints are.
        like: array that sets kind, type and device.
        found: before.
        model_error: allow for what a body cannot follow beside the detector's noise (see ``fit_sigma_px``).

    Raises:
        NoDetections: in no frame enough points are known to place a body.
    """
    cameras, keypoints = capture.require_multiview()
    named = keypoints.named
    count = named.joint_set.num_keypoints
    points, covariance = triangulation.points[:, :count], triangulation.covariance[:, :count]
    if not seen_frames(np.asarray(points)).any():
        raise NoDetections(
            "In no frame do two cameras agree on enough keypoints to place a body.", where=capture.name,
            hint="Check that the calibration belongs to this recording and that the cameras are synchronised.",
        )  # fmt: skip
    sigma_px = triangulation.sigma_px
    fit_px = fit_sigma_px(cameras, triangulation.points, sigma_px) if model_error else sigma_px
    return Measurements(
        landmarks=keypoint_landmarks(body, named.joint_set),
        points=points,
        covariance=covariance,
        term=ReprojectionTerm.of(cameras, named, fit_px[..., :count], like),
        fps=named.fps,
        report=ReprojectionReport(cameras, named),
        joint_set=named.joint_set,
        hands=HandViews.of(cameras, keypoints),
        own=OwnViews.of(cameras, keypoints, triangulation, fit_px),
        provenance={
            "diagnostics": [item.as_dict() for item in found],
            "sigma_px": [round(float(s), 3) for s in sigma_px[:count]],
        },
    )
