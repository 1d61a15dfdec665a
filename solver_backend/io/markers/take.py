"""What every marker reader returns: the markers in our world, and what was recognised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerEvent:
    """Something that happened during the take, as the recording program noted it."""

    label: str
    """Such as 'Foot Strike'."""
    time: float
    """Seconds on the file's clock, which starts at the trial's first frame even where the file does not."""
    context: str = ""
    """Such as 'Left'."""
    subject: str = ""
    """Name of the subject it concerns."""


@dataclass(frozen=True)
class MarkerReport:
    """What was recognised in a file of markers."""

    format: str
    """The file's format, with its kind."""
    frames: int
    """Number of frames."""
    first_frame: int
    """The file's own number of the first frame."""
    fps: float
    """Frames per second."""
    unit: str
    """The file's length unit."""
    up_axis: str
    """The file's axis that points up."""
    subjects: tuple[str, ...] = ()
    """Prefixes of the labels, in the order of the file; empty where labels have none."""
    unlabelled: tuple[str, ...] = ()
    """Labels that a program gave to points that nobody named."""
    gaps: tuple[int, ...] = ()
    """Number of gaps of each marker."""
    missing: tuple[int, ...] = ()
    """Frames in which each marker is not seen."""
    analog_channels: tuple[str, ...] = ()
    """Analog channels (forces, muscles) that are in the file and are not read."""
    events: tuple[MarkerEvent, ...] = ()
    """Events in the file."""
    notes: tuple[Diagnostic, ...] = ()
    """What was found and assumed, how unit and axis were found among it."""
    problems: tuple[Diagnostic, ...] = ()
    """What the user should know before solving."""


@dataclass(frozen=True)
class MarkerTake:
    """Markers of one file, Z up, in metres."""

    cloud: MarkerCloud
    """The markers; without labels where nobody named any."""
    report: MarkerReport
    """What was recognised."""
    others: MarkerCloud | None = None
    """Markers under prefixes of their own that name nobody: props, perhaps."""


def gaps_of(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how many gaps each marker has and in how many frames it is missing.

    Args:
        seen: (frames, markers) booleans.

    Returns:
        (markers,) gaps, those at the ends too, and (markers,) frames.
    """
    missing = ~seen
    starts = missing[:1].sum(axis=0) + (missing[1:] & seen[:-1]).sum(axis=0)
    return starts, missing.sum(axis=0)
