"""Compare a motion with ground truth, and with filtered triangulation as a baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import FileMissing, MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.detections.named_keypoints import plain_name
from solver_backend.metrics import (
    accel_error_m_s2,
    angle_mae_deg,
    diversity,
    foot_skating_cm_per_frame,
    frechet_distance,
    mpjpe_mm,
    pa_mpjpe_mm,
    pck_percent,
    rmse_mm,
    self_intersection_percent,
    world_mpjpe_mm,
)
from solver_backend.priors.gaussian_vae import LATENT_DIM, load_vae
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D, MarkerCloud, Motion


def triangulate_and_filter(cameras: Cameras, keypoints: Keypoints2D, cutoff_hz: float = 6.0) -> np.ndarray:
    """Triangulate keypoints and filter them with ``butterworth``, as a baseline. Return points (F, K, 3) in metres.

    Gaps are interpolated. A keypoint that is never triangulated is NaN.
    """
    points = bridged(triangulate(cameras, keypoints.xy, keypoints.confidence).points)
    return butterworth(points, keypoints.fps, cutoff_hz)


def bridged(points: np.ndarray) -> np.ndarray:
    """Interpolate gaps in points (F, K, 3) linearly. Beyond the ends, repeat the nearest point."""
    frames = np.arange(len(points))
    filled = points.copy()
    for k in range(points.shape[1]):
        valid = np.isfinite(points[:, k]).all(-1)
        if valid.any():
            for axis in range(3):
                filled[:, k, axis] = np.interp(frames, frames[valid], points[valid, k, axis])
    return filled


def butterworth(signal: np.ndarray, fps: float, cutoff_hz: float) -> np.ndarray:
    """Filter a signal (F, ...) with a zero-phase fourth-order Butterworth low-pass filter.

    A second-order filter runs forwards and then backwards over the signal, which is extended by point reflection. Its
    cut-off is corrected so that both passes together are 3 dB down at ``cutoff_hz`` (Winter 2009, "Biomechanics and
    Motor Control", 3.4). A signal that is too short or has too low a frame rate is returned unchanged.
    """
    if len(signal) < 4 or cutoff_hz >= 0.45 * fps:
        return signal.copy()
    pad = min(len(signal) - 1, int(3 * fps / cutoff_hz))
    head, tail = 2 * signal[:1] - signal[pad:0:-1], 2 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    extended = np.concatenate([head, signal, tail])
    section = _second_order_section(np.tan(np.pi * cutoff_hz / fps) / (np.sqrt(2.0) - 1.0) ** 0.25)
    for _ in range(2):
        extended = _run(section, extended)[::-1]
    return extended[pad : pad + len(signal)]


def _second_order_section(w: float) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (b, a) of a second-order Butterworth filter for the pre-warped cut-off w."""
    norm = 1 + np.sqrt(2.0) * w + w * w
    return np.array([w * w, 2 * w * w, w * w]) / norm, np.array([2 * (w * w - 1), 1 - np.sqrt(2.0) * w + w * w]) / norm


def _run(section: tuple[np.ndarray, np.ndarray], signal: np.ndarray) -> np.ndarray:
    """Run a second-order filter section over a signal (F, ...), which is extended by its first sample at the start."""
    b, a = section
    out = np.empty_like(signal)
    x1 = x2 = y1 = y2 = signal[0]
    for i, x in enumerate(signal):
        y = b[0] * x + b[1] * x1 + b[2] * x2 - a[0] * y1 - a[1] * y2
        out[i] = y
        x1, x2, y1, y2 = x, x1, y, y1
    return out


_LIMBS = JointSet.COCO_17.keypoints[5:]  # Joints that marker systems, detectors and SMPL define in the same way.
_LEAST_POINTS = 3  # A similarity needs three points.
CODED_FRAMES = 2 * LATENT_DIM + 2  # Fewest frames for FID and DIV: two halves with more poses than code numbers.


@dataclass(frozen=True)
class Evaluation:
    """Errors of a motion and of the baseline on the same capture. Values without data are None."""

    joints_mpjpe_mm: float  # Mean error of the joints that the motion and the truth share, usually SMPL's 24.
    joints_rmse_mm: float  # Mean over frames of the RMS joint error (thesis eq. 4.28).
    joints_pck1_percent: float  # Percentage of joints within 1 cm (eq. 4.29).
    joints_pck3_percent: float
    joints_pck7_percent: float
    joints_accel_m_s2: float  # Mean acceleration error of the joints.
    joints_pa_mpjpe_mm: float  # Mean error after aligning each frame by a similarity.
    joints_wa_mpjpe_100_mm: float  # Mean error with one similarity per 100 frames.
    joints_w_mpjpe_100_mm: float  # Mean error with the similarity of the first two of each 100 frames.
    skating_cm_per_frame: float | None = None  # Sliding of standing toes (thesis 6.3.4).
    skating_true_cm_per_frame: float | None = None  # The same for the ground truth.
    angles_mae_deg: float | None = None  # Mean angle between rotations of joints 1..21.
    keypoints_mpjpe_mm: float | None = None  # Mean error of the observed keypoints.
    keypoints_accel_m_s2: float | None = None  # Mean acceleration error of the observed keypoints.
    markers_mpjpe_mm: float | None = None  # Mean error of the markers on the solved body.
    codes_fid: float | None = None  # FID between the motion's poses and the true ones, by VPoser's codes (eq. 4.30).
    codes_div: float | None = None  # DIV of the motion's poses, by VPoser's codes (eq. 4.31).
    codes_div_true: float | None = None
    self_intersection_percent: float | None = None  # Frames in which parts penetrate others by more than 3 cm.
    self_intersection_true_percent: float | None = None  # The same percentage for the true joints.
    baseline_mpjpe_mm: float | None = None  # Triangulation + 6 Hz Butterworth: mean error of the observed keypoints.
    baseline_accel_m_s2: float | None = None  # The same: mean acceleration error of the observed keypoints.
    joints_moved_mpjpe_mm: float | None = None  # With a reference: after one rigid motion between the two worlds.
    compared: tuple[str, ...] = ()  # Names of the reference's points.

    @property
    def mpjpe_ratio(self) -> float | None:
        """MPJPE of the joints or of the keypoints, whichever is larger, divided by the MPJPE of the baseline."""
        return _ratio((self.joints_mpjpe_mm, self.keypoints_mpjpe_mm), self.baseline_mpjpe_mm)

    @property
    def accel_ratio(self) -> float | None:
        """Acceleration error of the joints or keypoints, whichever is larger, divided by the baseline's error."""
        return _ratio((self.joints_accel_m_s2, self.keypoints_accel_m_s2), self.baseline_accel_m_s2)

    def figures(self) -> dict[str, float]:
        """Return all known values by name, rounded to four decimals."""
        known = {**asdict(self), "mpjpe_ratio": self.mpjpe_ratio, "accel_ratio": self.accel_ratio}
        known.pop("compared")
        return {name: round(value, 4) for name, value in known.items() if value is not None}

    def lines(self) -> list[str]:
        """Format the values as lines of a text report."""
        rows = [
            ("joints", self.joints_mpjpe_mm, self.joints_accel_m_s2),
            ("observed keypoints", self.keypoints_mpjpe_mm, self.keypoints_accel_m_s2),
            ("markers", self.markers_mpjpe_mm, None),
            ("triangulation + filter", self.baseline_mpjpe_mm, self.baseline_accel_m_s2),
        ]
        lines = [
            f"{name:<24} {mm:7.2f} mm" + ("" if accel is None else f"   acceleration error {accel:6.2f} m/s²")
            for name, mm, accel in rows
            if mm is not None
        ]
        if self.mpjpe_ratio is not None and self.accel_ratio is not None:
            lines.append(f"{'ratio to the filter':<24} {self.mpjpe_ratio:7.2f}      {'':<18} {self.accel_ratio:6.2f}")
        shares = self.joints_pck1_percent, self.joints_pck3_percent, self.joints_pck7_percent
        lines.append(f"{'joints, RMSE':<24} {self.joints_rmse_mm:7.2f} mm")
        aligned = self.joints_pa_mpjpe_mm, self.joints_wa_mpjpe_100_mm, self.joints_w_mpjpe_100_mm
        lines.append(f"{'PA-, WA-100, W-100 MPJPE':<24} " + "  ".join(f"{error:.2f} mm" for error in aligned))
        lines.append(f"{'within 1, 3, 7 cm':<24} " + "  ".join(f"{share:5.1f} %" for share in shares))
        if self.angles_mae_deg is not None:
            lines.append(f"{'joint angles':<24} {self.angles_mae_deg:7.2f}°")
        if self.skating_cm_per_frame is not None:
            lines.append(
                f"{'foot skating':<24} {self.skating_cm_per_frame:7.3f} cm per frame "
                f"(truth {self.skating_true_cm_per_frame:.3f})"
            )
        if self.self_intersection_percent is not None:
            lines.append(
                f"{'body through itself':<24} {self.self_intersection_percent:7.2f} % of frames "
                f"(truth {self.self_intersection_true_percent:.2f})"
            )
        if self.codes_fid is not None:
            lines.append(
                f"{'poses, VPoser codes':<24} FID {self.codes_fid:.2f}, DIV {self.codes_div:.2f} "
                f"(truth {self.codes_div_true:.2f})"
            )
        if self.compared:
            lines.append(f"{'worlds aligned':<24} {self.joints_moved_mpjpe_mm:7.2f} mm")
            lines.append(f"{'compared points':<24} {', '.join(self.compared)}")
        return lines


def evaluate(capture: Capture, motion: Motion) -> Evaluation:
    """Compare a motion with ground truth, or with joint centres from another system.

    Joint centres are markers with joint names, such as ``left_knee`` or ``RKnee``. They are interpolated linearly to
    the times of the motion's frames.

    Raises:
        MotionInvalid: the capture has neither ground truth nor joint centres, or its frames or joints do not match
          the motion's.
    """
    capture = capture.named
    reference = "joints" not in capture.truth
    solved, joints, names = _of_reference(capture, motion) if reference else _of_truth(capture, motion)
    more: dict[str, Any] = {
        **_of_feet(solved, joints, names),
        **_of_intersections(solved, joints, names),
        **_of_angles(capture, motion),
        **_of_keypoints(capture, motion),
        **_of_markers(capture, motion),
        **_of_yardstick(capture),
    }
    found = Evaluation(
        mpjpe_mm(solved, joints),
        rmse_mm(solved, joints),
        pck_percent(solved, joints, 0.01),
        pck_percent(solved, joints, 0.03),
        pck_percent(solved, joints, 0.07),
        accel_error_m_s2(solved, joints, motion.fps),
        pa_mpjpe_mm(solved, joints),
        world_mpjpe_mm(solved, joints),
        world_mpjpe_mm(solved, joints, fitted=2),
        **more,
    )
    if reference:
        found = replace(found, joints_moved_mpjpe_mm=_moved_mpjpe_mm(solved, joints), compared=names)
    return found


def _of_truth(capture: Capture, motion: Motion) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    solved, joints, names = motion.beside_truth(np.asarray(capture.truth["joints"]))
    if not names:
        raise MotionInvalid(
            f"The motion's {motion.num_frames} frames and {motion.body_layout.num_joints} joints cannot be compared "
            f"with the truth's {' by '.join(str(n) for n in np.shape(capture.truth['joints'])[:2])}.",
            where=capture.name,
            hint="Use the capture that it was solved from, and --frames if the motion has only some of its frames.",
        )
    return solved, joints, names


def _of_reference(capture: Capture, motion: Motion) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return the points (F, N, 3) of the motion and of the reference, and the N names that they have in common."""
    markers = capture.markers
    seen = np.isfinite(markers.positions).all(-1).any(0) if markers else ()
    labels = (markers and markers.labels) or ()
    columns = [plain_name(label) if known else "" for label, known in zip(labels, seen, strict=False)]
    points = {} if motion.keypoints3d is None else _named(JointSet(motion.joint_set).keypoints, motion.keypoints3d)
    points |= {name: xyz for name, xyz in _named(motion.body_layout.joints, motion.joints).items() if name in _LIMBS}
    names = tuple(name for name in dict.fromkeys(columns) if name in points)
    if markers is None or len(names) < _LEAST_POINTS:
        hint = "Use a simulated capture (dataset demo, dataset make), or joint centres with names such as left_knee."
        what = "It has no ground truth to compare with, and fewer than three of its points are named after joints."
        raise MotionInvalid(what, where=capture.name, hint=hint)
    lasts, needed = len(markers.positions) / markers.fps, motion.num_frames / motion.fps
    if abs(lasts - needed) > 1 / min(markers.fps, motion.fps) + 1e-6:
        what = f"The motion lasts {needed:.2f} s and the reference {lasts:.2f} s."
        raise MotionInvalid(what, where=capture.name, hint="Choose the frames of the reference with --frames.")
    found = np.stack([points[name] for name in names], axis=1)
    return found, _at_frames(markers, [columns.index(name) for name in names], motion), names


def _moved_mpjpe_mm(found: np.ndarray, true: np.ndarray) -> float:
    """Return the MPJPE in mm after one rigid alignment of the whole take to the reference, which has another world."""
    both = np.isfinite(true).all(-1) & np.isfinite(found).all(-1)
    if both.sum() < _LEAST_POINTS:
        return float("nan")
    _, R, t = umeyama(found[both][None], true[both][None], np.ones((1, int(both.sum()))), with_scale=False)
    return mpjpe_mm(found @ R[0].T + t[0], true)


def _named(names: Sequence[str], points: np.ndarray) -> dict[str, np.ndarray]:
    return {name: points[:, column] for column, name in enumerate(names)}


def _at_frames(markers: MarkerCloud, columns: list[int], motion: Motion) -> np.ndarray:
    """Interpolate (F, N, 3) markers at the times of the motion's frames. The result is NaN next to gaps."""
    last = len(markers.positions) - 1
    times = np.minimum(np.arange(motion.num_frames) * (markers.fps / motion.fps), last)
    before = np.floor(times + 1e-9).astype(int)
    share = np.maximum(times - before, 0.0)[:, None, None]
    first, second = (markers.positions[frames][:, columns] for frames in (before, np.minimum(before + 1, last)))
    return np.where(share > 1e-9, (1 - share) * first + share * second, first)


def _of_feet(found: np.ndarray, true: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """Return the skating of the solved and the true feet. The floor is at the lowest height of the true toes."""
    if names != SMPL.joints:
        return {}
    toes = [names.index(name) for name in ("left_foot", "right_foot")]
    floor = float(true[:, toes, 2].min())
    return {
        "skating_cm_per_frame": foot_skating_cm_per_frame(found[:, toes], floor),
        "skating_true_cm_per_frame": foot_skating_cm_per_frame(true[:, toes], floor),
    }


def _of_intersections(found: np.ndarray, true: np.ndarray, names: tuple[str, ...]) -> dict[str, float]:
    """Return the percentages of self-intersecting frames, if the joints are SMPL's 24."""
    if names != SMPL.joints:
        return {}
    body, shares = load_body(), ("self_intersection_percent", "self_intersection_true_percent")
    return {name: self_intersection_percent(body, points) for name, points in zip(shares, (found, true), strict=True)}


def _of_angles(capture: Capture, motion: Motion) -> dict[str, float]:
    truth, turns = np.asarray(capture.truth.get("body_pose", np.zeros((0, 0)))), 3 * NUM_BODY_JOINTS
    if truth.ndim != 2 or len(truth) != motion.num_frames or min(truth.shape[1], motion.body_pose.shape[1]) < turns:
        return {}
    found, true = (exp_so3(pose[:, :turns].reshape(-1, NUM_BODY_JOINTS, 3)) for pose in (motion.body_pose, truth))
    figures = {"angles_mae_deg": angle_mae_deg(found, true)}
    return figures | _of_codes(found, true)


def _of_codes(found: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Return FID and DIV in VPoser's latent space, or {} if there are too few frames or no VPoser weights."""
    if len(found) < CODED_FRAMES:
        return {}
    try:
        prior = load_vae("vposer")
    except FileMissing:
        return {}
    codes, known = np.asarray(prior.encode(found)), np.asarray(prior.encode(true))
    return {
        "codes_fid": frechet_distance(codes, known),
        "codes_div": diversity(codes, 0),
        "codes_div_true": diversity(known, 0),
    }


def _of_keypoints(capture: Capture, motion: Motion) -> dict[str, float]:
    truth = capture.truth.get("keypoints3d")
    if truth is None or motion.keypoints3d is None or motion.keypoints3d.shape != np.shape(truth):
        return {}
    points = np.asarray(truth)
    return {
        "keypoints_mpjpe_mm": mpjpe_mm(motion.keypoints3d, points),
        "keypoints_accel_m_s2": accel_error_m_s2(motion.keypoints3d, points, motion.fps),
    }


def _of_markers(capture: Capture, motion: Motion) -> dict[str, float]:
    truth, recorded = capture.truth.get("markers"), capture.markers
    same = recorded is not None and motion.marker_labels == recorded.labels and motion.markers is not None
    if truth is None or not same or motion.markers is None or motion.markers.shape != np.shape(truth):
        return {}
    return {"markers_mpjpe_mm": mpjpe_mm(motion.markers, np.asarray(truth))}


def _of_yardstick(capture: Capture) -> dict[str, float]:
    truth = capture.truth.get("keypoints3d")
    if truth is None or capture.several_views is None:
        return {}
    cameras, keypoints = capture.require_multiview()
    filtered, points = triangulate_and_filter(cameras, keypoints), np.asarray(truth)
    return {
        "baseline_mpjpe_mm": mpjpe_mm(filtered, points),
        "baseline_accel_m_s2": accel_error_m_s2(filtered, points, keypoints.fps),
    }


def _ratio(errors: tuple[float | None, ...], yardstick: float | None) -> float | None:
    return None if yardstick is None else max(error for error in errors if error is not None) / yardstick
