"""Read the marker labels that a user assigned by hand. The solver never overrides them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, MarkersUnknown
from solver_backend.io.files import read_json
from solver_backend.labelling.outputs import MARKERS
from solver_backend.types import MarkerCloud

FORMAT, VERSION = "manifold_mocap_user_labels", 1


def read_user_labels(path: Path, cloud: MarkerCloud) -> dict[tuple[int, int], str]:
    """Read the marker names that a user assigned to points. Return them by (column, frame).

    Each item has ``point`` (column, from 0), ``frame`` (from 0) and ``marker`` (a name in ``MARKERS``, or "" if the
    point is not a marker).

    Raises:
        FileMissing, FileDamaged: the file is missing, has another format, or refers to an unknown point.
        MarkersUnknown: a marker is not in ``MARKERS``.
    """
    values = read_json(path)
    if not isinstance(values, dict) or (values.get("format"), values.get("version")) != (FORMAT, VERSION):
        raise FileDamaged(f"The file is not a {FORMAT} of version {VERSION}.", where=str(path))
    items = values.get("points")
    if not isinstance(items, list):
        raise FileDamaged("'points' must be a list.", where=str(path))
    labels: dict[tuple[int, int], str] = {}
    for number, item in enumerate(items):
        where = f"{path}: points[{number}]"
        if not isinstance(item, dict) or type(item.get("point")) is not int or type(item.get("frame")) is not int:
            raise FileDamaged("An item must contain 'point', 'frame' and 'marker'.", where=where)
        marker = item.get("marker")
        if marker != "" and marker not in MARKERS:
            hint = f"Use one of {', '.join(MARKERS)}, or '' for no marker."
            raise MarkersUnknown(f"There is no marker {marker!r}.", where=where, hint=hint)
        column, frame = item["point"], item["frame"]
        frames, points = cloud.positions.shape[:2]
        if not (0 <= column < points and 0 <= frame < frames) or not np.isfinite(cloud.positions[frame, column]).all():
            raise FileDamaged("The point is not in this frame.", where=where)
        labels[column, frame] = str(marker)
    return labels
