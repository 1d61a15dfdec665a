"""From what a file of markers holds, in its own unit and axes, to markers in our world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.marker_names import is_unnamed
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, sentence
from solver_backend.exchange.errors import FileDamaged, JobInvalid, NoDetections
from solver_backend.exchange.props import POSE_POINTS
from solver_backend.io.markers.missing import without_sentinels
from solver_backend.io.recognition.marker_labels import subjects_of, unique_labels
from solver_backend.io.recognition.marker_unit import Unit, find_unit
from solver_backend.io.recognition.marker_up_axis import UpAxis, find_up_axis
from solver_backend.io.recognition.subject_labels import by_subject
from solver_backend.io.recognition.up_axis import rotation_to_z_up
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


ARM_M = 0.1
"""From a body's origin to the points on its axes: markers on things that people hold are about so far apart."""


@dataclass(frozen=True)
class RigidBodies:
    """B rigid bodies over F frames, in the unit and axes of their file."""

    names: tuple[str, ...]
    """One a body."""
    positions: np.ndarray
    """(F, B, 3) their origins, NaN where a body is not seen."""
    rotations: np.ndarray
    """(F, B, 3, 3) from each body's axes to the file's."""

    def kept(self, chosen: list[int]) -> RigidBodies:
        """Return some of them."""
        names = tuple(self.names[i] for i in chosen)
        return RigidBodies(names, self.positions[:, chosen], self.rotations[:, chosen])

    def points(self, metres: float, to_world: np.ndarray, fps: float) -> MarkerCloud:
        """Return each body's origin and a point on each of its axes, labelled ``NAME:origin``, ``NAME:x`` and so on.

        Args:
            metres: a unit of the file.
            to_world: (3, 3) from the file's axes to the world's.
            fps: frames per second.
        """
        origins = metres * self.positions @ to_world.T
        arms = ARM_M * np.swapaxes(to_world @ self.rotations, -1, -2)
        points = np.concatenate([origins[:, :, None], origins[:, :, None] + arms], axis=2)
        points = np.where(np.isfinite(points).all((-2, -1), keepdims=True), points, np.nan)
        labels = tuple(f"{name}:{point}" for name in self.names for point in POSE_POINTS)
        return MarkerCloud(points.reshape(len(points), -1, 3), fps, labels)


STILL_FRAMES = 10
"""A marker that is exactly where it was over this many frames was not measured in them."""


@dataclass(frozen=True)
class MarkerSource:
    """What a reader found in a file."""

    path: Path
    """The file."""
    format: str
    """Name of the format, with its kind."""
    positions: np.ndarray
    """(F, M, 3) in the file's unit and axes, NaN where missing."""
    labels: tuple[str, ...]
    """M labels, empty where there is none."""
    rate: float | None
    """Frames per second, None where the file states none."""
    default_unit: str
    """Unit of most files of the format."""
    default_up_axis: str
    """Axis that points up in most files of the format."""
    unit: str = ""
    """Unit as the file states it."""
    up_axis: str = ""
    """Axis that points up as the file states it."""
    residual: np.ndarray | None = None
    """(F, M) the recording program's residual, in the file's unit."""
    first_frame: int = 1
    """The file's number of the first frame."""
    bodies: RigidBodies | None = None
    """Rigid bodies whose poses the file holds."""
    events: tuple[MarkerEvent, ...] = ()
    """Events in the file."""
    analog_channels: tuple[str, ...] = ()
    """Analog channels, which are not read."""
    notes: tuple[Diagnostic, ...] = ()
    """What the reader assumed."""
    problems: tuple[Diagnostic, ...] = ()
    """What the reader found wrong."""


def left_out_note(outputs: int) -> tuple[Diagnostic, ...]:
    """Return a diagnostic of points that are not positions, if there are any."""
    return (diagnostic("parts_not_read", kind="outputs", count=outputs),) if outputs else ()


def as_take(source: MarkerSource, *, fps: float | None, unit: str | None, up_axis: str | None) -> MarkerTake:
    """Return the markers in metres with Z up, and what was recognised.

    Args:
        source: what a reader found.
        fps: frames per second; None takes what the file states.
        unit: the file's length unit; None takes what the file states, or estimates it from the markers' spread.
        up_axis: the file's axis that points up; None takes what the file states, or how the body stands.

    Raises:
        NoDetections: the file holds no markers, or none is ever seen.
        FileDamaged: the file states no frame rate, and none is given.
        JobInvalid: the rate, unit or axis that is given is impossible.
    """
    _require_markers(source)
    labels, problems = _labels(source)
    positions, notes, sentinels = without_sentinels(source.positions, labels)
    if not np.isfinite(positions).any():
        raise NoDetections("No marker is seen in any frame.", where=str(source.path), hint="Export it again.")
    found_unit = find_unit(positions, source.unit, unit, source.default_unit, labels)
    positions *= found_unit.metres
    found_axis = find_up_axis(positions, labels, source.up_axis, up_axis, source.default_up_axis)
    to_world = rotation_to_z_up(found_axis.name)
    positions = (positions.reshape(-1, 3) @ to_world.T).reshape(positions.shape)
    rate = _rate(source, fps)
    gaps, missing = gaps_of(np.isfinite(positions[..., 0]))
    unlabelled = tuple(label for label in labels if is_unnamed(label))
    named = len(unlabelled) < len(labels)
    report = MarkerReport(
        format=source.format,
        frames=len(positions),
        first_frame=source.first_frame,
        fps=rate,
        unit=found_unit.name,
        up_axis=found_axis.name,
        subjects=subjects_of(labels),
        unlabelled=unlabelled,
        gaps=tuple(gaps.tolist()),
        missing=tuple(missing.tolist()),
        analog_channels=source.analog_channels,
        events=source.events,
        notes=(
            _described(source, rate),
            found_unit.note,
            found_axis.note,
            *_channels(source),
            *_naming(labels, named=named),
            *notes,
            *source.notes,
        ),
        problems=(*source.problems, *_found(found_unit, found_axis), *sentinels, *problems, *_still(positions, labels)),
    )
    residual = source.residual * found_unit.metres if source.residual is not None else None
    others = None if source.bodies is None else source.bodies.points(found_unit.metres, to_world, rate)
    return MarkerTake(MarkerCloud(positions, rate, labels if named else None, residual), report, others)


def _require_markers(source: MarkerSource) -> None:
    frames, markers = source.positions.shape[:2]
    if not markers:
        channels = len(source.analog_channels)
        what = f" but {channels} analog channels (forces, muscles)" if channels else ""
        raise NoDetections(
            " ".join((f"The file holds no markers{what}.", *map(sentence, source.notes))),
            where=str(source.path),
            hint="Choose the recording's file of markers, or export it with trajectories.",
        )
    if not frames:
        raise NoDetections("The file holds no frames.", where=str(source.path), hint="Export it again.")


def _labels(source: MarkerSource) -> tuple[tuple[str, ...], tuple[Diagnostic, ...]]:
    """Return labels that are unique, and what was wrong with the file's."""
    labels, doubled = unique_labels(by_subject(source.labels))
    problems: list[Diagnostic] = []
    if doubled:
        problems.append(diagnostic("labels_doubled", markers=doubled))
    empty = sum(not label for label in source.labels)
    if empty and not all(is_unnamed(label) for label in source.labels):
        problems.append(diagnostic("points_without_label", count=empty, total=len(labels)))
    return labels, tuple(problems)


def _naming(labels: Sequence[str], *, named: bool) -> tuple[Diagnostic, ...]:
    return () if named else (diagnostic("points_without_label", total=0, severity=Severity.NOTE, count=len(labels)),)


def _rate(source: MarkerSource, fps: float | None) -> float:
    if fps is not None:
        if not (np.isfinite(fps) and fps > 0):
            raise JobInvalid(f"The frame rate must be a positive number, not {fps}.", where="fps")
        return float(fps)
    if source.rate is None or not (np.isfinite(source.rate) and source.rate > 0):
        found = "states no frame rate" if source.rate is None else f"states a frame rate of {source.rate:g}"
        raise FileDamaged(
            f"The file {found}; a positive number is expected.", where=str(source.path), hint="Give the frame rate."
        )
    return float(source.rate)


def _described(source: MarkerSource, rate: float) -> Diagnostic:
    frames, markers = source.positions.shape[:2]
    return diagnostic("markers_read", format=source.format, count=markers, length=frames, fps=rate)


def _channels(source: MarkerSource) -> tuple[Diagnostic, ...]:
    names = source.analog_channels
    return (diagnostic("parts_not_read", kind="analog", count=len(names), channels=names),) if names else ()


def _found(unit: Unit, axis: UpAxis) -> tuple[Diagnostic, ...]:
    return tuple(problem for problem in (unit.problem, axis.problem) if problem is not None)


def _still(positions: np.ndarray, labels: Sequence[str]) -> tuple[Diagnostic, ...]:
    """Return a diagnostic of the markers that never move, if there are any."""
    if len(positions) < STILL_FRAMES:
        return ()
    seen = np.isfinite(positions[..., 0])
    first = positions[np.argmax(seen, axis=0), np.arange(positions.shape[1])]
    moved = np.any([(seen & (positions[..., k] != first[:, k])).any(axis=0) for k in range(3)], axis=0)
    still = [labels[int(i)] for i in np.flatnonzero(~moved & (seen.sum(axis=0) >= STILL_FRAMES))]
    return (diagnostic("marker_never_moves", markers=still),) if still else ()
