"""Pose correctives: geometry nodes before the armature move the skin by the bones' rotations, as the model does.

The model adds ``P flatten(R_j - I)`` to the rest shape (Loper et al. 2015, eq. 9). A joint reaches few vertices, so
``P`` is kept as a table, a point for each vertex and joint that moves it, not as a shape key over the whole skin for
each of its features; drivers without Python bring the pose bones' rotations, constraints included, into the nodes.

Of a body that equals its mirror image the table holds the left half. With S = diag(-1, 1, 1), the skin at ``S v`` moves
by S times what ``v`` would move by if each joint turned as the one across from it does in the mirror; in the axes of
mirrored bones that is a rotation with two of its Euler angles negated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.datablocks import add_driver, node_input
from ..conventions.skeleton import BodyLayout
from .armature import rotation_from_body_axes
from .body_file import BodyFile, once_a_body

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


CORRECTIVES = "Pose Correctives"
"""Name of the modifier."""
_LARGEST_FEATURE = 2.0
_LEAST_M = 5e-5
"""Displacements that no rotation makes this large are left out."""
_SAME_PLACE_M, _SAME_DIRECTION_M = 2e-6, 2e-6
_FLIP, _TURNED = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])
"""S, and what a mirror does to the Euler angles of a bone in the axes of its mirror image."""


@dataclass(frozen=True)
class CorrectiveTable:
    """The pose correctives that are not zero: a row for each vertex and joint that moves it, by vertex."""

    vertex: np.ndarray
    """(N,) index of the vertex, rising."""
    joint: np.ndarray
    """(N,) index of the joint, 1..J-1."""
    directions: np.ndarray
    """(N, 3, 3, 3) metres: axis of the skin, then row and column of ``R - I``."""

    def part(self, chosen: np.ndarray) -> CorrectiveTable:
        """Return some of the rows."""
        return CorrectiveTable(self.vertex[chosen], self.joint[chosen], self.directions[chosen])


def corrective_table(posedirs: np.ndarray) -> CorrectiveTable:
    """Return the (V, 3, 9 (J - 1)) pose correctives as a table, in the axes they are given in."""
    blocks = posedirs.astype(np.float32).reshape(len(posedirs), 3, -1, 3, 3)
    reach = _LARGEST_FEATURE * np.sqrt(np.square(blocks).sum(axis=1).max(axis=(2, 3)))
    vertex, joint = np.nonzero(reach >= _LEAST_M)
    return CorrectiveTable(vertex, joint + 1, blocks[vertex, :, joint])


def add_correctives(
    armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile, hidden: bpy.types.Collection
) -> int:
    """Add the body's pose correctives to a mesh and return how many of its joints have some.

    Args:
        armature: from ``create_armature``.
        mesh: its mesh, deformed by an armature modifier.
        body: the body; without correctives nothing is added.
        hidden: collection that the table's points go into.
    """
    if body.posedirs is None:
        return 0
    axes = np.asarray(rotation_from_body_axes(armature), np.float64)
    table, turned, rows, joints, across = _mirrored_rows(body, axes.tobytes())
    if not joints:
        return 0
    points = _table_object(f"{mesh.name} correctives", table, turned, joints)
    hidden.objects.link(points)
    mesh.data.attributes.new(ROW, "INT", "POINT").data.foreach_set("value", rows)
    modifier = mesh.modifiers.new(CORRECTIVES, "NODES")
    names, mirror = [body.layout.joints[joint] for joint in joints], body.layout.mirror
    opposite = [names.index(body.layout.joints[mirror[joint]]) for joint in joints] if across else []
    modifier.node_group = build_corrective_nodes(f"{mesh.name} correctives", points, names, opposite)
    mesh.modifiers.move(len(mesh.modifiers) - 1, 0)
    for name in names:
        for axis in range(3):
            _drive(drive_input(modifier, name, axis), armature, name, "XYZ"[axis])
    return len(joints)


@once_a_body
def _mirrored_rows(body: BodyFile, axes: bytes) -> tuple[CorrectiveTable, np.ndarray, np.ndarray, list[int], bool]:
    """Return what is kept of a body's table: its left half where the right one mirrors it.

    Args:
        body: with correctives.
        axes: (J, 3, 3) of the bones, as bytes of float64.

    Returns:
        The table, the same in the axes of the bones (N, 3, 3, 3), the row of each vertex (V,), the joints of the whole
        table, and whether the right half is left out.
    """
    assert body.posedirs is not None
    table = corrective_table(body.posedirs)
    joints = np.unique(table.joint).tolist()
    turned = _in_bone_axes(table, np.frombuffer(axes).reshape(-1, 3, 3))
    across = mirror_of(body.v_template) if joints else None
    if across is not None and not _is_mirrored(table, turned, across, body.layout):
        across = None
    rows = np.full(len(body.v_template), NO_ROW, np.int32)
    if across is not None:
        kept = body.v_template[table.vertex, 0] >= -_SAME_PLACE_M
        table, turned = table.part(kept), turned[kept]
    first = np.unique(table.vertex, return_index=True)
    rows[first[0]] = first[1]
    if across is not None:
        right = body.v_template[:, 0] < -_SAME_PLACE_M
        rows[right] = np.where(rows[across[right]] >= 0, MIRRORED - rows[across[right]], NO_ROW)
    return table, turned, rows, joints, across is not None


def mirror_of(vertices: np.ndarray) -> np.ndarray | None:
    """Return (V,) the index of each vertex's mirror image, None where one has none."""
    keys = np.round(vertices / _SAME_PLACE_M).astype(np.int64)
    order, other = np.lexsort(keys.T), np.lexsort((keys * [-1, 1, 1]).T)
    if np.abs(vertices[order] - vertices[other] * _FLIP).max() > _SAME_PLACE_M:
        return None
    across = np.empty(len(vertices), np.int64)
    across[order] = other
    return across


def _is_mirrored(table: CorrectiveTable, turned: np.ndarray, across: np.ndarray, layout: BodyLayout) -> bool:
    """Return whether every row equals the one of the mirrored vertex and joint, mirrored, in the axes of the bones."""
    rows = zip(table.vertex.tolist(), table.joint.tolist(), strict=True)
    here = {key: row for row, key in enumerate(rows)}
    image = zip(across[table.vertex].tolist(), np.array(layout.mirror)[table.joint].tolist(), strict=True)
    found = np.array([here.get(key, -1) for key in image])
    if (found < 0).any():
        return False
    mirrored = turned[found] * _FLIP[:, None, None] * _TURNED[:, None] * _TURNED
    return bool(np.abs(mirrored - turned).max() < _SAME_DIRECTION_M)


def _in_bone_axes(table: CorrectiveTable, C: np.ndarray) -> np.ndarray:
    """Return (N, 3, 3, 3): the table for skin in the armature's axes and rotations in the bones' axes ``C``."""
    axes = C[table.joint]
    return np.einsum("kc,ncab,nia,njb->nkij", R_ARMATURE_BODY, table.directions, axes, axes, optimize=True)


def _table_object(name: str, table: CorrectiveTable, turned: np.ndarray, joints: list[int]) -> bpy.types.Object:
    """Return the table as points that count ``joints``; they stay hidden wherever the body is appended to."""
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(table.joint))
    data.vertices.foreach_set("co", turned[:, :, IN_POSITION[0], IN_POSITION[1]].astype(np.float32).ravel())
    order = np.searchsorted(joints, table.joint)
    data.attributes.new(JOINT, "INT8", "POINT").data.foreach_set("value", order.astype(np.int32))
    data.attributes.new(VERTEX, "INT", "POINT").data.foreach_set("value", table.vertex.astype(np.int32))
    for row in range(3):
        for column in range(3):
            if (row, column) != IN_POSITION:
                attribute = data.attributes.new(column_attribute(row, column), "FLOAT_VECTOR", "POINT")
                attribute.data.foreach_set("vector", turned[:, :, row, column].astype(np.float32).ravel())
    points = bpy.data.objects.new(name, data)
    points.hide_viewport = points.hide_render = points.hide_select = True
    return points


def _drive(driver: bpy.types.Driver, armature: bpy.types.Object, joint: str, axis: str) -> None:
    driver.type = "SUM"
    variable = driver.variables.new()
    variable.name, variable.type = axis.lower(), "TRANSFORMS"
    target = variable.targets[0]
    target.id, target.bone_target = armature, joint
    target.transform_type, target.rotation_mode = f"ROT_{axis}", "XYZ"
    target.transform_space = "LOCAL_SPACE"
