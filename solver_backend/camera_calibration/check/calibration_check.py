"""True if a calibration fits what the cameras saw: by camera, part of the picture, over time, in scale, upright."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.extrinsics.from_person import refined_by_person
from solver_backend.camera_calibration.extrinsics.two_views import sampson_distance
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.cameras.projection import project, undistort
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.recognition.gravity import upright_from_person
from solver_backend.io.recognition.person_scale import MEAN_STATURE_M, scale_from_stature
from solver_backend.types import Cameras, Keypoints2D
from solver_backend.types.cameras import COLUMNS, ROWS, CameraFits

STAGE = "Checking the calibration"
FRAMES = 240
"""Frames at most that are looked at."""
WINDOWS = 6
"""Parts of the take whose epipolar errors are compared."""
WORSE = 1.4
"""Refined cameras that explain the keypoints so much better show that the calibration is wrong."""
SCALE_DOUBT, TILT_DOUBT_DEG, TILT_DOUBT_SIGMAS, DRIFT = 0.12, 8.0, 3.0, 1.6


@dataclass(frozen=True)
class CalibrationCheck:
    """Result of the check, in px unless stated."""

    camera_px: np.ndarray
    """(C,) median distance of keypoints to where the other cameras have them."""
    region_px: np.ndarray
    """(C, 3, 3) the same by part of the picture, rows first. NaN where fewer than 30 keypoints are."""
    epipolar_px: np.ndarray
    """(C, windows) median distance to epipolar lines over the take."""
    refined_px: float
    """Median distance after the poses were adjusted to the take."""
    all_px: float
    refined_camera_px: np.ndarray
    """(C,) median distance of each camera after."""
    stature_m: float
    tilt_deg: float
    tilt_sigma_deg: float
    """Standard deviation of that angle, by what a person's stance shows of gravity."""
    findings: tuple[Diagnostic, ...]

    @property
    def verdict(self) -> str:
        """One sentence."""
        what = "calibration warning" if self.findings else "the calibration fits"
        return f"{what}: {self.all_px:.1f} px, {self.refined_px:.1f} px at best"

    @property
    def fit(self) -> CameraFits:
        """Return the values of the report."""
        return CameraFits(
            verdict=self.verdict,
            region_px=self.region_px,
            camera_px=self.camera_px,
            best_px=self.refined_camera_px,
            epipolar_px=self.epipolar_px,
            stature_m=self.stature_m,
            tilt_deg=self.tilt_deg,
            tilt_sigma_deg=self.tilt_sigma_deg,
            findings=tuple(sentence(item) for item in self.findings),
        )

    @property
    def worst_region(self) -> list[str]:
        """Name of each camera's worst part."""
        found = []
        for grid in self.region_px:
            row, column = np.unravel_index(int(np.argmax(np.nan_to_num(grid, nan=-1.0))), grid.shape)
            found.append(f"{ROWS[row]} {COLUMNS[column]}")
        return found

    @property
    def worst_region_px(self) -> np.ndarray:
        """(C,) its error."""
        return np.nan_to_num(self.region_px, nan=0.0).max((1, 2))

    def as_dict(self) -> dict[str, object]:
        """Return plain JSON values."""
        lists = {key: _numbers(getattr(self, key)) for key in ("camera_px", "refined_camera_px")}
        grids = {key: [_numbers(row) for row in getattr(self, key)] for key in ("region_px", "epipolar_px")}
        one = {"median_px": round(self.all_px, 3), "refined_px": round(self.refined_px, 3)}
        one |= {"stature_m": round(self.stature_m, 3), "verdict": self.verdict}
        one |= {key: round(getattr(self, key), 2) for key in ("tilt_deg", "tilt_sigma_deg")}
        found = {"findings": [sentence(item) for item in self.findings]}
        return {**one, **lists, **grids, **found, "diagnostics": [item.as_dict() for item in self.findings]}


def _numbers(values: np.ndarray) -> list[float | None]:
    return [None if not np.isfinite(v) else round(float(v), 3) for v in np.ravel(values)]


def check_calibration(cameras: Cameras, keypoints: Keypoints2D, progress: Progress = silent) -> CalibrationCheck:
    """Hold a calibration against the keypoints of one person.

    Raises:
        NoDetections: no two cameras see the person at once.
    """
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, min(FRAMES, keypoints.num_frames)).astype(int))
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
    points = triangulate(cameras, xy, confidence).points
    error = _errors(cameras, xy, points)
    regions = _by_region(cameras, xy, error)
    epipolar = _epipolar(cameras, xy, progress)
    refined = refined_by_person(cameras, keypoints, watch=lambda step, _: progress(STAGE, min(50 + step, 99), 100))
    progress(STAGE, 100, 100)
    after = np.linalg.norm(refined.adjusted.error, axis=-1)
    best = float(np.nanmedian(after))
    of = refined.adjusted.seen.camera
    best_by_camera = np.array(
        [np.nanmedian(after[of == c]) if (of == c).any() else np.nan for c in range(len(cameras))]
    )
    scale, _ = scale_from_stature(points, keypoints.joint_set, None)
    stature = MEAN_STATURE_M / scale
    upright = upright_from_person(points, keypoints.joint_set)
    tilt, tilt_sigma = (float(np.degrees(a)) for a in (np.arccos(np.clip(upright.R[2, 2], -1, 1)), upright.tilt_sigma))
    by_camera = np.array([np.nanmedian(e) for e in error])
    everything = float(np.nanmedian(error))
    words = (
        *_camera_words(cameras, by_camera, regions, everything, best_by_camera),
        *_time_words(cameras, epipolar),
        *_world_words(stature, scale, tilt, tilt_sigma),
    )
    return CalibrationCheck(
        by_camera, regions, epipolar, best, everything, best_by_camera, stature, tilt, tilt_sigma, words
    )


def _errors(cameras: Cameras, xy: np.ndarray, points: np.ndarray) -> np.ndarray:
    px = project(cameras, points)
    return np.linalg.norm(px - xy, axis=-1)


def _by_region(cameras: Cameras, xy: np.ndarray, error: np.ndarray) -> np.ndarray:
    grid = np.full((len(cameras), 3, 3), np.nan)
    for c in range(len(cameras)):
        good = np.isfinite(error[c])
        cell = np.clip((3 * xy[c][good] / cameras.image_size[c]).astype(int), 0, 2)
        for row in range(3):
            for column in range(3):
                values = error[c][good][(cell[:, 1] == row) & (cell[:, 0] == column)]
                if len(values) >= 30:
                    grid[c, row, column] = np.median(values)
    return grid


def _epipolar(cameras: Cameras, xy: np.ndarray, progress: Progress) -> np.ndarray:
    """Return (C, windows) the median distance to the epipolar lines of the other cameras."""
    C, F = xy.shape[:2]
    n = undistort(cameras, xy)
    windows = np.array_split(np.arange(F), min(WINDOWS, F))
    values: list[list[list[np.ndarray]]] = [[[] for _ in windows] for _ in range(C)]
    pairs = compared_pairs(C)
    for number, (i, j) in enumerate(pairs):
        progress(STAGE, 50 * number // len(pairs), 100)
        R = cameras.R[j] @ cameras.R[i].T
        t = cameras.t[j] - R @ cameras.t[i]
        cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        focal = 0.5 * float(cameras.K[i, 0, 0] + cameras.K[j, 0, 0])
        for w, part in enumerate(windows):
            a, b = n[i, part].reshape(-1, 2), n[j, part].reshape(-1, 2)
            both = np.isfinite(a).all(-1) & np.isfinite(b).all(-1)
            if both.any():
                distance = focal * sampson_distance((cross @ R)[None], a[both], b[both])[0]
                values[i][w].append(distance)
                values[j][w].append(distance)
    empty = np.array([np.nan])
    return np.array([[float(np.median(np.concatenate(w or [empty]))) for w in row] for row in values])


def _camera_words(
    cameras: Cameras, by_camera: np.ndarray, regions: np.ndarray, everything: float, best: np.ndarray
) -> list[Diagnostic]:
    words: list[Diagnostic] = []
    worse = (by_camera > WORSE * best) & (by_camera - best > 1.0)
    if worse.any():
        c = int(np.nanargmax(np.where(worse, by_camera / best, 0.0)))
        words.append(
            diagnostic("camera_moved", amount="check", cameras=[cameras.names[c]], size=by_camera[c], best=best[c])
        )
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
        if (
            len(track) >= 4
            and track.max() > DRIFT * 1.5 * max(track.min(), 0.5 * usual)
            and track.argmax() != track.argmin()
        ):
            half = len(track) // 2
            first, last = float(np.median(track[:half])), float(np.median(track[half:]))
            if max(first, last) > DRIFT * min(first, last):
                words.append(diagnostic("camera_drifts", cameras=[name], first=first, last=last))
    return words


def _world_words(stature: float, scale: float, tilt: float, tilt_sigma: float) -> list[Diagnostic]:
    words: list[Diagnostic] = []
    if abs(np.log(scale)) > SCALE_DOUBT:
        words.append(diagnostic("world_doubted", kind="scale", stature=stature))
    if tilt > max(TILT_DOUBT_DEG, TILT_DOUBT_SIGMAS * tilt_sigma):
        words.append(diagnostic("world_doubted", kind="tilt", angle=tilt))
    return words
