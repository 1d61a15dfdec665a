"""Optical markers as one object of named points, coloured by their distance from the solved body.

Points are stored and played like detections (``point_player``). A colour is a number per point and frame, which the
modifier turns into a material, so that a solve recolours the take by writing one array.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile
from ..conventions.datablocks import MARKER_COLOURS
from ..conventions.timing import TakeTiming
from .overlay import PointLook, create_point_overlay
from .point_player import GRADE, POINTS, SEEN, played_row

BOUNDS_MM = (10.0, 25.0)
"""Limits of the residual of a marker near the body, and of one that is not far off."""
LABELS = "marker_labels"
"""Custom property of the object: the markers' labels, one per line, in the order of the points."""
_LOOK = PointLook(0.008, MARKER_COLOURS)
"""Radius in metres, about that of a real marker, and colours, chosen by hand."""


def create_marker_cloud(
    markers: np.ndarray, labels: Sequence[str], fps: float, timing: TakeTiming, collection: bpy.types.Collection
) -> bpy.types.Object:
    """Create the object of (F, M, 3) markers in metres, NaN if unseen, with M labels or none."""
    cloud = create_point_overlay("Markers", markers, fps, timing, collection, _LOOK)
    cloud[LABELS] = "\n".join(labels or (f"*{number}" for number in range(1, markers.shape[1] + 1)))
    return cloud


def labels_of(cloud: bpy.types.Object) -> list[str]:
    """Return the labels of a cloud's points, in their order."""
    return str(cloud.get(LABELS, "")).split("\n")


def grade_markers(cloud: bpy.types.Object, motion: MotionFile | None) -> None:
    """Colour every marker of every frame by its residual in a motion, which begins with the same frame.

    Without a motion, all have their plain colour, as have markers that were not solved.
    """
    labels = labels_of(cloud)
    grades = np.zeros((len(cloud.data.vertices) // len(labels), len(labels)), np.float32)
    if motion is not None and motion.marker_residual_mm is not None:
        column = {label: i for i, label in enumerate(motion.marker_labels)}
        solved = [i for i, label in enumerate(labels) if label in column]
        residual = motion.marker_residual_mm[: len(grades), [column[labels[i]] for i in solved]]
        grades[: len(residual), solved] = np.where(np.isfinite(residual), 1 + np.searchsorted(BOUNDS_MM, residual), 0)
    cloud.data.attributes[GRADE].data.foreach_set("value", grades.ravel())
    cloud.data.update_tag()


def marker_positions(cloud: bpy.types.Object, frame: float) -> dict[str, tuple[float, float, float]]:
    """Return the positions of the seen markers on a scene frame, in the object's own frame, by label."""
    count, vertices, seen = int(cloud[POINTS]), cloud.data.vertices, cloud.data.attributes[SEEN].data
    first = played_row(cloud, frame) * count
    return {
        label: tuple(vertices[first + i].co) for i, label in enumerate(labels_of(cloud)) if seen[first + i].value > 0.5
    }
