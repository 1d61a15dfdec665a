"""Which distortion model a lens needs: the one that predicts pictures best that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.intrinsics.lens_fit import LensFit, fitted_lens, held_out_rmse
from solver_backend.exchange.errors import CalibrationInvalid

FOLDS = 4
"""Parts of the pictures, each left out once."""
GAIN = 0.03
"""A richer model must predict better by this share."""


@dataclass(frozen=True)
class LensChoice:
    """The lens of one camera, fitted to all pictures with the chosen model."""

    fit: LensFit
    """The lens."""
    held_out_px: dict[str, float]
    """Root mean squared error of pictures left out, by the model's name."""

    @property
    def held_out(self) -> float:
        """That of the chosen model."""
        return self.held_out_px[self.fit.model.name]


def chosen_lens(
    board: Board,
    views: Sequence[BoardSighting],
    image_size: tuple[int, int],
    models: Sequence[str] = tuple(LENS_MODELS),
) -> LensChoice:
    """Fit every model without a part of the pictures, evaluate it on that part, and fit the best one to all.

    Parts are taken in turn (picture i belongs to part i mod 4), so that each spans the recording; of fewer than twelve
    pictures each is left out alone. A richer model is
    taken only if it predicts better by 3 %.

    Args:
        board: what was filmed.
        views: pictures of one camera.
        image_size: width and height.
        models: names of ``LENS_MODELS`` to choose from, the simplest first.

    Raises:
        CalibrationInvalid: too few pictures, or no model fits them.

    Reference: Geisser 1975 (cross-validation).
    """
    first = fitted_lens(board, views, image_size, LENS_MODELS[models[0]])
    folds = FOLDS if len(views) >= 3 * FOLDS else len(views)
    if len(views) <= 3:  # too few to leave one out: the simplest model, evaluated on what it was fitted to
        return LensChoice(first, {models[0]: first.rmse_px})
    held_out = {name: _held_out(board, views, image_size, name, folds, first) for name in models}
    finite = {name: value for name, value in held_out.items() if np.isfinite(value)}
    if not finite:
        raise CalibrationInvalid(
            "No lens model explains the pictures.",
            hint="Check that it is one camera at one zoom, and that --board names the board.",
        )
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
