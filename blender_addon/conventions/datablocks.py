"""Create materials and collections, and set the inputs of geometry-nodes modifiers."""

from __future__ import annotations

from typing import Any

import bpy

Colour = tuple[float, float, float, float]  # Linear RGBA.

DETECTION_COLOUR: Colour = (1.0, 0.42, 0.02, 1.0)
KEYPOINT_COLOUR: Colour = (0.02, 0.75, 0.38, 1.0)
MARKER_COLOURS: tuple[Colour, ...] = (
    (0.85, 0.85, 0.9, 1.0),
    (0.05, 0.62, 0.20, 1.0),
    (0.95, 0.55, 0.03, 1.0),
    (0.85, 0.05, 0.04, 1.0),
)
"""Colours of optical markers: not used in the solve, near the solved body, off the body, and far off the body."""
FLOOR_COLOURS: tuple[Colour, Colour] = ((0.30, 0.31, 0.33, 1.0), (0.52, 0.54, 0.57, 1.0))  # Colours of tiles and lines.


def create_material(name: str, colour: Colour, *, roughness: float = 0.55, glossy: bool = False) -> bpy.types.Material:
    """Create a material that looks the same in the viewport and in renders."""
    material = bpy.data.materials.new(name)
    material.diffuse_color = colour
    material.roughness = roughness
    shader = shader_of(material)
    if glossy and shader is not None:
        shader.inputs["Base Color"].default_value = colour
        shader.inputs["Roughness"].default_value = roughness
        return material
    nodes = material.node_tree.nodes
    leave = next((node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial"), None)
    for node in [node for node in nodes if node != leave]:
        nodes.remove(node)
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = colour
    leave = leave or nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(diffuse.outputs[0], leave.inputs["Surface"])
    return material


def shader_of(owner: bpy.types.Material | bpy.types.World, kind: str = "BsdfPrincipled") -> Any:
    """Return the shader node of a new material or world, or None if it has no node of this kind."""
    if bpy.app.version < (5, 0):  # later versions always use nodes, and setting this is deprecated
        owner.use_nodes = True
    return next((node for node in owner.node_tree.nodes if node.bl_idname == f"ShaderNode{kind}"), None)


def child_collection(name: str, parent: bpy.types.Collection) -> bpy.types.Collection:
    """Create a collection inside another collection."""
    collection = bpy.data.collections.new(name)
    parent.children.link(collection)
    return collection


def node_input(modifier: bpy.types.NodesModifier, name: str) -> tuple[Any, str]:
    """Return the object and the property path that store a geometry-nodes input's value."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if hasattr(modifier, "properties"):  # Blender 5.2 and later
        return getattr(modifier.properties.inputs, identifier), "value"
    return modifier, f'["{identifier}"]'


def get_input(modifier: bpy.types.NodesModifier, name: str) -> Any:
    """Return the value of a geometry-nodes input."""
    owner, path = node_input(modifier, name)
    return owner.value if path == "value" else owner[path[2:-2]]


def set_input(modifier: bpy.types.NodesModifier, name: str, value: Any) -> None:
    """Set the value of a geometry-nodes input."""
    owner, path = node_input(modifier, name)
    if path == "value":
        owner.value = value
    else:
        owner[path[2:-2]] = value


def add_driver(owner: bpy.types.bpy_struct, path: str, axis: int = -1) -> bpy.types.Driver:
    """Add a driver to a property or an array element, without modifiers or keys that change the driver's value."""
    curve = owner.driver_add(path, axis)
    for modifier in tuple(curve.modifiers):  # only before Blender 5
        curve.modifiers.remove(modifier)
    curve.keyframe_points.clear()
    return curve.driver
