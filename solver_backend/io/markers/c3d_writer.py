"""Markers out to C3D files: Intel, floats, millimetres, Z up.

Source: the C3D file format user guide (Motion Lab Systems, c3d.org). The parameters are those that the guide asks for,
and no analog data. Counts above 65,535 are kept in TRIAL:ACTUAL_END_FIELD and POINT:LONG_FRAMES, as programs that read
long files look for them in the one or the other; more than 255 labels go on in POINT:LABELS2.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import NonFiniteData, ShapeMismatch
from solver_backend.exchange.outputs import atomic_output
from solver_backend.io.markers.c3d import BLOCK, KEY, MOST_BLOCKS, Processor
from solver_backend.types import MarkerCloud

PER_PARAMETER = 255
"""Most strings in one parameter, and most characters in one."""
MOST_POINTS = 65535
LARGEST_M = 1e30
"""Largest coordinate: single precision ends at 3.4e38, millimetres and the scale included."""
_MM = 1000.0
"""Millimetres in a metre."""


def write_c3d(path: Path | str, cloud: MarkerCloud, *, overwrite: bool = False) -> Path:
    """Write markers to a C3D file, whole or not at all; a missing one is 0 0 0 with the residual -1.

    Args:
        cloud: markers, Z up, in metres.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData: the frame rate is not positive, or a number is larger than the file's can be.
        ShapeMismatch: labels and markers differ in number, or the labels are too many or too long for a C3D file.
    """
    positions = np.asarray(cloud.positions, dtype=np.float64)
    frames, markers = positions.shape[:2]
    labels = cloud.labels or unnamed_labels(markers)
    largest = float(np.nanmax(np.abs(positions), initial=0.0)) if np.isfinite(positions).any() else 0.0
    size = C3dSize(frames, labels, cloud.fps, largest)
    if len(labels) != markers:
        raise ShapeMismatch(f"{len(labels)} labels do not fit {markers} markers.", where=str(path))
    parts = [(positions, cloud.residual)]
    return write_c3d_parts(path, size, parts, overwrite=overwrite)


@dataclass(frozen=True)
class C3dSize:
    """What the head of a file holds before its frames are there."""

    frames: int
    """Number of frames."""
    labels: Sequence[str]
    """One label a marker."""
    fps: float
    """Frames per second."""
    largest_m: float
    """Largest absolute coordinate in metres."""


def unnamed_labels(markers: int) -> tuple[str, ...]:
    """Return labels of points without names."""
    return tuple(f"*{i}" for i in range(1, markers + 1))


def write_c3d_parts(
    path: Path | str, size: C3dSize, parts: Iterable[tuple[np.ndarray, np.ndarray | None]], *, overwrite: bool = False
) -> Path:
    """Write a C3D file whose frames come in parts, which together are never in memory.

    Args:
        size: what all parts together are.
        parts: (F, M, 3) positions in metres and (F, M) residuals, in the order of time.

    Raises:
        OutputExists, OutputNotWritable, NonFiniteData, ShapeMismatch: see ``write_c3d``.
    """
    markers = len(size.labels)
    if not (np.isfinite(size.fps) and size.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {size.fps}.", where=str(path))
    if not (size.largest_m < LARGEST_M and size.fps < LARGEST_M):
        raise NonFiniteData(
            f"A coordinate of {size.largest_m:.3g} m or the rate of {size.fps:.3g} Hz does not fit a C3D file, whose "
            f"numbers end at {LARGEST_M:g}.",
            where=str(path),
            hint="Leave out the marker or the frames where it is.",
        )
    if markers > MOST_POINTS:
        raise ShapeMismatch(f"{markers} markers do not fit a C3D file, which holds {MOST_POINTS}.", where=str(path))
    # Half of a 16-bit integer's range, should a program store the points as such.
    scale = max(0.1, size.largest_m * _MM / 32000.0)
    section, data_block = _parameter_section(size.fps, size.frames, size.labels, scale)
    with atomic_output(path, overwrite=overwrite) as temporary, open(temporary, "wb") as stream:
        stream.write(_header(size.fps, size.frames, markers, scale, data_block))
        stream.write(section)
        for positions, residual in parts:
            stream.write(_frames(np.asarray(positions, np.float64) * _MM, residual, scale).tobytes())
        stream.write(bytes(-stream.tell() % BLOCK))
    return Path(path)


def _frames(positions: np.ndarray, residual: np.ndarray | None, scale: float) -> np.ndarray:
    """Return (F, M, 4) floats: x, y, z and the residual in units of the scale, -1 where missing."""
    seen = np.isfinite(positions).all(axis=-1)
    values = np.zeros((*positions.shape[:2], 4), dtype="<f4")
    values[..., :3] = np.where(seen[..., None], positions, 0.0)
    if residual is not None:
        values[..., 3] = np.clip(np.rint(np.nan_to_num(residual) * _MM / scale), 0, 255)
    values[~seen, 3] = -1.0
    return values


def _header(fps: float, frames: int, markers: int, scale: float, data_block: int) -> bytes:
    last = min(frames, 65535)
    return _padded(struct.pack("<BBHHHHHfHHf", 2, KEY, markers, 0, 1, last, 10, -scale, data_block, 0, fps))


def _parameter_section(fps: float, frames: int, labels: Sequence[str], scale: float) -> tuple[bytes, int]:
    """Return the section, filled up to blocks, and the block after it."""

    def records(data_block: int) -> bytes:
        point = {
            "USED": _integers(len(labels)), "FRAMES": _integers(min(frames, 65535)), "SCALE": _floats(-scale),
            "RATE": _floats(fps), "DATA_START": _integers(data_block), "UNITS": _texts(["mm"]),
            "X_SCREEN": _texts(["+X"]), "Y_SCREEN": _texts(["+Z"]), **_long("LABELS", labels),
            **_long("DESCRIPTIONS", [""] * len(labels)), "LONG_FRAMES": _floats(frames),
        }  # fmt: skip
        trial = {
            "ACTUAL_START_FIELD": _integers(1, 0),
            "ACTUAL_END_FIELD": _integers(frames % 65536, frames // 65536),
            "CAMERA_RATE": _floats(fps),
        }
        analog = {
            "USED": _integers(0), "RATE": _floats(fps), "GEN_SCALE": _floats(1.0), "LABELS": _texts([]),
            "DESCRIPTIONS": _texts([]), "SCALE": (4, (0,), b""), "OFFSET": (2, (0,), b""), "UNITS": _texts([]),
        }  # fmt: skip
        force = {"USED": _integers(0), "TYPE": (2, (0,), b""), "ZERO": _integers(1, 0)}
        return _records({"POINT": point, "TRIAL": trial, "ANALOG": analog, "FORCE_PLATFORM": force})

    size = len(records(0)) + 4
    blocks = -(-size // BLOCK)
    if blocks > MOST_BLOCKS:
        raise ShapeMismatch(f"{len(labels)} labels are too long for the head of a C3D file.")
    head = bytes([1, KEY, blocks, Processor.INTEL])
    return _padded(head + records(2 + blocks)), 2 + blocks


_Value = tuple[int, tuple[int, ...], bytes]


def _integers(*values: int) -> _Value:
    return 2, () if len(values) == 1 else (len(values),), struct.pack(f"<{len(values)}H", *values)


def _floats(*values: float) -> _Value:
    return 4, () if len(values) == 1 else (len(values),), struct.pack(f"<{len(values)}f", *values)


def _texts(texts: Sequence[str]) -> _Value:
    raw = [text.encode("utf-8")[:PER_PARAMETER] for text in texts]
    length = max((len(text) for text in raw), default=0) or 1
    return -1, (length, len(raw)), b"".join(text.ljust(length) for text in raw)


def _long(name: str, texts: Sequence[str]) -> dict[str, _Value]:
    parts = [texts[i : i + PER_PARAMETER] for i in range(0, max(len(texts), 1), PER_PARAMETER)]
    return {f"{name}{i if i > 1 else ''}": _texts(part) for i, part in enumerate(parts, 1)}


def _records(groups: dict[str, dict[str, _Value]]) -> bytes:
    """Return the chain of records that ``c3d_parameters`` follows, without descriptions."""
    chain = [(-i, name, b"\0") for i, name in enumerate(groups, 1)]
    for i, parameters in enumerate(groups.values(), 1):
        for name, (kind, sizes, data) in parameters.items():
            chain.append((i, name, struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"))
    out = b""
    for k, (group, name, body) in enumerate(chain):
        step = 0 if k == len(chain) - 1 else len(body) + 2
        out += struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<H", step) + body
    return out


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % BLOCK)
