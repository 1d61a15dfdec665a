"""Statements of a marker file as its reader returns them, and the interpreted markers in metres with Z up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.props import POSE_POINTS
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerTake:
    """Markers of one file, Z up, in metres."""

    cloud: MarkerCloud  # The markers, without labels if all are unnamed.
    subjects: tuple[str, ...] = ()  # Prefixes of the labels in the order of the file.
    unlabelled: tuple[str, ...] = ()  # Labels that a program gave to unnamed points.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    others: MarkerCloud | None = None  # Markers under prefixes of their own that name no person: props, perhaps.


ARM_M = 0.1  # Distance of the points on a body's axes from its origin, about that of markers on hand-held things.


@dataclass(frozen=True)
class RigidBodies:
    """B rigid bodies over F frames, in the unit and axes of their file."""

    names: tuple[str, ...]  # One per body.
    positions: np.ndarray  # (F, B, 3) their origins, NaN where unseen.
    rotations: np.ndarray  # (F, B, 3, 3) from each body's axes to the file's.

    def points(self, metres: float, to_world: np.ndarray, fps: float) -> MarkerCloud:
        """Return each body's origin and a point on each axis, labelled ``NAME:origin``, ``NAME:x`` and so on.

        ``to_world`` (3, 3) turns the file's axes to the world's. Its unit has ``metres``.
        """
        origins = metres * self.positions @ to_world.T
        arms = ARM_M * np.swapaxes(to_world @ self.rotations, -1, -2)
        points = np.concatenate([origins[:, :, None], origins[:, :, None] + arms], axis=2)
        points = np.where(np.isfinite(points).all((-2, -1), keepdims=True), points, np.nan)
        labels = tuple(f"{name}:{point}" for name in self.names for point in POSE_POINTS)
        return MarkerCloud(points.reshape(len(points), -1, 3), fps, labels)


@dataclass(frozen=True)
class MarkerSource:
    """Content of a marker file in its own unit and axes."""

    path: Path
    format: str  # Name of the format, with its kind.
    positions: np.ndarray  # (F, M, 3) in the file's unit and axes, NaN where missing.
    labels: tuple[str, ...]  # M labels, empty where there is none.
    rate: float | None  # Frames per second, None if the file states none.
    default_unit: str  # Unit of most files of the format.
    default_up_axis: str  # Axis that points up in most files of the format.
    unit: str = ""  # Stated unit.
    up_axis: str = ""  # Stated axis that points up.
    residual: np.ndarray | None = None  # (F, M) the recording program's residual, in the file's unit.
    bodies: RigidBodies | None = None  # Rigid bodies with poses in the file.
    analog_channels: tuple[str, ...] = ()  # Analog channels, which are not read.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    rate_doubts: tuple[Diagnostic, ...] = ()  # Contradictions about the rate, which a given rate settles.
    to_metres: np.ndarray | None = None  # (3, 3) transform of the positions to metres, Z up, if the file knows it.


def left_out_note(outputs: int) -> tuple[Diagnostic, ...]:
    """Return a diagnostic of points that are not positions, if there are any."""
    return (diagnostic("parts_not_read", kind="outputs", count=outputs),) if outputs else ()
