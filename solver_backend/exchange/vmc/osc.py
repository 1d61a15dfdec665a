"""Encode and decode Open Sound Control 1.0 messages and bundles (Wright 2002)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .humanoid import Humanoid

Value = int | float | str | bytes | bool | None

IMMEDIATELY = 1  # Time tag of a bundle that takes effect immediately.
LONGEST = 65507  # Largest payload of a UDP datagram over IPv4 in bytes.
_BUNDLE = b"#bundle\0"
_DEEPEST = 8  # Largest depth of nested bundles that is read. Programs send at most two levels.


class PacketInvalid(ValueError):
    """A packet is not valid Open Sound Control."""


@dataclass(frozen=True)
class OscMessage:
    """An Open Sound Control message: an address and its arguments."""

    address: str
    values: tuple[Value, ...]


def encode_message(address: str, values: Sequence[Value] = ()) -> bytes:
    """Encode a message as address, type tags and arguments, each padded to 4 bytes, big-endian.

    Raises:
        ValueError: a text contains a null character, or an int does not fit in 32 bits.
    """
    tags, content = ",", b""
    for value in values:
        if value is None or isinstance(value, bool):
            tags += "N" if value is None else "T" if value else "F"
        elif isinstance(value, int):
            tags, content = tags + "i", content + _packed(">i", value)
        elif isinstance(value, float):
            tags, content = tags + "f", content + struct.pack(">f", value)
        elif isinstance(value, str):
            tags, content = tags + "s", content + _text(value)
        else:
            tags, content = tags + "b", content + struct.pack(">i", len(value)) + _padded(value)
    return _text(address) + _text(tags) + content


def encode_bundle(elements: Sequence[bytes]) -> bytes:
    """Encode a bundle that contains encoded messages or bundles."""
    parts = [struct.pack(">i", len(element)) + element for element in elements]
    return b"".join([_BUNDLE, struct.pack(">Q", IMMEDIATELY), *parts])


def decode_packet(packet: bytes) -> list[OscMessage]:
    """Return the messages in an Open Sound Control packet in order, without time tags.

    Raises:
        PacketInvalid: it is truncated, or not Open Sound Control.
    """
    found: list[OscMessage] = []
    waiting = [(packet, 0)]
    while waiting:
        element, depth = waiting.pop()
        if not element.startswith(_BUNDLE):
            found.append(_message(element))
            continue
        if depth == _DEEPEST:
            raise PacketInvalid(f"bundles are more than {_DEEPEST} deep")
        waiting += [(part, depth + 1) for part in reversed(_elements(element))]
    return found


def _elements(bundle: bytes) -> list[bytes]:
    if len(bundle) < 16:
        raise PacketInvalid("a bundle's header is truncated")
    elements, at = [], 16
    while at < len(bundle):
        (size,) = _unpacked(">i", bundle, at)
        if size <= 0 or size % 4 or at + 4 + size > len(bundle):
            raise PacketInvalid(f"an element of {size} bytes does not fit in its bundle")
        elements.append(bundle[at + 4 : at + 4 + size])
        at += 4 + size
    return elements


def _message(element: bytes) -> OscMessage:
    address, at = _read_text(element, 0)
    if not address.startswith("/"):
        raise PacketInvalid("an address does not begin with /")
    if at == len(element):  # old senders omit the tags if there are no arguments
        return OscMessage(address, ())
    tags, at = _read_text(element, at)
    if not tags.startswith(","):
        raise PacketInvalid(f"{address} has no type tags")
    values: list[Value] = []
    for tag in tags[1:]:
        value, at = _argument(tag, element, at)
        values.append(value)
    return OscMessage(address, tuple(values))


def _argument(tag: str, element: bytes, at: int) -> tuple[Value, int]:
    if tag in _NUMBERS:
        layout = _NUMBERS[tag]
        return _unpacked(layout, element, at)[0], at + struct.calcsize(layout)
    if tag in _CONSTANTS:
        return _CONSTANTS[tag], at
    if tag in "sS":
        return _read_text(element, at)
    if tag == "b":
        (size,) = _unpacked(">i", element, at)
        end = at + 4 + size
        if size < 0 or end > len(element):
            raise PacketInvalid(f"a blob of {size} bytes does not fit in its message")
        return element[at + 4 : end], end + -size % 4
    raise PacketInvalid(f"the type tag {tag!r} is unknown")


_NUMBERS = {"i": ">i", "f": ">f", "h": ">q", "d": ">d", "t": ">Q", "c": ">I", "r": ">I", "m": ">I"}
_CONSTANTS: dict[str, Value] = {"T": True, "F": False, "N": None, "I": float("inf")}


def _read_text(element: bytes, at: int) -> tuple[str, int]:
    end = element.find(b"\0", at)
    if end < 0:
        raise PacketInvalid("a string has no end")
    after = end + 4 - (end - at) % 4
    if after > len(element):
        raise PacketInvalid("a string's padding is truncated")
    return element[at:end].decode("utf-8", "replace"), after


def _unpacked(layout: str, element: bytes, at: int) -> tuple[Any, ...]:
    try:
        return struct.unpack_from(layout, element, at)
    except struct.error as error:
        raise PacketInvalid("a number is truncated") from error


def _packed(layout: str, value: int) -> bytes:
    try:
        return struct.pack(layout, value)
    except struct.error as error:
        raise ValueError(f"{value} does not fit in 32 bits") from error


def _text(text: str) -> bytes:
    if "\0" in text:
        raise ValueError("an Open Sound Control string cannot contain a null character")
    return _padded(text.encode() + b"\0")


def _padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 4)


OK, TIME, ROOT, BONE = "/VMC/Ext/OK", "/VMC/Ext/T", "/VMC/Ext/Root/Pos", "/VMC/Ext/Bone/Pos"
_UNTURNED = (0.0, 0.0, 0.0, 1.0)
_XYZW = [1, 2, 3, 0]
"""Columns of a quaternion w x y z in VMC's order."""


class FrameBundle:
    """Builds VMC bundles for a humanoid. Only the numbers change between bundles.

    The root stays at the world's origin without rotation, and the hips follow the path. Bones have their T-pose
    positions relative to their parents.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        self.humanoid = humanoid
        numbers = np.concatenate([humanoid.offsets, np.tile(_UNTURNED, (len(humanoid.bones), 1))], axis=1)
        bones = [
            encode_message(BONE, [name, *values]) for name, values in zip(humanoid.bones, numbers.tolist(), strict=True)
        ]
        root = encode_message(ROOT, ["root", 0.0, 0.0, 0.0, *_UNTURNED])
        elements = [encode_message(OK, [1]), encode_message(TIME, [0.0]), root, *bones]
        self._bytes = np.frombuffer(encode_bundle(elements), np.uint8).copy()
        # The numbers of an element are its last bytes. Each element is preceded by its size.
        ends = 16 + np.cumsum([4 + len(element) for element in elements])
        self._time = slice(ends[1] - 4, ends[1])
        self._hips = slice(ends[3] - 28, ends[3] - 16)
        self._turns = (ends[3:, None] - 16 + np.arange(16)).ravel()

    def encode(self, time_s: float, rotvec: np.ndarray, transl: np.ndarray) -> bytes:
        """Encode a pose as a bundle. ``rotvec`` (n, 3) rotates the first n joints. All other joints are at rest."""
        quat, hips = self.humanoid.to_unity(rotvec, transl)
        self._bytes[self._time] = _big_endian(np.array([time_s]))
        self._bytes[self._hips] = _big_endian(hips)
        self._bytes[self._turns] = _big_endian(quat[:, _XYZW])
        return self._bytes.tobytes()


def _big_endian(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, ">f4").reshape(-1).view(np.uint8)
