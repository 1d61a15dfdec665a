"""Packets of the VMC protocol become frames of bones; whatever else comes is named once and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.exchange.plain_text import plain
from solver_backend.exchange.vmc.bones import JOINT_OF
from solver_backend.exchange.vmc.bundle import BONE, ROOT, TIME
from solver_backend.exchange.vmc.osc import OscMessage, PacketInvalid, decode_packet
from solver_backend.live.named_once import JUMP_S, OneSender

FARTHEST_M = 1e4
"""No person is farther from the origin, in metres."""
FACE = "/VMC/Ext/Blend/Val"
MOST_CHANNELS = 256
"""Channels of a face that are kept; ARKit has 52."""
_LARGEST = 10.0
"""No channel has a value as large."""
_LONGEST_NAME = 40
"""Letters of a foreign name that are shown; chosen by hand."""
_FINGERS = ("Thumb", "Index", "Middle", "Ring", "Little")


@dataclass(frozen=True)
class BoneFrame:
    """Unity's humanoid at a moment, as the sender has it."""

    time: float
    """Seconds since the first frame, on the sender's clock where it has one."""
    arrived: float
    """``time.perf_counter()`` when its last packet came."""
    quat: dict[str, np.ndarray]
    """(4,) unit quaternion wxyz of each bone that was heard, relative to its parent."""
    place: dict[str, np.ndarray]
    """(3,) metres of the same bones, relative to their parents."""
    root: tuple[np.ndarray, np.ndarray]
    """Unit quaternion wxyz and (3,) metres of the root, in Unity's world."""
    face: dict[str, float]
    """Value of each channel of the face, of a sender that has some; 0 to 1 as a rule."""


class FrameAssembly(OneSender):
    """Gathers the bones of one sender; a frame is whole when every bone of the last one, or one of them twice, came."""

    def __init__(self) -> None:
        super().__init__()
        self._sender: Any = None
        self._heard = -math.inf
        self._packets: list[bytes] = []
        self._forget()

    def _forget(self) -> None:
        self._clock: float | None = None
        self._quat: dict[str, np.ndarray] = {}
        self._place: dict[str, np.ndarray] = {}
        self._root = (np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
        self._face: dict[str, float] = {}
        self._came: set[str] = set()
        self._whole: frozenset[str] = frozenset()
        self._begun: tuple[float | None, float] = (None, 0.0)
        self._last: tuple[float | None, float] | None = None
        self._time = 0.0

    def take(self, packet: bytes, sender: Any, arrived: float) -> Iterator[BoneFrame]:
        """Yield the frames that a packet makes whole.

        Args:
            packet: a datagram.
            sender: whose it is; frames are of one sender at a time.
            arrived: ``time.perf_counter()``.
        """
        if self.is_other(sender, arrived):  # at once: it may send without end
            return self.name_once("second_sender", "Another sender is ignored while the first one sends.")
        try:
            messages = decode_packet(packet)
        except PacketInvalid as error:
            return self.name_once("packet_invalid", f"A packet is not Open Sound Control: {error}.")
        if not self._is_ours(messages, sender, arrived) or not self._is_next(messages, packet):
            return
        for message in messages:
            if message.address == BONE:
                if (bone := self._bone(message)) is not None:
                    if bone[0] in self._came:
                        yield self._frame()
                    self._add(bone, arrived)
            elif message.address == ROOT:
                if (root := self._numbers(message)) is not None:
                    self._root = root
            elif message.address == FACE:
                self._add_face(message)
            elif not message.address.startswith("/VMC/"):
                self.name_once("message_unknown", f"A message is not of the protocol: {_shown(message.address)}.")
        if self._whole and self._came >= self._whole:
            yield self._frame()

    def _is_ours(self, messages: Sequence[OscMessage], sender: Any, arrived: float) -> bool:
        """Return whether a packet is of the sender who is heard; one with bones takes over from one who is gone."""
        if sender != self._sender:
            if not any(message.address == BONE for message in messages):
                return False
            self._sender, self._packets = sender, []
            self._forget()
        self._heard = arrived
        return True

    def _is_next(self, messages: Sequence[OscMessage], packet: bytes) -> bool:
        """Return whether a packet comes after those before it, by its clock, and was not there already."""
        times = [m.values[0] for m in messages if m.address == TIME and m.values and isinstance(m.values[0], float)]
        clock = next((time for time in times if math.isfinite(time)), None)
        return clock is None or self.is_next(packet, clock)

    def _bone(self, message: OscMessage) -> tuple[str, np.ndarray, np.ndarray] | None:
        name = message.values[0] if message.values else None
        if not isinstance(name, str) or name not in JOINT_OF:
            return self.name_once("bone_unknown", f"A bone is not one of Unity's: {_shown(name)}.")
        numbers = self._numbers(message)
        return None if numbers is None else (name, *numbers)

    def _numbers(self, message: OscMessage) -> tuple[np.ndarray, np.ndarray] | None:
        """Return rotation wxyz and place of a message's seven numbers, None where they cannot be."""
        values = [v for v in message.values[1:8] if isinstance(v, float | int) and not isinstance(v, bool)]
        numbers = np.array(values if len(values) == 7 else [math.nan], np.float64)
        good = bool(np.isfinite(numbers).all()) and bool((np.abs(numbers) < FARTHEST_M).all())
        length = float(np.linalg.norm(numbers[3:])) if good else 0.0
        if not 0.5 < length < 2.0:
            return self.name_once(
                "numbers_impossible", f"The numbers of {_shown(message.values[:1])} are not possible."
            )
        return numbers[[6, 3, 4, 5]] / length, numbers[:3]

    def _add(self, bone: tuple[str, np.ndarray, np.ndarray], arrived: float) -> None:
        name, quat, place = bone
        if not self._came:
            self._begun = (self._clock, arrived)
        self._came.add(name)
        self._quat[name], self._place[name] = quat, place

    def _add_face(self, message: OscMessage) -> None:
        name, value = (*message.values, None, None)[:2]
        if isinstance(name, str) and isinstance(value, float) and abs(value) < _LARGEST:  # NaN is not
            channel = name[:_LONGEST_NAME]
            if len(self._face) < MOST_CHANNELS or channel in self._face:
                self._face[channel] = value
                return
        self.name_once("face_impossible", f"A channel of the face is impossible, or one too many: {_shown(name)}.")

    def _frame(self) -> BoneFrame:
        """Return what came as a frame, and begin the next."""
        clock, arrived = self._begun
        if self._last is not None:
            before, arrived_before = self._last
            passed = arrived - arrived_before
            if clock is not None and before is not None and clock > before and abs(clock - before - passed) < JUMP_S:
                passed = clock - before
            self._time += max(passed, 0.0)
        self._last, self._whole = self._begun, frozenset(self._came)
        self._came.clear()
        return BoneFrame(self._time, arrived, dict(self._quat), dict(self._place), self._root, dict(self._face))


def has_fingers(frame: BoneFrame) -> bool:
    """Return whether the sender moves fingers."""
    return any(finger in bone for bone in frame.quat for finger in _FINGERS)


def _shown(name: object) -> str:
    return plain(str(name)[:_LONGEST_NAME])
