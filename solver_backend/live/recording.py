"""What live begins and ends with: the person to fit, and the take that was recorded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.fitters.recipes.live import LiveFit, fit_average_person
from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.native.subject_file import read_subject
from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.live.frames import PointFrame
from solver_backend.types import MarkerCloud


def person_fit(subject: Path | None) -> tuple[PointNetwork, LiveFit]:
    """Return the network and a fit of a calibrated person, or of one whose shape is learned as they move.

    Raises:
        FileMissing, SubjectInvalid: the subject cannot be read.
    """
    network = load_network()
    if subject is None:
        return network, fit_average_person()
    person = read_subject(subject)
    offsets = np.zeros((len(MARKERS), 3))
    places = name_markers(person.places).known
    for place, offset in zip(person.places, person.offsets, strict=True):
        if places.get(place) in MARKERS:
            offsets[MARKERS.index(places[place])] = offset
    return network, LiveFit(load_body(), offsets=offsets, betas=person.betas)


class Recorder:
    """Keeps the points of all frames that were read."""

    def __init__(self) -> None:
        self.frames: list[PointFrame] = []

    @property
    def count(self) -> int:
        """Number of frames with points."""
        return sum(len(frame.points) > 0 for frame in self.frames)

    def watched(self, frames: Iterable[PointFrame]) -> Iterator[PointFrame]:
        """Yield the same frames."""
        for frame in frames:
            if not frame.fault:
                self.frames.append(replace(frame))
            yield frame

    def write(self, path: Path, fps: float | None, to_metres: np.ndarray | None, *, overwrite: bool) -> Path:
        """Write the take as C3D; its rate is that of the times where none is told.

        Raises:
            OutputExists, OutputNotWritable: see ``write_c3d``.
        """
        most = max(len(frame.points) for frame in self.frames)
        positions = np.full((len(self.frames), most, 3), np.nan)
        turn = np.eye(3) if to_metres is None else to_metres
        for row, frame in zip(positions, self.frames, strict=True):
            row[: len(frame.points)] = frame.points @ turn.T
        steps = np.diff([frame.time for frame in self.frames])
        steps = steps[steps > 0]
        rate = fps or (1.0 / float(np.median(steps)) if len(steps) else 120.0)
        return write_c3d(path, MarkerCloud(positions, rate), overwrite=overwrite)
