"""Origins of the segments whose rotations a C3D file holds: joint centres, where markerless programs write no points.

Source: the ROTATION group of Theia3D and Visual3D (C-Motion, "C3D rotation data type"). A block beside the frames of
points holds, frame by frame, 17 floats a segment: a 4 x 4 matrix, one column after the other, and a residual, negative
where the segment was not seen. The last column is where the segment's proximal joint is.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from solver_backend.io.markers.c3d_numbers import floats
from solver_backend.io.markers.c3d_parameters import BLOCK, Parameters

_WORDS = 17
_NAMES = {"uarm": "upper_arm", "larm": "lower_arm", "torso": "thorax"}
"""Names of segments as skeletons have them."""


@dataclass(frozen=True)
class SegmentOrigins:
    """Where S segments begin and how they are turned, in F frames."""

    positions: np.ndarray
    """(F, S, 3) in the unit of the file's points, NaN where a segment is not seen."""
    labels: tuple[str, ...]
    """One a segment, the side in words."""
    turns: np.ndarray
    """(F, S, 3, 3) rotations from each segment's axes to the file's."""
    rate: float | None
    """Frames per second."""


def read_origins(data: np.ndarray, parameters: Parameters) -> SegmentOrigins | None:
    """Return the segments' origins, None where the file holds no rotations.

    Args:
        data: the file's bytes.
        parameters: its parameters.
    """
    labels = parameters.continued_texts("ROTATION:LABELS")
    count = min(int(parameters.number("ROTATION:USED") or 0), len(labels))
    block = int(parameters.number("ROTATION:DATA_START") or 0)
    start, stride = (block - 1) * BLOCK, 4 * _WORDS * count
    if count <= 0 or block < 2 or start + stride > len(data):
        return None
    ratio = max(parameters.number("ROTATION:RATIO") or 1.0, 1.0)
    stated = parameters.number("POINT:FRAMES")
    frames = (len(data) - start) // stride
    frames = min(frames, int(stated * ratio)) if stated else frames
    values = floats(data[start : start + frames * stride].reshape(frames, stride), parameters.processor)
    values = values.reshape(frames, count, _WORDS)
    kept = [i for i, label in enumerate(labels[:count]) if not label.lower().startswith("world")]
    positions = np.where(values[:, kept, -1:] >= 0, values[:, kept, 12:15], np.nan)
    columns = values[:, kept, :16].reshape(frames, len(kept), 4, 4)[..., :3, :3]
    names = tuple(_named(labels[i]) for i in kept)
    return SegmentOrigins(positions, names, np.swapaxes(columns, -1, -2), parameters.number("ROTATION:RATE"))


def _named(label: str) -> str:
    """Return a segment's name as skeletons write it: ``left_upper_arm`` for ``l_uarm_4X4``."""
    name = re.sub(r"_?4x4$", "", label.strip(), flags=re.IGNORECASE).lower()
    side = {"l_": "left_", "r_": "right_"}.get(name[:2], "")
    part = name[2:] if side else name
    return side + _NAMES.get(part, part)
