"""Calibrations as OpenCV's FileStorage writes them, YAML: one node a camera."""

from __future__ import annotations

import re

import numpy as np

from solver_backend.camera_calibration.formats.toml_files import coefficients
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.types import Cameras


def opencv_yaml(cameras: Cameras) -> str:
    """Return the text of one file for all cameras, lengths in metres."""
    lines = ["%YAML:1.0", "---"]
    for c, name in enumerate(cameras.names):
        key = re.sub(r"[^A-Za-z0-9_]", "_", name)
        key = key if key[:1].isalpha() else f"cam_{key}"
        lines += [f"{key}:", f'   name: "{_plain(name)}"']
        lines += [f"   image_width: {cameras.image_size[c, 0]}", f"   image_height: {cameras.image_size[c, 1]}"]
        if cameras.models[c] != DEFAULT_MODEL:
            lines.append(f'   distortion_model: "{cameras.models[c]}"')
        lines += _matrix("camera_matrix", cameras.K[c])
        lines += _matrix("distortion_coefficients", coefficients(cameras, c)[:, None])
        lines += _matrix("R", cameras.R[c]) + _matrix("T", cameras.t[c][:, None])
    return "\n".join([*lines, ""])


def _matrix(key: str, values: np.ndarray) -> list[str]:
    data = ", ".join(f"{float(v):.17g}" if float(v) % 1 else f"{float(v):.1f}" for v in values.ravel())
    head = [f"   {key}: !!opencv-matrix", f"      rows: {values.shape[0]}", f"      cols: {values.shape[1]}"]
    return [*head, "      dt: d", f"      data: [ {data} ]"]


def _plain(name: str) -> str:
    return "".join(c for c in name if c.isprintable() and c not in "\"'\\")
