"""Read wand recordings from sensor folders and point files."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, lens_of
from solver_backend.camera_calibration.intrinsics.known_lenses import known_lenses
from solver_backend.exchange.errors import CalibrationMissing, CommandLineInvalid, FileDamaged, FileMissing
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.camera_names import natural_key
from solver_backend.io.files import read_text
from solver_backend.sensors.acquisition.acquire import Acquisition, SensorSightings
from solver_backend.sensors.devices.recorded import ABOUT, STUDIO_SHOT, SensorFolder, open_folder
from solver_backend.sensors.take import masks_of
from solver_backend.sensors.wand.views import WandView, with_growing_times
from solver_backend.types import Cameras


def is_sensor_folder(path: Path) -> bool:
    """Return whether a folder is a sensor recording or a shot of the studio."""
    return (path / ABOUT).is_file() or all((path / name).exists() for name in STUDIO_SHOT)


def sensor_views(
    folder: SensorFolder, masks: Mapping[str, np.ndarray] = MappingProxyType({}), progress: Progress = silent
) -> list[WandView]:
    """Return the views of one marker. Frames with several markers are crowded.

    Args:
        folder: recording with the sensors' lenses. Their poses are not used.
        masks: (h, w) bool per sensor, True for constant lights, see ``masks_of``.

    Raises:
        PicturesDiffer: infrared, depth and calibration have different sizes.
        RecordingInvalid, SensorFailed: the recording is damaged.
        TimesInvalid: a sensor's times do not increase.
    """
    views = []
    for index, name in enumerate(folder.cameras.names):
        rows, crowded = [], 0
        for seen in sightings_of(folder, folder.cameras, name, masks):
            alone = len(seen) == 1
            crowded += len(seen) > 1
            px, depth = (seen.px[0], seen.depth[0]) if alone else (np.full(2, np.nan), np.nan)
            rows.append((seen.time, *px, depth))
            progress(f"The wand before {name}", len(rows), len(rows))
        if rows:
            table = np.array(rows)
            lens = lens_of(folder.cameras, index)
            view = WandView(name, lens, table[:, 0], table[:, None, 1:3], table[:, 3:], crowded)
            views.append(with_growing_times(view))
    return views


def sensor_clouds(path: Path, cameras: Cameras, empty: Path | None = None) -> list[np.ndarray]:
    """Return the (N, 3) points of each frame of each sensor with at least three, in metres of the cameras' world."""
    folder, masks = open_folder(path), {} if empty is None else masks_of(open_folder(empty))
    clouds = []
    for name in folder.cameras.names:
        for seen in sightings_of(folder, cameras, name, masks):
            points = seen.points[np.isfinite(seen.points).all(1)]
            if len(points) >= 3:
                clouds.append(points)
    return clouds


def sightings_of(
    folder: SensorFolder, cameras: Cameras, name: str, masks: Mapping[str, np.ndarray] = MappingProxyType({})
) -> Iterator[SensorSightings]:
    """Yield what one sensor sees, nothing if the folder has no such sensor. ``masks`` are as in ``sensor_views``."""
    device = next((device for device in folder.devices if device.name == name), None)
    if device is None:
        return
    find = Acquisition(cameras, name, masks.get(name))
    yield from (find(frame) for frame in device.frames())


DEPTH_HEADER = "t_ns;u;v;depth_mm"
LENS_SUFFIXES = (".yaml", ".yml", ".toml")
LIGHTS_COLUMNS, DEPTH_COLUMNS = 7, 4


def points_files(folder: Path) -> list[Path]:
    """Return the tables of a folder in the natural order of their names."""
    return sorted(folder.glob("*.csv"), key=lambda path: natural_key(path.name)) if folder.is_dir() else []


def read_points_folder(folder: Path, lenses: Mapping[str, Lens] | None = None) -> list[WandView]:
    """Return the views of a folder's tables, ``NAME.csv`` per sensor.

    Args:
        lenses: lens of each sensor. If None, they are read from ``NAME.yaml`` or ``NAME.toml``.

    Raises:
        FileMissing: there is no table.
        CalibrationMissing: a sensor has no lens.
        FileDamaged: a row has neither format, or the tables have different ones.
    """
    files = points_files(folder)
    if not files:
        raise FileMissing("There is no table (.csv) of a wand here.", where=str(folder))
    views = [_view(path, lens_beside(path, lenses)) for path in files]
    if len({view.depth_m is None for view in views}) > 1:
        message, hint = "Some tables have depth, others three lights.", "Keep them in folders of their own."
        raise FileDamaged(message, where=str(folder), hint=hint)
    return [with_growing_times(view) for view in views]


def lens_beside(path: Path, lenses: Mapping[str, Lens] | None) -> Lens:
    """Return a sensor's lens: the given one, or the one in a calibration file next to the table.

    Raises:
        CalibrationMissing: there is neither.
    """
    name = path.stem
    if lenses is not None and name in lenses:
        return lenses[name]
    beside = next((p for s in LENS_SUFFIXES if (p := path.with_suffix(s)).is_file()), None)
    if beside is None:
        hint = f"Put it beside the table as {name}.yaml, or give --lenses FILE."
        raise CalibrationMissing("The sensor has no lens.", where=f"sensor {name}", hint=hint)
    return lens_of(read_calibration(beside).cameras, 0)


def read_table(path: Path) -> tuple[np.ndarray, bool]:
    """Return a table's rows, one per moment or marker, and whether they are markers with depth.

    Raises:
        FileMissing, FileDamaged: there is no such file, or a row has neither format.
    """
    text = read_text(path)
    first = text.split("\n", 1)[0].strip().lstrip("\ufeff").replace(" ", "").lower()
    with_depth = first == DEPTH_HEADER
    if not with_depth and first[:1].isalpha():
        hint = f"It is '{DEPTH_HEADER}' for a marker with depth, and left out for three lights."
        raise FileDamaged(f"The first line is '{first[:60]}'.", where=str(path), hint=hint)
    columns, skip = DEPTH_COLUMNS if with_depth else LIGHTS_COLUMNS, int(with_depth)
    if not text.strip() or len(text.splitlines()) <= skip:
        raise FileDamaged("The table is empty.", where=str(path))
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=";", skiprows=skip, ndmin=2)
    except ValueError as error:
        raise FileDamaged(f"A row is not numbers between semicolons: {error}.", where=str(path)) from error
    if table.shape[1] != columns:
        raise FileDamaged(f"Rows have {table.shape[1]} numbers; {columns} are expected.", where=str(path))
    return table, with_depth


def _view(path: Path, lens: Lens) -> WandView:
    table, with_depth = read_table(path)
    if with_depth:
        return _with_depth(path.stem, lens, table)
    px = table[:, 1:].reshape(-1, 3, 2)
    return WandView(path.stem, lens, 1e-9 * table[:, 0], np.where((px < 0).any(-1, keepdims=True), np.nan, px))


def _with_depth(name: str, lens: Lens, table: np.ndarray) -> WandView:
    """Return the view of a marker. Times with several rows are crowded."""
    starts = np.flatnonzero(np.r_[True, table[1:, 0] != table[:-1, 0]])
    alone = np.diff(np.r_[starts, len(table)]) == 1
    rows = table[starts]
    seen = alone & np.isfinite(rows[:, 1:3]).all(1) & (rows[:, 1:3] >= 0).all(1)
    px = np.where(seen[:, None], rows[:, 1:3], np.nan)[:, None]
    depth = np.where(seen & (rows[:, 3] > 0), 1e-3 * rows[:, 3], np.nan)[:, None]
    return WandView(name, lens, 1e-9 * rows[:, 0], px, depth, crowded=int((~alone).sum()))


def wand_views(
    folder: Path, lenses: Path | None, *, lights: bool, empty: Path | None = None, progress: Progress = silent
) -> list[WandView]:
    """Return the views of a wand.

    Args:
        lenses: a calibration or a lens library. If None, lenses are read from files next to the tables.

    Raises:
        FileMissing: there is no recording.
        CommandLineInvalid: the recording is of the other kind of wand.
    """
    if not folder.exists():
        raise FileMissing("There is no such folder.", where=str(folder))
    if is_sensor_folder(folder):
        if lights:
            message = "The folder is a recording of depth sensors, which see one marker."
            raise CommandLineInvalid(message, where=str(folder), hint="Leave --wand out.")
        masks = {} if empty is None else masks_of(open_folder(empty))
        return sensor_views(open_folder(folder, lenses), masks, progress)
    files = points_files(folder)
    known = None if lenses is None else known_lenses(lenses, tuple(path.stem for path in files))
    progress("Tables of the wand", 0, 1)
    views = read_points_folder(folder, known)
    if lights and views[0].depth_m is not None:
        message = "The tables are of one marker with depth, which has no lengths."
        raise CommandLineInvalid(message, where=str(folder), hint="Leave --wand out.")
    if not lights and views[0].depth_m is None:
        message = "The tables are of a wand with three lights and no depth."
        raise CommandLineInvalid(message, where=str(folder), hint="Give its lengths in metres: --wand 0.13 0.26")
    return views
