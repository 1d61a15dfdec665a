"""A capture that was read and solved, as the add-on's tests take it in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from blender_addon.animation.takes import SolveFiles


@dataclass(frozen=True)
class SolvedCapture:
    """A short capture, what the solver said when it read it, and its solved motion."""

    folder: Path
    read: dict[str, Any]

    @property
    def files(self) -> SolveFiles:
        return SolveFiles(*(self.folder / name for name in ("take_01.npz", "capture.npz", "take_01.html", "job.json")))
