"""Check a capture and its solve, and return the diagnostics, most severe first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.agreement.epipolar_fit import report_lenses
from solver_backend.agreement.reading import MIN_POINTS, extent
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import limb_of, of_one_limb
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic, load_table, read_diagnostics
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.plausible import HIGHEST_STEP_M
from solver_backend.exchange.stands import SPEED_M_S, steps
from solver_backend.geometry.arrays import quantile, true_runs
from solver_backend.io.motions.motion_checks import check_motion
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import LEG_SHARE
from solver_backend.metrics import foot_skating_cm_per_frame
from solver_backend.report.statistics import KeypointResiduals, detected_share, residuals_of
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, MARKER_GHOST, Capture, JointSet, Motion
from solver_backend.types.capture import left_out_views

BELOW_FLOOR_M, ABOVE_FLOOR_M = 0.05, 0.25
"""Heights of a foot joint below and above the floor that are suspicious, in metres."""
DRIFT_M, DRIFT_ENDS_S = 0.5, 0.5
"""Smallest height change (m) of the lowest joint that counts as a drift, and duration (s) of the two ends compared."""
STEADY = 0.3  # Smallest fraction of the change that the median speed must explain in a drift. Steps are sudden.
_LEAST_STANCES = 0.1  # Smallest fraction of frames in which a foot stands still on the ground, for stances to count.
SKATING_CM_S, _SLIDING_HZ = 15.0, 30.0
"""Largest speed (cm/s) of feet on the floor that do not skate, and sampling rate (Hz) that suppresses noise in fast
recordings."""
_ON_FLOOR_SHARE = 0.02  # Fraction of frames in which the feet are lowest. These determine the floor.


def _feet(capture: Capture, motion: Motion) -> Iterator[Diagnostic]:
    feet = joints_of(motion, "left_foot", "right_foot")
    if feet is None or rests(motion, "left_foot", "right_foot"):
        return
    lowest = feet[..., 2].min(axis=1)
    if centres_of(motion) or capture.is_one_view:  # several cameras can see a climber. A suit's floor may sink
        yield from _drift(motion, feet)
    below, usual = -float(lowest.min()), float(np.median(lowest))
    if usual < -BELOW_FLOOR_M:
        yield diagnostic("feet_off_floor", size=-100 * usual, way="below")
    elif below > BELOW_FLOOR_M:
        yield diagnostic("foot_below_floor", size=100 * below)
    low = float(quantile(lowest, _ON_FLOOR_SHARE, axis=0))
    if low > ABOVE_FLOOR_M and usual - low < ABOVE_FLOOR_M:  # otherwise a box, stairs or a trampoline
        severity = Severity.NOTE if usual <= HIGHEST_STEP_M else Severity.WARNING
        yield diagnostic("feet_off_floor", severity=severity, size=100 * usual, way="above")
    every = max(1, round(motion.fps / _SLIDING_HZ))
    skating = foot_skating_cm_per_frame(feet[::every]) * motion.fps / every
    if skating > SKATING_CM_S and usual > -BELOW_FLOOR_M:  # otherwise they always seem to be on the floor
        yield diagnostic("feet_slide", size=skating)


def joints_of(motion: Motion, *names: str) -> np.ndarray | None:
    """Return the (F, N, 3) positions of the named joints, or None if the body lacks any of them."""
    known = motion.body_layout.joints
    return motion.joints[:, [known.index(name) for name in names]] if set(names) <= set(known) else None


def rests(motion: Motion, *names: str) -> bool:
    """Return whether any of the named joints has no data in some frame, and is therefore shown at rest."""
    columns = [motion.body_layout.joints.index(name) for name in names]
    return motion.resting is not None and bool(motion.resting[:, columns].any())


def _drift(motion: Motion, feet: np.ndarray) -> Iterator[Diagnostic]:
    # The height of the lowest joint changes between the ends of the take, although a floor does not move.
    lowest, ends = motion.joints[..., 2].min(axis=1), max(1, round(DRIFT_ENDS_S * motion.fps))
    change = float(lowest[-ends:].min() - lowest[:ends].min())
    if len(lowest) <= 2 * ends or abs(change) <= DRIFT_M:
        return
    steady = float(np.median(lowest[ends:] - lowest[:-ends])) * len(lowest) / ends
    if steady / change > STEADY and _is_moving_in_stances(feet, motion.fps, change):
        yield diagnostic("take_drifts", size=abs(change), way="sinks" if change < 0 else "rises")


def _is_moving_in_stances(feet: np.ndarray, fps: float, change: float) -> bool:
    """Return whether planted feet rise or sink together with the whole body, as in a drift of the world.

    During a stance, a foot on stairs is still, whereas in a drift it moves with the body. Without stances, the two
    cannot be distinguished, and the result is True.
    """
    lower = feet[..., 2].argmin(axis=1)[:, None]
    way, seconds = steps(feet[..., :2], fps)
    stands = np.take_along_axis(np.linalg.norm(way, axis=-1) < SPEED_M_S * seconds, lower, axis=1)
    rises = np.take_along_axis(np.gradient(feet[..., 2], axis=0), lower, axis=1)
    return bool(stands.mean() < _LEAST_STANCES or len(feet) * rises[stands].mean() / change > STEADY)


FAR_MM, CENTRES_FAR_MM = 10.0, 30.0
"""Median residuals (mm) of markers and joint centres that are suspicious. 60 recordings from other laboratories have
0.1 to 5 (7 if a network labelled the points), and 3D keypoints from networks have up to 25."""
ALWAYS_MM, WHILE_MM, WHILE_S = 20.0, 50.0, 0.3
"""Suspicious values: median residual (mm) of a single marker, residual (mm) in some frames, and duration (s) of those
frames. In 60 recordings, good markers have medians up to 19, and exceed 50 for at most 0.24 s."""
STANDS_OUT = 2.0  # Largest ratio of a marker's or camera's residual to the others' without a warning.
_WAIST = ("LFWT", "RFWT", "LBWT", "RBWT")
_HIPS = (("=pelvis",), ("~mid_hip",), ("=left_hip", "=right_hip"), ("~left_hip", "~right_hip"), _WAIST, _WAIST[:2])
HIPS_STILL_M, HIPS_BESIDE_M = 2e-4, 0.1
"""Largest movement of the hip centre if positions are relative to it (caused by rounding in files), and smallest
movement of another point in that case, both in metres."""
USELESS = 5.0  # Multiple of these limits that makes a result useless.


def marker_plausibility(motion: Motion) -> Iterator[Diagnostic]:
    """Yield diagnostics if all markers, or single markers, are too far from the solved body."""
    error = motion.marker_residual_mm
    if error is None or motion.marker_labels is None or not isinstance(motion.provenance.get("markers"), list):
        return
    centres = centres_of(motion)
    size, limit = float(quantile(error[np.isfinite(error)], 0.5, axis=0)), CENTRES_FAR_MM if centres else FAR_MM
    if size > limit:
        severity, kind = useless(size > USELESS * limit), "joint centres" if centres else "markers"
        yield diagnostic("markers_far", severity=severity, size=size, limit=limit, kind=kind)
    yield from _far_markers(motion, size, limit / FAR_MM)
    yield from _side_by_name(motion.layout or ())


def _side_by_name(places: tuple[str, ...]) -> Iterator[Diagnostic]:
    """Yield a diagnostic if all markers are on one limb, and only their labels distinguish left from right."""
    named = [place for place in places if place[:1] in ("L", "R") and not is_joint_centre(place)]
    if len(named) < len(places) or not of_one_limb(named, load_layouts()):
        return
    side, arm = named[0][0], any(limb_of(place, load_layouts()) == "arm" for place in named)
    if arm or not {side + place for place in ("ANK", "HEE", "TOE")} <= set(named):
        side, limb = "left" if side == "L" else "right", "arm" if arm else "leg"
        yield diagnostic("limb_side_found", basis="label", side=side, limb=limb)


def useless(is_useless: bool) -> Severity:
    """Return error severity for a useless result, so that it is rejected. Otherwise, return warning severity."""
    return Severity.ERROR if is_useless else Severity.WARNING


def centres_of(motion: Motion) -> bool:
    """Return whether a motion was solved from joint centres."""
    places = motion.provenance.get("markers")
    return isinstance(places, list) and any(is_joint_centre(str(place)) for place in places)


def hips_never_move(capture: Capture, motion: Motion) -> bool:
    """Return whether the centre of the hips never moves, although other points move."""
    cloud = capture.markers
    if cloud is None or cloud.labels is None or motion.marker_labels is None or motion.layout is None:
        return False
    label_of = dict(zip(motion.layout, motion.marker_labels, strict=True))
    spans = np.ptp(cloud.positions, axis=0).max(-1) if len(cloud.positions) > 1 else np.zeros(0)
    if not (spans > HIPS_BESIDE_M).any():
        return False
    for places in _HIPS:
        columns = [cloud.labels.index(label_of[name]) for name in places if label_of.get(name) in cloud.labels]
        if len(columns) == len(places):
            middle = cloud.positions[:, columns].mean(axis=1)
            middle = middle[np.isfinite(middle).all(-1)]
            if len(middle) > 1 and np.ptp(middle, axis=0).max() < HIPS_STILL_M:
                return True
    return False


def _far_markers(motion: Motion, usual: float, scale: float) -> Iterator[Diagnostic]:
    """Yield diagnostics about markers that are far from their positions on the body.

    Args:
        usual: median residual of the take in millimetres.
        scale: factor applied to the limits.
    """
    assert motion.marker_residual_mm is not None and motion.marker_labels is not None
    thrown_out = 0 if motion.marker_flags is None else motion.marker_flags & MARKER_GHOST
    error = np.where(thrown_out, np.nan, motion.marker_residual_mm)
    always, least = quantile(error, 0.5, axis=0), max(scale * ALWAYS_MM, STANDS_OUT * usual)
    for m in np.argsort(-np.nan_to_num(always)):
        label, far = motion.marker_labels[int(m)], np.nan_to_num(error[:, m]) > scale * WHILE_MM
        if always[m] > least:
            yield diagnostic("marker_far", markers=[label], size=always[m])
        elif runs := [run for run in true_runs(far) if run[1] + 1 - run[0] >= WHILE_S * motion.fps]:
            largest = max(float(np.nanmax(error[a : b + 1, m])) for a, b in runs)
            yield diagnostic("marker_far", markers=[label], frames=runs, size=largest)


STATURES_M = (1.0, 2.2)  # Range of recorded people in metres, from four-year-old children to the tallest athletes.
IMPOSSIBLE_STATURES_M = (0.65, 2.8)
"""Limits beyond toddlers and the tallest man on record (2.72 m). Outside them, the scale is wrong by half or more."""
LEAST_AGREEMENT_PERCENT = 75.0  # Smallest percentage of inliers. If lower, the report shows a red tile.
LEAST_VIEWS_PERCENT = 75.0
"""Smallest percentage of views that show the person, among those that should. Real captures reach 100 %."""
USELESS_VIEWS_PERCENT, USELESS_VIEWS = 62.5, 2.75
"""Percentage and number of agreeing views. A result that is below both is useless. Two of four views can agree by
chance (cameras started seconds apart: 56 %, 2.2 views). Two of three or three of five rarely do. With two cameras, less
than 75 % leaves half of the frames to one of them (the demo with one camera mirrored: 65 %, 201 mm error)."""
AGREES_SHARE = 0.06
"""Largest median distance at which a view agrees with the body, relative to the person's extent in the image. Detector
errors are 0.8 to 1.5 %."""
DETECTOR_SHARE, USELESS_SHARE = 0.04, 0.1
"""Median distances relative to the person's extent: one exceeds any detector's errors, one makes a result useless."""
TILT_DEGREES, LEANS_DEGREES, TILT_SIGMAS = 8.0, 25.0, 3.0
"""Smallest suspicious angles between a standing person and the world's up direction: in degrees from joint centres, in
degrees from views, and in standard deviations. Level takes stay within 5 degrees, but people who dance or climb stairs
lean by 19 (``bench_good_captures``)."""
STANDS_SHARE = 0.5  # Smallest fraction of frames within 45° of upright that serves as evidence of up.


def _stature(motion: Motion) -> Iterator[Diagnostic]:
    # Use the legs, because all bodies of the family have the same leg joints.
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
    """Masks of the views that show the person at the position of the solved body."""

    counted: np.ndarray  # (C, F) mask of views that show the person, or somebody else where the person should be.
    agrees: np.ndarray  # (C, F) mask of views that show the person.

    @property
    def percent(self) -> float:
        """Percentage of views that agree, or NaN if no person is visible."""
        return 100.0 * self.agrees.sum() / self.counted.sum() if self.counted.any() else float("nan")

    @property
    def views(self) -> float:
        """Mean number of agreeing views per frame that shows a person."""
        return float(self.agrees.sum() / max(1, self.counted.any(0).sum()))


def view_agreement(capture: Capture, motion: Motion, residuals: KeypointResiduals) -> ViewAgreement:
    """Find the views that agree with the solved body in each frame.

    A view agrees if its detections of the solved person are near the projected body. A view disagrees if it detects
    another person there. This is only tested in frames in which at least two views detect the solved person, and no
    view shows the two people in different places. Views that show neither person and views that the user excluded do
    not count.
    """
    assert capture.cameras is not None and capture.keypoints is not None
    px = _body_px(capture, motion)
    inside = ((px >= 0) & (px < capture.cameras.image_size[:, None, None])).all(-1).mean(-1) > 0.5
    seen = (capture.keypoints.confidence > 0).sum(-1) >= MIN_POINTS
    extents = _extents(px)
    with np.errstate(invalid="ignore"):
        off = quantile(np.moveaxis(residuals.error_px, -1, 0), 0.5, axis=0) / extents
    others = np.zeros_like(seen)
    for person in capture.people:
        if person.name != capture.person:
            xy = np.where(person.keypoints.confidence[..., None] > 0, person.keypoints.xy, np.nan)
            apart = np.linalg.norm(_middles(xy) - _middles(px), axis=-1)
            present = (person.keypoints.confidence > 0).sum(-1) >= MIN_POINTS
            with np.errstate(invalid="ignore"):
                there = apart < extents / 2
            others |= inside & present & there & ~(seen & present & ~there).any(axis=0)
    others &= seen.sum(0) >= 2  # otherwise the body is interpolated, and the visible person may be a different one
    settings = motion.provenance.get("settings")
    texts = settings.get("leave_out", ()) if isinstance(settings, dict) else ()
    taken = ~left_out_views(texts or (), capture.cameras.names, motion.num_frames)
    return ViewAgreement((seen | others) & taken, seen & taken & (off < AGREES_SHARE))


def _body_px(capture: Capture, motion: Motion) -> np.ndarray:
    """Return the (C, F, K, 2) pixels of the body's projected keypoints. Without 3D keypoints, return the detections."""
    assert capture.cameras is not None and capture.keypoints is not None
    if motion.keypoints3d is None:
        return np.where(capture.keypoints.confidence[..., None] > 0, capture.keypoints.xy, np.nan)
    return project(capture.cameras, motion.keypoints3d)


def _middles(px: np.ndarray) -> np.ndarray:
    """Return the (C, F, 2) centroids of the known points in (C, F, K, 2) pixels, NaN if none is known."""
    known = np.isfinite(px).all(-1, keepdims=True)
    count = known.sum(-2)
    return np.where(count > 0, np.where(known, px, 0.0).sum(-2) / np.maximum(count, 1), np.nan)


def _extents(px: np.ndarray) -> np.ndarray:
    """Return the (C, F) diagonals of the boxes around (C, F, K, 2) pixels, NaN with too few points."""
    return np.where(np.isfinite(px).all(-1).sum(-1) >= MIN_POINTS, extent(px), np.nan)


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
    """Yield a diagnostic if Z is not the vertical estimated from a standing person's trunk, balance and feet."""
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
        upright = upright_from_person(points[::step], _STANCE, motion.fps / step)
    except NoDetections:
        return
    tilt, sigma = np.degrees(np.arccos(np.clip(upright.R[2, 2], -1.0, 1.0))), np.degrees(upright.tilt_sigma)
    if centres_of(motion):  # the floor is unreliable if a suit sinks, so the body must lean too
        mean = along.mean(axis=0)
        lean = np.degrees(np.arccos(np.clip(mean[2] / max(float(np.linalg.norm(mean)), 1e-9), -1.0, 1.0)))
        tilt = tilt if lean > max(TILT_DEGREES, 0.5 * tilt) else 0.0
    if tilt > max(TILT_DEGREES if centres_of(motion) else LEANS_DEGREES, TILT_SIGMAS * sigma):
        yield diagnostic("person_tilted", size=float(tilt), sigma=float(sigma))


MOST_FRAMES = 0.9  # If a correction applies to this fraction of the take, it explains the camera's warnings.
LEAST_OTHERS = 3  # Number of other cameras needed for a comparison without the corrected one.


def without_explained(
    found: Iterable[Diagnostic], num_frames: int, capture: Capture | None = None
) -> Iterator[Diagnostic]:
    """Remove the reader's warnings about cameras that the solve has corrected.

    The corrections must cover most of the take. A fault of unknown cause is explained by any correction. In warnings
    that compare cameras, only the corrected cameras are removed. If too few cameras remain, the warning is removed. If
    a capture is given, the focal lengths of the remaining cameras are compared again.
    """
    found, table = tuple(found), load_table()
    roles = {item.code: entry.role for item in found if (entry := table.get(item.code))}
    corrections = [item for item in found if roles.get(item.code) == "explains" and item.remedy is Remedy.REPAIRED]
    repaired, explained = set[str](), set[str]()
    for item in corrections:
        repaired |= {*item.where.cameras}
        if sum(last - first + 1 for first, last in item.where.frames) >= MOST_FRAMES * num_frames:
            explained |= {*item.where.cameras}
    cameras = None if capture is None or not explained else capture.cameras
    others = None if cameras is None else [c for c, name in enumerate(cameras.names) if name not in explained]
    for item in found:
        role = roles.get(item.code)
        named = [name for name in item.where.cameras if name not in (repaired if role == "unknown" else explained)]
        if role == "compares all" and others is not None and cameras is not None:
            if capture is not None and capture.keypoints is not None and len(others) > 1:
                again = report_lenses(cameras.subset(others), capture.keypoints.views(others))
                yield from (other for other in again if other.code == item.code)
        elif role == "compares":
            if named and (others is None or len(others) >= LEAST_OTHERS):
                known = item.values.get("shifts")
                shifts = {name: known[name] for name in named if isinstance(known, dict) and name in known}
                yield replace(item, where=replace(item.where, cameras=tuple(named)), values={"shifts": shifts})
        elif role not in ("doubts", "unknown") or len(named) == len(item.where.cameras):
            yield item


BRIEF_S = 0.2  # Longest gap in seconds that is interpolated without a warning. People who walk away are absent longer.
UNSURE_SHARE = 0.05  # Largest fraction of unsure frames that only causes a note. More frames cause a warning.
SELDOM_PERCENT, OUTLIER_PERCENT = 50.0, 20.0
"""Smallest percentage of a keypoint's frames with two detections, and largest percentage of outliers in one view."""


def capture_diagnostics(capture: Capture) -> tuple[Diagnostic, ...]:
    """Return the diagnostics that were raised while the capture was read."""
    return (*capture.notes, *capture.problems)


def recorded_diagnostics(motion: Motion) -> tuple[Diagnostic, ...]:
    """Return the diagnostics that the solve stored in a motion."""
    return read_diagnostics(motion.provenance.get("diagnostics"))


def by_gravity(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Sort diagnostics by severity, most severe first, and remove duplicates.

    Two diagnostics are duplicates if their codes, names and named values are equal. Their figures may differ in the
    last digit, because they are computed again.
    """
    first: dict[object, Diagnostic] = {}
    for item in found:
        entry, where = load_table().get(item.code), item.where
        names = ("text", "part", *(entry.words if entry else ()))
        chosen = tuple(str(item.values.get(name)) for name in names)
        key = item.code, where.cameras, where.markers, where.joints, where.person, where.file, item.remedy, chosen
        first.setdefault(key, item)
    return tuple(sorted(first.values(), key=lambda item: ("error", "warning", "note").index(item.severity)))


_MOST_UNSEEN = 0.5  # Fraction of frames in which a person who arrives late or leaves may be missing without a warning.


def _flagged(capture: Capture, motion: Motion) -> Iterator[Diagnostic]:
    if motion.flags is None:
        return
    unseen, unsure = ((motion.flags & bit) > 0 for bit in (FLAG_UNSEEN, FLAG_UNSURE))
    unsure &= ~unseen
    if unseen.any():
        reason = "single" if capture.is_one_view else "views" if motion.markers is None else "markers"
        runs, last = true_runs(unseen), motion.num_frames - 1
        brief = all(b - a < BRIEF_S * motion.fps or (capture.people and (a == 0 or b == last)) for a, b in runs)
        severity = Severity.NOTE if brief and unseen.mean() <= _MOST_UNSEEN else Severity.WARNING
        yield diagnostic("frames_unseen", severity=severity, reason=reason, frames=runs)
    if unsure.any():
        severity = Severity.NOTE if unsure.mean() <= UNSURE_SHARE else Severity.WARNING
        data, percent = "views" if motion.markers is None else "markers", 100 * unsure.mean()
        yield diagnostic("frames_unsure", severity=severity, data=data, frames=true_runs(unsure), percent=percent)


def _cameras(capture: Capture, motion: Motion, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None
    seen = detected_share(capture)
    assert seen is not None
    medians = residuals.by_camera
    depth = np.einsum("ci,fi->cf", capture.cameras.R[:, 2], motion.joints[:, 0]) + capture.cameras.t[:, 2, None]
    px_m = capture.cameras.K[:, 0, 0] / np.maximum(quantile(depth, 0.5, axis=1), 1e-3)
    distances = medians / px_m  # detector errors scale with the person's size in the image
    for c, name in enumerate(capture.cameras.names):
        others = np.delete(distances, c)
        others = others[np.isfinite(others)]
        percent = 100 * float(seen[c].mean())
        usual = float(quantile(others, 0.5, axis=0) * px_m[c]) if others.size else float("nan")
        if medians[c] > STANDS_OUT * usual:
            yield diagnostic("camera_disagrees", cameras=[name], size=medians[c], usual=usual)
        if percent < SELDOM_PERCENT:
            yield diagnostic("camera_sees_little", cameras=[name], percent=percent)


def _keypoints(capture: Capture, residuals: KeypointResiduals) -> Iterator[Diagnostic]:
    assert capture.cameras is not None and capture.keypoints is not None
    agreement = residuals.agreement_percent(1)
    names = [name.replace("_", " ") for name in capture.keypoints.joint_set.keypoints]
    often = 100.0 * capture.placed.mean(axis=0)
    rare = [f"{names[k]} ({often[k]:.0f} %)" for k in np.argsort(often, kind="stable") if often[k] < SELDOM_PERCENT]
    if rare:
        yield diagnostic("keypoints_seldom_seen", shares=rare)
    outliers = 100.0 - np.nan_to_num(agreement, nan=100.0)
    poor = sorted((-float(outliers[c, k]), c, k) for c, k in np.argwhere(outliers > OUTLIER_PERCENT))
    if poor:
        shares = [f"{names[k]} in {capture.cameras.names[c]} ({-share:.0f} %)" for share, c, k in poor]
        yield diagnostic("keypoints_often_outliers", shares=shares)


def run_checks(capture: Capture, motion: Motion, residuals: KeypointResiduals | None) -> Iterator[Diagnostic]:
    """Yield the diagnostics of all checks of a solve. ``residuals`` is None if there are no detections."""
    yield from check_motion(motion)
    yield from _flagged(capture, motion)
    yield from _stature(motion)
    if residuals is not None:
        yield from _residual(capture, motion, residuals)
        yield from _views(capture, motion, residuals)
    if residuals is not None or centres_of(motion):  # the floor is always level in marker recordings
        yield from _tilt(motion)
    yield from marker_plausibility(motion)
    if hips_never_move(capture, motion):
        yield diagnostic("hips_never_move")
    else:
        yield from _feet(capture, motion)
    if residuals is not None:
        yield from _cameras(capture, motion, residuals)
        yield from _keypoints(capture, residuals)


def diagnose(capture: Capture, motion: Motion, residuals: KeypointResiduals | None = None) -> tuple[Diagnostic, ...]:
    """Return all diagnostics of a capture and its solve, most severe first.

    Args:
        residuals: residuals of the motion in the capture. They are computed if None.
    """
    capture = capture.named
    residuals = residuals or residuals_of(capture, motion)
    found = [*capture_diagnostics(capture), *recorded_diagnostics(motion), *run_checks(capture, motion, residuals)]
    return by_gravity(without_explained(found, motion.num_frames, capture))
