"""Receive faces from a phone, as packets from Live Link Face (Epic Games) or iFacialMocap.

Live Link Face sends one big-endian datagram per frame. It contains the version 6 (uint8), the names of device and
subject (each after its length as int32), the frame number (int32), its fraction (float32), the rate as numerator and
denominator (int32 each), the number of values (uint8) and the values (float32). These are 52 blend shapes in the order
of Unreal's ``EARFaceBlendShape``, and 9 angles of the head and eyes. A frame without a face ends before the values.

iFacialMocap sends text: ``NAME-VALUE|NAME-VALUE|…|=head#…|rightEye#…|leftEye#…|`` with values from 0 to 100 (developer
page, ifacialmocap.com/for-developer). Facemotion3D writes ``&`` in place of ``-``. The suffixes ``_L`` and ``_R`` are
converted to ARKit's ``Left`` and ``Right``. The angles of the head and the eyes are ignored.
"""

from __future__ import annotations

import itertools
import math
import re
import socket
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

from solver_backend.exchange.events import EventLine, LiveLine, frame_line
from solver_backend.exchange.vmc.sender import IFACIALMOCAP, LIVE_LINK
from solver_backend.live.port import LARGEST_CHANNEL, MOST_CHANNELS, OneSender, rounded_face
from solver_backend.live.recordings import FaceRecorder

VERSION = 6  # Version of Live Link Face packets.
_LONGEST_NAME = 256  # Longest device or subject name in bytes. Chosen by hand.
_NAMES = """
    eyeBlinkLeft eyeLookDownLeft eyeLookInLeft eyeLookOutLeft eyeLookUpLeft eyeSquintLeft eyeWideLeft
    eyeBlinkRight eyeLookDownRight eyeLookInRight eyeLookOutRight eyeLookUpRight eyeSquintRight eyeWideRight
    jawForward jawLeft jawRight jawOpen mouthClose mouthFunnel mouthPucker mouthLeft mouthRight
    mouthSmileLeft mouthSmileRight mouthFrownLeft mouthFrownRight mouthDimpleLeft mouthDimpleRight
    mouthStretchLeft mouthStretchRight mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper
    mouthPressLeft mouthPressRight mouthLowerDownLeft mouthLowerDownRight mouthUpperUpLeft mouthUpperUpRight
    browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight
    cheekPuff cheekSquintLeft cheekSquintRight noseSneerLeft noseSneerRight tongueOut
"""
BLEND_SHAPES = tuple(_NAMES.split())  # ARKit's 52 names, in the order used in the packets.
_PAIR = re.compile(r"(\w{1,64})[-&](-?\d{1,6}(?:\.\d{1,9})?)")
_SIDE = re.compile(r"_[LR]$")


class FacePacketInvalid(ValueError):
    """Raised for a packet that is not in the app's format."""


class FacePacket(NamedTuple):
    """Content of one face packet."""

    channels: dict[str, float]  # Value of each channel, usually 0 to 1. Empty if the app sees no face.
    time: float | None = None  # Seconds on the app's clock, or None if it has no clock.


def decode_live_link(packet: bytes) -> FacePacket:
    """Decode a packet from Live Link Face. Raise ``FacePacketInvalid`` if its format is different."""
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
        raise FacePacketInvalid("it is truncated") from error
    seconds = None
    if numerator > 0 and denominator > 0 and math.isfinite(part) and abs(part) <= 1.0:
        seconds = (number + part) * denominator / numerator
    if not count:
        return FacePacket({}, seconds)
    if count < len(BLEND_SHAPES):
        raise FacePacketInvalid(f"it has {count} values, but a face has {len(BLEND_SHAPES)}")
    if not all(abs(value) < LARGEST_CHANNEL for value in values[: len(BLEND_SHAPES)]):  # NaN fails this test
        raise FacePacketInvalid("a value is not valid")
    return FacePacket(dict(zip(BLEND_SHAPES, values, strict=False)), seconds)


def decode_ifacialmocap(packet: bytes) -> FacePacket:
    """Decode a packet from iFacialMocap. Raise ``FacePacketInvalid`` if its format is different."""
    try:
        text = packet.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FacePacketInvalid("it is not text") from error
    face = text.partition("=head#")[0].partition("=")[0]
    pairs = [pair for pair in face.split("|") if pair]
    found = [_PAIR.fullmatch(pair) for pair in pairs]
    if not pairs or len(pairs) > MOST_CHANNELS or None in found:
        raise FacePacketInvalid("it is not a list of names and values")
    sides = {"_L": "Left", "_R": "Right"}
    channels = {_SIDE.sub(lambda end: sides[end[0]], m[1]): float(m[2]) / 100.0 for m in filter(None, found)}
    if not all(abs(value) < LARGEST_CHANNEL for value in channels.values()):
        raise FacePacketInvalid("a value is not valid")
    channels.pop("trackingStatus", None)
    return FacePacket(channels)


REQUEST = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719"
"""Packet that asks the app to start sending (ifacialmocap.com/for-developer)."""
_DECODERS: dict[str, Callable[[bytes], FacePacket]] = {LIVE_LINK: decode_live_link, IFACIALMOCAP: decode_ifacialmocap}


class FaceFrame(NamedTuple):
    """Face channels in one frame of a live stream."""

    time: float  # Seconds since the first frame.
    arrived: float  # ``time.perf_counter()`` on arrival.
    channels: dict[str, float]  # Value of each channel. Empty if no face is seen.


class FaceAssembly(OneSender[FacePacket, FaceFrame]):
    """Decoder for the packets of one phone. It drops late, repeated and invalid packets."""

    words = "Another phone is ignored while the first one sends.", "A packet is not from this app"

    def __init__(self, scheme: str) -> None:
        super().__init__()
        self._scheme = scheme

    def _decode(self, packet: bytes) -> FacePacket:
        return _DECODERS[self._scheme](packet)

    def _frames(self, content: FacePacket, packet: bytes, arrived: float) -> Iterator[FaceFrame]:
        # An app that has no clock sends identical packets while a face is still.
        if self._scheme != LIVE_LINK or self.is_next(packet, content.time):
            yield FaceFrame(self.pass_time(content.time, arrived), arrived, content.channels)


def ask_phone(host: str, port: int) -> Callable[[socket.socket], None]:
    """Return a callback for ``listen`` that asks iFacialMocap on a phone to start sending."""

    def ask(there: socket.socket) -> None:
        with suppress(OSError):
            there.sendto(REQUEST, (host, port))

    return ask


def face_lines(found: Iterable[FaceFrame | EventLine], recorder: FaceRecorder | None = None) -> Iterator[LiveLine]:
    """Yield output lines for the frames and events from ``listen``. A recorder, if given, stores each frame first."""
    number = itertools.count()
    for item in found:
        if isinstance(item, dict):
            yield item
            continue
        if recorder is not None and item.channels:
            recorder.add(item.time, item.channels)
        lag_s = time.perf_counter() - item.arrived
        state, shown = "no_person", {"why": "the phone does not see a face"}
        if item.channels:
            state, shown = "tracking", {"face": rounded_face(item.channels)}
        yield frame_line(next(number), item.time, state, lag_s, lag_s, points=0, **shown)
