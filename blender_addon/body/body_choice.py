"""The body that a motion was solved for: by the name or path in its provenance, and by its id."""

from __future__ import annotations

import json
import os
from pathlib import Path

from .._exchange.body_choice import SHIPPED, SUFFIXES, bodies_folder, is_path
from .._exchange.motion_file import MotionFile
from ..errors import BodyMismatch, BodyMissing
from .body_file import BodyFile, default_body_path


def body_path_of(provenance: str) -> Path:
    """Return the body file in a motion's provenance (JSON text), the bundled one if there is none.

    Raises:
        BodyMissing: the body is neither in the user's folder nor at its path.
        SolverMissing: see ``default_body_path``.
    """
    choice = _choice(provenance)
    if choice == SHIPPED:
        return default_body_path()
    by_name = [bodies_folder() / f"{choice}{end}" for end in SUFFIXES]
    places = [Path(os.path.expanduser(choice))] if is_path(choice) else by_name
    for place in places:
        if os.path.isfile(place):
            return place
    message = f"The motion was solved for the body '{places[0].stem}', whose file is not there."
    hint = f"Put the file into {bodies_folder()}, or name it when you bake."
    raise BodyMissing(message, where=str(places[0]), hint=hint)


def require_body(motion: MotionFile, body: BodyFile) -> None:
    """Check that a motion belongs to a body. A motion that does not name its body fits any.

    Raises:
        BodyMismatch: both have an id and the ids differ.
    """
    if motion.body and body.id and motion.body != body.id:
        message = f"The motion was solved for the body '{motion.body}', not for '{body.id}'."
        raise BodyMismatch(message, where=motion.name, hint="Name the body file it was solved for.")


def _choice(provenance: str) -> str:
    try:
        choice = json.loads(provenance)["settings"]["body"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return SHIPPED
    return choice if isinstance(choice, str) and choice else SHIPPED
