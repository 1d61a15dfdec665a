"""Markers to C3D files: Intel, floats, millimetres, Z up."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import NonFiniteData, ShapeMismatch
from solver_backend.exchange.outputs import atomic_output
from solver_backend.io.markers.c3d import BLOCK, KEY, MOST, MOST_BLOCKS, Processor
from solver_backend.types import MarkerCloud

# Source: the C3D file format user guide (Motion Lab Systems, c3d.org), with the parameters that it requires and no
# analog data. Counts above 65,535 are in TRIAL:ACTUAL_END_FIELD and in POINT:LONG_FRAMES, because programs look for
# them in one or the other. More than 255 labels continue in POINT:LABELS2.
PER_PARAMETER = 255  # Most strings in one parameter, and most characters in one.
LARGEST_M = 1e30  # Largest coordinate. Single precision ends at 3.4e38, including millimetres and the scale.
_MM = 1000.0  # Millimetres in a metre.


@dataclass(frozen=True)
class C3dSize:
    """Content of a file's head, known before its frames."""

    frames: int
    labels: Sequence[str]
    fps: float
    largest_m: float  # Largest absolute coordinate in metres.


def unnamed_labels(markers: int) -> tuple[str, ...]:
    """Return labels of points without names."""
    return tuple(f"*{i}" for i in range(1, markers + 1))


def write_c3d(path: Path | str, cloud: MarkerCloud, *, overwrite: bool = False) -> Path:
    """Write markers to a C3D file. A missing marker is 0 0 0 with the residual -1.

    Raises:
        OutputExists, OutputNotWritable, NonFiniteData, ShapeMismatch: see ``write_c3d_parts``.
    """
    positions = np.asarray(cloud.positions, dtype=np.float64)
    largest = float(np.nanmax(np.abs(positions), initial=0.0)) if np.isfinite(positions).any() else 0.0
    size = C3dSize(len(positions), cloud.labels or unnamed_labels(positions.shape[1]), cloud.fps, largest)
    return write_c3d_parts(path, size, [(positions, cloud.residual)], overwrite=overwrite)


def write_c3d_parts(
    path: Path | str, size: C3dSize, parts: Iterable[tuple[np.ndarray, np.ndarray | None]], *, overwrite: bool = False
) -> Path:
    """Write a C3D file from parts, (F, M, 3) metres and (F, M) residuals in the order of time, one at a time in memory.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData: the frame rate is not positive, or a number does not fit the format.
        ShapeMismatch: there are too many markers, or their labels are too long.
    """
    markers = len(size.labels)
    if not (np.isfinite(size.fps) and size.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {size.fps}.", where=str(path))
    if not (size.largest_m < LARGEST_M and size.fps < LARGEST_M):
        what = f"A coordinate of {size.largest_m:.3g} m or the rate of {size.fps:.3g} Hz does not fit a C3D file."
        hint = f"Numbers end at {LARGEST_M:g}: leave out the marker or the frames where it is."
        raise NonFiniteData(what, where=str(path), hint=hint)
    if markers > MOST:
        raise ShapeMismatch(f"{markers} markers do not fit a C3D file, which holds {MOST}.", where=str(path))
    # Half of a 16-bit integer's range, for programs that store the points as integers.
    scale = max(0.1, size.largest_m * _MM / 32000.0)
    section, data_block = _parameter_section(size, scale)
    last = min(size.frames, MOST)
    head = struct.pack("<BBHHHHHfHHf", 2, KEY, markers, 0, 1, last, 10, -scale, data_block, 0, size.fps)
    with atomic_output(path, overwrite=overwrite) as temporary, open(temporary, "wb") as stream:
        stream.write(_padded(head) + section)
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


_Value = tuple[int, tuple[int, ...], bytes]  # Kind, dimensions and bytes of a parameter.


def _parameter_section(size: C3dSize, scale: float) -> tuple[bytes, int]:
    """Return the section, padded to blocks, and the block after it."""
    frames, labels, none = size.frames, size.labels, _texts([])
    point = {"USED": _words(len(labels)), "FRAMES": _words(min(frames, MOST)), "SCALE": _singles(-scale)}
    point |= {"RATE": _singles(size.fps), "DATA_START": _words(0), "UNITS": _texts(["mm"])}
    point |= {"X_SCREEN": _texts(["+X"]), "Y_SCREEN": _texts(["+Z"]), **_long("LABELS", labels)}
    point |= {**_long("DESCRIPTIONS", [""] * len(labels)), "LONG_FRAMES": _singles(frames)}
    trial = {"ACTUAL_START_FIELD": _words(1, 0), "ACTUAL_END_FIELD": _words(frames % 65536, frames // 65536)}
    trial["CAMERA_RATE"] = _singles(size.fps)
    analog = {"USED": _words(0), "RATE": _singles(size.fps), "GEN_SCALE": _singles(1.0), "LABELS": none}
    analog |= {"DESCRIPTIONS": none, "SCALE": (4, (0,), b""), "OFFSET": (2, (0,), b""), "UNITS": none}
    force = {"USED": _words(0), "TYPE": (2, (0,), b""), "ZERO": _words(1, 0)}
    groups = {"POINT": point, "TRIAL": trial, "ANALOG": analog, "FORCE_PLATFORM": force}
    blocks = -(-(len(_records(groups)) + 4) // BLOCK)
    if blocks > MOST_BLOCKS:
        raise ShapeMismatch(f"{len(labels)} labels are too long for the head of a C3D file.")
    point["DATA_START"] = _words(2 + blocks)
    return _padded(bytes([1, KEY, blocks, Processor.INTEL]) + _records(groups)), 2 + blocks


def _words(*values: int) -> _Value:
    return 2, (len(values),) if values[1:] else (), struct.pack(f"<{len(values)}H", *values)


def _singles(*values: float) -> _Value:
    return 4, (len(values),) if values[1:] else (), struct.pack(f"<{len(values)}f", *values)


def _texts(texts: Sequence[str]) -> _Value:
    raw = [text.encode("utf-8")[:PER_PARAMETER] for text in texts]
    length = max((len(text) for text in raw), default=0) or 1
    return -1, (length, len(raw)), b"".join(text.ljust(length) for text in raw)


def _long(name: str, texts: Sequence[str]) -> dict[str, _Value]:
    parts = [texts[i : i + PER_PARAMETER] for i in range(0, max(len(texts), 1), PER_PARAMETER)]
    return {f"{name}{i if i > 1 else ''}": _texts(part) for i, part in enumerate(parts, 1)}


def _records(groups: dict[str, dict[str, _Value]]) -> bytes:
    """Return the chain of records that ``c3d._follow_chain`` reads, without descriptions."""
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
