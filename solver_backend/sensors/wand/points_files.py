"""A folder of tables, one a sensor, of where it saw the wand, with the sensors' lenses.

Two kinds, by the header. Without one, a row is ``t_ns;u1;v1;u2;v2;u3;v3``: nanoseconds and the pixels of three
lights in any order, -1 where one is not seen (the format of eWand, Gossard et al. 2024). With the header
``t_ns;u;v;depth_mm`` a row is one marker that a depth sensor saw; several rows of the same time are several markers.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, lens_of
from solver_backend.exchange.errors import CalibrationMissing, FileDamaged, FileMissing
from solver_backend.io.calibration import read_calibration
from solver_backend.io.files import read_text
from solver_backend.io.recognition.camera_names import natural_key
from solver_backend.sensors.wand.views import WandView, with_growing_times

DEPTH_HEADER = "t_ns;u;v;depth_mm"
LENS_SUFFIXES = (".yaml", ".yml", ".toml")
LIGHTS_COLUMNS, DEPTH_COLUMNS = 7, 4


def points_files(folder: Path) -> list[Path]:
    """Return the tables of a folder, in the order of their names."""
    return sorted(folder.glob("*.csv"), key=lambda path: natural_key(path.name)) if folder.is_dir() else []


def read_points_folder(folder: Path, lenses: Mapping[str, Lens] | None = None) -> list[WandView]:
    """Return the views of a folder's tables.

    Args:
        folder: with ``NAME.csv`` a sensor, and ``NAME.yaml`` or ``NAME.toml`` of its lens where no lenses are given.
        lenses: by the sensors' names.

    Raises:
        FileMissing: there is no table.
        CalibrationMissing: a sensor has no lens.
        FileDamaged: a row is none of either kind, or both kinds are mixed; names file and line.
        TimesInvalid: see ``with_growing_times``.
    """
    files = points_files(folder)
    if not files:
        raise FileMissing("There is no table (.csv) of a wand here.", where=str(folder))
    views = [_view(path, lens_beside(path, lenses)) for path in files]
    if len({view.depth_m is None for view in views}) > 1:
        raise FileDamaged(
            "Some tables have depth, others three lights.", where=str(folder), hint="Keep them in folders of their own."
        )
    return [with_growing_times(view) for view in views]


def lens_beside(path: Path, lenses: Mapping[str, Lens] | None) -> Lens:
    """Return the lens of a table's sensor: given by its name, or in a calibration file beside the table.

    Raises:
        CalibrationMissing: it is neither.
    """
    name = path.stem
    if lenses is not None and name in lenses:
        return lenses[name]
    beside = next((p for s in LENS_SUFFIXES if (p := path.with_suffix(s)).is_file()), None)
    if beside is None:
        raise CalibrationMissing(
            "The sensor has no lens.", where=f"sensor {name}",
            hint=f"Put it beside the table as {name}.yaml, or give --lenses FILE.",
        )  # fmt: skip
    return lens_of(read_calibration(beside).cameras, 0)


def read_table(path: Path) -> tuple[np.ndarray, bool]:
    """Return the numbers of a table, a row a moment or a marker, and whether it is of markers with depth.

    Raises:
        FileMissing, FileDamaged: there is no such file, or a row is of neither kind.
    """
    text = read_text(path)
    first = text.split("\n", 1)[0].strip().lstrip("\ufeff").replace(" ", "").lower()
    with_depth = first == DEPTH_HEADER
    if not with_depth and first[:1].isalpha():
        raise FileDamaged(
            f"The first line is '{first[:60]}'.", where=str(path),
            hint=f"It is '{DEPTH_HEADER}' for a marker with depth, and left out for three lights.",
        )  # fmt: skip
    return _table(text, DEPTH_COLUMNS if with_depth else LIGHTS_COLUMNS, path, skip=int(with_depth)), with_depth


def _view(path: Path, lens: Lens) -> WandView:
    table, with_depth = read_table(path)
    return (_with_depth if with_depth else _lights)(path.stem, lens, table)


def _table(text: str, columns: int, path: Path, *, skip: int) -> np.ndarray:
    """Return the (rows, columns) numbers."""
    if not text.strip() or len(text.splitlines()) <= skip:
        raise FileDamaged("The table is empty.", where=str(path))
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=";", skiprows=skip, ndmin=2)
    except ValueError as error:
        raise FileDamaged(f"A row is not numbers between semicolons: {error}.", where=str(path)) from error
    if table.shape[1] != columns:
        raise FileDamaged(f"Rows have {table.shape[1]} numbers; {columns} are expected.", where=str(path))
    return table


def _lights(name: str, lens: Lens, table: np.ndarray) -> WandView:
    px = table[:, 1:].reshape(-1, 3, 2)
    px = np.where((px < 0).any(-1, keepdims=True), np.nan, px)
    return WandView(name, lens, 1e-9 * table[:, 0], px)


def _with_depth(name: str, lens: Lens, table: np.ndarray) -> WandView:
    """Return the view of rows of one time each, where a row is alone at its time."""
    starts = np.flatnonzero(np.r_[True, table[1:, 0] != table[:-1, 0]])
    alone = np.diff(np.r_[starts, len(table)]) == 1
    rows = table[starts]
    seen = alone & np.isfinite(rows[:, 1:3]).all(1) & (rows[:, 1:3] >= 0).all(1)
    px = np.where(seen[:, None], rows[:, 1:3], np.nan)[:, None]
    depth = np.where(seen & (rows[:, 3] > 0), 1e-3 * rows[:, 3], np.nan)[:, None]
    return WandView(name, lens, 1e-9 * rows[:, 0], px, depth, crowded=int((~alone).sum()))
