"""Everything that was found about a solve: by its reader, by the solve itself, and by what the result shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, read_diagnostics
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.runs import true_runs
from solver_backend.io.recognition.motion_checks import check_motion
from solver_backend.io.recognition.world_check import LARGEST_RESIDUAL_PX, LEG_SHARE
from solver_backend.metrics import foot_skating_cm_per_frame
from solver_backend.report.statistics import Residuals, detected_share, residuals_of
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Motion

BELOW_FLOOR_M = 0.05
"""Depth of a foot joint under the floor beyond which the floor is doubted."""
DRIFT_M, DRIFT_ENDS_S = 0.5, 0.5
"""Metres by which the lowest joint is elsewhere in the last half second than in the first."""
STATURES_M = (1.2, 2.2)
"""Of people who are recorded: children of seven years to the tallest athletes."""
UNSURE_SHARE = 0.02
"""Of the frames; where more are unsure, an animator has more than single frames to look at."""
LEAST_AGREEMENT_PERCENT = 75.0
"""Of the detections that are no outliers; where the tile of the report turns red."""
DISAGREES = 1.6
"""A camera's median residual over the median of the others'."""
SELDOM_PERCENT, OUTLIER_PERCENT = 50.0, 20.0
"""Of a keypoint's frames in which two cameras detect it; of its detections in one view that are outliers."""
SKATING_CM_S = 15.0
"""Of feet on the floor."""


def diagnose(capture: Capture, motion: Motion, residuals: Residuals | None = None) -> tuple[Diagnostic, ...]:
    """Return everything that was found, the gravest first; for a motion that holds it already, the same again.

    Args:
        capture: what was solved.
        motion: the solve; what was found while it was solved stands in its provenance.
        residuals: of the motion in the capture, measured here if None.

    Raises:
        MotionInvalid: the motion does not belong to the capture.
    """
    residuals = residuals or residuals_of(capture, motion)
    found = [*capture_diagnostics(capture), *recorded_diagnostics(motion), *check_motion(motion)]
    found += [*_flagged(motion), *_stature(motion)]
    if residuals is not None:
        found += [*_agreement(residuals), *_cameras(capture, residuals), *_keypoints(capture, residuals)]
    return by_gravity([*found, *_floor(motion)])


def capture_diagnostics(capture: Capture) -> tuple[Diagnostic, ...]:
    """Return what the reader of a capture found."""
    notes = tuple(diagnostic("earlier_note", text=note) for note in capture.notes)
    return (*notes, *read_diagnostics(capture.problems))


def recorded_diagnostics(motion: Motion) -> tuple[Diagnostic, ...]:
    """Return what a motion says was found when it was solved; in ``findings`` where an earlier version wrote it."""
    return read_diagnostics([*_list(motion, "findings"), *_list(motion, "diagnostics")])


def _list(motion: Motion, key: str) -> list[object]:
    values = motion.provenance.get(key)
    return values if isinstance(values, list) else []


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


def _flagged(motion: Motion) -> Iterator[Diagnostic]:
    if motion.flags is None:
        return
    kind = "_markers" if motion.markers is not None else ""
    unseen, unsure = ((motion.flags & bit) > 0 for bit in (FLAG_UNSEEN, FLAG_UNSURE))
    if unseen.any():
        yield diagnostic(f"frames_unseen{kind}", frames=true_runs(unseen))
    if unsure.any():
        few = "few_" if unsure.mean() <= UNSURE_SHARE else ""
        yield diagnostic(f"{few}frames_unsure{kind}", frames=true_runs(unsure), percent=100 * unsure.mean())


def _joints(motion: Motion, *names: str) -> np.ndarray | None:
    """Return (F, N, 3) joints by name, None where the motion's body lacks one."""
    known = motion.body_layout.joints
    return motion.joints[:, [known.index(name) for name in names]] if set(names) <= set(known) else None


def _rests(motion: Motion, *names: str) -> bool:
    """Return whether one of these joints is at rest in some frame."""
    columns = [motion.body_layout.joints.index(name) for name in names]
    return motion.resting is not None and bool(motion.resting[:, columns].any())


def _stature(motion: Motion) -> Iterator[Diagnostic]:
    """The stature by the legs, which every body of the family has in the same joints."""
    leg = _joints(motion, "left_hip", "left_knee", "left_ankle")
    if leg is None:
        return
    stature = float(np.linalg.norm(np.diff(leg[0], axis=0), axis=-1).sum()) / LEG_SHARE
    if not STATURES_M[0] <= stature <= STATURES_M[1]:
        yield diagnostic("stature_odd", size=stature, least=STATURES_M[0], most=STATURES_M[1])


def _agreement(residuals: Residuals) -> Iterator[Diagnostic]:
    percent = float(residuals.agreement_percent((0, 1, 2)))
    if percent < LEAST_AGREEMENT_PERCENT:
        yield diagnostic("views_disagree_with_result", percent=percent)
    if residuals.median_px > LARGEST_RESIDUAL_PX:
        yield diagnostic("residual_large", size=residuals.median_px, limit=LARGEST_RESIDUAL_PX)


def _cameras(capture: Capture, residuals: Residuals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None
    seen = detected_share(capture)
    assert seen is not None
    medians = residuals.by_camera
    for c, name in enumerate(capture.cameras.names):
        others = np.delete(medians, c)
        others = others[np.isfinite(others)]
        percent = 100 * float(seen[c].mean())
        if others.size and medians[c] > DISAGREES * float(quantile(others, 0.5, axis=0)):
            usual = float(quantile(others, 0.5, axis=0))
            yield diagnostic("camera_disagrees", cameras=[name], size=medians[c], usual=usual)
        if percent < SELDOM_PERCENT:
            yield diagnostic("camera_sees_little", cameras=[name], percent=percent)


def _keypoints(capture: Capture, residuals: Residuals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None and capture.keypoints is not None
    agreement = residuals.agreement_percent(1)
    names = [name.replace("_", " ") for name in capture.keypoints.joint_set.keypoints]
    twice = 100.0 * ((capture.keypoints.confidence > 0).sum(axis=0) >= 2).mean(axis=0)
    rare = [f"{names[k]} ({twice[k]:.0f} %)" for k in np.argsort(twice, kind="stable") if twice[k] < SELDOM_PERCENT]
    if rare:
        yield diagnostic("keypoints_seldom_seen", shares=rare)
    outliers = 100.0 - np.nan_to_num(agreement, nan=100.0)
    poor = sorted((-float(outliers[c, k]), c, k) for c, k in np.argwhere(outliers > OUTLIER_PERCENT))
    if poor:
        shares = [f"{names[k]} in {capture.cameras.names[c]} ({-share:.0f} %)" for share, c, k in poor]
        yield diagnostic("keypoints_often_outliers", shares=shares)


def _drift(motion: Motion) -> Iterator[Diagnostic]:
    """Another height of the body's lowest joint at the take's end than at its beginning: a floor does not move."""
    lowest, ends = motion.joints[..., 2].min(axis=1), max(1, round(DRIFT_ENDS_S * motion.fps))
    change = float(lowest[-ends:].min() - lowest[:ends].min())
    if len(lowest) > 2 * ends and abs(change) > DRIFT_M:
        yield diagnostic("take_drifts", size=abs(change), way="sinks" if change < 0 else "rises")


def _floor(motion: Motion) -> Iterator[Diagnostic]:
    feet = _joints(motion, "left_foot", "right_foot")
    if feet is None or _rests(motion, "left_foot", "right_foot"):
        return
    lowest = feet[..., 2].min(axis=1)
    yield from _drift(motion)
    below = -float(lowest.min())
    if below > BELOW_FLOOR_M:
        usual = -float(np.median(lowest)) > BELOW_FLOOR_M
        yield diagnostic("floor_too_high" if usual else "foot_below_floor", size=100 * below)
    skating = foot_skating_cm_per_frame(feet)
    if skating * motion.fps > SKATING_CM_S:
        yield diagnostic("feet_slide", size=skating)
