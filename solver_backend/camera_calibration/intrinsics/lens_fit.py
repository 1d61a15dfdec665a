"""A lens fitted to pictures of a board, and the board's pose in each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import adjust
from solver_backend.camera_calibration.adjustment.lens import (
    CENTRE,
    FOCAL,
    PARAMETERS,
    Lens,
    LensModel,
    lens_of,
    rough_lens,
)
from solver_backend.camera_calibration.adjustment.planar import focal_from_homographies, homography, planar_pose
from solver_backend.camera_calibration.adjustment.problem import Adjusted, Bodies, BodySightings, Unknowns
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.types.shapes import Bool, Float

FEWEST_VIEWS = 3
"""Pictures of a board from which a lens is fitted."""
CORNER_SIGMA_PX = 0.3
"""What a corner is expected to be off by; the penalty's scale follows from it."""


@dataclass(frozen=True)
class LensFit:
    """A lens and how well it explains the pictures it was fitted to."""

    lens: Lens
    """The lens."""
    model: LensModel
    """What was fitted."""
    rmse_px: float
    """Over all points of all pictures."""
    view_rmse_px: Float[np.ndarray, " views"]
    """(V,) of each picture."""
    focal_sigma_px: float
    """Standard deviation of the focal length."""
    adjusted: Adjusted
    """The boards' poses, errors and covariance."""


def fitted_lens(
    board: Board,
    views: Sequence[BoardSighting],
    image_size: tuple[int, int],
    model: LensModel,
    start: Lens | None = None,
    steps: int = 60,
) -> LensFit:
    """Fit a lens to pictures of a board: focal lengths, centre and the model's coefficients with the boards' poses.

    fx equals fy but for the start's ratio.

    Args:
        board: what was filmed.
        views: V sightings of one camera.
        image_size: width and height of the pictures.
        model: which coefficients.
        start: a lens to start from; found from the homographies if left out.
        steps: of the adjustment, at most.

    Raises:
        CalibrationInvalid: fewer than three pictures, or all of them show the board alike.

    Reference: Zhang 2000, "A flexible new technique for camera calibration", sec. 3.
    """
    if len(views) < FEWEST_VIEWS:
        raise CalibrationInvalid(
            f"The board is seen in {len(views)} pictures; a lens needs {FEWEST_VIEWS}, better 20.",
            hint="Film it nearer, larger than a quarter of the picture, tilted, held still, in every corner.",
        )
    lens = start or _start(board, views, image_size)
    lens = Lens(lens.K, lens.distortion, image_size, model.distortion_model)
    free = np.zeros((1, PARAMETERS), dtype=bool)
    free[0, [*FOCAL, *CENTRE]] = True
    free[0, [4 + i for i in model.fitted]] = True
    sigma = np.full((1, PARAMETERS), 1.0)  # a weak bound that keeps richer models from folding where nothing is seen
    sigma[0, list(CENTRE)], sigma[0, 4:] = 0.1, 2.0
    found = _adjusted(board, views, lens, Unknowns(np.zeros(1, bool), free, True, sigma), steps)
    focal = np.sqrt(np.diag(found.covariance))[6] * found.cameras.K[0, 0, 0]
    return LensFit(
        lens_of(found.cameras, 0), model, found.rmse_px, view_errors(found, views),
        float(focal * found.rmse_px / np.sqrt(2) / CORNER_SIGMA_PX), found,
    )  # fmt: skip


def held_out_rmse(board: Board, views: Sequence[BoardSighting], lens: Lens) -> float:
    """Return the root mean squared error in px of pictures to which a lens was not fitted, the board's pose apart."""
    nothing = np.zeros((1, PARAMETERS), dtype=bool)
    return _adjusted(board, views, lens, Unknowns(np.zeros(1, bool), nothing), 30).rmse_px


def view_errors(found: Adjusted, views: Sequence[BoardSighting]) -> Float[np.ndarray, " views"]:
    """Return (V,) px, the root mean squared error of each picture."""
    firsts = np.cumsum([0, *(len(v.ids) for v in views)])[:-1]
    counts = np.array([len(v.ids) for v in views])
    return np.sqrt(np.add.reduceat((found.error**2).sum(-1), firsts) / counts)


def board_poses(board: Board, views: Sequence[BoardSighting], lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (V, 3, 3) and translations (V, 3) board to camera, by homographies of undistorted points."""
    poses = []
    for view in views:
        flat = undistort(lens.as_camera(), view.px[None])[0]
        good = np.isfinite(flat).all(-1)
        enough = good.sum() >= 4
        image = flat[good] if enough else (view.px - lens.K[:2, 2]) / lens.K[[0, 1], [0, 1]]
        poses.append(planar_pose(board.points[view.ids[good] if enough else view.ids, :2], image))
    return np.stack([R for R, _ in poses]), np.stack([t for _, t in poses])


def tilted(board: Board, views: Sequence[BoardSighting], lens: Lens) -> Bool[np.ndarray, " views"]:
    """Return (V,) whether the board is turned from the picture's plane by more than 15 degrees."""
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
    seen = BodySightings(
        camera=np.zeros(len(which), dtype=int),
        body=which,
        local=np.concatenate([board.points[v.ids] for v in views]),
        px=np.concatenate([v.px for v in views]),
        sigma=np.full(len(which), CORNER_SIGMA_PX),
    )
    return adjust(
        lens.as_camera(), Bodies(R, t), seen, unknowns, robust_scale=4.0, steps=steps, gauge=0, tolerance=1e-6
    )
