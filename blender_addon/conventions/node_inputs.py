"""Where a nodes modifier keeps the value of one of its inputs; Blender 5.2 moved them."""

from __future__ import annotations

from typing import Any

import bpy


def node_input(modifier: bpy.types.NodesModifier, name: str) -> tuple[Any, str]:
    """Return what owns an input's value, and its path there, for ``driver_add`` and the like.

    Raises:
        KeyError: the node group has no such input.
    """
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if hasattr(modifier, "properties"):  # Blender 5.2 and later
        return getattr(modifier.properties.inputs, identifier), "value"
    return modifier, f'["{identifier}"]'


def get_input(modifier: bpy.types.NodesModifier, name: str) -> Any:
    """Return the value of an input."""
    owner, path = node_input(modifier, name)
    return owner.value if path == "value" else owner[path[2:-2]]


def set_input(modifier: bpy.types.NodesModifier, name: str, value: Any) -> None:
    """Set the value of an input."""
    owner, path = node_input(modifier, name)
    if path == "value":
        owner.value = value
    else:
        owner[path[2:-2]] = value
