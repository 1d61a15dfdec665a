"""Calibrations as TOML: Pose2Sim's and anipose's, FreeMoCap's, caliscope's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras


def pose2sim_toml(cameras: Cameras, rmse_px: float | None = None, *, scale: float = 1.0, tool: str = "") -> str:
    """Return the text of a calibration as Pose2Sim and anipose have it; ours too.

    Args:
        cameras: C cameras.
        rmse_px: of the calibration, for people.
        scale: units of length a metre: 1 for Pose2Sim, 1000 for FreeMoCap.
        tool: goes into the metadata.
    """
    parts = []
    for c, name in enumerate(cameras.names):
        rotation = log_so3(cameras.R[c])
        parts.append(
            f"[{_key(name)}]\n"
            f"name = {_text(name)}\n"
            f"size = {_list(cameras.image_size[c].astype(float))}\n"
            f"matrix = {_matrix(cameras.K[c])}\n"
            f"distortions = {_list(coefficients(cameras, c))}\n"
            f"rotation = {_list(rotation)}\n"
            f"translation = {_list(scale * cameras.t[c])}\n"
            f"fisheye = {str(cameras.models[c] == 'fisheye').lower()}\n"
            f"{_model(cameras.models[c])}"
        )
    error = "" if rmse_px is None else f"error = {rmse_px:.6g}\n"
    program = f"tool = {_text(tool)}\n" if tool else ""
    return "\n".join([*parts, f"[metadata]\nadjusted = false\n{error}{program}"])


def caliscope_toml(cameras: Cameras, rmse_px: float | None = None) -> str:
    """Return the text of caliscope's ``camera_array.toml``; cameras are numbered in their order."""
    parts = []
    for c in range(len(cameras)):
        fisheye = "fisheye = true\n" if cameras.models[c] == "fisheye" else _model(cameras.models[c])
        parts.append(
            f"[cameras.{c}]\n"
            f"cam_id = {c}\n"
            "rotation_count = 0\n"
            f"error = {0.0 if rmse_px is None else rmse_px:.6g}\n"
            "ignore = false\n"
            f"{fisheye}"
            f"size = [{cameras.image_size[c, 0]}, {cameras.image_size[c, 1]}]\n"
            f"matrix = {_matrix(cameras.K[c])}\n"
            f"distortions = {_list(coefficients(cameras, c))}\n"
            f"translation = {_list(cameras.t[c])}\n"
            f"rotation = {_matrix(cameras.R[c])}\n"
        )
    return "\n".join(parts)


def coefficients(cameras: Cameras, index: int) -> np.ndarray:
    """Return as many coefficients as the lens needs: 4 of a fisheye, else 5, or 8 where the last are not zero."""
    return LENS_MODELS[cameras.models[index]].listed(cameras.distortion[index])


def _model(name: str) -> str:
    """Return the line that names a lens model which is neither OpenCV's nor the fisheye."""
    return "" if name in ("opencv", "fisheye") else f"distortion_model = {_text(name)}\n"


def _key(name: str) -> str:
    plain = name.replace("-", "").replace("_", "")
    return name if plain.isascii() and plain.isalnum() else _text(name)


def _text(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{"".join(c for c in escaped if c.isprintable())}"'


def _list(values: Sequence[float] | np.ndarray) -> str:
    return "[" + ", ".join(_number(float(v)) for v in values) + "]"


def _matrix(values: np.ndarray) -> str:
    return "[" + ", ".join(_list(row) for row in values) + "]"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)
