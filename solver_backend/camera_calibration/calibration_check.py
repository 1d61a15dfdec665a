"""Check a calibration against a take. Errors are measured per camera, image region and part of the take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.agreement.body_evidence import MEAN_STATURE_M
from solver_backend.camera_calibration.adjustment.bundle import median_by_camera
from solver_backend.camera_calibration.extrinsics.person_session import refined_by_person
from solver_backend.camera_calibration.extrinsics.two_views import sampson_distance
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.cameras.projection import project, undistort
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.rotations import skew
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import scale_from_stature
from solver_backend.types import Cameras, Keypoints2D
from solver_backend.types.cameras import COLUMNS, ROWS, CameraFits

STAGE = "Checking the calibration"
FRAMES = 240  # Maximum number of frames used.
WINDOWS = 6  # Number of parts into which the take is divided for epipolar errors.
WORSE = 1.4  # Factor by which refined cameras reduce the error of a wrong calibration.
SCALE_DOUBT, TILT_DOUBT_DEG, TILT_DOUBT_SIGMAS, DRIFT = 0.12, 8.0, 3.0, 1.6
"""Limits above which to warn: log scale, tilt (in degrees and in sigmas), and error growth. Chosen by hand."""


@dataclass(frozen=True)
class CalibrationCheck(CameraFits):
    """Reprojection errors of a calibration on a take. ``best_px`` applies after camera poses are fitted to the take."""

    all_px: float  # Median reprojection error over all cameras.
    refined_px: float  # Median reprojection error after the poses have been adjusted.
    diagnostics: tuple[Diagnostic, ...]  # Findings of the check.

    @property
    def worst_regions(self) -> list[tuple[str, float]]:
        """Name (such as "top left") and median error (px) of each camera's worst image region."""
        found = []
        for grid in self.region_px:
            row, column = np.unravel_index(int(np.argmax(np.nan_to_num(grid, nan=-1.0))), grid.shape)
            found.append((f"{ROWS[row]} {COLUMNS[column]}", float(np.nan_to_num(grid[row, column]))))
        return found

    def as_dict(self) -> dict[str, object]:
        """Return the check as JSON values."""
        lists = {"camera_px": _numbers(self.camera_px), "refined_camera_px": _numbers(self.best_px)}
        grids = {key: [_numbers(row) for row in getattr(self, key)] for key in ("region_px", "epipolar_px")}
        one = {"median_px": round(self.all_px, 3), "refined_px": round(self.refined_px, 3)}
        one |= {"stature_m": round(self.stature_m, 3), "verdict": self.verdict}
        one |= {key: round(getattr(self, key), 2) for key in ("tilt_deg", "tilt_sigma_deg")}
        found = {"findings": list(self.findings), "diagnostics": [item.as_dict() for item in self.diagnostics]}
        return {**one, **lists, **grids, **found}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [None if not np.isfinite(v) else round(float(v), 3) for v in np.ravel(values)]


def check_calibration(cameras: Cameras, keypoints: Keypoints2D, progress: Progress = silent) -> CalibrationCheck:
    """Check a calibration against the keypoints of one person."""
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, min(FRAMES, keypoints.num_frames)).astype(int))
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
    points = triangulate(cameras, xy, confidence).points
    error = np.linalg.norm(project(cameras, points) - xy, axis=-1)
    regions = _by_region(cameras, xy, error)
    epipolar = _epipolar(cameras, xy, progress)

    def adjusting(stage: str, done: int, total: int) -> None:
        progress(STAGE, min(50 + done, 99), 100)

    refined = refined_by_person(cameras, keypoints, progress=adjusting)
    progress(STAGE, 100, 100)
    after = np.linalg.norm(refined.adjusted.error, axis=-1)
    best = float(np.nanmedian(after))
    best_by_camera = median_by_camera(after, refined.adjusted.seen, len(cameras))
    scale, _ = scale_from_stature(points, keypoints.joint_set, None)
    stature = MEAN_STATURE_M / scale
    upright = upright_from_person(points, keypoints.joint_set, keypoints.fps * len(frames) / keypoints.num_frames)
    tilt, tilt_sigma = (float(np.degrees(a)) for a in (np.arccos(np.clip(upright.R[2, 2], -1, 1)), upright.tilt_sigma))
    by_camera = np.array([np.nanmedian(e) for e in error])
    everything = float(np.nanmedian(error))
    words = _camera_words(cameras, by_camera, regions, everything, best_by_camera)
    words += _time_words(cameras, epipolar)
    if abs(np.log(scale)) > SCALE_DOUBT:
        words.append(diagnostic("world_doubted", kind="scale", stature=stature))
    if tilt > max(TILT_DOUBT_DEG, TILT_DOUBT_SIGMAS * tilt_sigma):
        words.append(diagnostic("world_doubted", kind="tilt", angle=tilt))
    what = "calibration warning" if words else "the calibration fits"
    fits: dict[str, Any] = {
        "region_px": regions,
        "camera_px": by_camera,
        "best_px": best_by_camera,
        "epipolar_px": epipolar,
    }
    fits |= {"stature_m": stature, "tilt_deg": tilt, "tilt_sigma_deg": tilt_sigma}
    verdict, findings = f"{what}: {everything:.1f} px, {best:.1f} px at best", tuple(map(sentence, words))
    figures: dict[str, Any] = {"verdict": verdict, "findings": findings, "all_px": everything, "refined_px": best}
    return CalibrationCheck(**fits, **figures, diagnostics=tuple(words))


def _by_region(cameras: Cameras, xy: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the median error (C, 3, 3) in each cell of a 3 x 3 image grid, or NaN for fewer than 30 points."""
    grid = np.full((len(cameras), 3, 3), np.nan)
    for c, size in enumerate(cameras.image_size):
        good = np.isfinite(error[c])
        cell = np.clip((3 * xy[c][good] / size).astype(int), 0, 2)
        for row, column in np.ndindex(3, 3):
            values = error[c][good][(cell == (column, row)).all(-1)]
            if len(values) >= 30:
                grid[c, row, column] = np.median(values)
    return grid


def _epipolar(cameras: Cameras, xy: np.ndarray, progress: Progress) -> np.ndarray:
    """Return each camera's median epipolar distance (C, W) in px to the cameras compared with it, in W time windows."""
    n = undistort(cameras, xy)
    windows = np.array_split(np.arange(xy.shape[1]), min(WINDOWS, xy.shape[1]))
    values = {(c, w): [np.array([])] for c in range(len(cameras)) for w in range(len(windows))}
    pairs = compared_pairs(len(cameras))
    for number, (i, j) in enumerate(pairs):
        progress(STAGE, 50 * number // len(pairs), 100)
        R = cameras.R[j] @ cameras.R[i].T
        E = skew(cameras.t[j] - R @ cameras.t[i]) @ R
        focal = 0.5 * float(cameras.K[i, 0, 0] + cameras.K[j, 0, 0])
        for w, part in enumerate(windows):
            a, b = n[i, part].reshape(-1, 2), n[j, part].reshape(-1, 2)
            both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
            distance = focal * sampson_distance(E[None], a[both], b[both])[0]
            values[i, w].append(distance)
            values[j, w].append(distance)
    found = {place: np.concatenate(parts) for place, parts in values.items()}
    medians = [float(np.median(part)) if len(part) else np.nan for part in found.values()]
    return np.reshape(medians, (len(cameras), len(windows)))


def _camera_words(
    cameras: Cameras, by_camera: np.ndarray, regions: np.ndarray, everything: float, best: np.ndarray
) -> list[Diagnostic]:
    words: list[Diagnostic] = []
    worse = (by_camera > WORSE * best) & (by_camera - best > 1.0)
    if worse.any():
        c = int(np.nanargmax(np.where(worse, by_camera / best, 0.0)))
        figures = {"size": by_camera[c], "best": best[c]}
        words.append(diagnostic("camera_moved", amount="check", cameras=[cameras.names[c]], **figures))
    for c, name in enumerate(cameras.names):
        inner, rim = regions[c, 1, 1], np.nanmax(np.where(np.isfinite(regions[c]), regions[c], 0.0))
        if np.isfinite(inner) and rim > 3.0 * inner and rim > 2.0 * everything:
            words.append(diagnostic("lens_off_at_rim", cameras=[name], size=rim, inner=inner))
    return words


def _time_words(cameras: Cameras, epipolar: np.ndarray) -> list[Diagnostic]:
    words: list[Diagnostic] = []
    usual = float(np.nanmedian(epipolar))
    for c, name in enumerate(cameras.names):
        track = epipolar[c][np.isfinite(epipolar[c])]
        if len(track) < 4 or track.argmax() == track.argmin():
            continue
        if track.max() > DRIFT * 1.5 * max(track.min(), 0.5 * usual):
            half = len(track) // 2
            first, last = float(np.median(track[:half])), float(np.median(track[half:]))
            if max(first, last) > DRIFT * min(first, last):
                words.append(diagnostic("camera_drifts", cameras=[name], first=first, last=last))
    return words
