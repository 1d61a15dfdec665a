"""Which body a motion was solved for: by the name or path its provenance holds, and by its id."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from ..errors import BodyMismatch, BodyMissing
from ..files.motion_file import MotionFile
from .body_file import BodyFile, default_body_path

SHIPPED = "neutral"
"""Name of the body that ships with the solver."""
_FOLDER_VARIABLE = "MANIFOLD_MOCAP_BODIES"
_SUFFIXES = (".npz", ".pkl")


def bodies_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    """Return the user's folder of bodies by the solver's rule, of which this is a copy.

    It is ``MANIFOLD_MOCAP_BODIES``, or ``bodies`` in the system's folder for application data.
    """
    if environment.get(_FOLDER_VARIABLE):
        return Path(environment[_FOLDER_VARIABLE]).expanduser()
    home = Path.home()
    if platform == "win32":
        data = Path(environment.get("APPDATA") or home / "AppData" / "Roaming")
    elif platform == "darwin":
        data = home / "Library" / "Application Support"
    else:
        data = Path(environment.get("XDG_DATA_HOME") or home / ".local" / "share")
    return data / "manifold-mocap" / "bodies"


def body_path_of(provenance: str) -> Path:
    """Return the body file a motion was solved for; the one that ships where the motion does not say.

    Args:
        provenance: the motion's provenance, as JSON text.

    Raises:
        BodyMissing: the body is neither in the user's folder nor at its path.
        BackendMissing: see ``default_body_path``.
    """
    choice = _choice(provenance)
    if choice == SHIPPED:
        return default_body_path()
    is_path = choice.lower().endswith(_SUFFIXES) or "/" in choice or os.sep in choice
    places = [Path(choice).expanduser()] if is_path else [bodies_folder() / f"{choice}{end}" for end in _SUFFIXES]
    for place in places:
        if place.is_file():
            return place
    raise BodyMissing(
        f"The motion was solved for the body '{places[0].stem}', whose file is not there.",
        where=str(places[0]),
        hint=f"Put the file into {bodies_folder()}, or name it when you bake.",
    )


def require_body(motion: MotionFile, body: BodyFile) -> None:
    """Check that a motion belongs to a body; a motion that does not say so fits any.

    Raises:
        BodyMismatch: both have an id and the ids differ.
    """
    if motion.body and body.id and motion.body != body.id:
        raise BodyMismatch(
            f"The motion was solved for the body '{motion.body}', not for '{body.id}'.",
            where=motion.name,
            hint="Name the body file it was solved for.",
        )


def _choice(provenance: str) -> str:
    try:
        choice = json.loads(provenance)["settings"]["body"]
    except (ValueError, KeyError, TypeError):
        return SHIPPED
    return choice if isinstance(choice, str) and choice else SHIPPED
