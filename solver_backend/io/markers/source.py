"""Store the content of a marker file before and after its conversion to metres with Z up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.props import POSE_POINTS
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class MarkerTake:
    """Markers from one file, in metres with Z up."""

    cloud: MarkerCloud  # The markers. The labels are empty if all markers are unnamed.
    subjects: tuple[str, ...] = ()  # Label prefixes in file order.
    unlabelled: tuple[str, ...] = ()  # Labels that a program generated for unnamed points.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    others: MarkerCloud | None = None  # Markers whose prefixes do not name a person, possibly props.


ARM_M = 0.1  # Distance in metres from a body's origin to the points on its axes, similar to hand-held marker tools.


@dataclass(frozen=True)
class RigidBodies:
    """Poses of B rigid bodies in F frames, in the file's unit and axes."""

    names: tuple[str, ...]  # (B,) names.
    positions: np.ndarray  # (F, B, 3) origins, NaN where missing.
    rotations: np.ndarray  # (F, B, 3, 3) rotations from body axes to file axes.

    def points(self, metres: float, to_world: np.ndarray, fps: float) -> MarkerCloud:
        """Convert each body to four markers: ``NAME:origin``, and ``NAME:x``, ``NAME:y``, ``NAME:z`` on its axes.

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
    """Content of a marker file, in the file's unit and axes."""

    path: Path
    format: str  # Name and version of the format.
    positions: np.ndarray  # (F, M, 3) positions in the file's unit and axes, NaN where missing.
    labels: tuple[str, ...]  # (M,) labels, or empty if the points have no names.
    rate: float | None  # Frames per second, or None if the file does not state them.
    default_unit: str  # Most common unit for the format.
    default_up_axis: str  # Most common up axis for the format.
    unit: str = ""  # Unit stated in the file.
    up_axis: str = ""  # Up axis stated in the file.
    residual: np.ndarray | None = None  # (F, M) residuals from the recording program, in the file's unit.
    bodies: RigidBodies | None = None  # Rigid bodies whose poses the file contains.
    analog_channels: tuple[str, ...] = ()  # Names of analog channels, which are not read.
    notes: tuple[Diagnostic, ...] = ()
    problems: tuple[Diagnostic, ...] = ()
    rate_doubts: tuple[Diagnostic, ...] = ()  # Contradictions about the frame rate, which a user-defined rate resolves.
    to_metres: np.ndarray | None = None  # (3, 3) transform of the positions to metres with Z up, if known.


def left_out_note(outputs: int) -> tuple[Diagnostic, ...]:
    """Report how many ``outputs`` of a file were not read because they are not positions, such as joint angles."""
    return (diagnostic("parts_not_read", kind="outputs", count=outputs),) if outputs else ()
