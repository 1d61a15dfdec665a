"""The bodies a user can choose from: the one that ships, those in the user's folder, and any file by its path."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from solver_backend.body.body import DEFAULT_BODY, Body, load_body
from solver_backend.body.files.smpl_files import load_smpl_file
from solver_backend.exchange.body_choice import SHIPPED, SUFFIXES, bodies_folder, is_path
from solver_backend.exchange.errors import BodyUnknown


@dataclass(frozen=True)
class BodyChoice:
    """A body that can be chosen by name."""

    name: str
    path: Path


def list_bodies() -> tuple[BodyChoice, ...]:
    """Return the bodies that have a name: the one that ships, then the user's by name."""
    folder = bodies_folder()
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    own = {path.stem: path for path in files if path.stem != SHIPPED}
    return (BodyChoice(SHIPPED, DEFAULT_BODY), *(BodyChoice(name, path) for name, path in own.items()))


def resolve_body(choice: str) -> Path:
    """Return the file of a body.

    Args:
        choice: a name from ``list_bodies``, or a path.

    Raises:
        BodyUnknown: no body has that name, or there is no file at that path.
    """
    if is_path(choice):
        path = Path(os.path.expanduser(choice))
        if not os.path.isfile(path):
            raise BodyUnknown("There is no such body file.", where=choice, hint=f"Bodies by name: {_names()}.")
        return path
    for body in list_bodies():
        if body.name == choice:
            return body.path
    raise BodyUnknown(
        f"There is no body '{choice}'; known are {_names()}.",
        where=str(bodies_folder()),
        hint="Put a body file into this folder, or name a file by its path.",
    )


def load_chosen_body(choice: str) -> Body:
    """Read a body by name or path: ours, or an SMPL, SMPL-H or SMPL-X file.

    Raises:
        BodyUnknown: see ``resolve_body``.
        BodyInvalid, UnsafePickle: the file is no body.
    """
    path = resolve_body(choice)
    return load_smpl_file(path) if path.suffix.lower() == ".pkl" else load_body(path)


def _names() -> str:
    return ", ".join(body.name for body in list_bodies())
