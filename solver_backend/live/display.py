"""What a line holds for a display beside the pose: points, and how unsure each of them and each joint is."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from solver_backend.exchange.live_lines import FrameLine
from solver_backend.fitters.recipes.live import PersonFollower
from solver_backend.live.pose_lines import millimetres


class Shown(Protocol):
    """A live session, as a display sees it."""

    @property
    def fit(self) -> PersonFollower:
        """The fit, for the doubt of its joints."""
        ...

    @property
    def shown(self) -> np.ndarray | None:
        """(N, 3) points of the last frame, metres, Z up."""
        ...

    @property
    def shown_off_m(self) -> np.ndarray:
        """(N,) metres between each of them and where the body has it; NaN where it is none of the body's."""
        ...


def with_display(line: FrameLine, session: Shown) -> FrameLine:
    """Return a line with ``cloud``, ``cloud_off_mm`` and, where it has a pose, ``sigma_mm``."""
    if session.shown is None:
        return line
    line = {**line, "cloud": session.shown.round(4).tolist(), "cloud_off_mm": millimetres(session.shown_off_m)}
    if "pose" in line:
        line["sigma_mm"] = millimetres(session.fit.deviations())
    return line
