"""Register all parts of the add-on from one table, and unregister them in reverse order."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import bpy

from ..headless.blender_command import command
from . import acquisition_properties, adoption, capture_properties, preferences, project_files, properties, viewport
from .operators import (
    base,
    capture,
    clips,
    export,
    imports,
    live,
    plausible,
    retarget,
    review,
    solve,
    studio,
    takes,
    videos,
)
from .panels import acquire, deliver, run
from .panels import capture as capture_panels
from .panels import review as review_panels
from .panels import solve as solve_panels
from .panels import videos as videos_panel
from .setting_properties import prepare
from .translation import add_translations, remove_translations

_BASES = (
    bpy.types.PropertyGroup,
    bpy.types.AddonPreferences,
    bpy.types.Operator,
    bpy.types.FileHandler,
    bpy.types.UIList,
    bpy.types.Panel,
)


Registrable = tuple[Callable[[], Any], Callable[[], Any]]  # Functions that register and unregister one item.


def _classes(*modules: ModuleType) -> list[Registrable]:
    found = [cls for module in modules for cls in vars(module).values() if _is_defined_in(module, cls)]
    return [_class(cls) for cls in dict.fromkeys(found)]


def _is_defined_in(module: ModuleType, cls: object) -> bool:
    return isinstance(cls, type) and issubclass(cls, _BASES) and cls.__module__ == module.__name__


def _class(cls: type) -> Registrable:
    return lambda: bpy.utils.register_class(prepare(cls)), lambda: bpy.utils.unregister_class(cls)


def _listed(owner: Any, function: Callable[..., None]) -> Registrable:
    return lambda: owner.append(function), lambda: owner.remove(function)


def _pointer(owner: type, name: str, cls: type) -> Registrable:
    return lambda: setattr(owner, name, bpy.props.PointerProperty(type=cls)), lambda: delattr(owner, name)


def _drawn(space: Any, draw: Callable[[], None], event: str) -> Registrable:
    handles: list[Any] = []
    return (
        lambda: handles.append(space.draw_handler_add(draw, (), "WINDOW", event)),
        lambda: space.draw_handler_remove(handles.pop(), "WINDOW"),
    )


def _stop(stop: Callable[[], None]) -> Registrable:
    return lambda: None, stop


_HANDLERS = bpy.app.handlers


TABLE: tuple[Registrable, ...] = (
    (add_translations, remove_translations),
    *_classes(capture_properties, acquisition_properties, properties),
    _pointer(bpy.types.Scene, "mocap", properties.MocapSettings),
    *_classes(preferences),
    _stop(base.current.abandon),
    *_classes(base, imports, solve, review, takes, clips, plausible, capture, videos, retarget),
    _stop(live.live.abandon),
    *_classes(live),
    _stop(export.playing.stop),
    *_classes(export, studio),
    (videos_panel.previews.start, videos_panel.previews.stop),
    *_classes(run, capture_panels, videos_panel, solve_panels, review_panels, deliver, acquire),
    _listed(_HANDLERS.load_pre, live.before_load),
    _listed(_HANDLERS.load_pre, export.before_load),
    _listed(_HANDLERS.frame_change_post, export.on_frame_change),
    _listed(_HANDLERS.frame_change_pre, viewport.on_frame_change),
    *(_drawn(*row) for row in viewport.HANDLERS),
    _stop(viewport.weights.clear),
    _stop(viewport.ghosts.clear),
    _listed(_HANDLERS.load_post, base.after_load),
    _listed(_HANDLERS.load_post, adoption.on_load),
    _listed(_HANDLERS.depsgraph_update_post, adoption.on_update),
    _listed(_HANDLERS.save_pre, project_files.before_save),
    _listed(_HANDLERS.save_post, project_files.after_save),
    _listed(_HANDLERS.save_post_fail, project_files.after_failed_save),
    _listed(bpy.types.TOPBAR_MT_file_import, imports.draw_capture_menu),
    _listed(bpy.types.TOPBAR_MT_file_import, videos.draw_import_menu),
    _listed(bpy.types.TOPBAR_MT_file_import, imports.draw_import_menu),
    _listed(bpy.types.TOPBAR_MT_file_export, export.draw_export_menu),
    *(_listed(getattr(bpy.types, name), run.draw_rate_button) for name in run.HEADERS),
    (command.register, command.unregister),
)
"""Classes and pairs of functions, in registration order."""


def register() -> None:
    """Register all items of ``TABLE`` in order."""
    for add, _ in TABLE:
        add()


def unregister() -> None:
    """Unregister all items of ``TABLE`` in reverse order."""
    for _, remove in reversed(TABLE):
        remove()
