"""Locate the solver and build the environment of its process."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from .errors import SolverMissing

PACKAGE = "solver_backend"
_BUNDLED = "backend"
_ROOM_FOR_BYTE_CODE = 32 * 2**20
"""Free disk space in bytes that byte code needs, several times its real size. Chosen by hand."""
_ADDON = Path(__file__).resolve().parent


def backend_folder() -> Path:
    """Return the folder of the solver package, in the installed extension or in the source tree."""
    for folder in (_ADDON / _BUNDLED, _ADDON.parent):
        if (folder / PACKAGE / "__main__.py").is_file():
            return folder
    raise SolverMissing("The solver is not in the add-on's folder.", where=str(_ADDON), hint="Reinstall the add-on.")


@cache
def included_wheels() -> Path | None:
    """Return the folder of the included detector's unpacked wheels, or None if no detector is included.

    The result is cached, because panels ask for it at every redraw. Installing another zip reloads this module, which
    clears the cache.
    """
    spec = find_spec("ai_edge_litert") if (backend_folder() / "detector").is_dir() else None
    return None if spec is None or spec.origin is None else Path(spec.origin).parents[1]


def backend_command(python: Path | None = None) -> list[str]:
    """Return the command that starts the solver, without the solver's own arguments."""
    executable = Path(python or sys.executable)
    if not executable.is_file():
        raise SolverMissing(
            "No Python was found to run the solver.",
            where=str(executable),
            hint="Choose another Python in the add-on's preferences, or clear the field to use Blender's own.",
        )
    return [str(executable), "-m", PACKAGE]


def environment_for_child(python: Path | None = None, inherited: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of a solver process that runs in ``python``, or in Blender's Python if None.

    ``PYTHONPATH`` contains only the solver. All other Python variables are removed, as in Blender, and Python does not
    search the working folder for modules. If the disk is nearly full, no byte code is written, because Python 3.11
    would leave a truncated file that breaks every later start. The included detector's wheels are used only in
    Blender's Python, because other interpreters cannot load them.
    """
    base = os.environ if inherited is None else inherited
    kept = {name: value for name, value in base.items() if not name.upper().startswith("PYTHON")}
    settings = {"PYTHONPATH": str(backend_folder()), "PYTHONSAFEPATH": "1", "PYTHONUTF8": "1"}
    if shutil.disk_usage(backend_folder()).free < _ROOM_FOR_BYTE_CODE:
        settings["PYTHONDONTWRITEBYTECODE"] = "1"
    if python is None and (wheels := included_wheels()) is not None:
        settings["MANIFOLD_MOCAP_PACKAGES"] = str(wheels)
    return kept | settings | ({"PYTHONNOUSERSITE": "1"} if python is None else {})
