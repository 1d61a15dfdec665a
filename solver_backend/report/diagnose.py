"""Everything that was found about a solve: by its reader, by the solve itself, and by what the result shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, read_diagnostics
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.io.motions.motion_checks import check_motion
from solver_backend.report.explained import without_explained
from solver_backend.report.plausibility import plausibility
from solver_backend.report.statistics import KeypointResiduals, detected_share, residuals_of
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Motion

UNSURE_SHARE = 0.02
"""Of the frames; where more are unsure, an animator has more than single frames to look at."""
DISAGREES = 1.6
"""A camera's median residual over the median of the others'."""
SELDOM_PERCENT, OUTLIER_PERCENT = 50.0, 20.0
"""Of a keypoint's frames in which two cameras detect it; of its detections in one view that are outliers."""


def diagnose(capture: Capture, motion: Motion, residuals: KeypointResiduals | None = None) -> tuple[Diagnostic, ...]:
    """Return everything that was found, the gravest first; for a motion that holds it already, the same again.

    Args:
        capture: what was solved.
        motion: the solve; what was found while it was solved stands in its provenance.
        residuals: of the motion in the capture, measured here if None.

    Raises:
        MotionInvalid: the motion does not belong to the capture.
    """
    capture = capture.named
    residuals = residuals or residuals_of(capture, motion)
    found = [*capture_diagnostics(capture), *recorded_diagnostics(motion), *check_motion(motion)]
    found += [*_flagged(motion, capture.is_one_view), *plausibility(capture, motion, residuals)]
    if residuals is not None:
        found += [*_cameras(capture, residuals), *_keypoints(capture, residuals)]
    return by_gravity(without_explained(found, motion.num_frames, capture))


def capture_diagnostics(capture: Capture) -> tuple[Diagnostic, ...]:
    """Return what the reader of a capture found."""
    return (*capture.notes, *capture.problems)


def recorded_diagnostics(motion: Motion) -> tuple[Diagnostic, ...]:
    """Return what a motion states was found when it was solved."""
    return read_diagnostics(motion.provenance.get("diagnostics"))


def by_gravity(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return each diagnostic once, errors and warnings before notes.

    Two are the same if code and names are: figures of a file that was read again differ in their last digit.
    """
    first: dict[object, Diagnostic] = {}
    for item in found:
        where = item.where
        text = item.values.get("text") or item.values.get("part")
        key = item.code, where.cameras, where.markers, where.joints, where.person, where.file, item.remedy, text
        first.setdefault(key, item)
    return tuple(sorted(first.values(), key=lambda item: ("error", "warning", "note").index(item.severity)))


def _flagged(motion: Motion, one_view: bool) -> Iterator[Diagnostic]:
    if motion.flags is None:
        return
    unseen, unsure = ((motion.flags & bit) > 0 for bit in (FLAG_UNSEEN, FLAG_UNSURE))
    if unseen.any():
        reason = "single" if one_view else "views" if motion.markers is None else "markers"
        yield diagnostic("frames_unseen", reason=reason, frames=true_runs(unseen))
    if unsure.any():
        severity = Severity.NOTE if unsure.mean() <= UNSURE_SHARE else Severity.WARNING
        data, percent = "views" if motion.markers is None else "markers", 100 * unsure.mean()
        yield diagnostic("frames_unsure", severity=severity, data=data, frames=true_runs(unsure), percent=percent)


def _cameras(capture: Capture, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None
    seen = detected_share(capture)
    assert seen is not None
    medians = residuals.by_camera
    angles = medians / capture.cameras.K[:, 0, 0]
    for c, name in enumerate(capture.cameras.names):
        others = np.delete(angles, c)
        others = others[np.isfinite(others)]
        percent = 100 * float(seen[c].mean())
        usual = float(quantile(others, 0.5, axis=0) * capture.cameras.K[c, 0, 0]) if others.size else float("nan")
        if medians[c] > DISAGREES * usual:
            yield diagnostic("camera_disagrees", cameras=[name], size=medians[c], usual=usual)
        if percent < SELDOM_PERCENT:
            yield diagnostic("camera_sees_little", cameras=[name], percent=percent)


def _keypoints(capture: Capture, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None and capture.keypoints is not None
    agreement = residuals.agreement_percent(1)
    names = [name.replace("_", " ") for name in capture.keypoints.joint_set.keypoints]
    least = 1 if capture.is_one_view else 2
    often = 100.0 * ((capture.keypoints.confidence > 0).sum(axis=0) >= least).mean(axis=0)
    rare = [f"{names[k]} ({often[k]:.0f} %)" for k in np.argsort(often, kind="stable") if often[k] < SELDOM_PERCENT]
    if rare:
        yield diagnostic("keypoints_seldom_seen", shares=rare)
    outliers = 100.0 - np.nan_to_num(agreement, nan=100.0)
    poor = sorted((-float(outliers[c, k]), c, k) for c, k in np.argwhere(outliers > OUTLIER_PERCENT))
    if poor:
        shares = [f"{names[k]} in {capture.cameras.names[c]} ({-share:.0f} %)" for share, c, k in poor]
        yield diagnostic("keypoints_often_outliers", shares=shares)
