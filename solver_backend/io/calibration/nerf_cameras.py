"""``transforms.json`` of NeRF tools: a picture of each camera with its pose, axes as graphics have them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.io.calibration.camera_fields import numbers

_MOST_CAMERAS = 256
_FIELDS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x")
"""Values of a picture, or of all; ``camera_angle_x`` is the horizontal field of view in radians."""
_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""Graphics look along -z with y up; OpenCV along z with y down."""


def nerf_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return name and values of each camera; None where the content is no such file or its cameras move.

    ``transform_matrix`` takes the camera's axes to the world; its inverse, turned to OpenCV's axes, is the extrinsic
    matrix. A camera is named by its picture, or by the picture's folder where all pictures have one name.

    Raises:
        CalibrationInvalid: a matrix holds what is no number, or the focal length is missing.
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
    place = f"camera {name}"
    stated = {key: frame.get(key, tree.get(key)) for key in _FIELDS}
    found = {key: None if value is None else _number(value, place) for key, value in stated.items()}
    pose = numbers(frame["transform_matrix"], place)
    width, angle = found["w"], found["camera_angle_x"]
    by_angle = 0.5 * width / math.tan(0.5 * angle) if width and angle and 0 < angle < math.pi else None
    focal = found["fl_x"] or by_angle
    if not focal:
        raise CalibrationInvalid(
            "The camera has no focal length.", where=place,
            hint="Write fl_x, or camera_angle_x with w, for each picture or for all.",
        )  # fmt: skip
    fisheye = "FISHEYE" in str(frame.get("camera_model", tree.get("camera_model"))).upper()
    terms = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2")
    node = {"fx": focal, "fy": found["fl_y"] or focal, "width": width, "height": found["h"], "fisheye": fisheye,
            "cx": _middle(found["cx"], width), "cy": _middle(found["cy"], found["h"]),
            "distortion": [found[key] or 0.0 for key in terms]}  # fmt: skip
    if pose.shape == (4, 4) and np.isfinite(pose).all() and abs(np.linalg.det(pose)) > 0:
        node["extrinsics"] = np.linalg.inv(pose @ _TO_OPENCV)
    return {key: value for key, value in node.items() if value is not None}


def _number(value: Any, place: str) -> float:
    array = numbers(value, place)
    if array.size != 1:
        raise CalibrationInvalid("A number is expected where the file holds several.", where=place)
    return float(array.reshape(-1)[0])


def _middle(stated: float | None, size: float | None) -> float | None:
    """Return a coordinate of the principal point: as stated, else the middle of the picture."""
    return 0.5 * size if stated is None and size is not None else stated
