"""An array of 3D points (``points.npy``) with their names in a file beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.exchange.json_file import read_json_file
from solver_backend.io.markers.source import MarkerSource, as_take
from solver_backend.io.markers.take import MarkerTake
from solver_backend.types import JointSet

_NAMES_BYTES = 1_000_000
"""Largest file of names."""


def is_point_array(path: Path) -> bool:
    """Return whether a path is an array of (frames, points, 3) numbers."""
    if path.suffix.lower() != ".npy" or not path.is_file():
        return False
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError):
        return True  # a damaged one is named when it is read
    return array.ndim == 3 and array.shape[-1] == 3


def read_point_array(
    path: Path | str, *, fps: float | None = None, unit: str | None = None, up_axis: str | None = None
) -> MarkerTake:
    """Read (F, N, 3) points, NaN where missing, and their N names.

    Names are in ``NAME.txt``, ``NAME.json``, ``names.txt`` or ``names.json`` beside the array ``NAME.npy``: one a line,
    or a list of texts. Without such a file they are those of the only joint set that has N points.

    Args:
        path: the array.
        fps: frames per second, which no array states.
        unit: its length unit; None estimates it.
        up_axis: its axis that points up; None takes how the body stands.

    Raises:
        FileDamaged: it is no array of numbers, it has another number of names, or no frame rate is given.
        FileMissing: there are no names.
        NoDetections, JobInvalid: see ``as_take``.
    """
    path = Path(path)
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise FileDamaged(f"The array cannot be read ({error}).", where=str(path), hint="Save it again.") from error
    if array.ndim != 3 or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        raise FileDamaged(
            f"The array holds {array.dtype} of shape {array.shape}; numbers of (frames, points, 3) are expected.",
            where=str(path), hint="Save the points of one person.",
        )  # fmt: skip
    names, notes = _names(path, array.shape[1])
    source = MarkerSource(
        path=path, format="NumPy array", positions=array.astype(np.float64), labels=names, rate=None,
        default_unit="mm", default_up_axis="z", first_frame=0, notes=notes,
    )  # fmt: skip
    return as_take(source, fps=fps, unit=unit, up_axis=up_axis)


def _names(path: Path, count: int) -> tuple[tuple[str, ...], tuple[Diagnostic, ...]]:
    """Return the names of so many points, and a note on where they are from."""
    beside = [path.with_suffix(suffix) for suffix in (".txt", ".json")]
    found = next((p for p in (*beside, path.with_name("names.txt"), path.with_name("names.json")) if p.is_file()), None)
    if found is None:
        sets = [joint_set for joint_set in JointSet.fitting(count) if joint_set.num_keypoints == count]
        if len(sets) == 1:
            return sets[0].keypoints, (diagnostic("points_taken_for", count=count, joint_set=sets[0].value),)
        several = f" It might be {' or '.join(s.value for s in sets)}." if sets else ""
        raise FileMissing(
            f"The names of the array's {count} points are missing.{several}", where=str(path),
            hint=f"Write them into {path.stem}.txt beside it, one a line.",
        )  # fmt: skip
    names = _json_names(found) if found.suffix == ".json" else _text_names(found)
    if len(names) != count:
        raise FileDamaged(
            f"The file holds {len(names)} names; the array has {count} points.", where=str(found),
            hint="Write one name for each point, in the array's order.",
        )  # fmt: skip
    return names, (diagnostic("point_names_read", file=found.name),)


def _json_names(path: Path) -> tuple[str, ...]:
    values = read_json_file(path, _NAMES_BYTES)
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise FileDamaged("A list of names is expected.", where=str(path), hint='Write ["nose", "left_eye", ...].')
    return tuple(values)


def _text_names(path: Path) -> tuple[str, ...]:
    with path.open("rb") as stream:
        text = stream.read(_NAMES_BYTES).decode("utf-8-sig", "replace")
    return tuple(line.strip() for line in text.replace(",", "\n").splitlines() if line.strip())
