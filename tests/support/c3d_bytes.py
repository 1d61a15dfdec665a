"""C3D files written byte by byte, by the format's definition and by nothing of the product."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

INTEL, DEC, MIPS = 84, 85, 86
Value = tuple[int, Sequence[int], bytes]


@dataclass
class C3dBytes:
    """A file to be: points in the file's unit with a residual of -1 where missing, and whatever else a test sets."""

    points: np.ndarray
    labels: Sequence[str]
    processor: int = INTEL
    floating: bool = True
    scale: float = 0.1
    rate: float = 100.0
    fourth: np.ndarray | None = None
    units: str | None = "mm"
    screen: tuple[str, str] | None = ("+X", "+Z")
    first: int = 1
    last: int | None = None
    channels: Sequence[str] = ()
    samples: int = 1
    header_events: Sequence[tuple[str, float]] = ()
    more: dict[str, dict[str, Value]] = field(default_factory=dict)
    locked: bool = False

    def real(self, *values: float) -> bytes:
        """Return floats as the processor writes them."""
        if self.processor == DEC:
            words = (np.asarray(values, "<f4") * np.float32(4)).view("<u2")
            return words.reshape(-1, 2)[:, ::-1].tobytes()
        return struct.pack(f"{self.order}{len(values)}f", *values)

    def whole(self, *values: int) -> bytes:
        """Return 16-bit integers as the processor writes them."""
        return struct.pack(f"{self.order}{len(values)}H", *(value & 0xFFFF for value in values))

    @property
    def order(self) -> str:
        return ">" if self.processor == MIPS else "<"

    def text(self, texts: Sequence[str]) -> Value:
        length = max((len(text.encode()) for text in texts), default=1) or 1
        return -1, (length, len(texts)), b"".join(text.encode().ljust(length) for text in texts)

    def ints(self, *values: int) -> Value:
        return 2, (len(values),), self.whole(*values)

    def reals(self, *values: float) -> Value:
        return 4, (len(values),), self.real(*values)

    def records(self, data_block: int) -> bytes:
        scale = -self.scale if self.floating else self.scale
        point: dict[str, Value] = {
            "USED": self.ints(len(self.labels)),
            "SCALE": self.reals(scale),
            "RATE": self.reals(self.rate),
            "DATA_START": self.ints(data_block),
            "FRAMES": self.ints(min(len(self.points), 65535)),
        }
        for part in range(0, max(len(self.labels), 1), 255):
            name = f"LABELS{part // 255 + 1}" if part else "LABELS"
            point[name] = self.text(list(self.labels[part : part + 255]))
        if self.units is not None:
            point["UNITS"] = self.text([self.units])
        if self.screen is not None:
            point["X_SCREEN"], point["Y_SCREEN"] = (self.text([axis]) for axis in self.screen)
        groups = {"POINT": point}
        if self.channels:
            groups["ANALOG"] = {"USED": self.ints(len(self.channels)), "LABELS": self.text(list(self.channels))}
        for group, parameters in self.more.items():
            groups[group] = groups.get(group, {}) | parameters
        chain = [(-i, name, b"\x03abc") for i, name in enumerate(groups, 1)]
        for i, parameters in enumerate(groups.values(), 1):
            for name, (kind, sizes, data) in parameters.items():
                chain.append((i, name, struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0"))
        out = b""
        for k, (group, name, body) in enumerate(chain):
            length = -len(name) if self.locked else len(name)
            step = 0 if k + 1 == len(chain) else len(body) + 2
            out += struct.pack("<bb", length, group) + name.encode() + self.whole(step) + body
        return out

    def frames(self) -> bytes:
        frames, markers = self.points.shape[:2]
        fourth = np.zeros((frames, markers)) if self.fourth is None else self.fourth
        words = np.concatenate([self.points, fourth[..., None]], axis=-1)
        if not self.floating:
            words = np.concatenate([np.rint(self.points / self.scale), fourth[..., None]], axis=-1)
        analog = np.full((frames, len(self.channels) * self.samples), 7.0)
        words = np.concatenate([words.reshape(frames, 4 * markers), analog], axis=1).ravel()
        if self.floating:
            return self.real(*words.tolist())
        return self.whole(*words.astype(int).tolist())

    def to_bytes(self) -> bytes:
        frames, markers = self.points.shape[:2]
        blocks = -(-(len(self.records(0)) + 4) // 512)
        last = self.first + frames - 1 if self.last is None else self.last
        head = bytes([2, 0x50]) + self.whole(
            markers, len(self.channels) * self.samples, self.first, min(last, 65535), 0
        )
        head += self.real(-self.scale if self.floating else self.scale)
        head += self.whole(2 + blocks, self.samples if self.channels else 0) + self.real(self.rate)
        head = head.ljust(298, b"\0") + self.whole(12345, len(self.header_events), 0)
        head += self.real(*[time for _, time in self.header_events]).ljust(72, b"\0") + bytes(18) + bytes(2)
        head += b"".join(label.encode().ljust(4) for label, _ in self.header_events)
        section = bytes([1, 0x50, blocks, self.processor]) + self.records(2 + blocks)
        return head.ljust(512, b"\0") + section.ljust(512 * blocks, b"\0") + self.frames()
