"""Geometry-node modifier that plays points stored in a mesh, one row of points per frame.

The mesh has F rows of K vertices. The modifier creates K points, moves each to vertex ``row * K + k`` of the current
row, removes unseen points, and puts a small ball on all others. So an overlay is one object without curves, handlers or
drivers. It plays in any Blender, needs O(K) time per frame, and uses 16 bytes per point in the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy

from ..conventions.nodes import add_node, attribute, math, new_tree, sample_index

MODIFIER = "Points of this frame"  # Name of the modifier.
RADIUS = "Radius"  # Name of the modifier's input that sets the radius of the balls in metres.
SEEN = "seen"  # Name of the point attribute that is 0 where a point is unseen.
POINTS = "points"  # Custom property of an object that plays points: the number of points per row.
GRADE = "grade"  # Name of the point attribute that stores the index of a point's material.


@dataclass(frozen=True)
class PlayerSettings:
    """Number, timing and materials of the points that a player shows."""

    points: int  # Points per row.
    rows: int
    frame_start: float  # Scene frame of the first row.
    rows_per_frame: float  # Rows per scene frame.
    materials: tuple[bpy.types.Material, ...]
    """Materials of the balls. If there are several, the attribute ``GRADE`` selects one."""


def create_player(name: str, settings: PlayerSettings) -> bpy.types.NodeTree:
    """Create the node group that plays a mesh of ``rows * points`` vertices, one row of points at a time."""
    geometry = ("Geometry", "IN", "Geometry"), (RADIUS, "IN", "Float"), ("Geometry", "OUT", "Geometry")
    tree = new_tree(name, *geometry)
    size = tree.interface.items_tree[RADIUS]
    size.subtype, size.min_value = "DISTANCE", 0.0
    stored, radius = tree.nodes.new("NodeGroupInput").outputs[:2]
    index, seen = _vertex_index(tree, settings), attribute(tree, SEEN, "FLOAT")
    cloud = add_node(tree, "GeometryNodePoints", inputs={"Count": settings.points}).outputs[0]
    position = tree.nodes.new("GeometryNodeInputPosition").outputs[0]
    place = sample_index(tree, "FLOAT_VECTOR", stored, position, index)
    moved = add_node(tree, "GeometryNodeSetPosition", inputs={"Geometry": cloud, "Position": place}).outputs[0]
    if len(settings.materials) > 1:  # the index selects the material, so this must precede the removal of unseen points
        grade = sample_index(tree, "FLOAT", stored, attribute(tree, GRADE, "FLOAT"), index)
        inputs = {"Geometry": moved, "Name": GRADE, "Value": grade}
        moved = add_node(tree, "GeometryNodeStoreNamedAttribute", inputs=inputs).outputs[0]
    unseen = math(tree, "LESS_THAN", sample_index(tree, "FLOAT", stored, seen, index), 0.5)
    kept = add_node(tree, "GeometryNodeDeleteGeometry", inputs={"Geometry": moved, "Selection": unseen}).outputs[0]
    add_node(tree, "NodeGroupOutput", _balls(tree, kept, radius, settings))
    return tree


def player_of(obj: bpy.types.Object) -> bpy.types.NodeTree | None:
    """Return the node group that plays an object's points, or None if there is none."""
    modifier = obj.modifiers.get(MODIFIER)
    return modifier.node_group if modifier is not None and modifier.type == "NODES" else None


def played_rate(obj: bpy.types.Object) -> float:
    """Return how many stored rows of points an object plays per scene frame."""
    return float(_rate_socket(obj).default_value)


def played_row(obj: bpy.types.Object, frame: float) -> int:
    """Return the row that an object shows at a scene frame. Its node group computes the same."""
    return min(max(0, round((frame - _first_frame(obj)) * played_rate(obj))), _rows(obj) - 1)


def last_row_frame(obj: bpy.types.Object) -> float:
    """Return the first scene frame that shows an object's last row."""
    return _first_frame(obj) + (_rows(obj) - 1) / played_rate(obj)


def _first_frame(obj: bpy.types.Object) -> float:
    return float(_rate_socket(obj).node.inputs[0].links[0].from_node.inputs[1].default_value)


def _rows(obj: bpy.types.Object) -> int:
    return len(obj.data.vertices) // max(1, obj[POINTS])


def set_played_rate(obj: bpy.types.Object, rows_per_frame: float) -> None:
    """Set the number of rows per scene frame. The first row keeps its scene frame."""
    if abs(played_rate(obj) - rows_per_frame) > 1e-9:
        _rate_socket(obj).default_value = rows_per_frame


def _rate_socket(obj: bpy.types.Object) -> Any:
    """Return the node socket that stores how many rows an object plays per scene frame."""
    tree = player_of(obj)
    assert tree is not None
    difference = next(node for node in tree.nodes if getattr(node, "operation", "") == "SUBTRACT")
    return difference.outputs[0].links[0].to_node.inputs[1]


def _vertex_index(tree: bpy.types.NodeTree, settings: PlayerSettings) -> Any:
    frame = tree.nodes.new("GeometryNodeInputSceneTime").outputs["Frame"]
    row = math(tree, "MULTIPLY", math(tree, "SUBTRACT", frame, settings.frame_start), settings.rows_per_frame)
    row = math(tree, "MINIMUM", math(tree, "MAXIMUM", math(tree, "ROUND", row), 0.0), settings.rows - 1)
    first = math(tree, "MULTIPLY", row, settings.points)
    return math(tree, "ADD", first, tree.nodes.new("GeometryNodeInputIndex").outputs[0])


def _balls(tree: bpy.types.NodeTree, points: Any, radius: Any, settings: PlayerSettings) -> Any:
    ball = add_node(tree, "GeometryNodeMeshIcoSphere", inputs={"Radius": radius, "Subdivisions": 2}).outputs[0]
    instances = add_node(tree, "GeometryNodeInstanceOnPoints", inputs={"Points": points, "Instance": ball})
    painted = add_node(tree, "GeometryNodeRealizeInstances", inputs={"Geometry": instances.outputs[0]}).outputs[0]
    for number, material in enumerate(settings.materials):
        inputs = {"Geometry": painted, "Material": material}
        if number:
            inputs["Selection"] = math(tree, "GREATER_THAN", attribute(tree, GRADE, "FLOAT"), number - 0.5)
        painted = add_node(tree, "GeometryNodeSetMaterial", inputs=inputs).outputs[0]
    return painted
