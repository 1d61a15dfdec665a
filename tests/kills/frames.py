"""Frames in recordings that a killed run left, and whether the next run keeps them all."""

from __future__ import annotations

from pathlib import Path

from solver_backend.exchange.errors import MocapError
from solver_backend.io.markers.live_recording import SUFFIX, measure_recording
from solver_backend.io.markers.read import read_markers
from solver_backend.sensors.devices.recorded import open_folder


def recorded_frames(folder: Path) -> dict[str, int]:
    """Return the number of whole frames in each unfinished recording of live points, by its name."""
    return {path.name: _frames(path) for path in folder.glob(f"*{SUFFIX}")}


def _frames(path: Path) -> int:
    with path.open("rb") as stream:
        return measure_recording(stream).frames


def lost_frames(folder: Path, recorded: dict[str, int]) -> list[str]:
    """Return a sentence for each recording whose frames the next run did not keep, and for sensors' that is unreadable.

    Args:
        folder: of the operation, after the next run.
        recorded: what was there after the kill.
    """
    wrong = []
    for name, count in recorded.items():
        path = Path(name.removesuffix(SUFFIX))
        whole = folder / f"{path.stem}_recovered_1{path.suffix}"
        kept = len(read_markers(whole).cloud.positions) if whole.exists() else 0
        if kept != count:
            wrong.append(f"of {count} frames of {name} {kept} were kept")
    for about in folder.rglob("recording.json"):
        try:
            devices = open_folder(about.parent).devices
            for device in devices:
                with device:
                    sum(1 for _ in device.frames())
        except MocapError as error:
            wrong.append(f"the recording in {about.parent.name} cannot be read: {error.message}")
    return wrong
