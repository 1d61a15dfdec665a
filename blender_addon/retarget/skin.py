"""The skin of a rig at rest: the vertices that follow some of its bones."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from mathutils import Matrix


def skin_points(armature: bpy.types.Object, bones: set[str], centre: np.ndarray, radius: float) -> np.ndarray:
    """Return the (V, 3) vertices of all meshes on an armature that follow some bones most, near a place.

    Places are those of the meshes without shape keys and modifiers, in the armature's space and rest pose.

    Args:
        armature: the rig.
        bones: names of bones that deform.
        centre: (3,) a place in the armature's space.
        radius: how far from there vertices are looked at.
    """
    found = [np.zeros((0, 3))]
    for mesh, to_armature, holder in _meshes(armature):
        points = np.empty(3 * len(mesh.data.vertices), np.float32)
        mesh.data.vertices.foreach_get("co", points)
        placed = points.reshape(-1, 3) @ np.array(to_armature)[:3, :3].T + np.array(to_armature)[:3, 3]
        near = np.flatnonzero(np.linalg.norm(placed - centre, axis=1) < radius)
        if not holder:
            chosen = {group.index for group in mesh.vertex_groups if group.name in bones}
            near = [v for v in near if heaviest(mesh.data.vertices[int(v)]) in chosen] if chosen else []
        elif holder not in bones:
            continue
        found.append(placed[near])
    return np.concatenate(found)


def skin_by_bone(armature: bpy.types.Object, most: int) -> Iterator[tuple[np.ndarray, list[str]]]:
    """Yield the vertices (V, 3) of each mesh on an armature, places as in ``skin_points``, and the bone of each.

    Args:
        armature: the rig.
        most: vertices of a mesh that are looked at, evenly chosen of more.
    """
    for mesh, to_armature, holder in _meshes(armature):
        vertices, names = mesh.data.vertices, {group.index: group.name for group in mesh.vertex_groups}
        points = np.empty(3 * len(vertices), np.float32)
        vertices.foreach_get("co", points)
        chosen = range(0, len(vertices), 1 + len(vertices) // most)
        M = np.array(to_armature)
        bones = [holder or names.get(heaviest(vertices[v]), "") for v in chosen]
        yield points.reshape(-1, 3)[list(chosen)] @ M[:3, :3].T + M[:3, 3], bones


def _meshes(armature: bpy.types.Object) -> Iterator[tuple[bpy.types.Object, Matrix, str]]:
    """Yield the meshes on an armature, their way into its space at rest, and the bone that a rigid one hangs on."""
    for obj in bpy.data.objects:
        if obj.type != "MESH":
            continue
        if obj.parent == armature and obj.parent_type == "BONE" and obj.parent_bone in armature.data.bones:
            bone = armature.data.bones[obj.parent_bone]
            # Blender counts a bone's children from its tail.
            tail = bone.matrix_local @ Matrix.Translation((0.0, bone.length, 0.0))
            yield obj, tail @ obj.matrix_parent_inverse @ obj.matrix_basis, bone.name
        elif any(m.type == "ARMATURE" and m.object == armature for m in obj.modifiers) or (
            obj.parent == armature and obj.parent_type == "ARMATURE"
        ):
            yield obj, armature.matrix_world.inverted() @ obj.matrix_world, ""


def heaviest(vertex: bpy.types.MeshVertex) -> int:
    """Return the index of the group that a vertex follows most, -1 for none."""
    return max(vertex.groups, key=lambda entry: entry.weight).group if len(vertex.groups) else -1
