"""Show a take's props. Each is an animated empty with a mesh of its markers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import bpy
import numpy as np

from .._exchange.props import Prop
from .._exchange.so3 import quat_from_rotvec, sign_continuous
from ..animation.curves import create_action, key_type_values, mark_laid, write_curves
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import child_collection
from ..conventions.timing import TakeTiming

MARKERS = "marker_labels"  # Custom property of a prop's mesh: the label of each vertex, one per line.
SIGMA_MM, SIGMA_DEG = "sigma_mm", "sigma_deg"
"""Animated custom properties of a prop's empty: the standard deviations of its position (mm) and rotation (degrees)."""
_EMPTY_M = 0.1  # Length of an empty's arrows in metres.
_EDGES = 3  # Smallest number of edges drawn from each marker to its nearest neighbours.


def create_props(
    scene: bpy.types.Scene, props: Sequence[Prop], fps: float, timing: TakeTiming, collection: bpy.types.Collection
) -> tuple[bpy.types.Object, ...]:
    """Create an animated empty for each prop in a new collection, with the prop's markers as its child."""
    if not props:
        return ()
    folder = child_collection("Props", collection)
    empties = tuple(_create_prop(prop, fps, timing, folder, scene.unit_settings.scale_length) for prop in props)
    fit_units(scene, empties)
    return empties


def _create_prop(
    prop: Prop, fps: float, timing: TakeTiming, folder: bpy.types.Collection, metres_a_unit: float
) -> bpy.types.Object:
    empty = bpy.data.objects.new(prop.name, None)
    empty.empty_display_type, empty.empty_display_size = "ARROWS", _EMPTY_M
    empty.rotation_mode = "QUATERNION"
    folder.objects.link(empty)
    frames = len(prop.rotvec)
    times, types = timing.scene_frames(frames, fps), key_type_values(None, frames)
    target = create_action(f"{folder.name} {prop.name}", empty)
    channels = {
        "location": prop.transl / metres_a_unit,  # the empty's scale does not apply to its own keys
        "rotation_quaternion": sign_continuous(quat_from_rotvec(prop.rotvec)[:, None])[:, 0],
        f'["{SIGMA_MM}"]': 1000 * prop.sigma[:, :1],
        f'["{SIGMA_DEG}"]': np.degrees(prop.sigma[:, 1:]),
    }
    empty[SIGMA_MM], empty[SIGMA_DEG] = 0.0, 0.0
    for path, values in channels.items():
        write_curves(target, path, prop.name, times, values, types)
    mark_laid(target.action, fps, frames, timing.start, timing.scene_fps)
    mesh = bpy.data.meshes.new(f"{prop.name} markers")
    mesh.from_pydata(prop.points.tolist(), _edges(prop.points), [])
    mesh.update()
    markers = bpy.data.objects.new(mesh.name, mesh)
    markers[MARKERS] = "\n".join(prop.labels)
    markers.parent = empty
    folder.objects.link(markers)
    return empty


def _edges(points: np.ndarray) -> list[tuple[int, int]]:
    away = np.linalg.norm(points[:, None] - points, axis=-1)
    near = np.argsort(away, axis=1)[:, 1 : 1 + _EDGES]
    return [(a, b) for a, b in combinations(range(len(points)), 2) if b in near[a] or a in near[b]]
