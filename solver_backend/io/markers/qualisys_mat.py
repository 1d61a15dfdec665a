"""Markers in from MATLAB files of Qualisys Track Manager, where SciPy is installed.

Source: the QTM user manual, "MAT file format": one structure, named after the file, with ``Frames``, ``FrameRate``,
``StartFrame`` and ``Trajectories.Labeled`` (and ``Unidentified``): ``Count``, ``Labels``, and ``Data``, of each
trajectory x, y, z in millimetres and a residual in each frame, NaN where it is not seen. QTM's world has Z up unless
changed.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, FileDamaged, FileMissing
from solver_backend.io.markers.source import MarkerSource, as_take
from solver_backend.io.markers.take import MarkerTake

KINDS = ("Labeled", "Unidentified")
"""Groups of trajectories that are read; those that somebody discarded are not."""


def read_qualisys_mat(
    path: Path | str, *, fps: float | None = None, unit: str | None = None, up_axis: str | None = None
) -> MarkerTake:
    """Read the trajectories of a MATLAB file of QTM.

    Args:
        path: the file.
        fps: frames per second; None takes what the file states.
        unit: its length unit; None takes mm, or estimates it from the markers' spread.
        up_axis: its axis that points up; None takes Z, or how the body stands.

    Raises:
        FileMissing: there is no such file.
        BackendMissing: SciPy is not installed.
        FileDamaged: it is truncated, or no MATLAB file of version 5 to 7.2.
        CaptureNotRecognised: it is none of QTM, or of MATLAB 7.3.
        NoDetections: it holds no markers, or none is ever seen.
        JobInvalid: the rate, unit or axis that is given is impossible.
    """
    path = Path(path)
    record = _record(path)
    parts, labels = [], []
    for kind in KINDS:
        group = getattr(getattr(record, "Trajectories", None), kind, None)
        data = np.asarray(getattr(group, "Data", ()), dtype=np.float64)
        if data.size:
            data = data.reshape(-1, *data.shape[-2:])
            names = [str(name) for name in np.atleast_1d(getattr(group, "Labels", ()))]
            parts.append(data[:, :3])
            labels += [*names, *[""] * (len(data) - len(names))][: len(data)]
    rate, start = getattr(record, "FrameRate", None), getattr(record, "StartFrame", 1)
    frames = int(getattr(record, "Frames", 0))
    if len({part.shape[-1] for part in parts}) > 1 or any(part.shape[1] != 3 for part in parts):
        raise FileDamaged("The file's trajectories are of different lengths, or no points.", where=str(path))
    positions = np.concatenate(parts) if parts else np.zeros((0, 3, frames))
    source = MarkerSource(
        path=path, format="Qualisys MAT", positions=np.moveaxis(positions, 2, 0), labels=tuple(labels),
        rate=None if rate is None else float(rate), default_unit="mm", default_up_axis="z",
        first_frame=int(start) if np.isfinite(start) else 1,
    )  # fmt: skip
    return as_take(source, fps=fps, unit=unit, up_axis=up_axis)


def _record(path: Path) -> Any:
    """Return the structure of a QTM file."""
    try:
        matlab = import_module("scipy.io")
    except ImportError as error:
        raise BackendMissing(
            "MATLAB files are read with SciPy, which is not installed.", where=str(path),
            hint="Export C3D or TSV from QTM, or install SciPy in this Python.",
        ) from error  # fmt: skip
    if not path.is_file():
        raise FileMissing("The file is not there.", where=str(path))
    try:
        content: dict[str, Any] = matlab.loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise CaptureNotRecognised(
            "The file is not supported: MATLAB 7.3 (HDF5).", where=str(path),
            hint="Save it in MATLAB with save(name, '-v7'), or export C3D or TSV from QTM.",
        ) from error  # fmt: skip
    except Exception as error:  # SciPy raises what its parsers meet: of values, keys, types, memory, zlib
        raise FileDamaged(
            "The file is truncated, or no MATLAB file of version 5 to 7.2.", where=str(path),
            hint="Export it again, or as C3D or TSV.",
        ) from error  # fmt: skip
    found = [value for name, value in content.items() if not name.startswith("__") and hasattr(value, "Trajectories")]
    if not found:
        raise CaptureNotRecognised(
            "The MATLAB file is not one of Qualisys Track Manager: 'Trajectories' is expected.", where=str(path),
            hint="Export C3D or TSV from the program that recorded it.",
        )  # fmt: skip
    return found[0]
