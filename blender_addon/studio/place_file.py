"""Errors of arrays by place on the floor, as the benchmark writes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._exchange.errors import FileDamaged, FileMissing
from .._exchange.json_file import read_json_file

FORMAT, VERSION = "manifold_mocap_places", 1


@dataclass(frozen=True)
class PlaceMap:
    """Errors of an array over the floor; Y rows, X columns."""

    array: str
    x_m: np.ndarray
    y_m: np.ndarray
    error_mm: np.ndarray
    """(Y, X), NaN where nobody is located."""

    @property
    def median_mm(self) -> float | None:
        """Median over the places where somebody is located, None where nobody is anywhere."""
        good = self.error_mm[np.isfinite(self.error_mm)]
        return float(np.median(good)) if good.size else None


def read_places(path: Path) -> list[PlaceMap]:
    """Read the maps that ``studio-benchmark`` wrote.

    Raises:
        FileMissing: the file is gone.
        FileDamaged: it is of another format, or its rows do not fit.
    """
    if not path.exists():
        raise FileMissing("The map no longer exists.", where=str(path), hint="Run the benchmark again.")
    values = read_json_file(path)
    try:
        if (values["format"], values["version"]) != (FORMAT, VERSION):
            raise ValueError("another format")
        maps = [
            PlaceMap(
                str(item["camera_array" if "camera_array" in item else "rig"]),  # its name until 0.1
                np.array(item["x_m"], np.float64), np.array(item["y_m"], np.float64),
                np.array(item["error_mm"], np.float64),
            )
            for item in values["places"]
        ]  # fmt: skip
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileDamaged(f"This is not a map of errors: {error}.", where=str(path)) from error
    if not maps:
        raise FileDamaged("The map shows no array.", where=str(path), hint="Run the benchmark again.")
    if any(m.error_mm.shape != (*m.y_m.shape, *m.x_m.shape) or min(m.error_mm.shape, default=0) < 2 for m in maps):
        raise FileDamaged("The map's rows do not fit its places.", where=str(path))
    return maps


def shared_limits(maps: Sequence[PlaceMap]) -> tuple[float, float]:
    """Return the least error of all maps, and the one that all but a twentieth of the places stay below."""
    good = np.concatenate([item.error_mm[np.isfinite(item.error_mm)] for item in maps])
    return (float(good.min()), float(np.percentile(good, 95))) if good.size else (0.0, 1.0)
