"""SMPL, SMPL-H and SMPL-X files from the user's own disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from solver_backend.body.body import REQUIRED_KEYS, Body, body_from_arrays
from solver_backend.body.restricted_pickle import read_pickle
from solver_backend.errors import BodyInvalid


def load_smpl_file(path: Path | str, *, family: str | None = None) -> Body:
    """Read a licensed body model that the user owns; nothing of it is copied or kept.

    Args:
        path: ``.npz``, or the older ``.pkl`` (read without running anything it holds).
        family: 'SMPL', 'SMPL-H' or 'SMPL-X' if only that one will do.

    Raises:
        UnsafePickle: the pickle asks for code.
        BodyInvalid: keys are missing, shapes or joint counts are wrong, values are not finite, or it is another family.
    """
    path = Path(path)
    arrays = _read_npz(path) if path.suffix == ".npz" else read_pickle(path)
    missing = [key for key in REQUIRED_KEYS if key not in arrays]
    if missing:
        raise BodyInvalid(
            f"The body file lacks {', '.join(missing)}; found {', '.join(sorted(arrays))}.",
            where=str(path),
            hint=f"An SMPL-family file holds {', '.join(REQUIRED_KEYS)}.",
        )
    body = body_from_arrays(arrays, where=str(path), default_id=path.stem)
    if family is not None and body.family != family:
        raise BodyInvalid(
            f"This is a {body.family} file ({len(body.parents)} joints); {family} is expected.",
            where=str(path),
            hint=f"Choose {body.family} as the body's family, or another file.",
        )
    return body


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            wanted = set(REQUIRED_KEYS) | {"posedirs"}
            return {key: data[key] for key in data.files if key in wanted}
    except (OSError, ValueError, EOFError, KeyError, BadZipFile) as error:
        raise BodyInvalid(
            f"The file cannot be read: {error}", where=str(path), hint="The file may be truncated."
        ) from error
