"""Scenes that are made once, kept as files and opened for each test: sooner than making them again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import bpy

import blender_addon
from blender_addon.body.rig import Rig
from blender_addon.scene.bake import BakedTake

_LISTS = {bpy.types.Object: "objects", bpy.types.Collection: "collections", bpy.types.Action: "actions"}
"""Where Blender keeps what a take or a rig is made of."""
Made = TypeVar("Made")


def empty_scene() -> bpy.types.Scene:
    """Return the scene of an empty Blender session."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@contextmanager
def registered() -> Iterator[None]:
    """Have the add-on registered for a while."""
    blender_addon.register()
    try:
        yield
    finally:
        blender_addon.unregister()


class KeptScene(Generic[Made]):
    """A scene that holds a take, a rig or an action."""

    def __init__(self, path: Path, make: Callable[[bpy.types.Scene], Made]) -> None:
        """Make and keep it; the add-on must not be registered when it is kept, or it would move files beside it."""
        self._made = _by_name(make(empty_scene()))
        self._path = path
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=False, relative_remap=False)

    def opened(self) -> bpy.types.Scene:
        """Return the scene, opened in a session that was never saved, as ``empty_scene`` leaves it."""
        assert bpy.ops.wm.read_homefile(filepath=str(self._path), load_ui=False, use_splash=False) == {"FINISHED"}
        return bpy.context.scene

    def found(self) -> Made:
        """Return what was made, in the scene that is open."""
        return _by_object(self._made)


@dataclass(frozen=True)
class _Named:
    """Something of a file, by its kind and name."""

    kind: str
    name: str


def _by_name(made: Any) -> Any:
    """Return what was made with names in the place of Blender's objects, which do not outlive their session."""
    kind = next((kind for of, kind in _LISTS.items() if isinstance(made, of)), None)
    return _each(made, _by_name) if kind is None else _Named(kind, made.name)


def _by_object(made: Any) -> Any:
    return getattr(bpy.data, made.kind)[made.name] if isinstance(made, _Named) else _each(made, _by_object)


def _each(made: Any, change: Callable[[Any], Any]) -> Any:
    """Return the parts changed of what has some."""
    if isinstance(made, tuple):
        return tuple(map(change, made))
    if isinstance(made, BakedTake | Rig):
        return replace(made, **{field.name: change(getattr(made, field.name)) for field in fields(made)})
    return made
