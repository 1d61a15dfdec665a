"""The focal length of a camera without a calibration: given, or recorded in its file, or guessed; with its error."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, rough_lens
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.io.footage import PLAUSIBLE_MM, recorded_focal_mm

GUESSED_SIGMA = 0.15
"""Standard deviation of a guessed focal length as a share: phones film at 0.75 to 1.0 of the longer side."""
EQUIVALENT_SIGMA = 0.08
"""The same of a 35 mm equivalent: it is of the whole sensor; a video shows a part (16:9 of 4:3, stabilised)."""
FILM_DIAGONAL_MM = 43.27
"""Of 36 x 24 mm; equivalents compare diagonals (CIPA DCG-001)."""
PLAUSIBLE_SHARE = (0.2, 20.0)
"""Of the picture's longer side: a fisheye, and a telescope."""
EXAMPLE = "26mm (35 mm equivalent) or 1450px"
_FOCAL = re.compile(r"\s*([0-9]+(?:\.[0-9]+)?)\s*(mm|px)\s*")


@dataclass(frozen=True)
class FocalLength:
    """How long a lens is, and how sure that is."""

    px: float
    """Pixels."""
    sigma: float
    """Standard deviation as a share, 0 where it is known."""
    source: str
    """What it is from, for people."""

    def lens(self, image_size: tuple[int, int]) -> Lens:
        """Return a lens without distortion, its centre in the middle of the picture."""
        return rough_lens(image_size, self.px / max(image_size))


def find_focal_length(given: str, footage: Path, image_size: tuple[int, int]) -> FocalLength:
    """Return the focal length that was given, else the one in the file, else a guess.

    Args:
        given: such as ``EXAMPLE``; "" where nothing was.
        footage: a video or a folder of pictures.
        image_size: width and height of its pictures, px.

    Raises:
        CommandLineInvalid: what was given is no focal length.
    """
    if given:
        return _given(given, image_size)
    recorded = recorded_focal_mm(footage)
    if recorded is not None:
        source = f"the file's 35 mm equivalent of {recorded:g} mm"
        return FocalLength(_of_equivalent(recorded, image_size), EQUIVALENT_SIGMA, source)
    guessed = rough_lens(image_size)
    return FocalLength(float(guessed.K[0, 0]), GUESSED_SIGMA, "the picture's size, a guess")


def _given(text: str, image_size: tuple[int, int]) -> FocalLength:
    match = _FOCAL.fullmatch(text)
    if match is None:
        raise CommandLineInvalid(f"'{text}' is not a focal length.", hint=f"Give it as {EXAMPLE}.")
    value, unit = float(match[1]), match[2]
    px = value if unit == "px" else _of_equivalent(value, image_size)
    low, high = (share * max(image_size) for share in PLAUSIBLE_SHARE)
    if not (low <= px <= high and (unit == "px" or PLAUSIBLE_MM[0] <= value <= PLAUSIBLE_MM[1])):
        raise CommandLineInvalid(
            f"A focal length of {text.strip()} is {px:.0f} px in pictures of {image_size[0]} x {image_size[1]}; "
            f"{low:.0f} to {high:.0f} px are possible.", hint=f"Give it as {EXAMPLE}.",
        )  # fmt: skip
    return FocalLength(px, 0.0 if unit == "px" else EQUIVALENT_SIGMA, f"{text.strip()} as given")


def _of_equivalent(mm: float, image_size: tuple[int, int]) -> float:
    """Return pixels of a 35 mm equivalent: ``f = mm / 43.27 mm * diagonal``."""
    return mm / FILM_DIAGONAL_MM * float(np.hypot(*image_size))
