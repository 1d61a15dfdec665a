"""One distortion model for all cameras of an array: fisheye lenses or others, by the evidence of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.intrinsics.camera_lens import CameraLens
from solver_backend.camera_calibration.intrinsics.model_choice import chosen_lens


def choose_family(lenses: Mapping[str, CameraLens], models: Sequence[str]) -> str | None:
    """Return the distortion model under which all cameras together predict best; None where one of them lacks it.

    With errors of a normal distribution a camera's evidence is ``-n log σ`` for n pictures whose corners are predicted
    to σ px; that of a family is the sum over cameras of their best model in it.

    Args:
        lenses: by the camera's name, with the errors of pictures left out.
        models: names of ``LENS_MODELS`` that may be chosen.
    """
    families = {LENS_MODELS[name].distortion_model for name in models}
    costs: dict[str, float] = {}
    for family in sorted(families):
        errors = [_best_error(lens, family) for lens in lenses.values()]
        if np.isfinite(errors).all():
            counts = [len(lens.frames) for lens in lenses.values()]
            costs[family] = float(np.dot(counts, np.log(np.maximum(errors, 1e-9))))
    return min(costs, key=lambda family: costs[family]) if costs else None


def _best_error(lens: CameraLens, family: str) -> float:
    errors = [e for name, e in lens.choice.held_out_px.items() if LENS_MODELS[name].distortion_model == family]
    return min(errors, default=float("nan"))


def in_family(
    board: Board, lens: CameraLens, views: Sequence[BoardSighting], family: str, models: Sequence[str]
) -> CameraLens:
    """Return a camera's lens with the best model of a family, fitted to the same pictures.

    Args:
        board: what was filmed.
        lens: as it was chosen for itself.
        views: the pictures it was found from.
        family: a distortion model.
        models: names of ``LENS_MODELS`` that may be chosen.

    Raises:
        CalibrationInvalid: no model of the family fits.
    """
    allowed = [name for name in models if LENS_MODELS[name].distortion_model == family]
    if lens.lens.distortion_model == family or not allowed:
        return lens
    choice = chosen_lens(board, views, lens.lens.image_size, allowed)
    held_out = {**lens.choice.held_out_px, **choice.held_out_px}
    return replace(lens, choice=replace(choice, held_out_px=held_out))
