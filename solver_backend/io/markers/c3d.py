"""Markers in from C3D files of every processor, with integers or floats.

Source: the C3D file format user guide (Motion Lab Systems, c3d.org). A frame is, for every point, four words: x, y, z
and one that holds the residual in its low byte and a mask of the cameras in its high one; then the analog samples. A
word has two bytes in a file of integers and four in a file of floats, where the fourth is the same integer as a float.
It is negative for a point that was not seen. The header's numbers count where a parameter differs, as what cannot be
read without them is kept right by every writer, but counts above 65,535 are in parameters or nowhere.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.files import read_bytes
from solver_backend.io.markers.source import MarkerSource, left_out_note
from solver_backend.io.recognition.marker_labels import is_model_output


class Processor(IntEnum):
    """What wrote the numbers; the value is the byte in the file."""

    INTEL = 84
    DEC = 85
    MIPS = 86


def integers(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return signed 16-bit integers.

    Args:
        raw: (..., 2 n) bytes as uint8, contiguous along the last axis.
        processor: what wrote them.

    Returns:
        (..., n) int16.
    """
    return raw.view(">i2" if processor is Processor.MIPS else "<i2")


def floats(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return 32-bit floats as float64.

    A VAX F float is two little-endian 16-bit words, the high one first, with an exponent that is 2 larger than that of
    the IEEE float with the same bits: ``value = ieee(high << 16 | low) / 4`` (VAX Architecture Reference Manual).
    Its 2^126 and above, which IEEE keeps for infinity and NaN, come out as those.

    Args:
        raw: (..., 4 n) bytes as uint8, contiguous along the last axis.
        processor: what wrote them.

    Returns:
        (..., n) float64.
    """
    with np.errstate(invalid="ignore"):
        if processor is not Processor.DEC:
            return raw.view(">f4" if processor is Processor.MIPS else "<f4").astype(np.float64)
        words = raw.view("<u2").astype(np.uint32)
        ieee = (words[..., 0::2] << 16) | words[..., 1::2]
        return ieee.view(np.float32).astype(np.float64) / 4.0


def unsigned(raw: np.ndarray, processor: Processor) -> np.ndarray:
    """Return (..., n) unsigned 16-bit integers of (..., 2 n) bytes."""
    return integers(raw, processor).view(">u2" if processor is Processor.MIPS else "<u2")


BLOCK = 512
KEY = 0x50
"""Second byte of every C3D file."""
MOST_BLOCKS = 255
"""A parameter section states its length in one byte."""

_BYTES = {-1: 1, 1: 1, 2: 2, 4: 4}
"""Bytes of an element by the type of a parameter: characters, bytes, integers, floats."""


@dataclass(frozen=True)
class Header:
    """What the first block states; counts are unsigned, as files of more than 32,767 frames need them."""

    points: int
    """Points in a frame."""
    analog: int
    """Analog samples in a frame, all channels together."""
    analog_per_channel: int
    """Analog samples of one channel in a frame."""
    first: int
    """Number of the first frame."""
    last: int
    """Number of the last frame; 65,535 where there are more."""
    scale: float
    """Units of an integer; negative where points are floats."""
    data_block: int
    """Block at which the frames start."""
    rate: float
    """Frames per second."""


@dataclass(frozen=True)
class Parameter:
    """One parameter, decoded when it is asked for."""

    kind: int
    """-1 characters, 1 bytes, 2 integers, 4 floats."""
    dimensions: tuple[int, ...]
    """Sizes, the fastest first; none for a single value."""
    data: np.ndarray
    """Its bytes."""

    def numbers(self, processor: Processor) -> np.ndarray:
        """Return every value as float64, integers unsigned as counts are; characters have none."""
        if self.kind == 4:
            return floats(self.data, processor)
        if self.kind == 2:
            return unsigned(self.data, processor).astype(np.float64)
        return self.data.astype(np.float64) if self.kind == 1 else np.zeros(0)

    def texts(self) -> tuple[str, ...]:
        """Return its strings without the blanks that fill them up."""
        if self.kind != -1:
            return ()
        length = self.dimensions[0] if self.dimensions else 1
        count = len(self.data) // length if length else 0
        return tuple(_text(row) for row in self.data[: count * length].reshape(count, length)) if length else ()


@dataclass(frozen=True)
class Parameters:
    """All parameters by 'GROUP:NAME' in capitals."""

    processor: Processor
    """What wrote the file's numbers."""
    by_name: dict[str, Parameter]
    """The parameters; of two of one name, the first."""
    end: int
    """First byte after the section."""

    def numbers(self, name: str) -> np.ndarray:
        """Return a parameter's values, none where it is missing."""
        return self.by_name[name].numbers(self.processor) if name in self.by_name else np.zeros(0)

    def number(self, name: str) -> float | None:
        """Return a parameter's first value, None where it is missing or not finite."""
        values = self.numbers(name)
        return float(values[0]) if values.size and np.isfinite(values[0]) else None

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a parameter's strings, none where it is missing."""
        return self.by_name[name].texts() if name in self.by_name else ()

    def continued_texts(self, name: str) -> tuple[str, ...]:
        """Return the strings of a list that goes on in NAME2, NAME3, ..., as more than 255 do not fit into one."""
        texts, part = self.texts(name), 2
        while f"{name}{part}" in self.by_name:
            texts += self.texts(f"{name}{part}")
            part += 1
        return texts


def read_parameters(data: np.ndarray, path: Path) -> Parameters:
    """Find and read the parameter section.

    Raises:
        FileDamaged: the file is too short, has no key, or its processor is unknown.
    """
    if len(data) < BLOCK or data[1] != KEY:
        what = "is empty" if not len(data) else "is truncated or is not a C3D file"
        raise FileDamaged(f"The file {what}.", where=str(path), hint="Export it again.")
    start = (max(int(data[0]), 1) - 1) * BLOCK
    if start + 4 > len(data):
        raise FileDamaged("The file ends before its parameter section.", where=str(path), hint="Export it again.")
    if data[start + 3] not in list(Processor):
        known = ", ".join(f"{p.value} ({p.name})" for p in Processor)
        raise FileDamaged(f"Unknown processor {data[start + 3]}; known are {known}.", where=str(path))
    processor = Processor(data[start + 3])
    blocks = int(data[start + 2]) or MOST_BLOCKS
    end = min(start + blocks * BLOCK, len(data))
    return Parameters(processor, _walk(data[start + 4 : end], processor), end)


def _walk(section: np.ndarray, processor: Processor) -> dict[str, Parameter]:
    """Follow the chain of records; every step goes forward, so it ends.

    A record is: length of the name (negative if locked), id of the group (negative for a group's own record), name,
    distance from here to the next record; for a parameter: type, number of dimensions, dimensions, data.
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
        step = int(unsigned(section[name_end : name_end + 2], processor)[0])
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
    """Return the parameter whose type starts here, None where it does not fit into the section."""
    if len(body) < 2:
        return None
    kind, count = int(body[:1].view(np.int8)[0]), int(body[1])
    dimensions = tuple(int(size) for size in body[2 : 2 + count])
    size = math.prod(dimensions) * _BYTES.get(kind, 0)
    start = 2 + count
    if kind not in _BYTES or len(dimensions) < count or start + size > len(body):
        return None
    return Parameter(kind, dimensions, body[start : start + size])


def read_header(data: np.ndarray, processor: Processor) -> Header:
    """Read the first block; word ``n`` of the user guide is bytes ``2 n - 2`` and ``2 n - 1``."""

    def word(number: int) -> int:
        return int(unsigned(data[2 * number - 2 : 2 * number], processor)[0])

    def real(number: int) -> float:
        return float(floats(data[2 * number - 2 : 2 * number + 2], processor)[0])

    return Header(
        points=word(2),
        analog=word(3),
        first=word(4),
        last=word(5),
        scale=real(7),
        data_block=word(9),
        analog_per_channel=word(10),
        rate=real(11),
    )


def _text(raw: np.ndarray) -> str:
    data = re.split(rb"[\x00-\x1f]", raw.tobytes().lstrip())[0]
    try:
        return data.decode("utf-8").strip()
    except UnicodeDecodeError:
        return data.decode("latin-1").strip()


_WORDS = 17
_NAMES = {"uarm": "upper_arm", "larm": "lower_arm", "torso": "thorax"}
"""Names of segments as skeletons have them."""


@dataclass(frozen=True)
class SegmentOrigins:
    """Where S segments begin and how they are turned, in F frames."""

    positions: np.ndarray
    """(F, S, 3) in the unit of the file's points, NaN where a segment is not seen."""
    labels: tuple[str, ...]
    """One a segment, the side in words."""
    turns: np.ndarray
    """(F, S, 3, 3) rotations from each segment's axes to the file's."""
    rate: float | None
    """Frames per second."""


def read_origins(data: np.ndarray, parameters: Parameters) -> SegmentOrigins | None:
    """Return the segments' origins, None where the file holds no rotations."""
    labels = parameters.continued_texts("ROTATION:LABELS")
    count = min(int(parameters.number("ROTATION:USED") or 0), len(labels))
    block = int(parameters.number("ROTATION:DATA_START") or 0)
    start, stride = (block - 1) * BLOCK, 4 * _WORDS * count
    if count <= 0 or block < 2 or start + stride > len(data):
        return None
    ratio = max(parameters.number("ROTATION:RATIO") or 1.0, 1.0)
    stated = parameters.number("POINT:FRAMES")
    frames = (len(data) - start) // stride
    frames = min(frames, int(stated * ratio)) if stated else frames
    values = floats(data[start : start + frames * stride].reshape(frames, stride), parameters.processor)
    values = values.reshape(frames, count, _WORDS)
    kept = [i for i, label in enumerate(labels[:count]) if not label.lower().startswith("world")]
    positions = np.where(values[:, kept, -1:] >= 0, values[:, kept, 12:15], np.nan)
    columns = values[:, kept, :16].reshape(frames, len(kept), 4, 4)[..., :3, :3]
    names = tuple(_named(labels[i]) for i in kept)
    return SegmentOrigins(positions, names, np.swapaxes(columns, -1, -2), parameters.number("ROTATION:RATE"))


def _named(label: str) -> str:
    """Return a segment's name as skeletons write it: ``left_upper_arm`` for ``l_uarm_4X4``."""
    name = re.sub(r"_?4x4$", "", label.strip(), flags=re.IGNORECASE).lower()
    side = {"l_": "left_", "r_": "right_"}.get(name[:2], "")
    part = name[2:] if side else name
    return side + _NAMES.get(part, part)


MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
"""Lists of points that are not positions: programs keep what their models compute (joint angles) as points."""

MOST = 65535
"""Largest count in the header."""
SAME_RATE = 0.02
"""Share by which entries of one frame rate differ at most: 59.94 is 60. None of 80 recordings of many programs has
entries that differ by more."""


@dataclass(frozen=True)
class _Layout:
    """Where the frames are."""

    start: int
    """First byte."""
    frames: int
    """Number of frames."""
    stride: int
    """Bytes in a frame."""
    points: int
    """Points in a frame."""
    word: int
    """Bytes in a word: 4 in a file of floats, 2 in one of integers."""
    first_frame: int
    """Number of the first frame."""
    problems: tuple[Diagnostic, ...]
    """What is wrong with the file's counts."""


def read_c3d(path: Path) -> MarkerSource:
    """Read the markers of a C3D file.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is truncated, is not C3D.
        NoDetections: it holds no markers (but forces, perhaps), or none is ever seen.
    """
    data = np.frombuffer(read_bytes(path), np.uint8)
    parameters = read_parameters(data, path)
    header = read_header(data, parameters.processor)
    layout = _layout(data, header, parameters, path)
    labels = parameters.continued_texts("POINT:LABELS")[: layout.points]
    labels += ("",) * (layout.points - len(labels))
    kept, notes = _positions_only(labels, parameters)
    if not len(kept) and (origins := read_origins(data, parameters)) is not None:
        return _segments(origins, path, parameters)
    positions, residual, problems = _points(data, layout, kept, _scale(header, parameters, path), parameters)
    kind = "float" if layout.word == 4 else "integer"
    rate = header.rate if header.rate > 0 else (parameters.number("POINT:RATE") or header.rate)
    return MarkerSource(
        path=path,
        format=f"C3D ({parameters.processor.name}, {kind})",
        positions=positions,
        labels=tuple(labels[i] for i in kept),
        rate=rate,
        default_unit="mm",
        default_up_axis="z",
        unit=" ".join(parameters.texts("POINT:UNITS")[:1]),
        up_axis=_screen_up(parameters),
        residual=residual,
        first_frame=layout.first_frame,
        analog_channels=_analog_channels(header, parameters),
        notes=notes,
        problems=(*layout.problems, *problems),
        rate_doubts=_contradicted(rate, header, parameters),
    )


def read_segments(path: Path) -> SegmentOrigins | None:
    """Return origins and rotations of the segments that a file holds, None where it holds none.

    Raises:
        FileMissing, FileDamaged: it is not there, is truncated, or is no C3D.
    """
    data = np.frombuffer(read_bytes(path), np.uint8)
    return read_origins(data, read_parameters(data, path))


def _segments(origins: SegmentOrigins, path: Path, parameters: Parameters) -> MarkerSource:
    return MarkerSource(
        path=path,
        format=f"C3D ({parameters.processor.name}, rotations)",
        positions=origins.positions,
        labels=origins.labels,
        rate=origins.rate or parameters.number("POINT:RATE"),
        default_unit="mm",
        default_up_axis="z",
        unit=" ".join(parameters.texts("POINT:UNITS")[:1]),
        up_axis=_screen_up(parameters),
        notes=(diagnostic("points_computed", kind="segments", count=len(origins.labels)),),
    )


def _layout(data: np.ndarray, header: Header, parameters: Parameters, path: Path) -> _Layout:
    """Find the frames; no count is trusted beyond the file's own length.

    Where there are more than ``MOST`` frames and no parameter states it, the header's last frame stays at ``MOST`` or
    begins again at 0: the file's length decides.
    """
    word = 4 if header.scale < 0 or math.isnan(header.scale) else 2
    points = header.points or int(np.clip(parameters.number("POINT:USED") or 0, 0, MOST))
    block = header.data_block or int(parameters.number("POINT:DATA_START") or 0)
    start = (block - 1) * BLOCK if block > 1 else parameters.end
    room = max(len(data) - start, 0)
    claims, first = _frame_counts(header, parameters)
    stride = word * (4 * points + header.analog)
    # Some writers state the channels where the header wants their samples in a frame; then most of the file is left.
    samples = word * (4 * points + len(_analog_channels(header, parameters)) * header.analog_per_channel)
    if max(claims) * stride + BLOCK < room and max(claims) * stride < max(claims) * samples <= room:
        stride = samples
    if not points:
        return _Layout(start, 0, stride, 0, word, first, ())
    complete = room // stride
    fitting = [count for count in claims if 0 < count <= complete]
    frames = max(fitting) if fitting else complete
    if header.last == MOST and frames <= MOST:
        frames = complete
    elif (complete - frames) % (MOST + 1) <= BLOCK // stride:
        frames += (complete - frames) // (MOST + 1) * (MOST + 1)
    if not frames:
        hint = "Export it again."
        raise FileDamaged(f"The file ends before its first frame of {points} points.", where=str(path), hint=hint)
    problems = () if fitting else (diagnostic("count_not_as_stated", items="frames", stated=max(claims), count=frames),)
    return _Layout(start, frames, stride, points, word, first, problems)


def _frame_counts(header: Header, parameters: Parameters) -> tuple[list[int], int]:
    first = header.first
    claims = [header.last - header.first + 1]
    start, end = (parameters.numbers(f"TRIAL:ACTUAL_{name}_FIELD") for name in ("START", "END"))
    if start.size >= 2 and end.size >= 2:
        # Two words, the low one first.
        low, high = (values[0] + 65536 * values[1] for values in (start, end))
        if 0 <= low <= high < 2**32:
            claims.append(int(high - low) + 1)
            first = int(low)
    for name in ("POINT:LONG_FRAMES", "POINT:FRAMES"):
        count = parameters.number(name)
        if count is not None and 0 < count < 2**32:
            claims.append(int(count))
    return [count for count in dict.fromkeys(claims) if count > 0] or [1], first


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
    raise FileDamaged("Neither the header nor POINT:SCALE states a scale.", where=str(path), hint="Export it again.")


def _points(
    data: np.ndarray, layout: _Layout, kept: np.ndarray, scale: float, parameters: Parameters
) -> tuple[np.ndarray, np.ndarray, tuple[Diagnostic, ...]]:
    """Return positions (F, M, 3) and residuals (F, M) of the kept points, NaN where missing, in the file's unit."""
    frames = data[layout.start : layout.start + layout.frames * layout.stride].reshape(layout.frames, layout.stride)
    raw = frames[:, : 4 * layout.word * layout.points]
    decode = floats if layout.word == 4 else integers
    values = decode(raw, parameters.processor).reshape(layout.frames, layout.points, 4)
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


def _positions_only(labels: tuple[str, ...], parameters: Parameters) -> tuple[np.ndarray, tuple[Diagnostic, ...]]:
    outputs = {label for name in MODEL_OUTPUTS for label in parameters.continued_texts(f"POINT:{name}")} - {""}
    kept = [i for i, label in enumerate(labels) if label not in outputs and not is_model_output(label)]
    return np.array(kept, dtype=np.int64), left_out_note(len(labels) - len(kept))


def _screen_up(parameters: Parameters) -> str:
    axes = [" ".join(parameters.texts(f"POINT:{name}_SCREEN")[:1]).lower().lstrip("+") for name in "XY"]
    known = all(axis.lstrip("-") in ("x", "y", "z") for axis in axes)
    return axes[1] if known and axes[0][-1] != axes[1][-1] else ""


def _analog_channels(header: Header, parameters: Parameters) -> tuple[str, ...]:
    used = parameters.number("ANALOG:USED")
    count = int(used) if used is not None else header.analog // max(header.analog_per_channel, 1)
    count = min(max(count, 0), header.analog)
    labels = parameters.continued_texts("ANALOG:LABELS")[:count]
    return tuple(label or f"channel {i}" for i, label in enumerate(labels + ("",) * (count - len(labels)), 1))
