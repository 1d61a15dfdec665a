"""Build settings and captures from the solver's parsed command line."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.exchange.setting import is_list, settings_of_class
from solver_backend.exchange.solve_settings import PRESETS, SolveSettings

if TYPE_CHECKING:
    from solver_backend.io.calibration.entry import Calibration
    from solver_backend.types import Capture

EVERYBODY = "all"
"""Value of ``--person`` that selects all people in a capture."""


def given_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Return the solve settings that the command line sets, by name, including the settings of a preset."""
    return {**PRESETS.get(getattr(args, "preset", None) or "", {}), **_given(args, settings_of_class(SolveSettings))}


def given_reading(args: argparse.Namespace) -> dict[str, Any]:
    """Return the reading options that the command line sets, by name."""
    return {name: tuple(value) if is_list(value) else value for name, value in _given(args, READING_ROWS).items()}


def given_world(args: argparse.Namespace) -> dict[str, Any]:
    """Return the world settings that the command line sets, by name."""
    return _given(args, settings_of_class(WorldSettings))


def _given(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(args, name, None) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def reading(args: argparse.Namespace) -> dict[str, Any]:
    """Convert parsed arguments to the arguments of ``load_capture``."""
    from solver_backend.job import joint_set_named, positive_fps

    convert = {"fps": positive_fps, "joint_set": joint_set_named}
    options = {name: convert[name](value) if name in convert else value for name, value in given_reading(args).items()}
    if args.sync is not None:
        options["sync"] = args.sync
    if getattr(args, "resolve", None):
        options["frames"] = None  # here, the option selects the frames to solve again
    return options


def load(path: Path, options: dict[str, Any], progress: Progress) -> Capture:
    """Read a capture with the options of ``load_capture``. If the person is ``EVERYBODY``, read all people."""
    from solver_backend.io.load import load_capture

    person = options.get("person")
    options = {**options, "person": None if person == EVERYBODY else person}
    return load_capture(path, **options, progress=progress)


def loaded(args: argparse.Namespace, progress: Progress) -> Capture:
    """Read the capture that the command line selects."""
    return load(args.capture, reading(args), progress)


def calibration_of(path: Path, names: Sequence[str], called: str, hint: str) -> Calibration:
    """Read a calibration and sort it in the order of the camera names.

    Args:
        called: plural noun for the cameras in an error message, such as "videos".
        hint: advice in the error.

    Raises:
        CommandLineInvalid: the calibration is for other cameras.
    """
    from solver_backend.io.calibration.read import read_calibration
    from solver_backend.io.calibration.search import ordered
    from solver_backend.io.camera_names import listing, match_names

    calibration = read_calibration(path)
    order = match_names(names, calibration.cameras.names)
    if order is None:
        message = f"The {called} are {listing(names)}, but the calibration is for {listing(calibration.cameras.names)}."
        raise CommandLineInvalid(message, where=str(path), hint=hint)
    return ordered(calibration, order)


def trials_of(path: Path) -> list[Path]:
    """Return the recordings in a session folder. For any other path, return an empty list."""
    if not path.is_dir():
        return []
    from solver_backend.io.detections.search import camera_sources, trials_below

    return [] if camera_sources(path) else [path / trial for trial in trials_below(path)]
