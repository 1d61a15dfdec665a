"""Geometry nodes that add a body's pose correctives: over a vertex's rows, ``v + sum P_row flatten(R_joint - I)``."""

from __future__ import annotations

from collections.abc import Sequence

import bpy

_JOINT = "joint"


def row_attribute(slot: int) -> str:
    """Return the name of the skin's attribute that holds a vertex's row in the table of correctives."""
    return f"corrective {slot}"


def column_attribute(row: int, column: int) -> str:
    """Return the name of the table's attribute that belongs to one element of ``R - I``."""
    return f"r{row}{column}"


def build_corrective_nodes(
    name: str, table: bpy.types.Object, joints: Sequence[str], slots: int
) -> bpy.types.GeometryNodeTree:
    """Return nodes that move a skin by its correctives; each joint's rotation is a hidden input, XYZ Euler angles.

    Args:
        name: name of the node group.
        table: points with the index of their joint and nine vectors each.
        joints: names of the joints that the table counts.
        slots: number of rows that a vertex may have.
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
    moved = tree.nodes.new("GeometryNodeSetPosition")
    _link(tree, source.outputs["Geometry"], moved.inputs["Geometry"])
    _link(tree, _displacement(tree, _rotation(tree, entry, joints)), moved.inputs["Position"])
    total = None
    for slot in range(slots):
        part = _sampled(tree, moved.outputs["Geometry"], slot)
        total = part if total is None else _vector_math(tree, "ADD", total, part).outputs[0]
    skin = tree.nodes.new("GeometryNodeSetPosition")
    leave = tree.nodes.new("NodeGroupOutput")
    _link(tree, entry.outputs["Geometry"], skin.inputs["Geometry"])
    _link(tree, total, skin.inputs["Offset"])
    _link(tree, skin.outputs["Geometry"], leave.inputs["Geometry"])
    for k, node in enumerate(tree.nodes):
        node.location = (220.0 * (k // 8), -180.0 * (k % 8))
    return tree


def drive_input(modifier: bpy.types.NodesModifier, name: str, axis: int) -> bpy.types.Driver:
    """Return a new driver of one axis of a vector input of a nodes modifier."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if hasattr(modifier, "properties"):  # Blender 5.2 and later
        return getattr(modifier.properties.inputs, identifier).driver_add("value", axis).driver
    return modifier.driver_add(f'["{identifier}"]', axis).driver


def _rotation(tree: bpy.types.GeometryNodeTree, entry: bpy.types.Node, joints: Sequence[str]) -> bpy.types.NodeSocket:
    """Return the rotation of the joint that each row of the table belongs to."""
    chosen = tree.nodes.new("GeometryNodeIndexSwitch")
    chosen.data_type = "VECTOR"
    for _ in range(len(joints) - len(chosen.index_switch_items)):
        chosen.index_switch_items.new()
    _link(tree, _attribute(tree, _JOINT, "INT"), chosen.inputs["Index"])
    for k, joint in enumerate(joints):
        _link(tree, entry.outputs[joint], chosen.inputs[1 + k])
    rotation = tree.nodes.new("FunctionNodeEulerToRotation")
    _link(tree, chosen.outputs[0], rotation.inputs[0])
    return rotation.outputs[0]


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
            direction = _attribute(tree, column_attribute(row, column), "FLOAT_VECTOR")
            added = (direction, parts.outputs[row]) + (() if total is None else (total,))
            total = _vector_math(tree, "MULTIPLY_ADD", *added).outputs[0]
    return total


def _sampled(tree: bpy.types.GeometryNodeTree, table: bpy.types.NodeSocket, slot: int) -> bpy.types.NodeSocket:
    """Return what a row of the table moves a vertex by; a row of -1 does not move it."""
    position = tree.nodes.new("GeometryNodeInputPosition")
    sample = tree.nodes.new("GeometryNodeSampleIndex")
    sample.data_type, sample.domain, sample.clamp = "FLOAT_VECTOR", "POINT", False
    _link(tree, table, sample.inputs["Geometry"])
    _link(tree, position.outputs[0], sample.inputs["Value"])
    _link(tree, _attribute(tree, row_attribute(slot), "INT"), sample.inputs["Index"])
    return sample.outputs[0]


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
