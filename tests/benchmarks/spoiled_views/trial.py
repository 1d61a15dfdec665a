"""Write a recording with faults as a trial of Pose2Sim, read and solve it, and compare the result with the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import refuse_errors, sentence, warnings_in
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.geometry.alignment import umeyama
from solver_backend.io.load import load_capture
from solver_backend.report.checks import diagnose
from solver_backend.types import Capture
from tests.benchmarks.spoiled_views.kinds import Recording
from tests.support.calibration_files import toml_text
from tests.support.trial_files import write_detections

CHANGES = {
    "calibration_corrected", "camera_names_exchanged", "cameras_assigned_by_views",
    "unit_by_person", "detections_corrected", "person_mirrored", "starts_apart", "start_left_out",
    "image_mirrored", "camera_rates_differ", "focal_lengths_off", "cameras_shifted",
}  # fmt: skip
"""Diagnostics of a change in a capture, or of one that the user should make."""


@dataclass(frozen=True)
class Result:
    """Result of a recording."""

    error_mm: float  # Mean joint error after rigid alignment with the truth, NaN if refused.
    warnings: tuple[str, ...]  # Warnings of the solve.
    refused: str = ""  # Reason for a refusal, with a hint.
    tilt_deg: float = float("nan")  # Angle between its world's up axis and the truth's, NaN if refused.
    shape_mm: float = float("nan")  # ``error_mm`` at the truth's size.
    scale: float = float("nan")  # Scale of the truth relative to the result.
    codes: tuple[str, ...] = ()  # Codes of diagnostics of the recording.

    @property
    def silent(self) -> bool:
        """True if there is a result without a warning."""
        return not self.warnings and not self.refused


Known = Callable[[Capture], Result | None]  # Returns a reading's known result, or None if it must be solved.


def result_of(
    capture: Capture, recording: Recording, joints: np.ndarray, known: Known = lambda read: None, **options: Any
) -> Result:
    """Return the result of a recording in a temporary folder.

    Args:
        capture: origin of the frame rate.
        recording: recording that is written.
        joints: (F, 24, 3) joints of the complete film in metres. The take is compared with the best part of it.
        known: returns the result of a reading that needs no solve, otherwise None.
        options: fields of ``ReadOptions``.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trial"
        write_recording(path, capture, recording)
        return result_of_folder(path, joints, known, **options)


def result_of_folder(path: Path, joints: np.ndarray, known: Known = lambda read: None, **options: Any) -> Result:
    """Return the result of reading and solving a recording.

    Args:
        path: folder of the recording.
        joints, known, options: see ``result_of``.
    """
    try:
        read = load_capture(path, **options)
        codes = tuple(item.code for item in read.problems)
        if (result := known(read)) is not None:
            return replace(result, warnings=tuple(sentence(i) for i in warnings_in(read.problems)), codes=codes)
        motion = solve(read, SolveSettings()).motion
        found = refuse_errors(diagnose(read, motion), (), "")
    except MocapError as error:
        return Result(float("nan"), (), f"{error.message} [{error.hint}]")
    warnings = tuple(sentence(item, motion.fps) for item in warnings_in(found))
    scale = scale_of(motion.joints, joints)
    shape = error_mm(scale * motion.joints, joints)
    return Result(error_mm(motion.joints, joints), warnings, "", tilt_deg(motion.joints, joints), shape, scale, codes)


def write_recording(path: Path, capture: Capture, recording: Recording) -> None:
    """Write a recording as a trial of Pose2Sim with the frame rate of ``capture``."""
    keypoints = capture.keypoints
    assert keypoints is not None
    count, total = recording.xy.shape[:2]
    starts = np.zeros(count, int) if recording.starts is None else recording.starts
    lengths = total - starts
    xy, confidence = np.full_like(recording.xy, np.nan), np.zeros(recording.xy.shape[:3])
    for c, start in enumerate(starts):
        xy[c, : lengths[c]] = recording.xy[c, start:]
        confidence[c, : lengths[c]] = recording.confidence[c, start:]
    write_detections(path / "pose", recording.names, [(xy, confidence)], frames=lengths.tolist())
    cameras = recording.cameras
    if recording.transposed_K:
        cameras = replace(cameras, K=cameras.K.swapaxes(1, 2))
    (path / "calibration").mkdir()
    (path / "calibration" / "Calib.toml").write_text(toml_text(cameras), encoding="utf-8")
    (path / "Config.toml").write_text(f"[project]\nframe_rate = {keypoints.fps:g}\n", encoding="utf-8")


def error_mm(found: np.ndarray, joints: np.ndarray) -> float:
    """Return the mean distance in mm of (N, 24, 3) joints, aligned rigidly with the best N of (F, 24, 3) truth."""
    part = _shown_part(found, joints)
    return float("nan") if part is None else 1e3 * _laid_over(found, part)[0]


def tilt_deg(found: np.ndarray, joints: np.ndarray) -> float:
    """Return the angle in degrees between both up axes. If nothing levels the result, this is the world's tilt."""
    part = _shown_part(found, joints)
    return float("nan") if part is None else float(np.degrees(np.arccos(np.clip(_laid_over(found, part)[1], -1, 1))))


def scale_of(found: np.ndarray, joints: np.ndarray) -> float:
    """Return the scale of the truth relative to a result, from the spread of their joints."""
    part = _shown_part(found, joints)
    if part is None:
        return float("nan")
    spreads = [float(((p := points[:, :24].reshape(-1, 3)) - p.mean(0)).std()) for points in (part, found)]
    return spreads[0] / spreads[1]


_COMPARED = 12  # Number of frames that locate the take in the film.


def _shown_part(found: np.ndarray, joints: np.ndarray) -> np.ndarray | None:
    """Return the N of F frames with the best fit to N frames, or None if there are fewer."""
    few = np.unique(np.linspace(0, len(found) - 1, _COMPARED).astype(int))
    shifts = range(len(joints) - len(found) + 1)
    best = min(shifts, key=lambda shift: _laid_over(found[few], joints[shift + few])[0], default=None)
    return None if best is None else joints[best : best + len(found)]


def _laid_over(found: np.ndarray, joints: np.ndarray) -> tuple[float, float]:
    """Return the mean distance after the best rigid motion (Umeyama 1991), and the Z component of the moved up axis."""
    a, b = (points[:, :24].reshape(-1, 3) for points in (found, joints))
    _, R, t = umeyama(a, b)
    return float(np.linalg.norm(a @ R.T + t - b, axis=-1).mean()), float(R[2, 2])
