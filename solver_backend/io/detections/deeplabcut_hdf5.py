"""DeepLabCut's HDF5 tables: pandas' format "table", whose column names are pickled lists of tuples of texts."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.deeplabcut import frames_of_columns
from solver_backend.io.detections.hdf5 import begins_with, opened

_GROUP = b"df_with_missing"
"""Name of the table that DeepLabCut writes."""
_START_BYTES = 1 << 16
_LEVELS = (3, 4)
"""Of column names: scorer, individuals (where there are several), bodyparts, coords."""


def is_hdf5_table(path: Path) -> bool:
    """Whether a file is named, or begins, as DeepLabCut's tables do."""
    name = path.name.lower()
    return name.endswith((".h5", ".hdf5")) and ("dlc" in name or begins_with(path, _GROUP, _START_BYTES))


def read_hdf5_table(path: Path) -> CameraFrames:
    """Return the frames of one camera.

    Raises:
        BackendMissing: h5py is not installed.
        FileDamaged: it is no such table, or its column names hold anything but texts.
    """
    with opened(path, "DeepLabCut") as file:
        table = next(group["table"] for group in file.values() if "table" in group)
        rows = table[()]
        blocks = [name for name in rows.dtype.names if name.startswith("values_block_")]
        columns = [tuple(column) for name in blocks for column in _texts_in(table.attrs[f"{name}_kind"])]
        values = np.concatenate([np.asarray(rows[name], np.float64).reshape(len(rows), -1) for name in blocks], axis=1)
        if {len(column) for column in columns} - set(_LEVELS) or values.shape[1] != len(columns):
            raise ValueError(f"{values.shape[1]} columns have {len(columns)} names")
        people = [str(column[1]) if len(column) == _LEVELS[1] else "single" for column in columns]
        parts, coords = [str(column[-2]) for column in columns], [str(column[-1]).lower() for column in columns]
        return frames_of_columns([int(n) for n in rows["index"]], values, people, parts, coords, path)


def _texts_in(pickled: Any) -> list[Any]:
    """Return a pickled list of tuples of texts; nothing else is made, and no code is run.

    Raises:
        ValueError: it holds anything else.
    """
    try:
        found = _PlainUnpickler(io.BytesIO(bytes(pickled))).load()
    except (pickle.UnpicklingError, EOFError, MemoryError) as error:
        raise ValueError(f"its column names are not a list of texts: {error}") from error
    if not isinstance(found, list) or not all(isinstance(c, tuple) and all(map(_is_text, c)) for c in found):
        raise ValueError("its column names are not a list of texts")
    return found


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


class _PlainUnpickler(pickle.Unpickler):
    """Makes lists, tuples, texts and numbers alone: every class and function is refused by name."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """Refuse.

        Raises:
            UnpicklingError: always.
        """
        raise pickle.UnpicklingError(f"{module_name}.{global_name}")
