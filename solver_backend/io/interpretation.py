"""Convert file contents to metres, Z up and frames per second. No other module does this.

The user's options take precedence over the values in the file. Estimates from the numbers come last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.marker_names import is_unnamed
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, sentence
from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged, NoDetections
from solver_backend.geometry.arrays import quantile
from solver_backend.io.calibration.entry import Calibration, CameraEntry, StatedCameras, build_cameras, meant_entries
from solver_backend.io.markers.source import MarkerSource, MarkerTake
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.marker_labels import by_subject, subjects_of, unique_labels
from solver_backend.io.recognition.marker_up_axis import find_unit, find_up_axis
from solver_backend.io.text_table import LARGEST
from solver_backend.io.units_and_axes import metres_in, rotation_to_z_up, with_up_axis
from solver_backend.types import MarkerCloud

MARKER_OPTIONS = frozenset({"fps", "unit", "up_axis"})  # Reading options that ``interpret_markers`` applies.
STILL_FRAMES = 10  # A marker that does not move at all for this number of frames was not measured.
WIDEST_ARRAY_M = 60.0  # Largest plausible distance between cameras in metres. A larger value means another unit.
OTHER_UNIT, LEAST_FOR_OTHER_UNIT = 20.0, 3
"""Factor by which a camera in another unit widens the array of the other cameras, and the minimum number of cameras
for this check.
"""


def interpret_rate(
    given: float | None, stated: Sequence[tuple[float | None, Diagnostic]], default: float
) -> tuple[float, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Choose the frame rate of detections. Also return a note about its source, or a warning if it is assumed.

    The user's rate takes precedence. Otherwise, the first known rate in ``stated`` is used, with its note.
    """
    if given is not None:
        return given, (diagnostic("frame_rate_read", source="given", rate=given),), ()
    for rate, note in stated:
        if rate is not None:
            return float(rate), (note,), ()
    return default, (), (diagnostic("frame_rate_assumed", rate=default),)


def interpret_cameras(
    stated: StatedCameras, path: Path, kind: str, unit: str | None, up_axis: str | None
) -> Calibration | None:
    """Convert calibrated cameras to metres with Z up. Return None if there are no cameras.

    Without a unit, an array wider than ``WIDEST_ARRAY_M`` is in millimetres. ``kind`` names the format in notes.

    Raises:
        CalibrationInvalid: two cameras have the same name, or a value is invalid.
        JobInvalid: the unit or axis is unknown.
    """
    if not stated.entries:
        return None
    names = [entry.name for entry in stated.entries]
    if len(set(names)) < len(names):
        raise CalibrationInvalid("Two cameras have the same name.", where=f"{path}: {', '.join(names)}")
    entries, corrected = meant_entries(stated.entries)
    guessed = ""
    if unit:
        unit_note = diagnostic("unit_read", source="given", unit=unit)
    elif stated.unit:
        unit, unit_note = stated.unit, diagnostic("unit_read", source=stated.source, unit=stated.unit)
    else:
        width = _array_width(entries)
        unit = guessed = "mm" if width > WIDEST_ARRAY_M else "m"
        unit_note = diagnostic("unit_read", source="width", unit=unit, width=width)
    scale = metres_in(unit)
    try:
        cameras = build_cameras([replace(e, t=np.asarray(e.t) * scale) for e in entries], where=str(path))
    except CalibrationInvalid as error:
        where = error.where if str(path) in error.where else f"{path}, {error.where}"
        raise CalibrationInvalid(error.message, where=where, hint=error.hint) from error
    axis = up_axis or stated.up_axis or "z"
    known = "given" if up_axis else stated.source if stated.up_axis else "default"
    axis_note = diagnostic("up_axis_read", source=known, axis=axis.upper())
    return Calibration(
        cameras=with_up_axis(cameras, axis),
        source=path,
        guessed_unit=guessed,
        size_known=tuple(e.image_size is not None for e in entries),
        notes=(diagnostic("calibration_read", file=path.name, count=len(entries), kind=kind), unit_note, axis_note),
        problems=(*stated.problems, *corrected),
    )


def _array_width(entries: list[CameraEntry]) -> float:
    centres = np.stack(
        [-np.nan_to_num(e.R, posinf=0.0, neginf=0.0).T @ np.nan_to_num(e.t, posinf=0.0, neginf=0.0) for e in entries]
    )
    if len(centres) == 1:
        return float(np.linalg.norm(centres[0]))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    if len(centres) >= LEAST_FOR_OTHER_UNIT:
        far = int(np.argmax(np.median(apart, axis=1)))
        others = np.delete(np.delete(apart, far, axis=0), far, axis=1)
        if apart.max() > OTHER_UNIT * others.max() > 0:
            return float(others.max())
    return float(apart.max())


def interpret_markers(source: MarkerSource, options: ReadOptions) -> MarkerTake:
    """Convert the markers of a file to metres with Z up. The result includes notes on assumptions, and warnings.

    Raises:
        NoDetections: the file has no markers, or no marker is ever visible.
        FileDamaged: the file has no frame rate, and the user does not specify one.
        JobInvalid: the user's unit or axis is unknown.
    """
    if source.to_metres is not None and options.unit is None and options.up_axis is None:
        turned = (source.positions.astype(np.float32) @ np.asarray(source.to_metres, np.float32).T).astype(np.float64)
        source = replace(source, positions=turned, unit="m", up_axis="z")
    _require_markers(source)
    labels, problems = _labels(source)
    positions, zeros, sentinels = without_sentinels(source.positions, labels)
    if not np.isfinite(positions).any():
        raise NoDetections("All markers are hidden in all frames.", where=str(source.path), hint="Export them again.")
    unit = find_unit(positions, source.unit, options.unit, source.default_unit, labels)
    positions *= unit.metres
    axis = find_up_axis(positions, labels, source.up_axis, options.up_axis, source.default_up_axis)
    to_world = rotation_to_z_up(axis.name)
    positions = (positions.reshape(-1, 3) @ to_world.T).reshape(positions.shape)
    rate = _rate(source, options.fps)
    frames, count = positions.shape[:2]
    notes = [diagnostic("markers_read", format=source.format, count=count, length=frames, fps=rate)]
    notes += [unit.note, axis.note]
    if channels := source.analog_channels:
        notes.append(diagnostic("parts_not_read", kind="analog", count=len(channels), channels=channels))
    unlabelled = tuple(label for label in labels if is_unnamed(label))
    named = len(unlabelled) < len(labels)
    if not named:
        notes.append(diagnostic("points_without_label", total=len(labels), severity=Severity.NOTE, count=len(labels)))
    doubts = source.rate_doubts if options.fps is None else ()
    found = tuple(problem for problem in (unit.problem, axis.problem) if problem is not None)
    residual = source.residual * unit.metres if source.residual is not None else None
    return MarkerTake(
        cloud=MarkerCloud(positions, rate, labels if named else None, residual),
        subjects=subjects_of(labels),
        unlabelled=unlabelled,
        notes=(*notes, *zeros, *source.notes),
        problems=(*source.problems, *doubts, *found, *sentinels, *problems, *_still(positions, labels)),
        others=None if source.bodies is None else source.bodies.points(unit.metres, to_world, rate),
    )


def _require_markers(source: MarkerSource) -> None:
    frames, markers = source.positions.shape[:2]
    if not markers:
        channels = len(source.analog_channels)
        what = f", only {channels} analog channels (forces, muscles)" if channels else ""
        hint = "Choose the recording's marker file, or export it with trajectories."
        what = " ".join((f"The file contains no markers{what}.", *map(sentence, source.notes)))
        raise NoDetections(what, where=str(source.path), hint=hint)
    if not frames:
        raise NoDetections("The file contains no frames.", where=str(source.path), hint="Export the file again.")


def _labels(source: MarkerSource) -> tuple[tuple[str, ...], tuple[Diagnostic, ...]]:
    labels, doubled = unique_labels(by_subject(source.labels))
    problems: list[Diagnostic] = []
    if doubled:
        problems.append(diagnostic("labels_doubled", markers=doubled))
    empty = sum(not label for label in source.labels)
    if empty and not all(is_unnamed(label) for label in source.labels):
        problems.append(diagnostic("points_without_label", count=empty, total=len(labels)))
    return labels, tuple(problems)


def _rate(source: MarkerSource, fps: float | None) -> float:
    rate = source.rate if fps is None else fps
    if rate is None or not (np.isfinite(rate) and rate > 0):
        found = "does not state a frame rate" if rate is None else f"states a frame rate of {rate:g}"
        what = f"The file {found}, but a positive number is expected."
        raise FileDamaged(what, where=str(source.path), hint="Specify the frame rate.")
    return float(rate)


def _still(positions: np.ndarray, labels: Sequence[str]) -> tuple[Diagnostic, ...]:
    if len(positions) < STILL_FRAMES:
        return ()
    seen = np.isfinite(positions[..., 0])
    first = positions[np.argmax(seen, axis=0), np.arange(positions.shape[1])]
    moved = np.any([(seen & (positions[..., k] != first[:, k])).any(axis=0) for k in range(3)], axis=0)
    still = [labels[int(i)] for i in np.flatnonzero(~moved & (seen.sum(axis=0) >= STILL_FRAMES))]
    return (diagnostic("marker_never_moves", markers=still),) if still else ()


OUTSIDE = 1.0  # Smallest distance of a sentinel from the box around most positions, in lengths of its longest side.
FAR = 100.0  # Distance, in the same lengths, beyond which any number is a sentinel. The box contains the whole walk.
OFTEN = 3  # Minimum number of positions with one number on all axes that make this number a sentinel.
SHARES = (0.05, 0.3)  # Fraction of positions outside the box at each end, and the fraction used if more are missing.
_NINES = 9999.0  # Smallest number that consists only of nines, which programs write for missing values.


def without_sentinels(
    positions: np.ndarray, labels: Sequence[str]
) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Replace missing markers in positions (F, M, 3) by NaN. Also return notes and warnings.

    Many programs write 0 0 0 for a missing marker. Others write a sentinel, which is an impossible position: the same
    number on all axes (-9999, 1e6), or numbers whose digits are all 9.
    """
    x, y, z = np.moveaxis(positions, -1, 0)  # NumPy is slow at reducing an axis of length three
    origin = (x == 0) & (y == 0) & (z == 0)
    seen = (np.abs(x) < LARGEST) & (np.abs(y) < LARGEST) & (np.abs(z) < LARGEST) & ~origin
    found = np.where(seen[..., None], positions, np.nan)
    sentinel = seen & _sentinels(found)
    found[sentinel] = np.nan
    place = f"{positions[sentinel][0].tolist()} or similar" if sentinel.any() else ""
    return found, _unseen(Severity.NOTE, "origin", origin, labels), _unseen(Severity.WARNING, place, sentinel, labels)


def _sentinels(positions: np.ndarray) -> np.ndarray:
    """Return a mask (F, M) of sentinels, recognised by unnatural digits or extreme distance."""
    x, y, z = np.moveaxis(positions, -1, 0)
    alike = (x == y) & (y == z)
    values, counts = np.unique(x[alike], return_counts=True)
    often = alike & np.isin(x, values[counts >= OFTEN])
    rest = np.where(often[..., None], np.nan, positions)
    flat = rest[:: max(1, len(rest) // 500)].reshape(-1, 3)
    odd = alike | _is_nines(x) | _is_nines(y) | _is_nines(z)
    for share in SHARES:
        low, high = (quantile(flat, q, 0, "nearest") for q in (share, 1.0 - share))
        side = float(np.max(high - low))
        out = np.maximum(low - rest, rest - high)
        out = np.fmax(np.fmax(out[..., 0], out[..., 1]), out[..., 2])
        found = (odd & (out > OUTSIDE * side)) | (out > FAR * side) if side > 0 else np.zeros_like(often)
        if found.any():
            return often | found
    return often


def _is_nines(values: np.ndarray) -> np.ndarray:
    whole = np.abs(np.trunc(values))
    digits = np.floor(np.log10(np.maximum(whole, 1.0))) + 1.0
    return (whole >= _NINES) & (whole == 10.0**digits - 1.0)


def _unseen(severity: Severity, place: str, where: np.ndarray, labels: Sequence[str]) -> tuple[Diagnostic, ...]:
    at = [label for label, frames in zip(labels, where.sum(axis=0), strict=True) if frames]
    if not at:
        return ()
    figures: dict[str, Any] = {"count": len(at), "positions": int(where.sum())}
    return (diagnostic("markers_at_sentinel", severity=severity, place=place, markers=at, **figures),)
