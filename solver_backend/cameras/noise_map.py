"""Convert a detector's confidence to a solver weight, using a measured noise map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.json_file import read_json_file
from solver_backend.types import Keypoints2D

FORMAT = "manifold_mocap_detector_noise"
SYSTEMATIC_MM = 8.0
"""Standard deviation in mm per axis of errors that do not depend on confidence, as typical calibrations cause."""
USUAL_CONFIDENCE = 0.65
"""Confidence of an average detection, for which the solver's balance between data and priors was chosen."""
WEIGHTS = (0.02, 20.0)  # Smallest and largest weight that a detection can get.
MOST_STEPS = 1000  # Maximum number of confidence steps in a file.
LARGEST_CONFIDENCE = 1e9  # Largest confidence. It is high because confidences may be scores on any scale.
LARGEST_MM = 10_000.0  # Largest standard deviation of a detection at the person's distance.


@dataclass(frozen=True)
class NoiseMap:
    """Standard deviations of a detector's keypoints, measured at B levels of the detector's confidence."""

    detector: str
    confidence: np.ndarray
    """(B,) central confidence of each step, in ascending order."""
    sigma_mm: np.ndarray
    """(B,) standard deviation per axis at the person's distance. It never increases with confidence."""
    captures: tuple[str, ...] = ()
    """Names of the captures that were measured."""
    detections: int = 0
    """Number of keypoints that were measured."""

    def weight(self, confidence: np.ndarray) -> np.ndarray:
        """Return the solver weights of detections with the given confidences. A confidence of 0 has weight 0.

        ``w(c) = w₀ (σ_m² + s²) / (σ(c)² + s²)`` is the inverse variance, where s is the calibration error and σ is the
        detector's deviation. A detection with the map's median deviation σ_m gets the usual weight w₀. Better
        detections can have weights above 1. The solver multiplies squared errors by these weights.
        """
        variance = np.interp(confidence, self.confidence, self.sigma_mm) ** 2 + SYSTEMATIC_MM**2
        usual = np.median(self.sigma_mm) ** 2 + SYSTEMATIC_MM**2
        return np.where(confidence > 0, np.clip(USUAL_CONFIDENCE * usual / variance, *WEIGHTS), 0.0)

    def applied(self, keypoints: Keypoints2D, detector: str) -> tuple[Keypoints2D, Diagnostic]:
        """Replace keypoint confidences by solver weights. Also return a diagnostic that names the noise map."""
        note = diagnostic("noise_map_applied", measured=self.detector, keypoints=self.detections, detector=detector)
        return replace(keypoints, confidence=self.weight(keypoints.confidence)), note

    def as_dict(self) -> dict[str, object]:
        """Return the noise map as JSON values."""
        values: dict[str, object] = {"format": FORMAT, "version": 1, "detector": self.detector}
        values |= {"confidence": np.round(self.confidence, 5).tolist(), "sigma_mm": np.round(self.sigma_mm, 3).tolist()}
        return {**values, "captures": list(self.captures), "detections": self.detections}


def read_noise_map(path: Path | str) -> NoiseMap:
    """Read a detector's noise map from a JSON file. Raise ``FileDamaged`` if its values are invalid."""
    values = read_json_file(path)
    try:
        if not isinstance(values, dict) or values.get("format") != FORMAT:
            raise ValueError(f"its format is not '{FORMAT}'")
        if values.get("version") != 1:
            raise ValueError(f"it has version {values.get('version')!r}, but 1 is needed")
        return _checked(values)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        why = f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        hint = "Measure a noise map with `cameras noise CAPTURE --out NOISE.json`."
        raise FileDamaged(f"The file is not a detector noise map: {why}.", where=str(path), hint=hint) from error


def _checked(values: dict[str, Any]) -> NoiseMap:
    confidence, sigma = (_numbers(values, key) for key in ("confidence", "sigma_mm"))
    if confidence.shape != sigma.shape:
        raise ValueError(f"it has {len(confidence)} confidences and {len(sigma)} values of sigma_mm")
    if not 1 <= len(confidence) <= MOST_STEPS:
        raise ValueError(f"it has {len(confidence)} steps, and 1 to {MOST_STEPS} are allowed")
    if np.abs(confidence).max() > LARGEST_CONFIDENCE:
        raise ValueError(f"its confidences must be at most {LARGEST_CONFIDENCE:g}")
    if (np.diff(confidence) < 0).any():
        raise ValueError("its confidences are not in ascending order")
    if not ((sigma > 0) & (sigma <= LARGEST_MM)).all():
        raise ValueError(f"its sigma_mm must be above 0 and at most {LARGEST_MM:g}")
    if (np.diff(sigma) > 0).any():
        raise ValueError("its sigma_mm rises with the confidence")
    captures, count = values.get("captures", []), values.get("detections", 0)
    if not isinstance(captures, list) or not all(isinstance(name, str) for name in captures):
        raise ValueError("captures is not a list of names")
    if isinstance(count, bool) or not isinstance(count, int) or count < 0:
        raise ValueError("detections is not a whole number")
    if not isinstance(values["detector"], str):
        raise ValueError("detector is not a name")
    return NoiseMap(values["detector"], confidence, sigma, tuple(captures), count)


def _numbers(values: dict[str, Any], key: str) -> np.ndarray:
    given = values[key]
    plain = isinstance(given, list) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in given)
    numbers = np.array(given, dtype=np.float64) if plain else np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise ValueError(f"{key} is not a list of finite numbers")
    return numbers
