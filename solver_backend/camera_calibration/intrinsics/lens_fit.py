"""Fit a camera's lens to board pictures: choose the pictures, the lens model and its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import (
    CENTRE,
    FOCAL,
    LENS_MODELS,
    PARAMETERS,
    FittedLens,
    Lens,
    focal_from_homographies,
    homography,
    lens_of,
    planar_pose,
    rough_lens,
)
from solver_backend.camera_calibration.boards.board import Board, BoardSighting
from solver_backend.camera_calibration.pictures import Canvas
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.types.shapes import Bool, Float

FEWEST_VIEWS = 3  # Fewest pictures of a board to fit a lens.
CORNER_SIGMA_PX = 0.3  # Expected corner error in px, which sets the scale of the penalty.


@dataclass(frozen=True)
class LensFit:
    """A lens and its errors in the fitted pictures."""

    lens: Lens
    model: FittedLens
    rmse_px: float
    view_rmse_px: Float[np.ndarray, " views"]
    """(V,) root mean squared error of each picture."""
    focal_sigma_px: float
    adjusted: Adjusted


def fitted_lens(
    board: Board,
    views: Sequence[BoardSighting],
    image_size: tuple[int, int],
    model: FittedLens,
    start: Lens | None = None,
    steps: int = 60,
) -> LensFit:
    """Fit focal lengths, centre, the model's coefficients and the boards' poses to pictures of a board.

    The ratio of fx and fy does not change.

    Args:
        start: lens to start from. By default it is found from the homographies.

    Raises:
        CalibrationInvalid: there are fewer than three pictures, or all of them show the same pose.

    Reference: Zhang 2000, "A flexible new technique for camera calibration", sec. 3.
    """
    if len(views) < FEWEST_VIEWS:
        message = f"The board is seen in {len(views)} pictures; a lens needs {FEWEST_VIEWS}, better 20."
        hint = "Film it nearer, larger than a quarter of the picture, tilted, held still, in every corner."
        raise CalibrationInvalid(message, hint=hint)
    lens = start or _start(board, views, image_size)
    lens = Lens(lens.K, lens.distortion, image_size, model.distortion_model)
    free = np.zeros((1, PARAMETERS), dtype=bool)
    free[0, [*FOCAL, *CENTRE]] = True
    free[0, [4 + i for i in model.fitted]] = True
    sigma = np.full((1, PARAMETERS), 1.0)  # weak, so that richer models do not fold where nothing is seen
    sigma[0, list(CENTRE)], sigma[0, 4:] = 0.1, 2.0
    found = _adjusted(board, views, lens, Unknowns(np.zeros(1, bool), free, sigma), steps)
    focal = np.sqrt(np.diag(found.covariance))[6] * found.cameras.K[0, 0, 0]
    focal_sigma = float(focal * found.rmse_px / np.sqrt(2) / CORNER_SIGMA_PX)
    return LensFit(lens_of(found.cameras, 0), model, found.rmse_px, view_errors(found, views), focal_sigma, found)


def held_out_rmse(board: Board, views: Sequence[BoardSighting], lens: Lens) -> float:
    """Return the root mean squared error in px of pictures with a given lens and free board poses."""
    return _adjusted(board, views, lens, Unknowns(np.zeros(1, bool)), 30).rmse_px


def view_errors(found: Adjusted, views: Sequence[BoardSighting]) -> Float[np.ndarray, " views"]:
    """Return the (V,) root mean squared error of each picture in px."""
    firsts = np.cumsum([0, *(len(v.ids) for v in views)])[:-1]
    counts = np.array([len(v.ids) for v in views])
    return np.sqrt(np.add.reduceat((found.error**2).sum(-1), firsts) / counts)


def board_poses(board: Board, views: Sequence[BoardSighting], lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (V, 3, 3) and translations (V, 3) from board to camera, by homographies."""
    poses = []
    for view in views:
        flat = undistort(lens.as_camera(), view.px[None])[0]
        good = np.isfinite(flat).all(-1)
        enough = good.sum() >= 4
        image = flat[good] if enough else (view.px - lens.K[:2, 2]) / lens.K[[0, 1], [0, 1]]
        poses.append(planar_pose(board.points[view.ids[good] if enough else view.ids, :2], image))
    return np.stack([R for R, _ in poses]), np.stack([t for _, t in poses])


def tilted(board: Board, views: Sequence[BoardSighting], lens: Lens) -> Bool[np.ndarray, " views"]:
    """Return the (V,) mask of pictures with a board that is tilted by more than 15 degrees."""
    R, _ = board_poses(board, views, lens)
    return np.abs(R[:, 2, 2]) < np.cos(np.radians(15.0))


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


FOLDS = 4  # Number of parts of the pictures, for cross-validation.
GAIN = 0.03  # A richer model must predict better by this share.


@dataclass(frozen=True)
class LensChoice:
    """The lens of one camera, fitted to all pictures with the chosen model."""

    fit: LensFit
    held_out_px: dict[str, float]
    """Root mean squared error of held-out pictures by the model's name."""

    @property
    def held_out(self) -> float:
        """Error of the chosen model in held-out pictures."""
        return self.held_out_px[self.fit.model.name]


def chosen_lens(
    board: Board,
    views: Sequence[BoardSighting],
    image_size: tuple[int, int],
    models: Sequence[str] = tuple(LENS_MODELS),
) -> LensChoice:
    """Choose a lens model by cross-validation, and fit it to all pictures.

    Picture i belongs to part i mod 4, so that each part spans the recording. With fewer than twelve pictures, each one
    is a part. A richer model is chosen only if it predicts better by 3 %.

    Args:
        models: names of ``LENS_MODELS`` to choose from, the simplest first.

    Raises:
        CalibrationInvalid: there are too few pictures, or no model fits them.

    Reference: Geisser 1975 (cross-validation).
    """
    first = fitted_lens(board, views, image_size, LENS_MODELS[models[0]])
    folds = FOLDS if len(views) >= 3 * FOLDS else len(views)
    if len(views) <= 3:  # too few to hold one out
        return LensChoice(first, {models[0]: first.rmse_px})
    held_out = {name: _held_out(board, views, image_size, name, folds, first) for name in models}
    finite = {name: value for name, value in held_out.items() if np.isfinite(value)}
    if not finite:
        hint = "Check that it is one camera at one zoom, and that --board names the board."
        raise CalibrationInvalid("No lens model explains the pictures.", hint=hint)
    best = models[0]
    for name in models:
        if name in finite and (best not in finite or finite[name] < (1 - GAIN) * finite[best]):
            best = name
    start = first.lens if LENS_MODELS[best].distortion_model == first.lens.distortion_model else None
    return LensChoice(fitted_lens(board, views, image_size, LENS_MODELS[best], start), held_out)


def _held_out(
    board: Board, views: Sequence[BoardSighting], size: tuple[int, int], name: str, folds: int, first: LensFit
) -> float:
    model = LENS_MODELS[name]
    squares, count = 0.0, 0
    for fold in range(folds):
        kept = [v for i, v in enumerate(views) if i % folds != fold]
        left = [v for i, v in enumerate(views) if i % folds == fold]
        if len(kept) < 3:
            return float("inf")
        start = first.lens if model.distortion_model == first.lens.distortion_model else None
        try:
            error = held_out_rmse(board, left, fitted_lens(board, kept, size, model, start, steps=30).lens)
        except np.linalg.LinAlgError:
            return float("inf")
        points = sum(len(v.ids) for v in left)
        squares, count = squares + error**2 * points, count + points
    return float(np.sqrt(squares / count))


MOST_VIEWS = 40  # Most pictures to fit a lens to.
BLUR_SHARE = 0.4  # A picture less sharp than this share of the camera's 80 % quantile is skipped.
CELLS = (8, 6)  # Cells of the picture, across and down, for counting corners.


def selected_views(board: Board, sightings: Mapping[int, BoardSighting], image_size: tuple[int, int]) -> list[int]:
    """Select sharp pictures, one after the other the picture that differs most from those chosen before.

    Pictures differ by the places of the board's corners, in picture heights.

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


def coverage(sightings: list[BoardSighting], image_size: tuple[int, int]) -> np.ndarray:
    """Return the number of corners in each cell of the picture, (down, across)."""
    across, down = CELLS
    count = np.zeros((down, across), dtype=int)
    for view in sightings:
        cell = (view.px / np.array(image_size) * CELLS).astype(int)
        inside = ((cell >= 0) & (cell < CELLS)).all(-1)
        np.add.at(count, (cell[inside, 1], cell[inside, 0]), 1)
    return count


def advice(
    sightings: list[BoardSighting], image_size: tuple[int, int], tilted: int, camera: str
) -> tuple[Diagnostic, ...]:
    """Recommend pictures to film again.

    Args:
        tilted: number of pictures with a board that is tilted by more than 15 degrees.
    """
    words: list[Diagnostic] = []
    if len(sightings) < 12:
        words.append(diagnostic("board_views_weak", lack="pictures", cameras=[camera], count=len(sightings)))
    seen = coverage(sightings, image_size) > 0
    down, across = seen.shape
    parts = {
        "left": seen[:, : across // 4],
        "right": seen[:, -(across // 4) :],
        "top": seen[: down // 3],
        "bottom": seen[-(down // 3) :],
    }
    bare = [name for name, part in parts.items() if part.mean() < 0.4]
    if bare:
        words.append(diagnostic("board_views_weak", lack="parts", cameras=[camera], parts=bare))
    if tilted < min(5, len(sightings)):
        words.append(diagnostic("board_views_weak", lack="tilts", cameras=[camera], count=tilted))
    share = float(np.median([_extent(v) for v in sightings])) / min(image_size) if sightings else 0.0
    if sightings and share < 0.25:
        words.append(diagnostic("board_views_weak", lack="small", cameras=[camera], percent=100 * share))
    return tuple(words)


def coverage_svg(sightings: list[BoardSighting], image_size: tuple[int, int], title: str) -> str:
    """Draw all corners in the camera's picture."""
    width, height = image_size
    dots = "".join(f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{width / 200:.1f}"/>' for v in sightings for x, y in v.px)
    hulls = "".join(f'<path d="{_outline(v)}"/>' for v in sightings)
    clean = "".join(c for c in title if c not in "<>&")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width // 2}" '
        f'height="{height // 2}"><title>{clean}</title><rect width="{width}" height="{height}" fill="#f4f4f4" '
        f'stroke="#555"/><g fill="none" stroke="#1f77b4" stroke-opacity="0.3" stroke-width="{width / 500:.1f}">'
        f'{hulls}</g><g fill="#d62728" fill-opacity="0.5">{dots}</g></svg>\n'
    )


def _signature(board: Board, view: BoardSighting) -> np.ndarray:
    """Return the places of the board's four corners by a homography's affine part, (8,) px."""
    points = board.points
    h = np.concatenate([points[view.ids, :2], np.ones((len(view.ids), 1))], axis=1)
    affine = np.linalg.lstsq(h, view.px, rcond=None)[0]
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    corners = np.array([[low[0], low[1], 1], [high[0], low[1], 1], [high[0], high[1], 1], [low[0], high[1], 1]])
    return (corners @ affine).ravel()


def _extent(view: BoardSighting) -> float:
    return float(np.ptp(view.px, axis=0).max())


def _outline(view: BoardSighting) -> str:
    centre = view.px.mean(0)
    order = np.argsort(np.arctan2(*(view.px - centre).T))
    far = [view.px[order][part].tolist() for part in range(0, len(order), max(1, len(order) // 8))]
    return "M" + "L".join(f"{x:.0f} {y:.0f}" for x, y in far) + "Z"


WIDTH = 480  # Width of the picture in pixels. Chosen by hand.
_CELL, _CORNER = (58, 92, 74), (236, 112, 70)


def write_coverage_png(sightings: Sequence[BoardSighting], image_size: tuple[int, int], path: Path) -> None:
    """Write a PNG of all corners in the camera's picture, with the cells that the board reached in green.

    Raises:
        OutputNotWritable: the file cannot be written.
    """
    scale = WIDTH / image_size[0]
    canvas = Canvas(WIDTH, max(1, round(image_size[1] * scale)))
    wide, high = np.array(canvas.rgb.shape[1::-1]) / CELLS
    for row, column in np.argwhere(coverage(list(sightings), image_size)).tolist():
        canvas.box(wide * column, high * row, wide - 1, high - 1, _CELL)
    for view in sightings:
        canvas.dots(view.px * scale, _CORNER, 2)
    canvas.save(path)
