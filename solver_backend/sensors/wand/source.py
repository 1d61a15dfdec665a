"""The views of a wand's folder, whatever it holds: tables of points, or a recording of sensors."""

from __future__ import annotations

from pathlib import Path

from solver_backend.camera_calibration.intrinsics.known_lenses import known_lenses
from solver_backend.exchange.errors import CommandLineInvalid, FileMissing
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.devices.source import open_folder
from solver_backend.sensors.take import masks_of
from solver_backend.sensors.wand.from_sensors import is_sensor_folder, sensor_views
from solver_backend.sensors.wand.points_files import points_files, read_points_folder
from solver_backend.sensors.wand.views import WandView


def wand_views(
    folder: Path, lenses: Path | None, *, lights: bool, empty: Path | None = None, progress: Progress = silent
) -> list[WandView]:
    """Return what each sensor saw of the wand.

    Args:
        folder: with a table a sensor, a recording of infrared and depth, or a shot of the studio.
        lenses: a calibration or a lens library; None takes what lies beside the tables.
        empty: a recording of the sensors with nobody there, whose lamps are left out.
        lights: the wand has three lights and its lengths are given.
        progress: called as sensors are read.

    Raises:
        FileMissing: there is nothing of a wand.
        CommandLineInvalid: the folder's wand is of the other kind.
        MocapError: see ``read_points_folder`` and ``known_lenses``.
    """
    if not folder.exists():
        raise FileMissing("There is no such folder.", where=str(folder))
    if is_sensor_folder(folder):
        if lights:
            raise CommandLineInvalid(
                "The folder is a recording of depth sensors, which see one marker.", where=str(folder),
                hint="Leave --wand out.",
            )  # fmt: skip
        masks = {} if empty is None else masks_of(open_folder(empty))
        return sensor_views(open_folder(folder, lenses), masks, progress)
    files = points_files(folder)
    known = None if lenses is None else known_lenses(lenses, tuple(path.stem for path in files))
    progress("Tables of the wand", 0, 1)
    views = read_points_folder(folder, known)
    if lights and views[0].depth_m is not None:
        raise CommandLineInvalid(
            "The tables are of one marker with depth, which has no lengths.", where=str(folder),
            hint="Leave --wand out.",
        )  # fmt: skip
    if not lights and views[0].depth_m is None:
        raise CommandLineInvalid(
            "The tables are of a wand with three lights and no depth.", where=str(folder),
            hint="Give its lengths in metres: --wand 0.13 0.26",
        )  # fmt: skip
    return views
