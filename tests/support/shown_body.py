"""The body that solves use and the one that Blender shows, and poses in which they differ."""

from __future__ import annotations

from dataclasses import replace

import bpy  # noqa: F401  # brings mathutils
import numpy as np
from mathutils.bvhtree import BVHTree

from assets_procedural.layout import PARENTS
from assets_procedural.quality.contact_sheet import EXTREMES, BakedBody, read_baked
from assets_procedural.skeleton.skinning import vertex_areas, volume
from blender_addon.body.body_file import default_body_path, read_body

NAMED = {
    "crossed arms": {
        "left_collar": (0.0, -12.0, -6.0), "right_collar": (0.0, 12.0, 6.0), "left_shoulder": (25.0, -70.0, -42.0),
        "right_shoulder": (25.0, 70.0, 42.0), "left_elbow": (0.0, -105.0, 0.0), "right_elbow": (0.0, 105.0, 0.0),
    },
    "elbows bent": {
        "left_elbow": (0.0, -100.0, 0.0), "right_elbow": (0.0, 100.0, 0.0), "left_shoulder": (0.0, 0.0, -40.0),
        "right_shoulder": (0.0, 0.0, 40.0),
    },
    "seated": {
        "left_hip": (-88.0, 0.0, 5.0), "right_hip": (-88.0, 0.0, -5.0), "left_knee": (88.0, 0.0, 0.0),
        "right_knee": (88.0, 0.0, 0.0), "left_shoulder": (0.0, 0.0, -65.0), "right_shoulder": (0.0, 0.0, 65.0),
    },
    **{name: EXTREMES[name] for name in ("arms down", "arms up", "cross-legged", "deep squat")},
}  # fmt: skip
"""Poses of the sheet, rotation vectors of joints in degrees."""


def bodies() -> dict[str, BakedBody]:
    """Return the body that solves use and the one that Blender shows."""
    before, shown = read_baked(), read_body(default_body_path())
    assert shown.posedirs is not None
    return {"before": before, "after": replace(before, posedirs=shown.posedirs.astype(np.float64))}


def figures(body: BakedBody, local: np.ndarray) -> tuple[float, float, float]:
    """Return volume, surface and number of intersecting faces near a joint, for a pose of (24, 3, 3) rotations."""
    posed = body.posed(local)
    return volume(posed, body.faces), float(vertex_areas(posed, body.faces).sum()), float(crossing(body, posed))


def crossing(body: BakedBody, posed: np.ndarray) -> int:
    """Return the number of faces that cross another one of the same bone or of a neighbouring one."""
    tree = BVHTree.FromPolygons(posed.tolist(), body.faces.tolist(), all_triangles=True)
    pairs = np.array([pair for pair in tree.overlap(tree) if pair[0] < pair[1]], dtype=np.int64).reshape(-1, 2)
    corners = body.faces[pairs]
    pairs = pairs[~(corners[:, 0, :, None] == corners[:, 1, None]).any(axis=(1, 2))]
    bone, parents = body.weights[body.faces].sum(axis=1).argmax(axis=1)[pairs], np.array(PARENTS)
    near = (bone[:, 0] == bone[:, 1]) | (parents[bone[:, 0]] == bone[:, 1]) | (parents[bone[:, 1]] == bone[:, 0])
    return len(np.unique(pairs[near]))
