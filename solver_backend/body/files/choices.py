"""Find body files by name or path, in the program and in the user's folder."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import DEFAULT_BODY, REQUIRED_KEYS, Body, body_from_arrays, load_body
from solver_backend.body.files.restricted_pickle import read_pickle
from solver_backend.exchange.body_choice import SHIPPED, SUFFIXES, bodies_folder, is_path
from solver_backend.exchange.errors import BodyInvalid, BodyUnknown, FileDamaged, FileMissing
from solver_backend.exchange.npz import read_npz

_HANDS = ("hands_meanl", "hands_meanr")


def load_smpl_file(path: Path | str, *, family: str | None = None, flat_hands: bool = True) -> Body:
    """Read a licensed SMPL, SMPL-H or SMPL-X file. The program does not copy or store it.

    Args:
        path: ``.npz``, or the older ``.pkl`` (its code is not run).
        family: 'SMPL', 'SMPL-H' or 'SMPL-X' to accept only that family.
        flat_hands: False adds the file's relaxed hands (``hands_meanl``, ``hands_meanr``) to every finger pose.

    Raises:
        UnsafePickle: the pickle would run code.
        BodyInvalid: the file is not a body, or belongs to another family.
    """
    path = Path(path)
    arrays = _read_npz(path) if path.suffix == ".npz" else read_pickle(path)
    body = body_from_arrays(arrays, where=str(path), default_id=path.stem)
    if family is not None and body.layout.name != family:
        what = f"This is a {body.layout.name} file ({len(body.parents)} joints), but {family} is expected."
        hint = f"Choose {body.layout.name} as the body's family, or another file."
        raise BodyInvalid(what, where=str(path), hint=hint)
    return body if flat_hands else replace(body, hands_mean=_hands_mean(arrays, body, str(path)))


def _hands_mean(arrays: dict[str, Any], body: Body, where: str) -> np.ndarray | None:
    """Return axis-angles (r, 3) of the r unsolved joints: relaxed for fingers, 0 for others. SMPL gives None."""
    if body.layout.name == "SMPL":
        return None
    if not set(_HANDS) <= set(arrays):
        what = f"The body file has no relaxed hand pose ({', '.join(_HANDS)})."
        raise BodyInvalid(what, where=where, hint="Choose flat hands for this file.")
    mean = np.zeros((body.layout.num_joints, 3))
    for key, group in zip(_HANDS, ("left_hand", "right_hand"), strict=True):
        own, joints = np.asarray(arrays[key]), list(body.layout.group(group))
        if own.dtype.kind not in "fiu" or own.size != 3 * len(joints) or not np.isfinite(own).all():
            found = f"{own.dtype} of shape {own.shape}"
            raise BodyInvalid(f"{key} is {found}, but {3 * len(joints)} finite numbers are expected.", where=where)
        mean[joints] = own.reshape(-1, 3)
    return mean[1 + body.layout.num_solved :]


def _read_npz(path: Path) -> dict[str, Any]:
    wanted = {*REQUIRED_KEYS, "posedirs", *_HANDS}
    try:
        return dict(read_npz(path, wanted.__contains__))
    except (FileMissing, FileDamaged) as error:
        what = f"The file cannot be read: {error.message}"
        raise BodyInvalid(what, where=str(path), hint="Copy or download the file again.") from error


@dataclass(frozen=True)
class BodyChoice:
    """Body file that the user can choose by name."""

    name: str
    path: Path


def list_bodies() -> tuple[BodyChoice, ...]:
    """Return the bodies with names: the built-in one, then the user's files in alphabetical order."""
    folder = bodies_folder()
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    own = {path.stem: path for path in files if path.stem != SHIPPED}
    return (BodyChoice(SHIPPED, DEFAULT_BODY), *(BodyChoice(name, path) for name, path in own.items()))


def resolve_body(choice: str) -> Path:
    """Return the file path for a body's name or path. Raise ``BodyUnknown`` if there is no such body."""
    if is_path(choice):
        path = Path(os.path.expanduser(choice))
        if not os.path.isfile(path):
            raise BodyUnknown("There is no such body file.", where=choice, hint=f"Bodies by name: {_names()}.")
        return path
    for body in list_bodies():
        if body.name == choice:
            return body.path
    hint = "Put a body file in this folder, or specify the path of a file."
    what = f"Unknown body '{choice}'. Known bodies: {_names()}."
    raise BodyUnknown(what, where=str(bodies_folder()), hint=hint)


def load_chosen_body(choice: str) -> Body:
    """Read a body by name or path: the built-in body or an SMPL, SMPL-H or SMPL-X file.

    Raises the same errors as ``resolve_body``, ``load_body`` and ``load_smpl_file``.
    """
    path = resolve_body(choice)
    return load_smpl_file(path) if path.suffix.lower() == ".pkl" else load_body(path)


def _names() -> str:
    return ", ".join(body.name for body in list_bodies())
