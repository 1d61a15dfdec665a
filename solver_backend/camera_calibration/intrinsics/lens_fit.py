"""Fit a lens model to images of a board. This includes the choice of the images and of the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import (
    LENS_MODELS,
    FittedLens,
    Lens,
    focal_from_homographies,
    homography,
    lens_mask,
    lens_of,
    planar_pose,
    rough_lens,
)
from solver_backend.camera_calibration.boards.board import Board, BoardSighting
from solver_backend.camera_calibration.pictures import Canvas
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.types.shapes import Float

FEWEST_VIEWS = 3  # Minimum number of board images to which a lens is fitted.
CORNER_SIGMA_PX = 0.3  # Expected error of a corner in px, which sets the scale of the penalty.


@dataclass(frozen=True)
class LensFit:
    """A fitted lens and its errors in the board images."""

    lens: Lens
    model: FittedLens
    rmse_px: float
    view_rmse_px: Float[np.ndarray, " views"]  # (V,) root mean square error in each image.
    focal_sigma_px: float


def fitted_lens(
    board: Board,
    views: Sequence[BoardSighting],
    image_size: tuple[int, int],
    model: FittedLens,
    start: Lens | None = None,
    steps: int = 60,
) -> LensFit:
    """Fit the lens parameters and the board poses to V images of a board.

    The ratio of fx to fy stays constant.

    Args:
        start: initial lens. If None, or if its distortion model differs, homographies give an initial lens.

    Reference: Zhang 2000, "A flexible new technique for camera calibration", sec. 3.
    """
    if len(views) < FEWEST_VIEWS:
        message = f"The board is visible in {len(views)} images, but a lens needs {FEWEST_VIEWS}, preferably 20."
        hint = "Hold the board still, tilted and in every corner, so that it fills at least a quarter of the image."
        raise CalibrationInvalid(message, hint=hint)
    if start is None or start.distortion_model != model.distortion_model:
        start = _start(board, views, image_size)
    lens = Lens(start.K, start.distortion, image_size, model.distortion_model)
    free = lens_mask(model.fitted, centre=True)[None]
    sigma = np.repeat([1.0, 0.1, 2.0], [2, 2, 8])[None]  # weak, so that lenses do not fold where no corner is
    found = _adjusted(board, views, lens, Unknowns(np.zeros(1, bool), free, sigma), steps)
    focal = np.sqrt(np.diag(found.covariance))[6] * found.cameras.K[0, 0, 0]
    focal_sigma = float(focal * found.rmse_px / np.sqrt(2) / CORNER_SIGMA_PX)
    counts = np.array([len(view.ids) for view in views])
    square = np.add.reduceat((found.error**2).sum(-1), np.cumsum([0, *counts[:-1]]))
    return LensFit(lens_of(found.cameras, 0), model, found.rmse_px, np.sqrt(square / counts), focal_sigma)


def board_poses(board: Board, views: Sequence[BoardSighting], lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the rotations (V, 3, 3) and translations (V, 3) from board to camera in V images."""
    poses = []
    for view in views:
        flat = undistort(lens.as_camera(), view.px[None])[0]
        good = np.isfinite(flat).all(-1)
        enough = good.sum() >= 4
        image = flat[good] if enough else (view.px - lens.K[:2, 2]) / lens.K[[0, 1], [0, 1]]
        poses.append(planar_pose(board.points[view.ids[good] if enough else view.ids, :2], image))
    return np.stack([R for R, _ in poses]), np.stack([t for _, t in poses])


def _start(board: Board, views: Sequence[BoardSighting], image_size: tuple[int, int]) -> Lens:
    rough = rough_lens(image_size)
    planes = np.stack([homography(board.points[v.ids, :2], v.px) for v in views])
    focal = focal_from_homographies(planes, rough.K[:2, 2])
    if focal is None or not 0.3 < focal / rough.K[0, 0] < 8.0:
        return rough
    K = rough.K.copy()
    K[0, 0] = K[1, 1] = focal
    return Lens(K, rough.distortion, image_size)


def _adjusted(board: Board, views: Sequence[BoardSighting], lens: Lens, unknowns: Unknowns, steps: int) -> Adjusted:
    R, t = board_poses(board, views, lens)
    which = np.repeat(np.arange(len(views)), [len(v.ids) for v in views])
    n = len(which)
    local, px = np.concatenate([board.points[v.ids] for v in views]), np.concatenate([v.px for v in views])
    seen = BodySightings(np.zeros(n, dtype=int), which, local, px, np.full(n, CORNER_SIGMA_PX))
    options = {"robust_scale": 4.0, "gauge": 0, "tolerance": 1e-6}
    return adjust(lens.as_camera(), Bodies(R, t), seen, unknowns, steps=steps, **options)


FOLDS = 4  # Number of groups of images used for cross-validation.
GAIN = 0.03  # Smallest relative error reduction for which a model with more coefficients is chosen.
BAD_VIEW = 4.0  # Largest error of a usable image, in multiples of the median. Errors up to 0.5 px are always usable.
TILT_DEG, FEWEST_TILTED = 15.0, 5  # Smallest angle of a tilted board, and number of tilted images below which to warn.


@dataclass(frozen=True)
class CameraLens:
    """A camera's calibrated lens, and the board images to which it was fitted."""

    fit: LensFit  # Fit of the chosen model to all images.
    held_out_px: dict[str, float]  # Root mean square error in held-out images, by model name.
    frames: tuple[int, ...]
    views: tuple[BoardSighting, ...]
    left_out: tuple[int, ...]
    advice: tuple[Diagnostic, ...]

    @property
    def lens(self) -> Lens:
        """Lens fitted with the chosen model."""
        return self.fit.lens

    @property
    def held_out(self) -> float:
        """Reprojection error (px) of the chosen model in images that were left out of the fit."""
        return self.held_out_px[self.fit.model.name]


def camera_lens(
    board: Board,
    sightings: Mapping[int, BoardSighting],
    image_size: tuple[int, int],
    models: Sequence[str] = tuple(LENS_MODELS),
    name: str = "camera",
) -> CameraLens:
    """Calibrate a camera's lens from its board sightings. Images with large errors are excluded."""
    frames = selected_views(board, sightings, image_size)
    kept = list(frames)
    while True:
        fit = fitted_lens(board, [sightings[f] for f in kept], image_size, LENS_MODELS["radial2"])
        worst = int(np.argmax(fit.view_rmse_px))
        if fit.view_rmse_px[worst] <= max(BAD_VIEW * float(np.median(fit.view_rmse_px)), 0.5) or len(kept) <= 4:
            break
        kept.pop(worst)
    left_out = tuple(f for f in frames if f not in kept)
    views = [sightings[f] for f in kept]
    fit, held_out = chosen_lens(board, views, image_size, models)
    tilted = np.abs(board_poses(board, views, fit.lens)[0][:, 2, 2]) < np.cos(np.radians(TILT_DEG))
    words = advice(views, image_size, int(tilted.sum()), name)
    return CameraLens(fit, held_out, tuple(kept), tuple(views), left_out, words)


def chosen_lens(
    board: Board, views: Sequence[BoardSighting], image_size: tuple[int, int], models: Sequence[str]
) -> tuple[LensFit, dict[str, float]]:
    """Choose a lens model by cross-validation and fit it. Also return the held-out error of each model.

    Image i belongs to group i mod 4, so that each group covers the whole recording. If there are fewer than twelve
    images, each one forms a group. A model with more coefficients is only chosen if its error is 3 % smaller.

    Reference: Geisser 1975 (cross-validation).
    """
    first = fitted_lens(board, views, image_size, LENS_MODELS[models[0]])
    if len(views) <= FEWEST_VIEWS:  # too few to hold any out
        return first, {models[0]: first.rmse_px}
    held_out = {name: _held_out(board, views, image_size, LENS_MODELS[name], first.lens) for name in models}
    finite = {name: value for name, value in held_out.items() if np.isfinite(value)}
    if not finite:
        hint = "Check that all images are from one camera at one zoom, and that --board describes the board."
        raise CalibrationInvalid("No lens model fits the images.", hint=hint)
    best = next(iter(finite))
    for name, error in finite.items():
        best = name if error < (1 - GAIN) * finite[best] else best
    return fitted_lens(board, views, image_size, LENS_MODELS[best], first.lens), held_out


def _held_out(
    board: Board, views: Sequence[BoardSighting], size: tuple[int, int], model: FittedLens, start: Lens
) -> float:
    squares, count = 0.0, 0
    folds = FOLDS if len(views) >= 3 * FOLDS else len(views)
    for fold in range(folds):
        kept, left = ([v for i, v in enumerate(views) if (i % folds != fold) is fitted] for fitted in (True, False))
        if len(kept) < FEWEST_VIEWS:
            return float("inf")
        try:
            lens = fitted_lens(board, kept, size, model, start, steps=30).lens
            error = _adjusted(board, left, lens, Unknowns(np.zeros(1, bool)), 30).rmse_px
        except np.linalg.LinAlgError:
            return float("inf")
        points = sum(len(v.ids) for v in left)
        squares, count = squares + error**2 * points, count + points
    return float(np.sqrt(squares / count))


def choose_family(lenses: Mapping[str, CameraLens], models: Sequence[str]) -> str | None:
    """Choose the distortion model that best predicts held-out images. Return None if no model suits every camera.

    The best model minimises ``Σ n log σ`` over the cameras. For each camera, σ is the held-out error in px, and n is
    the number of images.
    """
    costs: dict[str, float] = {}
    for family in sorted({LENS_MODELS[name].distortion_model for name in models}):
        mine = [name for name, model in LENS_MODELS.items() if model.distortion_model == family]
        errors = [min((e.held_out_px.get(name, np.inf) for name in mine), default=np.inf) for e in lenses.values()]
        if np.isfinite(errors).all():
            counts = [len(lens.frames) for lens in lenses.values()]
            costs[family] = float(np.dot(counts, np.log(np.maximum(errors, 1e-9))))
    return min(costs, key=lambda family: costs[family]) if costs else None


def in_family(board: Board, lens: CameraLens, family: str, models: Sequence[str]) -> CameraLens:
    """Refit a camera's lens with the best variant of a given distortion model."""
    allowed = [name for name in models if LENS_MODELS[name].distortion_model == family]
    if lens.lens.distortion_model == family or not allowed:
        return lens
    fit, held_out = chosen_lens(board, lens.views, lens.lens.image_size, allowed)
    return replace(lens, fit=fit, held_out_px={**lens.held_out_px, **held_out})


MOST_VIEWS = 40  # Maximum number of images to which a lens is fitted.
BLUR_SHARE = 0.4  # Smallest sharpness of a usable image, relative to the 80 % quantile of the camera's images.
CELLS = (8, 6)  # Number of cells across and down the image in which corners are counted.


def selected_views(board: Board, sightings: Mapping[int, BoardSighting], image_size: tuple[int, int]) -> list[int]:
    """Select sharp images one by one, each as different as possible from the selected ones.

    The difference is the distance between the positions of the board corners, in image heights.

    Reference: Gonzalez 1985 (farthest point first).
    """
    frames = sorted(sightings)
    if not frames:
        return []
    bar = BLUR_SHARE * float(np.quantile([sightings[f].sharpness for f in frames], 0.8))
    sharp = [f for f in frames if sightings[f].sharpness >= bar] or frames
    if len(sharp) <= MOST_VIEWS:
        return sharp
    signature = np.stack([_signature(board, sightings[f]) for f in sharp]) / min(image_size)
    chosen = [int(np.argmax([len(sightings[f].ids) * sightings[f].spacing_px for f in sharp]))]
    distance = np.linalg.norm(signature - signature[chosen[0]], axis=1)
    while len(chosen) < MOST_VIEWS:
        farthest = int(np.argmax(distance))
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(signature - signature[farthest], axis=1))
    return sorted(sharp[i] for i in chosen)


def coverage(sightings: Sequence[BoardSighting], image_size: tuple[int, int]) -> np.ndarray:
    """Count the detected corners in each cell of the image. Return an array (rows, columns)."""
    across, down = CELLS
    count = np.zeros((down, across), dtype=int)
    for view in sightings:
        cell = (view.px / np.array(image_size) * CELLS).astype(int)
        inside = ((cell >= 0) & (cell < CELLS)).all(-1)
        np.add.at(count, (cell[inside, 1], cell[inside, 0]), 1)
    return count


def advice(
    sightings: Sequence[BoardSighting], image_size: tuple[int, int], tilted: int, camera: str
) -> tuple[Diagnostic, ...]:
    """Recommend board images to add, such as tilted ones. ``tilted`` is the number of tilted images."""
    seen = coverage(sightings, image_size) > 0
    down, across = seen.shape[0] // 3, seen.shape[1] // 4
    parts = {"left": seen[:, :across], "right": seen[:, -across:], "top": seen[:down], "bottom": seen[-down:]}
    bare = [name for name, part in parts.items() if part.mean() < 0.4]
    extents = [np.ptp(view.px, axis=0).max() for view in sightings]
    share = float(np.median(extents)) / min(image_size) if extents else 1.0
    lacks: list[tuple[bool, dict[str, Any]]] = [
        (len(sightings) < 12, {"lack": "pictures", "count": len(sightings)}),
        (bool(bare), {"lack": "parts", "parts": bare}),
        (tilted < min(FEWEST_TILTED, len(sightings)), {"lack": "tilts", "count": tilted}),
        (share < 0.25, {"lack": "small", "percent": 100 * share}),
    ]
    return tuple(diagnostic("board_views_weak", cameras=[camera], **what) for weak, what in lacks if weak)


def _signature(board: Board, view: BoardSighting) -> np.ndarray:
    """Estimate the positions (8,) of the board's outer corners in px by an affine fit."""
    points = board.points
    h = np.concatenate([points[view.ids, :2], np.ones((len(view.ids), 1))], axis=1)
    affine = np.linalg.lstsq(h, view.px, rcond=None)[0]
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    corners = np.array([[low[0], low[1], 1], [high[0], low[1], 1], [high[0], high[1], 1], [low[0], high[1], 1]])
    return (corners @ affine).ravel()


WIDTH = 480  # Width of the image in pixels. Chosen by hand.
_CELL, _CORNER = (58, 92, 74), (236, 112, 70)


def write_coverage(sightings: Sequence[BoardSighting], image_size: tuple[int, int], path: Path) -> None:
    """Write a PNG of a camera's image area with all detected corners. Covered cells are green."""
    scale = WIDTH / image_size[0]
    canvas = Canvas(WIDTH, max(1, round(image_size[1] * scale)))
    wide, high = np.array(canvas.rgb.shape[1::-1]) / CELLS
    for row, column in np.argwhere(coverage(sightings, image_size)).tolist():
        canvas.box(wide * column, high * row, wide - 1, high - 1, _CELL)
    for view in sightings:
        canvas.dots(view.px * scale, _CORNER, 2)
    canvas.save(path)
