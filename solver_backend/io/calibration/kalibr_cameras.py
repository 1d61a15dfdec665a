"""Kalibr's chain of cameras: each has its pose from the one before it; the first one's axes are the world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.io.calibration.camera_fields import numbers

_FROM_PREVIOUS = "T_cn_cnm1"
"""(4, 4) from the previous camera's axes to this one's."""


def kalibr_nodes(tree: Any) -> list[tuple[str, Mapping[str, Any]]] | None:
    """Return name and values of each camera of a ``camchain.yaml``; None where the content is no such file.

    Raises:
        CalibrationInvalid: a pose is missing or no matrix of 4 x 4, or a camera has another model than a pinhole.

    Reference: Furgale, Rehder and Siegwart 2013; the file is described in Kalibr's wiki, "YAML formats".
    """
    nodes = list(tree.items()) if isinstance(tree, Mapping) else []
    if len(nodes) < 2 or not all(isinstance(node, Mapping) and "intrinsics" in node for _, node in nodes):
        return None
    if not any(_FROM_PREVIOUS in node for _, node in nodes):
        return None
    pose, found = np.eye(4), []
    for i, (name, node) in enumerate(nodes):
        place = f"camera {name}"
        if str(node.get("camera_model", "pinhole")) != "pinhole":
            raise CalibrationInvalid(
                f"Not supported: Kalibr's camera model {node['camera_model']}.", where=place,
                hint="Calibrate with pinhole-radtan or pinhole-equi.",
            )  # fmt: skip
        step = numbers(node.get(_FROM_PREVIOUS, np.eye(4) if i == 0 else []), place)
        if step.shape != (4, 4):
            raise CalibrationInvalid(f"{_FROM_PREVIOUS} has shape {step.shape}; (4, 4) is expected.", where=place)
        pose = step @ pose
        found.append((str(name), {**node, "extrinsics": pose}))
    return found
