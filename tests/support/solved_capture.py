"""A capture that was read and solved, as the add-on's tests take it in."""

from __future__ import annotations

import json
import shutil
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

    def copied_to(self, folder: Path) -> SolvedCapture:
        """Return the same in another folder, which what the solver said names too."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        here, there = (json.dumps(str(place))[1:-1] for place in (self.folder, folder))
        return SolvedCapture(folder, json.loads(json.dumps(self.read).replace(here, there)))
