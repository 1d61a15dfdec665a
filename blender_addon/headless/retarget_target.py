"""The rig that a retarget is for: its file opened, and the map of its bones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import TYPE_CHECKING

from ..errors import TargetUnsuitable

if TYPE_CHECKING:
    import bpy

    from ..conventions.timing import TakeTiming
    from ..retarget.rig_map import RigMap
    from .retarget_request import RetargetRequest


def open_target(request: RetargetRequest) -> tuple[bpy.types.Scene, bpy.types.Object]:
    """Open the target's file and return the one armature that is meant."""
    from ..retarget.actor_rig import is_actor
    from ..retarget.scene_files import open_scene

    scene = open_scene(request.target)
    rigs = [o for o in scene.objects if o.type == "ARMATURE" and (request.object_name or not is_actor(o))]
    found = [o for o in rigs if request.object_name in ("", o.name)]
    if len(found) == 1:
        return scene, found[0]
    names = ", ".join(o.name_full for o in rigs) or "the file has none"
    if not found:
        message = f"There is no armature '{request.object_name}'." if request.object_name else "There is no armature."
    elif request.object_name:
        message = f"There are {len(found)} armatures '{request.object_name}': {', '.join(o.name_full for o in found)}."
    else:
        message = "Exactly one armature is needed."
    raise TargetUnsuitable(message, where=str(request.target), hint=f"Name one with --object: {names}.")


def lay_out_time(request: RetargetRequest, scene: bpy.types.Scene, rates: Collection[float]) -> TakeTiming:
    """Return where motions lie in the scene: characters of other programs get the most common rate of the motions."""
    from ..conventions.timing import TakeTiming, scene_frame_rate, set_scene_frame_rate

    if request.target.suffix.lower() != ".blend":
        set_scene_frame_rate(scene, Counter(rates).most_common(1)[0][0])
    return TakeTiming(request.frame_start, scene_frame_rate(scene))


def map_target(request: RetargetRequest, rig: bpy.types.Object) -> RigMap:
    """Return the map of the rig: the request's own, a preset by name, or what is recognised."""
    from ..retarget.recognition import map_rig, named_preset, user_presets_folder
    from ..retarget.rig_map import read_map

    names = rig.data.bones.keys()
    if request.map_file is not None:
        return read_map(request.map_file)
    if request.preset:
        return named_preset(request.preset, names, user_presets_folder())
    return map_rig(rig, user_presets_folder())
