"""Header and parameter section of a C3D file.

Source: the C3D file format user guide (Motion Lab Systems, c3d.org). A file is made of blocks of 512 bytes, counted
from 1. The header is block 1; its first byte is the block of the parameter section, its second is 0x50. Parameters are
a chain of records, each with the distance to the next, so unknown ones and descriptions are stepped over. Real files
break most of the rules; what bytes state is trusted only as far as the file reaches.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged


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
