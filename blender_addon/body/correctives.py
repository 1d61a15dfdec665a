"""Deform the skin by pose correctives in geometry nodes, before the armature deforms it.

The model adds ``P flatten(R_j - I)`` to the rest shape (Loper et al. 2015, eq. 9). A joint affects few vertices, so
``P`` is stored as a table with one row per joint and affected vertex, instead of one full shape key per feature.
Drivers that do not need Python pass the pose bones' rotations, including constraints, to the nodes.

For a symmetric body, the table stores only the left half. With S = diag(-1, 1, 1), the skin at ``S v`` moves by S times
the offset that ``v`` would have if each joint were posed like the mirror image of the opposite joint. In the axes of
mirrored bones, this is a rotation with two negated Euler angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.datablocks import add_driver, node_input
from ..conventions.nodes import add_node, attribute, enabled, math, new_tree, sample_index
from ..conventions.skeleton import BodyLayout
from .armature import rotation_from_body_axes
from .body_file import BodyFile, once_a_body

JOINT, VERTEX = "joint", "vertex"  # Names of the attributes that store the joint and vertex of each table row.
ROW = "corrective row"  # Name of the skin attribute that stores a vertex's first row in the table.
IN_POSITION = 2, 2  # Row and column of ``R - I`` whose vectors are stored as positions in the table.
NO_ROW, MIRRORED = -1, -2
"""Row number of unaffected vertices, and the first row number of mirrored ones: -2 - r mirrors row r."""


def _column_attribute(row: int, column: int) -> str:
    return f"r{row}{column}"


def _build_corrective_nodes(name: str, table: Any, joints: Sequence[str], opposite: Sequence[int]) -> Any:
    """Create nodes that apply the correctives. Their inputs are the XYZ Euler angles of each joint."""
    geometry = ("Geometry", "IN", "Geometry"), *((joint, "IN", "Vector") for joint in joints)
    tree = new_tree(name, *geometry, ("Geometry", "OUT", "Geometry"))
    tree.is_modifier = True
    for joint in joints:
        tree.interface.items_tree[joint].hide_in_modifier = True
    entry = tree.nodes.new("NodeGroupInput")
    points = add_node(tree, "GeometryNodeObjectInfo", inputs={"Object": table}).outputs["Geometry"]
    row, inner = attribute(tree, ROW, "INT"), _sums(f"{name} of one side")
    angles = [entry.outputs[joint] for joint in joints]
    moved = sample_index(tree, "FLOAT_VECTOR", points, _summed(tree, inner, _chosen(tree, angles)), row)
    if opposite:
        turned = _chosen(tree, [angles[k] for k in opposite])
        mirrored = math(tree, "MULTIPLY", turned, (1.0, -1.0, -1.0), kind="Vector")
        across = math(tree, "SUBTRACT", float(MIRRORED), row)
        there = sample_index(tree, "FLOAT_VECTOR", points, _summed(tree, inner, mirrored), across)
        moved = math(tree, "MULTIPLY_ADD", there, (-1.0, 1.0, 1.0), moved, kind="Vector")
    inputs = {"Geometry": entry.outputs["Geometry"], "Offset": moved}
    skin = add_node(tree, "GeometryNodeSetPosition", inputs=inputs).outputs["Geometry"]
    add_node(tree, "NodeGroupOutput", inputs={"Geometry": skin})
    _lay_out(tree)
    return tree


def _chosen(tree: bpy.types.NodeTree, angles: Sequence[bpy.types.NodeSocket]) -> Any:
    chosen = add_node(tree, "GeometryNodeIndexSwitch", data_type="VECTOR")
    for _ in range(len(angles) - len(chosen.index_switch_items)):
        chosen.index_switch_items.new()
    for source, socket in zip((attribute(tree, JOINT, "INT"), *angles), chosen.inputs, strict=False):
        tree.links.new(source, socket)
    return chosen.outputs[0]


def _sums(name: str) -> bpy.types.NodeTree:
    tree = new_tree(name, ("Angles", "IN", "Vector"), ("Sum", "OUT", "Vector"))
    rotation = add_node(tree, "FunctionNodeEulerToRotation", tree.nodes.new("NodeGroupInput").outputs[0]).outputs[0]
    inputs = {"Value": _displacement(tree, rotation), "Group ID": attribute(tree, VERTEX, "INT")}
    settings = {"data_type": "FLOAT_VECTOR", "domain": "POINT"}
    total = add_node(tree, "GeometryNodeAccumulateField", inputs=inputs, **settings)
    add_node(tree, "NodeGroupOutput", enabled(total.outputs, "Total"))
    _lay_out(tree)
    return tree


def _summed(tree: bpy.types.NodeTree, inner: bpy.types.NodeTree, angles: Any) -> Any:
    group = add_node(tree, "GeometryNodeGroup", node_tree=inner)
    tree.links.new(angles, group.inputs[0])
    return group.outputs[0]


def _displacement(tree: bpy.types.NodeTree, rotation: Any) -> Any:
    """Add nodes that sum the vectors ``r_ab (R_ab - I_ab)`` over rows a and columns b of the rotation R."""
    total: tuple[Any, ...] = ()
    for column in range(3):
        axis = [float(column == k) for k in range(3)]
        turned = add_node(tree, "FunctionNodeRotateVector", inputs={"Vector": axis, "Rotation": rotation}).outputs[0]
        change = math(tree, "SUBTRACT", turned, axis, kind="Vector")
        parts = add_node(tree, "ShaderNodeSeparateXYZ", change).outputs
        for row in range(3):
            if (row, column) == IN_POSITION:
                direction = tree.nodes.new("GeometryNodeInputPosition").outputs[0]
            else:
                direction = attribute(tree, _column_attribute(row, column), "FLOAT_VECTOR")
            total = (math(tree, "MULTIPLY_ADD", direction, parts[row], *total, kind="Vector"),)
    return total[0]


def _lay_out(tree: bpy.types.NodeTree) -> None:
    for k, node in enumerate(tree.nodes):
        node.location = (220.0 * (k // 8), -180.0 * (k % 8))


CORRECTIVES = "Pose Correctives"  # Name of the modifier.
_LARGEST_FEATURE = 2.0
_LEAST_M = 5e-5
"""Smallest displacement to keep, taken over all rotations, in metres."""
_SAME_PLACE_M, _SAME_DIRECTION_M = 2e-6, 2e-6
_FLIP, _TURNED = np.array([-1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])
"""Diagonal of S, and the signs of the Euler angles of a bone when expressed in its mirror image's axes."""


@dataclass(frozen=True)
class CorrectiveTable:
    """Non-zero pose correctives. There is one row per vertex and joint that moves it, sorted by vertex."""

    vertex: np.ndarray  # (N,) vertex indices, ascending.
    joint: np.ndarray  # (N,) joint indices, 1..J-1.
    directions: np.ndarray  # (N, 3, 3, 3) metres: axis of the skin, then the row and column of ``R - I``.

    def part(self, chosen: np.ndarray) -> CorrectiveTable:
        """Return a table with only the chosen rows."""
        return CorrectiveTable(self.vertex[chosen], self.joint[chosen], self.directions[chosen])


def corrective_table(posedirs: np.ndarray) -> CorrectiveTable:
    """Convert (V, 3, 9 (J - 1)) pose correctives to a table, in the axes of the body's rest frame."""
    blocks = posedirs.astype(np.float32).reshape(len(posedirs), 3, -1, 3, 3)
    reach = _LARGEST_FEATURE * np.sqrt(np.square(blocks).sum(axis=1).max(axis=(2, 3)))
    vertex, joint = np.nonzero(reach >= _LEAST_M)
    return CorrectiveTable(vertex, joint + 1, blocks[vertex, :, joint])


def add_correctives(
    armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile, hidden: bpy.types.Collection
) -> int:
    """Add the body's pose correctives to a mesh, and return the number of joints that have correctives."""
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
    modifier.node_group = _build_corrective_nodes(f"{mesh.name} correctives", points, names, opposite)
    mesh.modifiers.move(len(mesh.modifiers) - 1, 0)
    for name in names:
        owner, path = node_input(modifier, name)
        for axis in range(3):
            _drive(add_driver(owner, path, axis), armature, name, "XYZ"[axis])
    return len(joints)


@once_a_body
def _mirrored_rows(body: BodyFile, axes: bytes) -> tuple[CorrectiveTable, np.ndarray, np.ndarray, list[int], bool]:
    """Return a body's corrective table, without the right half if it mirrors the left half.

    The other results are the vectors of the N rows in the bones' axes (N, 3, 3, 3), the first row of each vertex (V,),
    the joints that have correctives, and whether the right half was omitted.
    """
    assert body.posedirs is not None
    table = corrective_table(body.posedirs)
    joints = np.unique(table.joint).tolist()
    turned = _in_bone_axes(table, np.frombuffer(axes).reshape(-1, 3, 3))
    across = _mirror_of(body.v_template) if joints else None
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


def _mirror_of(vertices: np.ndarray) -> np.ndarray | None:
    keys = np.round(vertices / _SAME_PLACE_M).astype(np.int64)
    order, other = np.lexsort(keys.T), np.lexsort((keys * [-1, 1, 1]).T)
    if np.abs(vertices[order] - vertices[other] * _FLIP).max() > _SAME_PLACE_M:
        return None
    across = np.empty(len(vertices), np.int64)
    across[order] = other
    return across


def _is_mirrored(table: CorrectiveTable, turned: np.ndarray, across: np.ndarray, layout: BodyLayout) -> bool:
    """Return whether every row is the mirror image of the row for the mirrored vertex and joint."""
    rows = zip(table.vertex.tolist(), table.joint.tolist(), strict=True)
    here = {key: row for row, key in enumerate(rows)}
    image = zip(across[table.vertex].tolist(), np.array(layout.mirror)[table.joint].tolist(), strict=True)
    found = np.array([here.get(key, -1) for key in image])
    if (found < 0).any():
        return False
    mirrored = turned[found] * _FLIP[:, None, None] * _TURNED[:, None] * _TURNED
    return bool(np.abs(mirrored - turned).max() < _SAME_DIRECTION_M)


def _in_bone_axes(table: CorrectiveTable, C: np.ndarray) -> np.ndarray:
    axes = C[table.joint]
    return np.einsum("kc,ncab,nia,njb->nkij", R_ARMATURE_BODY, table.directions, axes, axes, optimize=True)


def _table_object(name: str, table: CorrectiveTable, turned: np.ndarray, joints: list[int]) -> bpy.types.Object:
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(table.joint))
    data.vertices.foreach_set("co", turned[:, :, IN_POSITION[0], IN_POSITION[1]].astype(np.float32).ravel())
    order = np.searchsorted(joints, table.joint)
    data.attributes.new(JOINT, "INT8", "POINT").data.foreach_set("value", order.astype(np.int32))
    data.attributes.new(VERTEX, "INT", "POINT").data.foreach_set("value", table.vertex.astype(np.int32))
    for row in range(3):
        for column in range(3):
            if (row, column) != IN_POSITION:
                attribute = data.attributes.new(_column_attribute(row, column), "FLOAT_VECTOR", "POINT")
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
