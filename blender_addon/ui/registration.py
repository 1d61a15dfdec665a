"""One table of everything the add-on registers; unregistering walks it backwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy

from .import_motion import MOCAP_OT_import_motion, draw_import_menu
from .panels import VIEW3D_PT_mocap


@dataclass(frozen=True)
class Entry:
    """One thing to register, and how to take it back."""

    add: Callable[[], None]
    remove: Callable[[], None]


def _class(cls: type) -> Entry:
    return Entry(lambda: bpy.utils.register_class(cls), lambda: bpy.utils.unregister_class(cls))


def _menu(menu: type, draw: Callable[..., None]) -> Entry:
    return Entry(lambda: menu.append(draw), lambda: menu.remove(draw))


TABLE: tuple[Entry, ...] = (
    _class(MOCAP_OT_import_motion),
    _class(VIEW3D_PT_mocap),
    _menu(bpy.types.TOPBAR_MT_file_import, draw_import_menu),
)
"""In the order of registration."""


def register() -> None:
    """Register the table from top to bottom."""
    for entry in TABLE:
        entry.add()


def unregister() -> None:
    """Take back the table from bottom to top."""
    for entry in reversed(TABLE):
        entry.remove()
