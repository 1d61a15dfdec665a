"""Geometry nodes that add a body's pose correctives: over a vertex's rows, ``v + sum P_row flatten(R_joint - I)``.

The table's points are grouped by vertex and summed there; the skin then looks up the sum at its first row.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..conventions.node_inputs import node_input
from .drivers import add_driver

JOINT, VERTEX = "joint", "vertex"
"""Names of the table's attributes that hold which joint and vertex a row belongs to."""
ROW = "corrective row"
"""Name of the skin's attribute that holds a vertex's first row in the table."""
IN_POSITION = 2, 2
"""Row and column of ``R - I`` whose vectors are the table's positions, which a mesh has anyway."""
NO_ROW, MIRRORED = -1, -2
"""Value of vertices that nothing moves; one whose mirror image has the row r has -2 - r."""


def column_attribute(row: int, column: int) -> str:
    """Return the name of the table's attribute that belongs to one element of ``R - I``."""
    return f"r{row}{column}"


def build_corrective_nodes(
    name: str, table: bpy.types.Object, joints: Sequence[str], opposite: Sequence[int]
) -> bpy.types.GeometryNodeTree:
    """Return nodes that move a skin by its correctives; each joint's rotation is a hidden input, XYZ Euler angles.

    Args:
        name: name of the node group.
        table: points with the index of their joint and nine vectors each.
        joints: names of the joints that the table counts.
        opposite: for each joint the place of the one across in ``joints``; empty where the table is of the whole body.
    """
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.is_modifier = True
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    for joint in joints:
        socket = tree.interface.new_socket(joint, in_out="INPUT", socket_type="NodeSocketVector")
        socket.hide_in_modifier = True
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry = tree.nodes.new("NodeGroupInput")
    source = tree.nodes.new("GeometryNodeObjectInfo")
    source.inputs["Object"].default_value = table
    points, row = source.outputs["Geometry"], _attribute(tree, ROW, "INT")
    inner = _sums(f"{name} of one side")
    angles = [entry.outputs[joint] for joint in joints]
    moved = _looked_up(tree, points, _summed(tree, inner, _chosen(tree, angles)), row)
    if opposite:
        mirrored = _vector_math(tree, "MULTIPLY", _chosen(tree, [angles[k] for k in opposite]))
        mirrored.inputs[1].default_value = (1.0, -1.0, -1.0)
        across = tree.nodes.new("ShaderNodeMath")
        across.operation = "SUBTRACT"
        across.inputs[0].default_value = MIRRORED
        _link(tree, row, across.inputs[1])
        there = _looked_up(tree, points, _summed(tree, inner, mirrored.outputs[0]), across.outputs[0])
        back = _vector_math(tree, "MULTIPLY_ADD", there)
        back.inputs[1].default_value = (-1.0, 1.0, 1.0)
        _link(tree, moved, back.inputs[2])
        moved = back.outputs[0]
    skin = tree.nodes.new("GeometryNodeSetPosition")
    leave = tree.nodes.new("NodeGroupOutput")
    _link(tree, entry.outputs["Geometry"], skin.inputs["Geometry"])
    _link(tree, moved, skin.inputs["Offset"])
    _link(tree, skin.outputs["Geometry"], leave.inputs["Geometry"])
    _lay_out(tree)
    return tree


def drive_input(modifier: bpy.types.NodesModifier, name: str, axis: int) -> bpy.types.Driver:
    """Return a new driver of one axis of a vector input of a nodes modifier."""
    owner, path = node_input(modifier, name)
    return add_driver(owner, path, axis)


def _chosen(tree: bpy.types.GeometryNodeTree, angles: Sequence[bpy.types.NodeSocket]) -> bpy.types.NodeSocket:
    """Return the angles of the joint that each row of the table belongs to."""
    chosen = tree.nodes.new("GeometryNodeIndexSwitch")
    chosen.data_type = "VECTOR"
    for _ in range(len(angles) - len(chosen.index_switch_items)):
        chosen.index_switch_items.new()
    _link(tree, _attribute(tree, JOINT, "INT"), chosen.inputs["Index"])
    for k, angle in enumerate(angles):
        _link(tree, angle, chosen.inputs[1 + k])
    return chosen.outputs[0]


def _sums(name: str) -> bpy.types.GeometryNodeTree:
    """Return nodes that turn each row's angles into what all rows of its vertex move the skin by."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Angles", in_out="INPUT", socket_type="NodeSocketVector")
    tree.interface.new_socket("Sum", in_out="OUTPUT", socket_type="NodeSocketVector")
    rotation = tree.nodes.new("FunctionNodeEulerToRotation")
    _link(tree, tree.nodes.new("NodeGroupInput").outputs[0], rotation.inputs[0])
    total = tree.nodes.new("GeometryNodeAccumulateField")
    total.data_type, total.domain = "FLOAT_VECTOR", "POINT"
    _link(tree, _displacement(tree, rotation.outputs[0]), _enabled(total.inputs, "Value"))
    _link(tree, _attribute(tree, VERTEX, "INT"), _enabled(total.inputs, "Group ID"))
    _link(tree, _enabled(total.outputs, "Total"), tree.nodes.new("NodeGroupOutput").inputs[0])
    _lay_out(tree)
    return tree


def _summed(
    tree: bpy.types.GeometryNodeTree, inner: bpy.types.GeometryNodeTree, angles: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    group = tree.nodes.new("GeometryNodeGroup")
    group.node_tree = inner
    _link(tree, angles, group.inputs[0])
    return group.outputs[0]


def _displacement(tree: bpy.types.GeometryNodeTree, rotation: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the sum over rows a and columns b of the vector ``r_ab`` times ``R_ab - I_ab``."""
    total = None
    for column in range(3):
        axis = [float(column == k) for k in range(3)]
        turned = tree.nodes.new("FunctionNodeRotateVector")
        turned.inputs["Vector"].default_value = axis
        _link(tree, rotation, turned.inputs["Rotation"])
        change = _vector_math(tree, "SUBTRACT", turned.outputs[0])
        change.inputs[1].default_value = axis
        parts = tree.nodes.new("ShaderNodeSeparateXYZ")
        _link(tree, change.outputs[0], parts.inputs[0])
        for row in range(3):
            if (row, column) == IN_POSITION:
                direction = tree.nodes.new("GeometryNodeInputPosition").outputs[0]
            else:
                direction = _attribute(tree, column_attribute(row, column), "FLOAT_VECTOR")
            added = (direction, parts.outputs[row]) + (() if total is None else (total,))
            total = _vector_math(tree, "MULTIPLY_ADD", *added).outputs[0]
    return total


def _looked_up(
    tree: bpy.types.GeometryNodeTree,
    points: bpy.types.NodeSocket,
    value: bpy.types.NodeSocket,
    row: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return a value of the table's points by row; zero where there is no such row."""
    sample = tree.nodes.new("GeometryNodeSampleIndex")
    sample.data_type, sample.domain, sample.clamp = "FLOAT_VECTOR", "POINT", False
    _link(tree, points, sample.inputs["Geometry"])
    _link(tree, value, _enabled(sample.inputs, "Value"))
    _link(tree, row, sample.inputs["Index"])
    return _enabled(sample.outputs, "Value")


def _enabled(sockets: bpy.types.bpy_prop_collection, name: str) -> bpy.types.NodeSocket:
    """Return the socket of the data type that a node is set to, among those of its other types."""
    return next(socket for socket in sockets if socket.name == name and socket.enabled)


def _lay_out(tree: bpy.types.GeometryNodeTree) -> None:
    for k, node in enumerate(tree.nodes):
        node.location = (220.0 * (k // 8), -180.0 * (k % 8))


def _attribute(tree: bpy.types.GeometryNodeTree, name: str, kind: str) -> bpy.types.NodeSocket:
    node = tree.nodes.new("GeometryNodeInputNamedAttribute")
    node.data_type = kind
    node.inputs["Name"].default_value = name
    return node.outputs["Attribute"]


def _vector_math(
    tree: bpy.types.GeometryNodeTree, operation: str, *sources: bpy.types.NodeSocket
) -> bpy.types.ShaderNodeVectorMath:
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = operation
    for source, target in zip(sources, node.inputs, strict=False):
        _link(tree, source, target)
    return node


def _link(tree: bpy.types.GeometryNodeTree, source: bpy.types.NodeSocket, target: bpy.types.NodeSocket) -> None:
    tree.links.new(source, target)
