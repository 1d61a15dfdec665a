"""Lenses that are known already: from a library, or from any calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, lens_of
from solver_backend.camera_calibration.intrinsics.library import FORMAT, lens_named, read_lenses
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMismatch
from solver_backend.io.calibration import read_calibration
from solver_backend.io.files import LARGEST_TEXT, read_text
from solver_backend.io.recognition.camera_names import match_names
from solver_backend.types import Cameras


def known_lenses(path: Path, names: Sequence[str]) -> dict[str, Lens]:
    """Return the lenses of cameras by their names, from a library of lenses or any calibration.

    Raises:
        CalibrationMissing, CalibrationMismatch: a camera is not in it.
        CalibrationInvalid: a lens holds NaN.
    """
    if path.is_file() and path.suffix.lower() == ".json" and FORMAT in read_text(path, LARGEST_TEXT)[:200]:
        library = read_lenses(path)
        found = {name: lens_named(library, name, None, str(path)) for name in names}
    else:
        cameras: Cameras = read_calibration(path).cameras
        order = match_names(names, cameras.names)
        if order is None:
            raise CalibrationMismatch(
                f"The cameras are {', '.join(names)}; the file has {', '.join(cameras.names)}.", where=str(path)
            )
        found = {name: lens_of(cameras, i) for name, i in zip(names, order, strict=True)}
    if not all(np.isfinite(lens.K).all() for lens in found.values()):
        raise CalibrationInvalid("A lens holds NaN.", where=str(path))
    return found
