"""Read a benchmark's errors of camera arrays at floor positions, and show them in the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.errors import FileDamaged, FileMissing
from .._exchange.json_file import read_json_file
from .._exchange.solve_settings import METHODS
from ..conventions.datablocks import shader_of

FORMAT, VERSION = "manifold_mocap_places", 1
_LABELS = {"triangulation": "Triangulation", **{method.value: method.label for method in METHODS}}


@dataclass(frozen=True)
class PlaceMap:
    """Errors of a camera array at floor positions, in rows along Y and columns along X."""

    array: str
    x_m: np.ndarray
    y_m: np.ndarray
    error_mm: np.ndarray  # (Y, X), NaN where no keypoint is triangulated.

    @property
    def median_mm(self) -> float | None:
        """Median error in millimetres over all positions that are not NaN, or None if there are none."""
        good = self.error_mm[np.isfinite(self.error_mm)]
        return float(np.median(good)) if good.size else None


def read_places(path: Path) -> list[PlaceMap]:
    """Read the error map of each camera array in a benchmark's file."""
    if not path.exists():
        raise FileMissing("The map no longer exists.", where=str(path), hint="Run the benchmark again.")
    values = read_json_file(path)
    try:
        if (values["format"], values["version"]) != (FORMAT, VERSION):
            raise ValueError("another format")
        names = ("x_m", "y_m", "error_mm")
        maps = [
            PlaceMap(str(item["camera_array"]), *(np.array(item[name], np.float64) for name in names))
            for item in values["places"]
        ]
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise FileDamaged(f"This is not an error map: {error}.", where=str(path)) from error
    if not maps:
        raise FileDamaged("The map contains no camera array.", where=str(path), hint="Run the benchmark again.")
    if any(m.error_mm.shape != (*m.y_m.shape, *m.x_m.shape) or min(m.error_mm.shape, default=0) < 2 for m in maps):
        raise FileDamaged("The number of rows in the map does not match its positions.", where=str(path))
    return maps


def shared_limits(maps: Sequence[PlaceMap]) -> tuple[float, float]:
    """Return the smallest error and the 95th percentile of the errors in all maps, in millimetres."""
    good = np.concatenate([item.error_mm[np.isfinite(item.error_mm)] for item in maps])
    return (float(good.min()), float(np.percentile(good, 95))) if good.size else (0.0, 1.0)


MAP = "mocap_places"  # Custom property of the map object: the name of the camera array.
_STEPS = 12
_RAISED_M = 0.004
_FILLED = 0.96
"""Filled fraction of each side of a square."""
_NO_DATA = (0.25, 0.25, 0.25, 1.0)  # Colour of a place where no keypoint is triangulated. Chosen by hand.


def remove_places(scene: bpy.types.Scene) -> None:
    """Remove the error map from a scene's floor."""
    for old in [obj for obj in scene.objects if MAP in obj]:
        mesh = old.data
        bpy.data.objects.remove(old)
        if mesh.users == 0:
            bpy.data.meshes.remove(mesh)


def show_places(scene: bpy.types.Scene, places: PlaceMap, limits_mm: tuple[float, float]) -> bpy.types.Object:
    """Replace the map on a scene's floor, and return the new map object."""
    remove_places(scene)
    step = np.array([places.x_m[1] - places.x_m[0], places.y_m[1] - places.y_m[0]])
    middle = np.stack(np.meshgrid(places.x_m, places.y_m), axis=-1).reshape(-1, 2)
    corner = 0.5 * _FILLED * step * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    flat = (middle[:, None] + corner).reshape(-1, 2)
    mesh = bpy.data.meshes.new("error by place")
    faces = np.arange(len(flat)).reshape(-1, 4)
    mesh.from_pydata(np.c_[flat, np.full(len(flat), _RAISED_M)].tolist(), [], faces.tolist())
    error = places.error_mm.ravel()
    mesh.attributes.new("error_mm", "FLOAT", "FACE").data.foreach_set("value", error.astype(np.float32))
    for step_index in range(_STEPS + 1):
        mesh.materials.append(_material(step_index, limits_mm))
    mesh.polygons.foreach_set("material_index", _step(error, limits_mm).astype(np.int32))
    mesh.update()
    obj = bpy.data.objects.new(f"error by place, {places.array}", mesh)
    obj[MAP] = places.array
    obj.hide_select = True
    scene.collection.objects.link(obj)
    return obj


def _step(error: np.ndarray, limits_mm: tuple[float, float]) -> np.ndarray:
    low, high = limits_mm
    share = (error - low) / max(high - low, 1e-9)
    step = np.clip(np.nan_to_num(share) * _STEPS, 0, _STEPS - 1).astype(int)
    return np.where(np.isfinite(error), step, _STEPS)


def _material(step: int, limits_mm: tuple[float, float]) -> bpy.types.Material:
    low, high = limits_mm
    share = step / (_STEPS - 1)
    if step == _STEPS:
        name, colour = "not triangulated", _NO_DATA
    else:
        name = f"{low + share * (high - low):.0f} mm"
        blue, yellow, red = np.array([0.05, 0.25, 0.7]), np.array([0.9, 0.75, 0.15]), np.array([0.75, 0.06, 0.03])
        mixed = blue + 2 * share * (yellow - blue) if share < 0.5 else yellow + (2 * share - 1) * (red - yellow)
        colour = (*mixed.tolist(), 1.0)
    known = next((m for m in bpy.data.materials if m.name == name and tuple(m.diffuse_color) == colour), None)
    material = known or bpy.data.materials.new(name)
    material.diffuse_color = colour
    shader = shader_of(material)
    shader.inputs["Base Color"].default_value = colour
    shader.inputs["Roughness"].default_value = 0.9
    return material


def rows_of(verdicts: Sequence[Mapping[str, Any]], arrays: Sequence[str]) -> list[tuple[str, str]]:
    """Return a row for each camera array: its name, and a text with each method's mean joint error over its shots."""
    return [(array, _line_of([v for v in verdicts if v["camera_array"] == array])) for array in arrays]


def _line_of(verdicts: Sequence[Mapping[str, Any]]) -> str:
    parts = []
    for method in dict.fromkeys(v["method"] for v in verdicts):
        errors = [v["mpjpe_mm"] for v in verdicts if v["method"] == method and v["mpjpe_mm"] is not None]
        mean = f"{sum(errors) / len(errors):.1f} mm" if errors else "failed"
        parts.append(f"{_LABELS.get(method, method)} {mean}")
    return ", ".join(parts) or "one camera cannot triangulate"
