"""Read and write markers in C3D files, with the numbers of any processor type."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, NonFiniteData, ShapeMismatch
from solver_backend.exchange.outputs import atomic_output
from solver_backend.io.files import read_bytes
from solver_backend.io.markers.source import MarkerSource, left_out_note
from solver_backend.io.recognition.marker_labels import is_model_output
from solver_backend.types import MarkerCloud

# Source: the C3D file format user guide (Motion Lab Systems, c3d.org).
#
# A file consists of 512-byte blocks, counted from 1. The header is block 1. Its first byte is the block number of the
# parameter section, its second byte is 0x50. Parameters form a chain of records. Each states the distance to the next,
# so unknown records can be skipped. Real files break most of the rules, so no count is trusted beyond the end of the
# file.
#
# A frame has four words per point: x, y, z, and a word with the residual in its low byte and a camera mask in its high
# byte. The fourth word is negative for a missing point. Analog samples follow. A word has two bytes in integer files
# and four in float files, where the fourth word is the same integer as a float. The header overrides a different
# parameter, because no program reads a file without a correct header. Counts above 65,535 are only in parameters.


class Processor(IntEnum):
    """Processor type that defines the number format. The value is the byte in the file."""

    INTEL = 84
    DEC = 85
    MIPS = 86


def _view(raw: np.ndarray, processor: Processor, kind: str) -> np.ndarray:
    return raw.view((">" if processor is Processor.MIPS else "<") + kind)


def _floats(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Convert bytes (..., 4 n) in the processor's float format to float64 numbers (..., n).

    A VAX F float consists of two little-endian 16-bit words, high word first. Its exponent is larger by 2 than in the
    IEEE float with the same bits: ``value = ieee(high << 16 | low) / 4`` (VAX Architecture Reference Manual).
    Numbers from 2^126 up become infinity or NaN, because their bits have this meaning in IEEE.
    """
    with np.errstate(invalid="ignore"):
        if processor is not Processor.DEC:
            return _view(raw, processor, "f4").astype(np.float64)
        words = raw.view("<u2").astype(np.uint32)
        ieee = (words[..., 0::2] << 16) | words[..., 1::2]
        return ieee.view(np.float32).astype(np.float64) / 4.0


BLOCK, KEY, MOST_BLOCKS = 512, 0x50, 255
"""Bytes per block, second byte of every C3D file, and largest number of blocks in its parameter section."""
_BYTES = {-1: 1, 1: 1, 2: 2, 4: 4}  # Bytes per element by parameter type: characters, bytes, integers, floats.


@dataclass(frozen=True)
class Header:
    """First block of a C3D file. Counts are unsigned, because files may have more than 32,767 frames."""

    points: int  # Points per frame.
    analog: int  # Analog samples per frame, over all channels.
    analog_per_channel: int  # Analog samples per frame in one channel.
    first: int  # Number of the first frame.
    last: int  # Number of the last frame, or 65,535 if there are more.
    scale: float  # Length units per integer step, negative in float files.
    data_block: int  # Block where the first frame starts.
    rate: float  # Frames per second.


@dataclass(frozen=True)
class Parameter:
    """A C3D parameter, decoded on demand."""

    kind: int  # -1 characters, 1 bytes, 2 integers, 4 floats.
    dimensions: tuple[int, ...]  # Sizes, fastest-varying axis first. Empty for a single value.
    data: np.ndarray  # Bytes of the values.

    def numbers(self, processor: Processor) -> np.ndarray:
        """Decode all values as float64. Integers are unsigned. A text parameter has no numbers."""
        if self.kind == 4:
            return _floats(self.data, processor)
        if self.kind == 2:
            return _view(self.data, processor, "u2").astype(np.float64)
        return self.data.astype(np.float64) if self.kind == 1 else np.zeros(0)

    def texts(self) -> tuple[str, ...]:
        """Decode the strings of a text parameter, without padding."""
        length = (self.dimensions[0] if self.dimensions else 1) if self.kind == -1 else 0
        count = len(self.data) // length if length else 0
        return tuple(_text(row) for row in self.data[: count * length].reshape(count, -1)) if count else ()


@dataclass(frozen=True)
class Parameters:
    """All parameters of a C3D file, by 'GROUP:NAME' in capitals."""

    processor: Processor
    by_name: dict[str, Parameter]  # First parameter with each name.
    end: int  # First byte after the parameter section.

    def numbers(self, name: str) -> np.ndarray:
        """Return the values of a numeric parameter, or no values if it is missing."""
        return self.by_name[name].numbers(self.processor) if name in self.by_name else np.zeros(0)

    def number(self, name: str) -> float | None:
        """Return the first value of a parameter, or None if it is missing or not finite."""
        values = self.numbers(name)
        return float(values[0]) if values.size and np.isfinite(values[0]) else None

    def first_text(self, name: str) -> str:
        """Return the first string of a parameter, or an empty string if it is missing."""
        return next(iter(self.by_name[name].texts()), "") if name in self.by_name else ""

    def texts(self, name: str) -> tuple[str, ...]:
        """Return the strings of a parameter. Long lists continue in NAME2, NAME3 and so on."""
        found, part = self.by_name[name].texts() if name in self.by_name else (), 2
        while (key := f"{name}{part}") in self.by_name:
            found += self.by_name[key].texts()
            part += 1
        return found


def _read_parameters(data: np.ndarray, path: Path) -> Parameters:
    if len(data) < BLOCK or data[1] != KEY:
        what = "is empty" if not len(data) else "is truncated or is not a C3D file"
        raise FileDamaged(f"The file {what}.", where=str(path), hint="Export the file again.")
    start = (max(int(data[0]), 1) - 1) * BLOCK
    if start + 4 > len(data):
        raise FileDamaged("The file ends before its parameter section.", where=str(path), hint="Export the file again.")
    if data[start + 3] not in list(Processor):
        known = ", ".join(f"{p.value} ({p.name})" for p in Processor)
        raise FileDamaged(f"Unknown processor {data[start + 3]}. Known processors: {known}.", where=str(path))
    processor = Processor(data[start + 3])
    blocks = int(data[start + 2]) or MOST_BLOCKS
    end = min(start + blocks * BLOCK, len(data))
    return Parameters(processor, _follow_chain(data[start + 4 : end], processor), end)


def _follow_chain(section: np.ndarray, processor: Processor) -> dict[str, Parameter]:
    """Decode the chain of parameter records. Every step moves forward, so the loop ends.

    A record consists of the length of the name (negative if locked), the group id (negative in the group's own record),
    the name, and the distance from this position to the next record. A parameter record adds its type, the number of
    dimensions, the dimensions and the data.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Parameter]] = []
    at = 0
    while at + 2 <= len(section):
        length, group = (int(value) for value in section[at : at + 2].view(np.int8))
        name_end = at + 2 + abs(length)
        if length == 0 or name_end + 2 > len(section):
            break
        name = _text(section[at + 2 : name_end]).upper()
        step = int(_view(section[name_end : name_end + 2], processor, "u2")[0])
        if group < 0:
            groups.setdefault(-group, name)
        elif (parameter := _parameter(section[name_end + 2 :])) is not None:
            found.append((group, name, parameter))
        if step == 0:
            break
        at = name_end + step
    by_name: dict[str, Parameter] = {}
    for group, name, parameter in found:
        by_name.setdefault(f"{groups.get(group, '')}:{name}", parameter)
    return by_name


def _parameter(body: np.ndarray) -> Parameter | None:
    """Decode a parameter that starts with its type byte, or return None if it extends beyond the section."""
    if len(body) < 2:
        return None
    kind, count = int(body[:1].view(np.int8)[0]), int(body[1])
    dimensions = tuple(int(size) for size in body[2 : 2 + count])
    size = math.prod(dimensions) * _BYTES.get(kind, 0)
    start = 2 + count
    if kind not in _BYTES or len(dimensions) < count or start + size > len(body):
        return None
    return Parameter(kind, dimensions, body[start : start + size])


def _read_header(data: np.ndarray, processor: Processor) -> Header:
    # Word n in the user guide is bytes 2 n - 2 and 2 n - 1.
    words = [int(value) for value in _view(data[:BLOCK], processor, "u2")[:10]]
    scale, rate = (float(_floats(data[2 * n - 2 : 2 * n + 2], processor)[0]) for n in (7, 11))
    return Header(words[1], words[2], words[9], words[3], words[4], scale, words[8], rate)


def _text(raw: np.ndarray) -> str:
    data = re.split(rb"[\x00-\x1f]", raw.tobytes().lstrip())[0]
    try:
        return data.decode("utf-8").strip()
    except UnicodeDecodeError:
        return data.decode("latin-1").strip()


_WORDS = 17  # Numbers per segment and frame: the matrix by columns, then the residual.
_SEGMENT_NAMES = {"uarm": "upper_arm", "larm": "lower_arm", "torso": "thorax"}  # Our names of C3D segments.
_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Parameters listing points that are not positions. Programs store computed values (joint angles) as points."""
MOST = 65535  # Largest count in the header.
SAME_RATE = 0.02
"""Largest relative difference between entries of one frame rate: 59.94 is 60. No file of 80 recordings exceeds it."""


@dataclass(frozen=True)
class SegmentOrigins:
    """Origins and rotations of S body segments in F frames."""

    positions: np.ndarray  # (F, S, 3) origins in the file's length unit, NaN where missing.
    labels: tuple[str, ...]  # (S,) segment names, such as ``left_upper_arm``.
    turns: np.ndarray  # (F, S, 3, 3) rotations from segment axes to file axes.
    rate: float | None  # Frames per second.


def read_segments(path: Path) -> SegmentOrigins | None:
    """Read the body segments in a C3D file, or return None if it contains none."""
    data = np.frombuffer(read_bytes(path), np.uint8)
    return _origins(data, _read_parameters(data, path))


def _origins(data: np.ndarray, parameters: Parameters) -> SegmentOrigins | None:
    labels = parameters.texts("ROTATION:LABELS")
    count = min(int(parameters.number("ROTATION:USED") or 0), len(labels))
    block = int(parameters.number("ROTATION:DATA_START") or 0)
    start, stride = (block - 1) * BLOCK, 4 * _WORDS * count
    if count <= 0 or block < 2 or start + stride > len(data):
        return None
    frames, stated = (len(data) - start) // stride, parameters.number("POINT:FRAMES")
    if stated:
        frames = min(frames, int(stated * max(parameters.number("ROTATION:RATIO") or 1.0, 1.0)))
    values = _floats(data[start : start + frames * stride].reshape(frames, stride), parameters.processor)
    values = values.reshape(frames, count, _WORDS)
    kept = [i for i, label in enumerate(labels[:count]) if not label.lower().startswith("world")]
    positions = np.where(values[:, kept, -1:] >= 0, values[:, kept, 12:15], np.nan)
    columns = values[:, kept, :16].reshape(frames, len(kept), 4, 4)[..., :3, :3]
    names = tuple(_segment_name(labels[i]) for i in kept)
    return SegmentOrigins(positions, names, np.swapaxes(columns, -1, -2), parameters.number("ROTATION:RATE"))


def _segment_name(label: str) -> str:
    """Convert a C3D label such as ``l_uarm_4X4`` to a segment name such as ``left_upper_arm``."""
    name = re.sub(r"_?4x4$", "", label.strip(), flags=re.IGNORECASE).lower()
    side = {"l_": "left_", "r_": "right_"}.get(name[:2], "")
    part = name[2:] if side else name
    return side + _SEGMENT_NAMES.get(part, part)


@dataclass(frozen=True)
class _Layout:
    start: int  # Index of the first byte.
    frames: int
    stride: int  # Bytes per frame.
    points: int
    word: int  # Bytes per word: 4 in float files, 2 in integer files.
    problems: tuple[Diagnostic, ...]


def read_c3d(path: Path) -> MarkerSource:
    """Read the markers in a C3D file. If it only contains segments, read their origins."""
    data = np.frombuffer(read_bytes(path), np.uint8)
    parameters = _read_parameters(data, path)
    header = _read_header(data, parameters.processor)
    layout = _layout(data, header, parameters, path)
    labels = parameters.texts("POINT:LABELS")[: layout.points]
    labels += ("",) * (layout.points - len(labels))
    outputs = {label for name in _MODEL_OUTPUTS for label in parameters.texts(f"POINT:{name}")} - {""}
    kept = [i for i, label in enumerate(labels) if label not in outputs and not is_model_output(label)]
    common: dict[str, Any] = {"path": path, "default_unit": "mm", "default_up_axis": "z"}
    common |= {"unit": parameters.first_text("POINT:UNITS"), "up_axis": _screen_up(parameters)}
    if not kept and (origins := _origins(data, parameters)) is not None:
        return MarkerSource(
            format=f"C3D ({parameters.processor.name}, rotations)",
            positions=origins.positions,
            labels=origins.labels,
            rate=origins.rate or parameters.number("POINT:RATE"),
            notes=(diagnostic("points_computed", kind="segments", count=len(origins.labels)),),
            **common,
        )
    positions, residual, problems = _points(data, layout, kept, _scale(header, parameters, path), parameters)
    rate = header.rate if header.rate > 0 else (parameters.number("POINT:RATE") or header.rate)
    return MarkerSource(
        format=f"C3D ({parameters.processor.name}, {'float' if layout.word == 4 else 'integer'})",
        positions=positions,
        labels=tuple(labels[i] for i in kept),
        rate=rate,
        residual=residual,
        analog_channels=_analog_channels(header, parameters),
        notes=left_out_note(len(labels) - len(kept)),
        problems=(*layout.problems, *problems),
        rate_doubts=_contradicted(rate, header, parameters),
        **common,
    )


def _layout(data: np.ndarray, header: Header, parameters: Parameters, path: Path) -> _Layout:
    """Locate the frames in a C3D file.

    The header cannot store a last frame above ``MOST``. Longer files store ``MOST``, or the number modulo
    ``MOST + 1``. Unless a parameter states the number of frames, the file length determines it.
    """
    word = 4 if header.scale < 0 or math.isnan(header.scale) else 2
    points = header.points or int(np.clip(parameters.number("POINT:USED") or 0, 0, MOST))
    block = header.data_block or int(parameters.number("POINT:DATA_START") or 0)
    start = (block - 1) * BLOCK if block > 1 else parameters.end
    room = max(len(data) - start, 0)
    claims = _frame_counts(header, parameters)
    stride = word * (4 * points + header.analog)
    # Some writers store the number of channels instead of samples per frame. Most of the file would then remain unread.
    samples = word * (4 * points + len(_analog_channels(header, parameters)) * header.analog_per_channel)
    if max(claims) * stride + BLOCK < room and max(claims) * stride < max(claims) * samples <= room:
        stride = samples
    if not points:
        return _Layout(start, 0, stride, 0, word, ())
    complete = room // stride
    fitting = [count for count in claims if 0 < count <= complete]
    frames = max(fitting) if fitting else complete
    if header.last == MOST and frames <= MOST:
        frames = complete
    elif (complete - frames) % (MOST + 1) <= BLOCK // stride:
        frames += (complete - frames) // (MOST + 1) * (MOST + 1)
    if not frames:
        hint = "Export the file again."
        raise FileDamaged(f"The file ends before its first frame of {points} points.", where=str(path), hint=hint)
    problems = () if fitting else (diagnostic("count_not_as_stated", items="frames", stated=max(claims), count=frames),)
    return _Layout(start, frames, stride, points, word, problems)


def _frame_counts(header: Header, parameters: Parameters) -> list[int]:
    """Return the different frame counts that the header and the parameters state."""
    claims = [header.last - header.first + 1]
    start, end = (parameters.numbers(f"TRIAL:ACTUAL_{name}_FIELD") for name in ("START", "END"))
    if start.size >= 2 and end.size >= 2:
        low, high = (values[0] + 65536 * values[1] for values in (start, end))  # the low word comes first
        if 0 <= low <= high < 2**32:
            claims.append(int(high - low) + 1)
    stated = [parameters.number(f"POINT:{name}") for name in ("LONG_FRAMES", "FRAMES")]
    claims += [int(count) for count in stated if count is not None and 0 < count < 2**32]
    return [count for count in dict.fromkeys(claims) if count > 0] or [1]


def _contradicted(rate: float, header: Header, parameters: Parameters) -> tuple[Diagnostic, ...]:
    analog, samples = parameters.number("ANALOG:RATE"), header.analog_per_channel
    stated = {name: parameters.number(name) for name in ("POINT:RATE", "TRIAL:CAMERA_RATE")}
    stated["ANALOG:RATE over the samples of a frame"] = analog / samples if analog and samples else None
    known = {name: value for name, value in {"header": header.rate, **stated}.items() if value and 0 < value < math.inf}
    others = [f"{name} {value:.4g}" for name, value in known.items() if abs(value - rate) > SAME_RATE * rate]
    return (diagnostic("marker_rates_contradict", rate=rate, others=others),) if others and rate > 0 else ()


def _scale(header: Header, parameters: Parameters, path: Path) -> float:
    for scale in (header.scale, parameters.number("POINT:SCALE") or math.nan):
        if math.isfinite(scale) and scale != 0:
            return abs(scale)
    raise FileDamaged("The header and POINT:SCALE state no scale.", where=str(path), hint="Export the file again.")


def _points(
    data: np.ndarray, layout: _Layout, kept: list[int], scale: float, parameters: Parameters
) -> tuple[np.ndarray, np.ndarray, tuple[Diagnostic, ...]]:
    """Decode positions (F, M, 3) and residuals (F, M) in the file's unit. Also return warnings."""
    frames = data[layout.start : layout.start + layout.frames * layout.stride].reshape(layout.frames, layout.stride)
    raw = frames[:, : 4 * layout.word * layout.points]
    values = _floats(raw, parameters.processor) if layout.word == 4 else _view(raw, parameters.processor, "i2")
    values = values.reshape(layout.frames, layout.points, 4)
    values = values if len(kept) == layout.points else values[:, kept]
    positions = values[..., :3] * (1.0 if layout.word == 4 else scale)
    fourth = np.nan_to_num(values[..., 3].astype(np.float64), nan=-1.0, posinf=-1.0, neginf=-1.0)
    missing = fourth < 0
    problems: tuple[Diagnostic, ...] = ()
    if missing.all() and positions.any():
        missing, problems = np.zeros_like(missing), (diagnostic("residuals_mark_nothing"),)
    positions[missing] = np.nan
    residual = (fourth.clip(0, 32767).astype(np.int64) & 255) * scale
    residual[missing] = np.nan
    return positions, residual, problems


def _screen_up(parameters: Parameters) -> str:
    axes = [parameters.first_text(f"POINT:{name}_SCREEN").lower().lstrip("+") for name in "XY"]
    known = all(axis.lstrip("-") in ("x", "y", "z") for axis in axes)
    return axes[1] if known and axes[0][-1] != axes[1][-1] else ""


def _analog_channels(header: Header, parameters: Parameters) -> tuple[str, ...]:
    used = parameters.number("ANALOG:USED")
    count = int(used) if used is not None else header.analog // max(header.analog_per_channel, 1)
    count = min(max(count, 0), header.analog)
    labels = parameters.texts("ANALOG:LABELS")[:count]
    return tuple(label or f"channel {i}" for i, label in enumerate(labels + ("",) * (count - len(labels)), 1))


# Source: the C3D file format user guide (Motion Lab Systems, c3d.org). Only required parameters are written, and no
# analog data. Counts above 65,535 are stored in both TRIAL:ACTUAL_END_FIELD and POINT:LONG_FRAMES, because each program
# reads only one of them. If there are more than 255 labels, they continue in POINT:LABELS2.
PER_PARAMETER = 255  # Largest number of strings per parameter, and of characters per string.
LARGEST_M = 1e30  # Largest coordinate in metres. Single precision ends at 3.4e38, including millimetres and the scale.
_MM = 1000.0  # Millimetres per metre.


@dataclass(frozen=True)
class C3dSize:
    """Values for the header of a C3D file, which is written before the frames."""

    frames: int
    labels: Sequence[str]
    fps: float
    largest_m: float  # Largest absolute coordinate in metres.
    events: Sequence[tuple[float, str, str]] = ()  # Seconds from the first frame, side ("Left", "Right"), name.


def unnamed_labels(markers: int) -> tuple[str, ...]:
    """Return C3D labels for unnamed points: ``*1``, ``*2`` and so on."""
    return tuple(f"*{i}" for i in range(1, markers + 1))


def write_c3d(
    path: Path | str, cloud: MarkerCloud, *, events: Sequence[tuple[float, str, str]] = (), overwrite: bool = False
) -> Path:
    """Write markers to a C3D file. Missing markers are written as 0 0 0 with residual -1."""
    positions = np.asarray(cloud.positions, dtype=np.float64)
    largest = float(np.nanmax(np.abs(positions), initial=0.0)) if np.isfinite(positions).any() else 0.0
    size = C3dSize(len(positions), cloud.labels or unnamed_labels(positions.shape[1]), cloud.fps, largest, events)
    return write_c3d_parts(path, size, [(positions, cloud.residual)], overwrite=overwrite)


def write_c3d_parts(
    path: Path | str, size: C3dSize, parts: Iterable[tuple[np.ndarray, np.ndarray | None]], *, overwrite: bool = False
) -> Path:
    """Write a C3D file from successive blocks of positions (F, M, 3) and residuals (F, M).

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData: the frame rate is not positive, or a number cannot be represented in the format.
        ShapeMismatch: there are too many markers, or their labels are too long.
    """
    markers = len(size.labels)
    if not (np.isfinite(size.fps) and size.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {size.fps}.", where=str(path))
    if not (size.largest_m < LARGEST_M and size.fps < LARGEST_M):
        what = f"A coordinate of {size.largest_m:.3g} m or the rate of {size.fps:.3g} Hz does not fit in a C3D file."
        hint = f"The limit is {LARGEST_M:g}. Omit this marker or these frames."
        raise NonFiniteData(what, where=str(path), hint=hint)
    if markers > MOST:
        what = f"{markers} markers do not fit in a C3D file, which can contain at most {MOST}."
        raise ShapeMismatch(what, where=str(path), hint="Write fewer markers.")
    # Use half the range of 16-bit integers, for programs that store the points as integers.
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
    """Encode points as floats (F, M, 4): x, y, z and the scaled residual, which is -1 for a missing point."""
    seen = np.isfinite(positions).all(axis=-1)
    values = np.zeros((*positions.shape[:2], 4), dtype="<f4")
    values[..., :3] = np.where(seen[..., None], positions, 0.0)
    if residual is not None:
        values[..., 3] = np.clip(np.rint(np.nan_to_num(residual) * _MM / scale), 0, 255)
    values[~seen, 3] = -1.0
    return values


_Value = tuple[int, tuple[int, ...], bytes]  # Type, dimensions and bytes of a parameter.


def _parameter_section(size: C3dSize, scale: float) -> tuple[bytes, int]:
    """Encode the parameter section in whole blocks. Also return the number of the next block."""
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
    if size.events:
        groups["EVENT"] = _event_group(size.events)
    blocks = -(-(len(_records(groups)) + 4) // BLOCK)
    if blocks > MOST_BLOCKS:
        raise ShapeMismatch(f"{len(labels)} labels are too long for the header of a C3D file.")
    point["DATA_START"] = _words(2 + blocks)
    return _padded(bytes([1, KEY, blocks, Processor.INTEL]) + _records(groups)), 2 + blocks


def _event_group(events: Sequence[tuple[float, str, str]]) -> dict[str, _Value]:
    """Encode the EVENT group: side and name of each event, and its time in minutes and seconds."""
    times, sides, names = zip(*events[:PER_PARAMETER], strict=True)
    count = len(times)
    clock = struct.pack(f"<{2 * count}f", *(part for t in times for part in divmod(t, 60.0)))
    group = {"USED": _words(count), "CONTEXTS": _texts(sides), "LABELS": _texts(names), "TIMES": (4, (2, count), clock)}
    return group | {"DESCRIPTIONS": _texts([""] * count), "SUBJECTS": _texts([""] * count)}


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
    """Encode parameters as the chain of records that ``_follow_chain`` decodes."""
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
