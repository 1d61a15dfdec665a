"""Store the lens parameters of cameras in a library, and read them from a library or a calibration."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, lens_of, rough_lens
from solver_backend.exchange.errors import (
    CalibrationInvalid,
    CalibrationMismatch,
    CalibrationMissing,
    CommandLineInvalid,
    FileDamaged,
)
from solver_backend.exchange.outputs import write_text
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.camera_names import match_names
from solver_backend.io.files import LARGEST_TEXT, read_json, read_text
from solver_backend.io.footage import PLAUSIBLE_MM, recorded_focal_mm

FORMAT, VERSION = "manifold-mocap-lenses", 1


def read_lenses(path: Path) -> dict[str, Lens]:
    """Read a lens library. Return the lenses by name, or an empty dictionary if the file does not exist."""
    if not path.exists():
        return {}
    table = read_json(path)
    if not isinstance(table, dict) or table.get("format") != FORMAT or table.get("version") != VERSION:
        raise FileDamaged("The file is not a lens library written by --keep-lenses.", where=str(path))
    lenses = table.get("lenses", {})
    if not isinstance(lenses, dict):
        raise FileDamaged("'lenses' must be an object that maps each camera name to a lens.", where=str(path))
    return {str(name): _lens(entry, f"{path}, lens {name}") for name, entry in lenses.items()}


def keep_lenses(path: Path, lenses: dict[str, Lens], errors_px: dict[str, float] | None = None) -> None:
    """Add lenses to a library file. A lens with the same name is replaced."""
    kept = sorted((read_lenses(path) | lenses).items())
    entries = {name: {key: np.asarray(value).tolist() for key, value in vars(lens).items()} for name, lens in kept}
    for name, error in (errors_px or {}).items():
        entries[name]["held_out_px"] = round(error, 4)
    content = {"format": FORMAT, "version": VERSION, "lenses": entries}
    write_text(path, json.dumps(content, indent=1) + "\n", overwrite=True)


def lens_named(lenses: dict[str, Lens], name: str, image_size: tuple[int, int] | None, where: str) -> Lens:
    """Return a lens from a library, scaled to the given image size."""
    if name not in lenses:
        hint = f"Known lenses: {', '.join(lenses) or 'none'}."
        raise CalibrationMissing(f"There is no lens '{name}'.", where=where, hint=hint)
    lens = lenses[name]
    if image_size is None or image_size == lens.image_size:
        return lens
    share = image_size[0] / lens.image_size[0]
    if abs(image_size[1] / lens.image_size[1] / share - 1.0) > 0.01:
        own, other = (f"{width} x {height}" for width, height in (lens.image_size, image_size))
        shape = "with another aspect ratio, so they use another part of the sensor"
        message = f"The lens was calibrated with images of {own}, but these have {other}, {shape}."
        raise CalibrationInvalid(message, where=where, hint="Film the board in the video mode of the takes.")
    K = lens.K.copy()
    K[:2] *= share
    K[:2, 2] += (share - 1) / 2
    return Lens(K, lens.distortion, image_size, lens.distortion_model)


def _lens(entry: Any, where: str) -> Lens:
    try:
        K, bent = np.array(entry["K"], dtype=float), np.array(entry["distortion"], dtype=float)
        width, height = (int(v) for v in entry["image_size"])
        lens = Lens(K.reshape(3, 3), bent.reshape(8), (width, height), str(entry["distortion_model"]))
        lens.as_camera()
        return lens
    except (KeyError, TypeError, ValueError, OverflowError, CalibrationInvalid) as error:
        raise FileDamaged(f"The lens description is incomplete ({error}).", where=where) from error


def known_lenses(path: Path, names: Sequence[str]) -> dict[str, Lens]:
    """Read the lenses of the named cameras from a lens library or a calibration."""
    if path.is_file() and path.suffix.lower() == ".json" and FORMAT in read_text(path, LARGEST_TEXT)[:200]:
        library = read_lenses(path)
        found = {name: lens_named(library, name, None, str(path)) for name in names}
    else:
        cameras = read_calibration(path).cameras
        order = match_names(names, cameras.names)
        if order is None:
            message = f"The cameras are {', '.join(names)}, but the file has {', '.join(cameras.names)}."
            raise CalibrationMismatch(message, where=str(path))
        found = {name: lens_of(cameras, i) for name, i in zip(names, order, strict=True)}
    if not all(np.isfinite(lens.K).all() for lens in found.values()):
        raise CalibrationInvalid("A lens contains NaN.", where=str(path))
    return found


GUESSED_SIGMA = 0.15  # Relative deviation of a guessed focal length. Phones have 0.75 to 1.0 of the longer side.
EQUIVALENT_SIGMA = 0.08  # Relative deviation of a 35 mm equivalent. A video can show only a part of the sensor.
FILM_DIAGONAL_MM = 43.27  # Diagonal of 36 x 24 mm, to which equivalents refer (CIPA DCG-001).
PLAUSIBLE_SHARE = (0.2, 20.0)  # Focal lengths of a fisheye and a telephoto lens, relative to the longer image side.
EXAMPLE = "26mm (35 mm equivalent) or 1450px"
_FOCAL = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(mm|px)\s*")


@dataclass(frozen=True)
class FocalLength:
    """A focal length and its uncertainty."""

    px: float
    sigma: float  # Relative standard deviation, 0 if the focal length is known.
    source: str

    def lens(self, image_size: tuple[int, int]) -> Lens:
        """Return a lens without distortion. Its principal point is the image centre."""
        return rough_lens(image_size, self.px / max(image_size))


def find_focal_length(given: str, footage: Path, image_size: tuple[int, int]) -> FocalLength:
    """Return the focal length given by the user, or else the one stored in the footage, or else a guess."""
    if given:
        return _given(given, image_size)
    recorded = recorded_focal_mm(footage)
    if recorded is not None:
        source = f"the file's 35 mm equivalent of {recorded:g} mm"
        return FocalLength(_of_equivalent(recorded, image_size), EQUIVALENT_SIGMA, source)
    guessed = rough_lens(image_size)
    return FocalLength(float(guessed.K[0, 0]), GUESSED_SIGMA, "the image size, a guess")


def _given(text: str, image_size: tuple[int, int]) -> FocalLength:
    match = _FOCAL.fullmatch(text)
    if match is None:
        raise CommandLineInvalid(f"'{text}' is not a focal length.", hint=f"Write it as {EXAMPLE}.")
    value, unit = float(match[1]), match[2]
    px = value if unit == "px" else _of_equivalent(value, image_size)
    low, high = (share * max(image_size) for share in PLAUSIBLE_SHARE)
    if not (low <= px <= high and (unit == "px" or PLAUSIBLE_MM[0] <= value <= PLAUSIBLE_MM[1])):
        size = f"{px:.0f} px in images of {image_size[0]} x {image_size[1]}"
        message = f"A focal length of {text.strip()} is {size}. It must be {low:.0f} to {high:.0f} px."
        raise CommandLineInvalid(message, hint=f"Write it as {EXAMPLE}.")
    return FocalLength(px, 0.0 if unit == "px" else EQUIVALENT_SIGMA, f"{text.strip()} as given")


def _of_equivalent(mm: float, image_size: tuple[int, int]) -> float:
    """Convert a 35 mm equivalent focal length to pixels: ``f = mm / 43.27 mm * diagonal``."""
    return mm / FILM_DIAGONAL_MM * float(np.hypot(*image_size))
