"""A receiver of the protocol written from its pages and from OSC 1.0 alone; nothing of the product is used."""

from __future__ import annotations

import socket
import struct
import threading
from dataclasses import dataclass, field

import numpy as np

PARENT_OF = {
    "Spine": "Hips", "Chest": "Spine", "UpperChest": "Chest", "Neck": "UpperChest", "Head": "Neck",
    "Jaw": "Head", "LeftEye": "Head", "RightEye": "Head",
    **{
        f"{side}{bone}": parent if parent in ("Hips", "UpperChest") else f"{side}{parent}"
        for side in ("Left", "Right")
        for bone, parent in {
            "UpperLeg": "Hips", "LowerLeg": "UpperLeg", "Foot": "LowerLeg", "Toes": "Foot", "Shoulder": "UpperChest",
            "UpperArm": "Shoulder", "LowerArm": "UpperArm", "Hand": "LowerArm",
            **{f"{finger}Proximal": "Hand" for finger in ("Thumb", "Index", "Middle", "Ring", "Little")},
            **{f"{finger}Intermediate": f"{finger}Proximal"
               for finger in ("Thumb", "Index", "Middle", "Ring", "Little")},
            **{f"{finger}Distal": f"{finger}Intermediate"
               for finger in ("Thumb", "Index", "Middle", "Ring", "Little")},
        }.items()
    },
}  # fmt: skip
"""Unity's avatar definition."""


def texts_and_numbers(message: bytes) -> tuple[str, list]:
    """Return the address and the arguments of an OSC message."""

    def text(at: int) -> tuple[str, int]:
        end = message.index(b"\0", at)
        return message[at:end].decode(), at + 4 * ((end - at) // 4 + 1)

    address, at = text(0)
    tags, at = text(at)
    assert tags[0] == ","
    values: list = []
    for tag in tags[1:]:
        if tag == "s":
            value, at = text(at)
        else:
            (value,) = struct.unpack_from({"i": "!i", "f": "!f"}[tag], message, at)
            at += 4
        values.append(value)
    assert at == len(message)
    return address, values


def messages_of(bundle: bytes) -> list[tuple[str, list]]:
    """Return the messages of an OSC bundle."""
    assert bundle[:16] == b"#bundle\0" + bytes(7) + b"\x01"
    found, at = [], 16
    while at < len(bundle):
        (size,) = struct.unpack_from("!i", bundle, at)
        found.append(texts_and_numbers(bundle[at + 4 : at + 4 + size]))
        at += 4 + size
    assert at == len(bundle)
    return found


def matrix_of(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return Unity's rotation of a quaternion: (3, 3), for column vectors of its left-handed axes."""
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass
class Avatar:
    """What a frame says, and where it puts the bones of an avatar that has the sender's proportions."""

    available: int = 0
    time: float = float("nan")
    local: dict[str, np.ndarray] = field(default_factory=dict)
    """(3, 3) rotation of each bone."""
    offset: dict[str, np.ndarray] = field(default_factory=dict)
    """(3,) metres of each bone."""

    def receive(self, bundle: bytes) -> Avatar:
        """Take a bundle in."""
        for address, values in messages_of(bundle):
            if address == "/VMC/Ext/OK":
                self.available = values[0]
            elif address == "/VMC/Ext/T":
                self.time = values[0]
            else:
                assert address in ("/VMC/Ext/Root/Pos", "/VMC/Ext/Bone/Pos")
                self.local[values[0]] = matrix_of(*values[4:8])
                self.offset[values[0]] = np.array(values[1:4])
        return self

    def world(self, bone: str) -> tuple[np.ndarray, np.ndarray]:
        """Return a bone's rotation and place in Unity's world."""
        if bone == "root":
            return self.local[bone], self.offset[bone]
        R, p = self.world("root" if bone == "Hips" else PARENT_OF[bone])
        return R @ self.local[bone], p + R @ self.offset[bone]


class Receiver:
    """Everything that comes to a port of this machine, in the order of its coming."""

    def __init__(self, port: int = 0) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind(("127.0.0.1", port))
        self.port = self.socket.getsockname()[1]
        self.packets: list[bytes] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The address that it is reached at."""
        return f"vmc://127.0.0.1:{self.port}"

    def _listen(self) -> None:
        while packet := self.socket.recv(65536):
            self.packets.append(packet)

    def close(self) -> list[bytes]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join(5.0)
        self.socket.close()
        return self.packets
