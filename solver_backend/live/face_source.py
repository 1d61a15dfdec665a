"""Receive faces that a phone sends: packets of Live Link Face (Epic Games) and iFacialMocap.

Live Link Face sends one datagram per frame, big-endian. It holds the version 6 (uint8), the device's and the subject's
names (each with its length as int32), the frame number (int32), its fraction (float32), the rate as numerator and
denominator (int32 each), the number of values (uint8) and the values (float32). These are 52 blend shapes in the order
of Unreal's ``EARFaceBlendShape``, and 9 angles of head and eyes. A frame without a face ends before the values.

iFacialMocap sends text: ``NAME-VALUE|NAME-VALUE|…|=head#…|rightEye#…|leftEye#…|`` with values of 0 to 100 (its page for
developers, ifacialmocap.com/for-developer). Facemotion3D writes ``&`` for ``-``. The suffixes ``_L`` and ``_R`` become
ARKit's ``Left`` and ``Right``. Angles of head and eyes are not read.
"""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from solver_backend.exchange.live_lines import EventLine, LiveLine, frame_line
from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.vmc.sender import IFACIALMOCAP, LIVE_LINK
from solver_backend.live.port import JUMP_S, OneSender
from solver_backend.live.recordings import FaceRecorder

VERSION = 6
"""Of Live Link Face's packets."""
_LONGEST_NAME, _MOST_CHANNELS = 256, 256
"""Bytes of a device's or subject's name, and channels of a packet, that are read at most."""
_LARGEST = 10.0
"""No channel has a value as large."""
_OF_EYE = ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")


def _both(*stems: str) -> tuple[str, ...]:
    return tuple(f"{stem}{side}" for stem in stems for side in ("Left", "Right"))


BLEND_SHAPES = (
    *(f"eye{part}{side}" for side in ("Left", "Right") for part in _OF_EYE),
    "jawForward", "jawLeft", "jawRight", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft",
    "mouthRight", *_both("mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch"),
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper",
    *_both("mouthPress", "mouthLowerDown", "mouthUpperUp", "browDown"), "browInnerUp", *_both("browOuterUp"),
    "cheekPuff", *_both("cheekSquint", "noseSneer"), "tongueOut",
)  # fmt: skip
"""ARKit's names of the 52 in the packets' order."""
_PAIR = re.compile(r"(\w{1,64})[-&](-?\d{1,6}(?:\.\d{1,9})?)")
_SIDES = {"_L": "Left", "_R": "Right"}
_NOT_CHANNELS = ("trackingStatus",)


class FacePacketInvalid(ValueError):
    """A packet is none of the app's."""


@dataclass(frozen=True)
class FacePacket:
    """A face at a moment."""

    channels: dict[str, float]
    """Value of each channel, 0 to 1 as a rule; {} where the app sees no face."""
    time: float | None = None
    """Seconds on the app's clock, None where it has none."""


def decode_live_link(packet: bytes) -> FacePacket:
    """Return what a packet of Live Link Face holds.

    Raises:
        FacePacketInvalid: it is cut, or of another kind or version.
    """
    if packet[:1] != bytes([VERSION]):
        raise FacePacketInvalid(f"it does not begin with the version {VERSION}")
    at = 1
    try:
        for _ in ("device", "subject"):
            (length,) = struct.unpack_from(">i", packet, at)
            if not 0 <= length <= _LONGEST_NAME:
                raise FacePacketInvalid(f"a name has {length} bytes")
            at += 4 + length
        number, part, numerator, denominator = struct.unpack_from(">ifii", packet, at)
        at += 16
        count = packet[at] if at < len(packet) else 0
        values = struct.unpack_from(f">{count}f", packet, at + 1)
    except struct.error as error:
        raise FacePacketInvalid("it is cut") from error
    seconds = None
    if numerator > 0 and denominator > 0 and math.isfinite(part) and abs(part) <= 1.0:
        seconds = (number + part) * denominator / numerator
    if not count:
        return FacePacket({}, seconds)
    if count < len(BLEND_SHAPES):
        raise FacePacketInvalid(f"it has {count} values, and a face has {len(BLEND_SHAPES)}")
    if not all(abs(value) < _LARGEST for value in values[: len(BLEND_SHAPES)]):  # NaN is not
        raise FacePacketInvalid("a value is not valid")
    return FacePacket(dict(zip(BLEND_SHAPES, values, strict=False)), seconds)


def decode_ifacialmocap(packet: bytes) -> FacePacket:
    """Return what a packet of iFacialMocap holds.

    Raises:
        FacePacketInvalid: it is not text of its form.
    """
    try:
        text = packet.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FacePacketInvalid("it is not text") from error
    face = text.partition("=head#")[0].partition("=")[0]
    pairs = [pair for pair in face.split("|") if pair]
    found = [_PAIR.fullmatch(pair) for pair in pairs]
    if not pairs or len(pairs) > _MOST_CHANNELS or None in found:
        raise FacePacketInvalid("it is not a list of names and values")
    channels = {_with_side(match[1]): float(match[2]) / 100.0 for match in found if match is not None}
    if not all(abs(value) < _LARGEST for value in channels.values()):
        raise FacePacketInvalid("a value is not valid")
    return FacePacket({name: value for name, value in channels.items() if name not in _NOT_CHANNELS})


def _with_side(name: str) -> str:
    return f"{name[:-2]}{_SIDES[name[-2:]]}" if name[-2:] in _SIDES else name


REQUEST = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719"
"""Request that makes the app send (ifacialmocap.com/for-developer)."""
_DECODERS: dict[str, Callable[[bytes], FacePacket]] = {LIVE_LINK: decode_live_link, IFACIALMOCAP: decode_ifacialmocap}


@dataclass(frozen=True)
class FaceFrame:
    """A face at a moment."""

    time: float
    arrived: float
    """``time.perf_counter()`` when it came."""
    channels: dict[str, float]
    """Value of each channel; {} where no face is seen."""


class FaceAssembly(OneSender):
    """Frames of one phone. Packets of others, late, doubled and hostile ones are skipped."""

    def __init__(self, scheme: str) -> None:
        super().__init__()
        self._decode, self._has_clock = _DECODERS[scheme], scheme == LIVE_LINK
        self._before: tuple[float | None, float] | None = None
        self._time = 0.0

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[FaceFrame]:
        """Yield the frame of a packet, if it is one.

        Args:
            arrived: ``time.perf_counter()``.
        """
        if self.is_other(sender, arrived):
            return self.name_once("second_sender", "Another phone is ignored while the first one sends.")
        try:
            found = self._decode(packet)
        except FacePacketInvalid as error:
            return self.name_once("packet_invalid", f"A packet is not one of this app's: {plain(str(error))}.")
        if sender != self._sender:
            self._sender, self._packets, self._clock, self._before = sender, [], None, None
        self._heard = arrived
        if self._has_clock and not self.is_next(packet, found.time):  # without a clock, alike ones are a face
            return
        if self._before is not None:
            clock, came = self._before
            passed = arrived - came
            if clock is not None and found.time is not None and 0.0 < found.time - clock < JUMP_S:
                passed = found.time - clock
            self._time += max(passed, 0.0)
        self._before = (found.time, arrived)
        yield FaceFrame(self._time, arrived, found.channels)


def ask_phone(host: str, port: int) -> Callable[[Any], None]:
    """Return what asks iFacialMocap on a phone, by a socket, to send. A phone that is away is asked again later."""

    def ask(there: Any) -> None:
        with suppress(OSError):
            there.sendto(REQUEST, (host, port))

    return ask


def face_lines(found: Iterable[FaceFrame | EventLine], recorder: FaceRecorder | None = None) -> Iterator[LiveLine]:
    """Yield the lines of a live run of a face. Frames are recorded before.

    Args:
        found: what ``listen`` yields.
    """
    number = 0
    for item in found:
        if isinstance(item, dict):
            yield item
            continue
        if recorder is not None and item.channels:
            recorder.add(item.time, item.channels)
        lag_s = time.perf_counter() - item.arrived
        state, shown = "no_person", {"why": "the phone sees no face"}
        if item.channels:
            state, shown = "tracking", {"face": {name: round(value, 4) for name, value in item.channels.items()}}
        yield frame_line(number, item.time, state, lag_s, lag_s, points=0, **shown)
        number += 1
