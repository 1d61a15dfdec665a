"""Create and connect nodes, and create scripted drivers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import bpy

from .datablocks import add_driver


def new_tree(name: str, *sockets: tuple[str, str, str]) -> bpy.types.NodeTree:
    """Create a geometry node group with sockets given by name, direction and type."""
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for socket, direction, kind in sockets:
        tree.interface.new_socket(socket, in_out=f"{direction}PUT", socket_type=f"NodeSocket{kind}")
    return tree


def add_node(
    tree: bpy.types.NodeTree, kind: str, *sources: Any, inputs: Mapping[str, Any] = {}, **settings: Any
) -> Any:
    """Add a node. ``sources`` supply its first inputs, and ``inputs`` supply others by name."""
    node = tree.nodes.new(kind)
    for name, value in settings.items():
        setattr(node, name, value)
    pairs = [*zip(sources, node.inputs, strict=False), *((v, enabled(node.inputs, k)) for k, v in inputs.items())]
    for source, socket in pairs:
        if isinstance(source, bpy.types.NodeSocket):
            tree.links.new(source, socket)
        else:
            socket.default_value = source
    return node


def enabled(sockets: Iterable[bpy.types.NodeSocket], name: str = "") -> Any:
    """Return the first enabled socket, or the first enabled one with this name."""
    return next(socket for socket in sockets if socket.enabled and name in ("", socket.name))


def math(tree: bpy.types.NodeTree, operation: str, *sources: Any, kind: str = "") -> Any:
    """Add a math node and return its output. ``kind="Vector"`` adds a vector math node."""
    return add_node(tree, f"ShaderNode{kind}Math", *sources, operation=operation).outputs[0]


def attribute(tree: bpy.types.NodeTree, name: str, kind: str) -> Any:
    """Return an output socket that supplies the values of an attribute."""
    inputs = {"Name": name}
    return enabled(add_node(tree, "GeometryNodeInputNamedAttribute", inputs=inputs, data_type=kind).outputs)


def sample_index(tree: bpy.types.NodeTree, kind: str, geometry: Any, value: Any, index: Any) -> Any:
    """Add a node that samples a geometry's value at a point index. Its output is zero if the index is invalid."""
    inputs, settings = {"Geometry": geometry, "Value": value, "Index": index}, {"data_type": kind, "domain": "POINT"}
    return enabled(add_node(tree, "GeometryNodeSampleIndex", inputs=inputs, **settings).outputs)


def add_scripted_driver(
    owner: bpy.types.bpy_struct, path: str, axis: int, expression: str, sources: Mapping[str, tuple[bpy.types.ID, str]]
) -> None:
    """Drive a property by an expression of variables. ``sources`` maps each variable to a data-block and a path."""
    driver = add_driver(owner, path, axis)
    driver.type = "SCRIPTED"
    for name, (source, data_path) in sources.items():
        variable = driver.variables.new()
        variable.name, variable.type = name, "SINGLE_PROP"
        target = variable.targets[0]
        target.id_type = source.id_type
        target.id, target.data_path = source, data_path
    driver.expression = expression
