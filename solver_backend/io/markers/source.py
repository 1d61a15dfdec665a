"""Hold a marker file's content, and the interpreted markers in metres with Z up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.props import POSE_POINTS
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerTake:
    """Markers of one file in metres with Z up."""

    cloud: MarkerCloud  # The markers. There are no labels if all are unnamed.
    subjects: tuple[str, ...] = ()  # Prefixes of the labels in file order.
    unlabelled: tuple[str, ...] = ()  # Labels that a program generated for unnamed points.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    others: MarkerCloud | None = None  # Markers with other prefixes that name no person, possibly props.


ARM_M = 0.1  # Distance in metres from a body's origin to the points on its axes, similar to hand-held markers.


@dataclass(frozen=True)
class RigidBodies:
    """B rigid bodies in F frames, in the unit and axes of their file."""

    names: tuple[str, ...]  # (B,) names.
    positions: np.ndarray  # (F, B, 3) origins, NaN where missing.
    rotations: np.ndarray  # (F, B, 3, 3) rotations from body axes to file axes.

    def points(self, metres: float, to_world: np.ndarray, fps: float) -> MarkerCloud:
        """Return each body's origin and a point on each axis, as ``NAME:origin``, ``NAME:x``.

        ``to_world`` (3, 3) rotates file axes to world axes. ``metres`` is the length of the file's unit.
        """
        origins = metres * self.positions @ to_world.T
        arms = ARM_M * np.swapaxes(to_world @ self.rotations, -1, -2)
        points = np.concatenate([origins[:, :, None], origins[:, :, None] + arms], axis=2)
        points = np.where(np.isfinite(points).all((-2, -1), keepdims=True), points, np.nan)
        labels = tuple(f"{name}:{point}" for name in self.names for point in POSE_POINTS)
        return MarkerCloud(points.reshape(len(points), -1, 3), fps, labels)


@dataclass(frozen=True)
class MarkerSource:
    """Content of a marker file in the file's unit and axes."""

    path: Path
    format: str  # Name and version of the format.
    positions: np.ndarray  # (F, M, 3) positions in the file's unit and axes, NaN where missing.
    labels: tuple[str, ...]  # M labels. They are empty if points have no names.
    rate: float | None  # Frames per second, None if the file does not state it.
    default_unit: str  # Most common unit of the format.
    default_up_axis: str  # Most common upward axis of the format.
    unit: str = ""  # Unit that the file states.
    up_axis: str = ""  # Upward axis that the file states.
    residual: np.ndarray | None = None  # (F, M) residuals from the recording program in the file's unit.
    bodies: RigidBodies | None = None  # Rigid bodies whose poses are in the file.
    analog_channels: tuple[str, ...] = ()  # Names of the analog channels, which are not read.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    rate_doubts: tuple[Diagnostic, ...] = ()  # Contradictions about the frame rate, which a user's rate settles.
    to_metres: np.ndarray | None = None  # (3, 3) transform of the positions to metres with Z up, if known.


def left_out_note(outputs: int) -> tuple[Diagnostic, ...]:
    """Return a diagnostic about points that are not positions, if there are any."""
    return (diagnostic("parts_not_read", kind="outputs", count=outputs),) if outputs else ()
