"""Lenses kept for reuse, by camera, lens and mode, in one JSON file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged
from solver_backend.exchange.outputs import write_text
from solver_backend.io.files import read_json

FORMAT, VERSION = "manifold-mocap-lenses", 1


def read_lenses(path: Path) -> dict[str, Lens]:
    """Return the lenses of a library by their names, such as ``phone wide 1080p60``; none where there is no file.

    Raises:
        FileDamaged: it is no library, or a lens in it is impossible.
    """
    if not path.exists():
        return {}
    table = read_json(path)
    if not isinstance(table, dict) or table.get("format") != FORMAT or table.get("version") != VERSION:
        raise FileDamaged("The file is not a library of lenses.", where=str(path))
    lenses = table.get("lenses", {})
    if not isinstance(lenses, dict):
        raise FileDamaged("'lenses' must hold a lens for each name.", where=str(path))
    return {str(name): _lens(entry, f"{path}, lens {name}") for name, entry in lenses.items()}


def keep_lenses(path: Path, lenses: dict[str, Lens], errors_px: dict[str, float] | None = None) -> None:
    """Add lenses to a library, those of the same name replaced, the others kept.

    Raises:
        FileDamaged: there is a file that is no library.
        OutputNotWritable: it cannot be written.
    """
    kept = read_lenses(path) | lenses
    entries = {name: _entry(lens) for name, lens in sorted(kept.items())}
    for name, error in (errors_px or {}).items():
        entries[name]["held_out_px"] = round(error, 4)
    content = {"format": FORMAT, "version": VERSION, "lenses": entries}
    write_text(path, json.dumps(content, indent=1) + "\n", overwrite=True)


def lens_named(lenses: dict[str, Lens], name: str, image_size: tuple[int, int] | None, where: str) -> Lens:
    """Return the lens of a name, for pictures of a size.

    Raises:
        CalibrationMissing: there is none.
        CalibrationInvalid: it was found in another mode: its pictures have another shape.
    """
    if name not in lenses:
        raise CalibrationMissing(
            f"There is no lens '{name}'.", where=where, hint=f"There are: {', '.join(lenses) or 'none'}."
        )
    lens = lenses[name]
    if image_size is None or image_size == lens.image_size:
        return lens
    share = image_size[0] / lens.image_size[0]
    if abs(image_size[1] / lens.image_size[1] / share - 1.0) > 0.01:
        raise CalibrationInvalid(
            f"The lens was found in pictures of {lens.image_size[0]} x {lens.image_size[1]}; these have "
            f"{image_size[0]} x {image_size[1]}, of another shape, which is another part of the sensor.",
            where=where,
            hint="Film the board in the mode that the takes are filmed in.",
        )
    K = lens.K.copy()
    K[:2] *= share
    K[:2, 2] += (share - 1) / 2
    return Lens(K, lens.distortion, image_size, lens.distortion_model)


def _entry(lens: Lens) -> dict[str, object]:
    return {
        "image_size": list(lens.image_size), "K": lens.K.tolist(), "distortion": lens.distortion.tolist(),
        "distortion_model": lens.distortion_model,
    }  # fmt: skip


def _lens(entry: Any, where: str) -> Lens:
    try:
        K, bent = np.array(entry["K"], dtype=float), np.array(entry["distortion"], dtype=float)
        width, height = (int(v) for v in entry["image_size"])
        lens = Lens(K.reshape(3, 3), bent.reshape(8), (width, height), str(entry["distortion_model"]))
        lens.as_camera()
        return lens
    except (KeyError, TypeError, ValueError, OverflowError, CalibrationInvalid) as error:
        raise FileDamaged(f"The lens is not whole ({error}).", where=where) from error
