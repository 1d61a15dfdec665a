"""``transforms.json`` of NeRF tools: a picture of each camera with its pose, axes as graphics have them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from solver_backend.io.calibration.camera_fields import numbers

_MOST_CAMERAS = 256
_FIELDS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2")
_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Graphics look along -z with y up; OpenCV along z with y down."""


def nerf_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return name and values of each camera; None where the content is no such file or its cameras move.

    ``transform_matrix`` takes the camera's axes to the world; its inverse, turned to OpenCV's axes, is the extrinsic
    matrix. A camera is named by its picture, or by the picture's folder where all pictures have one name.

    Raises:
        CalibrationInvalid: a matrix holds what is no number.
    """
    frames = tree.get("frames") if isinstance(tree, Mapping) else None
    if not isinstance(frames, list) or not 0 < len(frames) <= _MOST_CAMERAS:
        return None
    if not all(isinstance(frame, Mapping) and "transform_matrix" in frame for frame in frames):
        return None
    pictures = [PurePosixPath(str(frame.get("file_path", i))) for i, frame in enumerate(frames)]
    stems = [picture.stem for picture in pictures]
    names = stems if len(set(stems)) == len(stems) else [picture.parent.name for picture in pictures]
    if len(set(names)) < len(names):
        return None
    return [(name, _node(tree, frame, name)) for name, frame in zip(names, frames, strict=True)]


def _node(tree: Mapping[str, Any], frame: Mapping[str, Any], name: str) -> dict[str, Any]:
    found = {key: frame.get(key, tree.get(key)) for key in _FIELDS}
    pose = numbers(frame["transform_matrix"], f"camera {name}")
    node = {"fx": found["fl_x"], "fy": found["fl_y"] or found["fl_x"], "cx": found["cx"], "cy": found["cy"],
            "width": found["w"], "height": found["h"],
            "distortion": [found[key] or 0.0 for key in ("k1", "k2", "p1", "p2")]}  # fmt: skip
    if pose.shape == (4, 4) and abs(np.linalg.det(pose)) > 0:
        node["extrinsics"] = np.linalg.inv(pose @ _TO_OPENCV)
    return {key: value for key, value in node.items() if value is not None}
