"""A geometry-node modifier that plays points stored in a mesh, one row of points a frame.

The mesh holds the whole take: F rows of K vertices. The modifier makes K points, moves each to vertex
``row * K + k`` of the current row, drops those that were not seen, and puts a small ball on each. So an overlay is
one object without curves, handlers or drivers: it plays wherever the file is opened, scrubs in O(K) a frame,
and costs 16 bytes a point in the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy

MODIFIER = "Points of this frame"
"""Name of the modifier."""
RADIUS = "Radius"
"""Name of the modifier's input that sets how large the balls are, metres."""
SEEN = "seen"
"""Name of the point attribute that is 0 where a point was not seen."""
POINTS = "points"
"""Custom property of an object that plays points: how many there are in a row."""
GRADE = "grade"
"""Name of the point attribute that selects which of the materials a point takes, 0 for the first."""


@dataclass(frozen=True)
class PlayerSettings:
    """What the modifier plays and how it looks."""

    points: int
    """Points in a row."""
    rows: int
    """Rows, one a frame."""
    frame_start: float
    """Scene frame of the first row."""
    rows_per_frame: float
    """Rows that pass in one scene frame."""
    materials: tuple[bpy.types.Material, ...]
    """Materials of the balls; where there are several, the mesh selects by ``GRADE`` which one a point takes."""


def create_player(name: str, settings: PlayerSettings) -> bpy.types.NodeTree:
    """Create the node group that plays a mesh of ``rows * points`` vertices."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    size = tree.interface.new_socket(RADIUS, in_out="INPUT", socket_type="NodeSocketFloat")
    size.subtype, size.min_value = "DISTANCE", 0.0
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    stored, radius = tree.nodes.new("NodeGroupInput").outputs[:2]
    index = _vertex_index(tree, settings)
    cloud = tree.nodes.new("GeometryNodePoints")
    cloud.inputs["Count"].default_value = settings.points
    position = tree.nodes.new("GeometryNodeInputPosition").outputs[0]
    seen = _named(tree, SEEN)
    moved = _linked(tree, "GeometryNodeSetPosition", Geometry=cloud.outputs[0])
    tree.links.new(_sampled(tree, "FLOAT_VECTOR", stored, position, index), moved.inputs["Position"])
    if len(settings.materials) > 1:
        grade = _named(tree, GRADE)
        moved = _linked(tree, "GeometryNodeStoreNamedAttribute", Geometry=moved.outputs[0])
        moved.inputs["Name"].default_value = GRADE  # by index, so before unseen points go
        tree.links.new(_sampled(tree, "FLOAT", stored, grade, index), _enabled(moved.inputs, "Value"))
    unseen = _math(tree, "LESS_THAN", _sampled(tree, "FLOAT", stored, seen, index), 0.5)
    kept = _linked(tree, "GeometryNodeDeleteGeometry", Geometry=moved.outputs[0], Selection=unseen)
    balls = _balls(tree, kept.outputs[0], radius, settings)
    tree.links.new(balls, tree.nodes.new("NodeGroupOutput").inputs[0])
    return tree


def player_of(obj: bpy.types.Object) -> bpy.types.NodeTree | None:
    """Return the node group that plays an object's points, None if it has none."""
    modifier = obj.modifiers.get(MODIFIER)
    return modifier.node_group if modifier is not None and modifier.type == "NODES" else None


def played_rate(obj: bpy.types.Object) -> float:
    """Return how many rows pass in one scene frame."""
    return float(_rate_socket(obj).default_value)


def played_row(obj: bpy.types.Object, frame: float) -> int:
    """Return the row that an object shows on a scene frame, as its node group finds it."""
    return min(max(0, round((frame - _first_frame(obj)) * played_rate(obj))), _rows(obj) - 1)


def last_row_frame(obj: bpy.types.Object) -> float:
    """Return the scene frame on which an object shows its last row first."""
    return _first_frame(obj) + (_rows(obj) - 1) / played_rate(obj)


def _first_frame(obj: bpy.types.Object) -> float:
    return float(_rate_socket(obj).node.inputs[0].links[0].from_node.inputs[1].default_value)


def _rows(obj: bpy.types.Object) -> int:
    return len(obj.data.vertices) // max(1, obj[POINTS])


def set_played_rate(obj: bpy.types.Object, rows_per_frame: float) -> None:
    """Let so many rows pass in one scene frame; the first row's frame stays."""
    if abs(played_rate(obj) - rows_per_frame) > 1e-9:
        _rate_socket(obj).default_value = rows_per_frame


def _rate_socket(obj: bpy.types.Object) -> Any:
    """Return the second factor of ``(frame - first) * rows per frame``, the tree's one difference."""
    tree = player_of(obj)
    assert tree is not None
    difference = next(node for node in tree.nodes if getattr(node, "operation", "") == "SUBTRACT")
    return difference.outputs[0].links[0].to_node.inputs[1]


def _vertex_index(tree: bpy.types.NodeTree, settings: PlayerSettings) -> Any:
    frame = tree.nodes.new("GeometryNodeInputSceneTime").outputs["Frame"]
    row = _math(tree, "MULTIPLY", _math(tree, "SUBTRACT", frame, settings.frame_start), settings.rows_per_frame)
    row = _math(tree, "MINIMUM", _math(tree, "MAXIMUM", _math(tree, "ROUND", row), 0.0), settings.rows - 1)
    first = _math(tree, "MULTIPLY", row, settings.points)
    return _math(tree, "ADD", first, tree.nodes.new("GeometryNodeInputIndex").outputs[0])


def _sampled(tree: bpy.types.NodeTree, data_type: str, geometry: Any, value: Any, index: Any) -> Any:
    node = tree.nodes.new("GeometryNodeSampleIndex")
    node.data_type = data_type
    node.domain = "POINT"
    for name, source in (("Geometry", geometry), ("Value", value), ("Index", index)):
        tree.links.new(source, _enabled(node.inputs, name))
    return next(s for s in node.outputs if s.enabled)


def _named(tree: bpy.types.NodeTree, name: str) -> Any:
    attribute = tree.nodes.new("GeometryNodeInputNamedAttribute")
    attribute.data_type = "FLOAT"
    attribute.inputs["Name"].default_value = name
    return next(s for s in attribute.outputs if s.enabled)


def _enabled(sockets: Any, name: str) -> Any:
    """Return the socket of the data type that a node is set to, among those of its other types."""
    return next(s for s in sockets if s.name == name and s.enabled)


def _balls(tree: bpy.types.NodeTree, points: Any, radius: Any, settings: PlayerSettings) -> Any:
    ball = _linked(tree, "GeometryNodeMeshIcoSphere", Radius=radius)
    ball.inputs["Subdivisions"].default_value = 2
    instances = _linked(tree, "GeometryNodeInstanceOnPoints", Points=points, Instance=ball.outputs[0])
    painted = _linked(tree, "GeometryNodeRealizeInstances", Geometry=instances.outputs[0])
    for number, material in enumerate(settings.materials):
        painted = _linked(tree, "GeometryNodeSetMaterial", Geometry=painted.outputs[0])
        painted.inputs["Material"].default_value = material
        if number:
            tree.links.new(_math(tree, "GREATER_THAN", _named(tree, GRADE), number - 0.5), painted.inputs["Selection"])
    return painted.outputs[0]


def _linked(tree: bpy.types.NodeTree, kind: str, **sources: Any) -> Any:
    node = tree.nodes.new(kind)
    for name, source in sources.items():
        tree.links.new(source, node.inputs[name])
    return node


def _math(tree: bpy.types.NodeTree, operation: str, first: Any, second: Any = None) -> Any:
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for socket, source in zip(node.inputs, (first, second), strict=False):
        if isinstance(source, int | float):
            socket.default_value = float(source)
        elif source is not None:
            tree.links.new(source, socket)
    return node.outputs[0]
