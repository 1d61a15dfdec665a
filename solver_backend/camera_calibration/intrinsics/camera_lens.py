"""One camera's lens from its pictures: chosen views, chosen model, bad pictures left out, and what to film again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, Lens
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.intrinsics.lens_fit import fitted_lens, tilted
from solver_backend.camera_calibration.intrinsics.model_choice import LensChoice, chosen_lens
from solver_backend.camera_calibration.intrinsics.view_selection import advice, selected_views
from solver_backend.exchange.diagnostics import Diagnostic

BAD_VIEW = 4.0
"""A picture whose error is so many times the median, and above half a pixel, is left out."""


@dataclass(frozen=True)
class CameraLens:
    """A lens with what it was found from."""

    choice: LensChoice
    """The lens, its model and its errors."""
    frames: tuple[int, ...]
    """Pictures that were used."""
    left_out: tuple[int, ...]
    """Pictures that contradict the others."""
    advice: tuple[Diagnostic, ...]
    """What to film again."""

    @property
    def lens(self) -> Lens:
        """The lens."""
        return self.choice.fit.lens


def camera_lens(
    board: Board,
    sightings: Mapping[int, BoardSighting],
    image_size: tuple[int, int],
    models: Sequence[str] = tuple(LENS_MODELS),
    name: str = "camera",
) -> CameraLens:
    """Find a lens from the sightings of one camera.

    Args:
        board: what was filmed.
        sightings: by frame.
        image_size: width and height, px.
        models: names of ``LENS_MODELS`` to choose from.
        name: of the camera, for the advice.

    Raises:
        CalibrationInvalid: fewer than three pictures, or no model fits them.
    """
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
    choice = chosen_lens(board, views, image_size, models)
    turned = int(tilted(board, views, choice.fit.lens).sum())
    return CameraLens(choice, tuple(kept), left_out, advice(views, image_size, turned, name))
