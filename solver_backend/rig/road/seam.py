"""The seam to calibration: what the road has when a take's cameras are not calibrated, and what it wants back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.errors import CalibrationMissing
from solver_backend.exchange.progress import Progress
from solver_backend.io.calibration.read import FORMATS
from solver_backend.rig.detect.video_detections import VideoDetections
from solver_backend.rig.road.layout import FoundFolder, FoundTake
from solver_backend.rig.sync.clocks import Clocks


@dataclass(frozen=True)
class CalibrationRequest:
    """A take whose cameras are to be calibrated."""

    found: FoundFolder
    """With the footage of boards, if there is any."""
    take: FoundTake
    """The take."""
    detections: tuple[VideoDetections, ...]
    """What was found in its videos, for calibration by the person alone."""
    clocks: Clocks
    """Of its cameras, told without calibration."""
    out: Path
    """Calibration file to write, in a format that ``read_calibration`` reads."""


Calibrator = Callable[[CalibrationRequest, Progress], None]


def no_calibrator(request: CalibrationRequest, progress: Progress) -> None:
    """Refuse: this installation calibrates no cameras.

    Raises:
        CalibrationMissing: always.
    """
    boards = f" ({len(request.found.footage)} folders of board footage are there)" if request.found.footage else ""
    raise CalibrationMissing(
        f"The take {request.take.name} has no camera calibration{boards}.",
        where=str(request.found.root),
        hint=f"Put one into its 'calibration' folder. Formats that are read: {FORMATS}.",
    )
