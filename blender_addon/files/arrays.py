"""Reading chosen arrays of an ``.npz`` without pickle."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ..errors import FileDamaged, FileMissing

_DAMAGE = (OSError, ValueError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error)


def read_arrays(path: Path, *, required: Iterable[str], optional: Iterable[str] = ()) -> dict[str, np.ndarray]:
    """Read the named arrays of an ``.npz``; optional ones that are not there are left out.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file is truncated, is no ``.npz``, or lacks required arrays.
    """
    path = Path(path)
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    required = tuple(required)
    try:
        # np.load leaves a broken archive's file open; a stream of our own is always closed.
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise ValueError("one bare array instead of an archive")
            found = set(archive.files)
            arrays = {key: archive[key] for key in (*required, *optional) if key in found}
    except _DAMAGE as error:
        raise FileDamaged(
            f"The file is truncated or is not an .npz of plain arrays ({error}).",
            where=str(path),
            hint="Write or copy it again.",
        ) from error
    missing = [key for key in required if key not in arrays]
    if missing:
        raise FileDamaged(
            f"The file lacks {', '.join(missing)}; it holds {', '.join(sorted(found)) or 'nothing'}.", where=str(path)
        )
    return arrays


def require_format(arrays: dict[str, np.ndarray], name: str, version: int, *, path: Path) -> None:
    """Check the ``format`` and ``version`` of one of our own files.

    Raises:
        FileDamaged: the file says that it is something else, or it is newer than this add-on.
    """
    found = text(arrays, "format", name)
    if found != name:
        raise FileDamaged(f"The file is a '{found}'; a '{name}' is expected.", where=str(path))
    written = int(arrays["version"]) if "version" in arrays else version
    if written > version:
        raise FileDamaged(
            f"The file has version {written}; this add-on reads up to {version}.",
            where=str(path),
            hint="Update the add-on.",
        )


def text(arrays: dict[str, np.ndarray], key: str, default: str = "") -> str:
    """Return a text entry; bytes are read as UTF-8."""
    if key not in arrays:
        return default
    value = np.asarray(arrays[key]).reshape(-1)
    if not len(value):
        return default
    return value[0].decode("utf-8", "replace") if isinstance(value[0], bytes) else str(value[0])


def texts(arrays: dict[str, np.ndarray], key: str) -> tuple[str, ...]:
    """Return a list of texts, empty where there is none."""
    return tuple(str(item) for item in np.asarray(arrays[key]).reshape(-1)) if key in arrays else ()
