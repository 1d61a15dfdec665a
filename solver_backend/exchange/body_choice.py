"""Locate the user's bodies folder, and tell body names from paths."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

SHIPPED = "neutral"  # Name of the body that ships with the solver.
SUFFIXES = (".npz", ".pkl")
FOLDER_VARIABLE = "MANIFOLD_MOCAP_BODIES"
"""Environment variable that points to an additional folder of bodies."""


def bodies_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    """Return the user's bodies folder, which may not exist.

    It is the value of ``MANIFOLD_MOCAP_BODIES``, or ``bodies`` in the system's application data folder.
    """
    if environment.get(FOLDER_VARIABLE):
        return Path(os.path.expanduser(environment[FOLDER_VARIABLE]))
    home = Path.home()
    if platform == "win32":
        data = Path(environment.get("APPDATA") or home / "AppData" / "Roaming")
    elif platform == "darwin":
        data = home / "Library" / "Application Support"
    else:
        data = Path(environment.get("XDG_DATA_HOME") or home / ".local" / "share")
    return data / "manifold-mocap" / "bodies"


def is_path(choice: str) -> bool:
    """Return whether a body choice is a path: it has a body file suffix or contains a folder separator."""
    return choice.lower().endswith(SUFFIXES) or "/" in choice or os.sep in choice
