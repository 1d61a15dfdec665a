"""Read the reports of the steps from videos, which the solver keeps next to its results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from .._exchange.diagnostics import Diagnostic, read_diagnostics
from .._exchange.errors import MocapError
from .._exchange.json_file import read_json_file
from .._exchange.plain_text import plain

NAME = "road.json"
_FORMAT, _VERSION = "manifold_mocap_road", 2
_LARGEST = 1 << 20
"""Bytes of a file that is read, chosen by hand."""


@dataclass(frozen=True)
class RoadStep:
    """One step that is done."""

    name: str
    diagnostics: tuple[Diagnostic, ...]  # Diagnostics of the step.
    pictures: tuple[Path, ...]  # Pictures that are there.


def read_road(folder: Path) -> tuple[RoadStep, ...]:
    """Return the finished steps in order, none without a valid file. Pictures outside the folder are ignored."""
    path = folder / NAME
    try:
        values = read_json_file(path, _LARGEST)
    except MocapError:
        return ()
    if not isinstance(values, dict) or values.get("format") != _FORMAT or values.get("version") != _VERSION:
        return ()
    steps = values.get("steps")
    rows = [row for row in steps if isinstance(row, dict)] if isinstance(steps, list) else []
    names = [plain(str(row.get("step", ""))) for row in rows]
    pictures = [_pictures(folder, row.get("pictures")) for row in rows]
    return tuple(map(RoadStep, names, [read_diagnostics(row.get("diagnostics")) for row in rows], pictures))


def _pictures(folder: Path, value: Any) -> tuple[Path, ...]:
    inside = folder.resolve()
    named = [PurePosixPath(item) for item in value if isinstance(item, str)] if isinstance(value, list) else []
    paths = [(folder / name).resolve() for name in named if name.suffix == ".png"]
    return tuple(path for path in paths if path.is_relative_to(inside) and path.is_file())
