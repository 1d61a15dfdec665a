"""Rigid bodies in CSV files of Motive: columns of a quaternion X, Y, Z, W and of a position.

Source: the OptiTrack documentation, "Data Export: CSV".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.so3 import matrix_from_quat
from solver_backend.io.markers.rigid_bodies import RigidBodies
from solver_backend.io.markers.text_table import triples
from solver_backend.io.recognition.marker_labels import prefix_of

_TYPE, _TURN, _PLACE = "rigid body", "rotation", "position"


@dataclass(frozen=True)
class BodyColumns:
    """Where rigid bodies stand in a table."""

    names: tuple[str, ...]
    """One a body."""
    turns: tuple[int, ...]
    """First column of each quaternion, X, Y, Z, W."""
    places: tuple[int, ...]
    """First column of each position."""

    def poses(self, values: np.ndarray) -> RigidBodies:
        """Return the bodies of a table of F rows; one without a quaternion in a row is not seen there."""
        places = triples(values, list(self.places))
        quat = np.stack([values[:, [turn + 3, turn, turn + 1, turn + 2]] for turn in self.turns], axis=1)
        length = np.linalg.norm(quat, axis=-1, keepdims=True)
        good = np.isfinite(length) & (length > 0.5)
        rotations = matrix_from_quat(np.where(good, quat, (1.0, 0.0, 0.0, 0.0)) / np.where(good, length, 1.0))
        return RigidBodies(self.names, np.where(good, places, np.nan), rotations)


def motive_bodies(
    header: Sequence[Sequence[str]], labels: Sequence[str], rotation_type: str
) -> tuple[BodyColumns | None, tuple[Diagnostic, ...]]:
    """Return the rigid bodies whose markers a file does not hold, and notes on all of them.

    Args:
        header: rows from the types to 'Frame', 'Time (Seconds)', ...
        labels: of the file's markers.
        rotation_type: as the file states it; Euler angles are not read.
    """
    at = next((i for i, row in enumerate(header) if any(cell.lower() == _TYPE for cell in row)), None)
    if at is None:
        return None, ()
    axes = header[-1]
    types, names, quantities = (
        [*row, *[""] * len(axes)][: len(axes)] for row in (header[at], header[at + 1], header[-2])
    )
    of_body = [i for i in range(len(axes)) if types[i].lower() == _TYPE]
    found = dict.fromkeys(names[i] for i in of_body)
    starts = {
        (names[i], quantities[i].lower()): i
        for i in reversed(of_body) if axes[i].upper() == "X" and quantities[i].lower() in (_TURN, _PLACE)
    }  # fmt: skip
    worn = {prefix_of(label) for label in labels}
    by_markers = [name for name in found if name in worn or any(label.startswith(f"{name}_") for label in labels)]
    left = [name for name in found if name not in by_markers and (name, _TURN) in starts and (name, _PLACE) in starts]
    notes = list[Diagnostic]()
    if by_markers:
        notes.append(diagnostic("body_poses_left_out", bodies=by_markers))
    if left and rotation_type and not rotation_type.lower().startswith("quat"):
        notes.append(diagnostic("body_poses_in_euler_angles", bodies=left))
        left = []
    if not left:
        return None, tuple(notes)
    notes.append(diagnostic("rigid_bodies_read", count=len(left), bodies=left))
    turns, places = (tuple(starts[name, quantity] for name in left) for quantity in (_TURN, _PLACE))
    return BodyColumns(tuple(left), turns, places), tuple(notes)
