"""A picture as it comes, and what gives pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class LivePicture:
    """A picture of one camera; its pixels are made only if they are asked for."""

    number: int
    """Count of the camera's pictures, from 0."""
    time_s: float
    """Seconds on the clock that all cameras share."""
    arrived: float
    """``time.perf_counter()`` when it came, or when a replay lets it come."""
    rgb: Callable[[], np.ndarray]
    """Returns (H, W, 3) uint8."""


class PictureSource(Protocol):
    """A camera, or a video in the place of one."""

    name: str
    """Of the camera, as the calibration has it."""
    size: tuple[int, int]
    """Width and height, px; known once it is open."""
    fps: float
    """Pictures a second; known once it is open."""

    def open(self) -> None:
        """Connect, so that no picture has to wait for it.

        Raises:
            MocapError: it is not there.
        """
        ...

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield pictures as they come, until the camera ends.

        Args:
            start: ``time.perf_counter()`` at which the shared clock is 0.
        """
        ...

    def close(self) -> None:
        """End; may be called several times, and from another thread."""
        ...
