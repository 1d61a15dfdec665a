"""Set up a new Blender file with a light, a world and viewports, and save scenes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from .._exchange.errors import OutputNotWritable
from ..conventions.timing import go_to_frame, scene_frame_rate

_WORLD = (0.24, 0.25, 0.28)  # Linear RGB of the ambient light. Chosen by hand.
_SUN_W_M2, _SUN_TURN = 3.0, (0.75, 0.15, 0.6)
_DISTANCE_M = 5.5
"""Distance between the viewport and the body in metres. Chosen by hand."""
_CAUSELESS = "Failed to write blendfile"  # Blender 5's error text if writing stops halfway.


def fresh_scene() -> bpy.types.Scene:
    """Close the open file, and return an empty scene with a sun and a grey world."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = _WORLD
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy = _SUN_W_M2
    sun = bpy.data.objects.new("Sun", light)
    sun.location, sun.rotation_euler = (0.0, 0.0, 4.0), _SUN_TURN
    scene.collection.objects.link(sun)
    return scene


def frame_viewports(target: tuple[float, float, float]) -> None:
    """Aim all 3D viewports at a point in world coordinates (metres), with studio light and material colours."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == "VIEW_3D":
                space = area.spaces.active
                space.region_3d.view_location = Vector(target)
                space.region_3d.view_distance = _DISTANCE_M
                space.shading.color_type = "MATERIAL"


def save_file(path: Path) -> None:
    """Save a compressed copy of the open file. Raise ``OutputNotWritable`` if that fails."""
    with _named_failure(path):
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(path), compress=True, copy=True)


def write_blocks(path: Path, blocks: set[bpy.types.ID], **options: Any) -> None:
    """Write data blocks to a file. Raises ``OutputNotWritable`` if Blender cannot write it."""
    with _named_failure(path):
        bpy.data.libraries.write(str(path), blocks, **options)


@contextmanager
def _named_failure(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError) as error:
        message = f"Blender cannot save the file: {why_not_written(error)}."
        hint = "Choose a writable folder with enough free space."
        raise OutputNotWritable(message, where=path.name, hint=hint) from error


def why_not_written(error: Exception) -> str:
    """Return the reason that Blender gives for a failed write, if any."""
    text = str(error).strip().removeprefix("Error: ").rstrip(".")
    return "Blender stopped while writing the file. The disk may be full" if text.startswith(_CAUSELESS) else text


_STARTUP = frozenset({"Cube", "Camera", "Light"})  # Objects in Blender's start-up file.
_FACTORY = (24.0, 250, 1920, 1080, 100)  # Frame rate, last frame and resolution in Blender's start-up file.


def is_untouched(scene: bpy.types.Scene) -> bool:
    """Return whether a scene is unchanged since Blender started. Its settings can then be replaced."""
    render = scene.render
    size = render.resolution_x, render.resolution_y, render.resolution_percentage
    return (
        not bpy.data.filepath
        and (scene_frame_rate(scene), scene.frame_end, *size) == _FACTORY
        and {obj.name for obj in scene.objects} <= _STARTUP
        and not bpy.data.actions
    )


@contextmanager
def undisturbed(context: bpy.types.Context) -> Iterator[None]:
    """Switch to object mode for a ``with`` block, then restore the mode, the selection and the active object."""
    layer = context.view_layer
    active, selected = layer.objects.active, list(context.selected_objects)
    mode = "OBJECT" if active is None else active.mode
    together = [obj for obj in layer.objects if mode != "OBJECT" and obj.mode == mode]
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        _select(layer, together, active)
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode=mode)
        _select(layer, selected, active)


def _select(layer: bpy.types.ViewLayer, chosen: list[bpy.types.Object], active: bpy.types.Object | None) -> None:
    for obj in layer.objects:
        if obj.select_get() != (obj in chosen):
            obj.select_set(obj in chosen)
    layer.objects.active = active


@contextmanager
def alone(armature: bpy.types.Object, scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Scene, bpy.types.Depsgraph]]:
    """Within a ``with`` block, show an armature alone in a temporary scene with the frame rate of ``scene``."""
    stage, window = bpy.data.scenes.new(armature.name), bpy.context.window
    shown = window and (window.scene, window.view_layer)
    stage.render.fps, stage.render.fps_base = scene.render.fps, scene.render.fps_base
    stage.collection.objects.link(armature)
    try:
        with bpy.context.temp_override(scene=stage, view_layer=stage.view_layers[0]):
            yield stage, bpy.context.evaluated_depsgraph_get()
    finally:
        if window and window.scene == stage:  # glTF export shows the scene that it writes
            window.scene, window.view_layer = shown
        bpy.data.scenes.remove(stage)


_REQUEST = "mocap_request"  # Custom property of a scene: a request to a second Blender, as JSON text.
_DRIVING = "mocap_driving"  # Custom property of a scene: meshes whose shape keys drive bones.


def save_alone(
    path: Path, armature: bpy.types.Object, meshes: Sequence[bpy.types.Object], scene: bpy.types.Scene, **request: Any
) -> None:
    """Save a scene with an armature, meshes and a request, for a second Blender to process."""
    with alone(armature, scene) as (stage, _):
        for mesh in meshes:
            stage.collection.objects.link(mesh)
        stage.unit_settings.scale_length = scene.unit_settings.scale_length
        stage[_REQUEST] = json.dumps(request)
        stage[_DRIVING] = {str(k): mesh for k, mesh in enumerate(_driving_meshes(armature))}  # this keeps the meshes
        write_blocks(path, {stage}, path_remap="ABSOLUTE", compress=True)


def request_of(scene: bpy.types.Scene) -> dict[str, Any]:
    """Return the request that ``save_alone`` stored in an opened file, or an empty dict."""
    request = json.loads(scene.get(_REQUEST, "{}"))
    return request if isinstance(request, dict) else {}


def _driving_meshes(owner: bpy.types.Object) -> list[bpy.types.Mesh]:
    """Return the meshes with shape keys that drive an object, including unlinked meshes."""
    variables = [variable for driver in _drivers((owner, owner.data)) for variable in driver.variables]
    found = (target.id for variable in variables for target in variable.targets)
    return list(dict.fromkeys(key.user for key in found if isinstance(key, bpy.types.Key)))


def _drivers(owners: Sequence[bpy.types.ID | None]) -> list[bpy.types.Driver]:
    return [
        curve.driver for owner in owners if owner and owner.animation_data for curve in owner.animation_data.drivers
    ]


def needs_this_file(objects: Sequence[bpy.types.Object]) -> bool:
    """Return whether objects must be processed in this Blender instead of a second one.

    A second Blender does not run Python drivers of the objects and of their dependencies. In Blender 4.5, a file that
    contains only a library override is damaged.
    """
    if any(obj.override_library is not None for obj in objects):
        return True
    needed = _with_needed(objects)
    driving = [mesh for obj in needed for mesh in _driving_meshes(obj)]
    if any(mesh.override_library is not None for mesh in driving):
        return True
    data = [*(obj.data for obj in needed), *driving]
    owners = dict.fromkeys([*needed, *data, *(getattr(item, "shape_keys", None) for item in data)])
    return any(driver.type == "SCRIPTED" and not driver.is_simple_expression for driver in _drivers([*owners]))


def _with_needed(objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return objects together with all their direct and indirect dependencies."""
    found = list(dict.fromkeys(objects))
    for obj in found:  # the list grows during the loop
        bones = obj.pose.bones if obj.pose is not None else ()
        rules = [*obj.constraints, *obj.modifiers, *(rule for bone in bones for rule in bone.constraints)]
        rules += [target for rule in rules for target in getattr(rule, "targets", ())]
        named = [getattr(rule, p.identifier) for rule in rules for p in rule.bl_rna.properties if p.type == "POINTER"]
        needed = [other for other in (obj.parent, *named) if isinstance(other, bpy.types.Object)]
        found += [other for other in dict.fromkeys(needed) if other not in found]
    return found


def sample_poses(
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    names: Sequence[str],
    times: np.ndarray,
    report: Callable[[int], None] = lambda frame: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return evaluated matrices of an armature (F, 4, 4) and of its bones (F, B, 4, 4) at scene frames."""
    worlds, poses = np.empty((len(times), 4, 4)), np.empty((len(times), len(names), 4, 4))
    with alone(armature, scene) as (stage, depsgraph):
        for f, time in enumerate(times):
            go_to_frame(stage, float(time))
            shown = armature.evaluated_get(depsgraph)
            worlds[f] = shown.matrix_world
            poses[f] = [shown.pose.bones[name].matrix for name in names]
            report(f)
    return worlds, poses
