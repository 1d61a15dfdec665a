"""Pose correctives: geometry nodes before the armature move the skin by the bones' rotations, as the model does.

The model adds ``P flatten(R_j - I)`` to the rest shape (Loper et al. 2015, eq. 9). A joint reaches few vertices, so
``P`` is kept as a table, a point for each vertex and joint that moves it, not as a shape key over the whole skin for
each of 207 features; drivers without Python bring the pose bones' rotations, constraints included, into the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.skeleton import JOINTS
from .armature import rotation_from_body_axes
from .body_file import BodyFile
from .corrective_nodes import build_corrective_nodes, column_attribute, drive_input, row_attribute

CORRECTIVES = "Pose Correctives"
"""Name of the modifier."""
_LARGEST_FEATURE = 2.0
_LEAST_M = 5e-5
"""Displacements that no rotation makes this large are left out."""


@dataclass(frozen=True)
class CorrectiveTable:
    """The pose correctives that are not zero: a row for each vertex and joint that moves it."""

    joint: np.ndarray
    """(N,) index of the joint, 1..23."""
    directions: np.ndarray
    """(N, 3, 3, 3) metres: axis of the skin, then row and column of ``R - I``."""
    rows: np.ndarray
    """(S, V) rows of each vertex, -1 where it has fewer than S."""


def corrective_table(posedirs: np.ndarray) -> CorrectiveTable:
    """Return the (V, 3, 207) pose correctives as a table, in the axes they are given in."""
    blocks = posedirs.astype(np.float32).reshape(len(posedirs), 3, -1, 3, 3)
    reach = _LARGEST_FEATURE * np.sqrt(np.square(blocks).sum(axis=1).max(axis=(2, 3)))
    vertex, joint = np.nonzero(reach >= _LEAST_M)
    first = np.searchsorted(vertex, np.arange(len(posedirs)))
    slot = np.arange(len(vertex)) - first[vertex]
    rows = np.full((int(slot.max(initial=-1)) + 1, len(posedirs)), -1, np.int32)
    rows[slot, vertex] = np.arange(len(vertex))
    return CorrectiveTable(joint + 1, blocks[vertex, :, joint], rows)


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
    table = corrective_table(body.posedirs)
    joints = np.unique(table.joint).tolist()
    if not joints:
        return 0
    points = _table_object(f"{mesh.name} correctives", table, rotation_from_body_axes(armature))
    hidden.objects.link(points)
    for slot, rows in enumerate(table.rows):
        mesh.data.attributes.new(row_attribute(slot), "INT", "POINT").data.foreach_set("value", rows)
    modifier = mesh.modifiers.new(CORRECTIVES, "NODES")
    names = [JOINTS[joint] for joint in joints]
    modifier.node_group = build_corrective_nodes(f"{mesh.name} correctives", points, names, len(table.rows))
    mesh.modifiers.move(len(mesh.modifiers) - 1, 0)
    for name in names:
        for axis in range(3):
            _drive(drive_input(modifier, name, axis), armature, name, "XYZ"[axis])
    return len(joints)


def _table_object(name: str, table: CorrectiveTable, C: np.ndarray) -> bpy.types.Object:
    """Return the table as points in the bones' axes ``C``; they stay hidden wherever the body is appended to."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(np.zeros((len(table.joint), 3)).tolist(), [], [])
    order = np.unique(table.joint, return_inverse=True)[1]
    data.attributes.new("joint", "INT", "POINT").data.foreach_set("value", order.astype(np.int32))
    axes = C[table.joint]
    turned = np.einsum("kc,ncab,nia,njb->nkij", R_ARMATURE_BODY, table.directions, axes, axes, optimize=True)
    for row in range(3):
        for column in range(3):
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
