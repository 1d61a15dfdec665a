"""``retarget``: a solved motion and a rig in; a Blender file with the rig playing the motion out."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._exchange.errors import FileMissing, OutputExists
from .._exchange.motion_file import read_motion
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..body.body_choice import body_path_of, require_body
from ..body.body_file import read_body
from ..errors import TargetUnsuitable

if TYPE_CHECKING:
    import bpy

    from ..retarget.maps.rig_map import RigMap
    from ..retarget.motion.figures import Actor


@dataclass(frozen=True)
class RetargetRequest:
    """What to retarget to what."""

    source: Path
    """Motion file, or a file with an armature that moves: Blender, FBX, glTF, BVH."""
    target: Path
    """File with the rig: Blender, FBX, glTF, VRM; it is not changed."""
    out: Path
    """Blender file to write."""
    object_name: str = ""
    """Which armature of the target; needed where there are several."""
    armature: str = ""
    """Which armature of the source is the actor; needed where there are several."""
    action: str = ""
    """Which of its actions it plays; "" for the one that it shows."""
    preset: str = ""
    """Name of a preset; "" for the one that fits."""
    map_file: Path | None = None
    """Map of the rig, instead of a preset."""
    save_map: Path | None = None
    """Where to write the map that was used, its map pose included."""
    limbs: str = "fk"
    """``fk`` or ``ik``."""
    in_place: bool = False
    """Leave out the way over the ground."""
    root_motion: bool = False
    """Let the root bone carry the way over the ground."""
    body: Path | None = None
    """Body file for a motion; None for the one the motion was solved for."""
    scale: float = 0.0
    """Size of the way by the actor's; 0 for the ratio of the legs."""
    frame_start: int = 1
    """Scene frame of the first frame."""
    overwrite: bool = False
    """Replace files that are there."""


def run_retarget(request: RetargetRequest, progress: Progress) -> dict[str, Any]:
    """Write a copy of the target's file in which the rig plays the motion.

    Returns:
        The ``result`` event: outputs, notes, frames, scale, deviation and the map's label.

    Raises:
        MocapError: an input is missing or wrong, the rig or its map is unsuitable, or an output exists.
    """
    from ..conventions.timing import TakeTiming, scene_frame_rate
    from ..retarget.maps.rig_map import write_map
    from ..retarget.motion.transfer import TransferSettings
    from ..retarget.retarget import RetargetSettings, retarget
    from ..scene.session import save_file

    start = time.monotonic()
    for path in (request.source, request.target):
        if not path.is_file():
            raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    if request.out.exists() and request.out.samefile(request.target):
        raise OutputExists("The target's own file would be replaced.", where=str(request.out), hint="Name another.")
    progress("reading the actor", 0, 1)
    actor, doubts = _actor(request)
    settings = RetargetSettings(
        request.limbs, TransferSettings(request.in_place, request.root_motion, scale=request.scale)
    )
    with atomic_outputs(request.out.parent, (request.out.name,), overwrite=request.overwrite) as temporary:
        scene, rig = _open_target(request)
        rig_map = _map(request, rig)
        timing = TakeTiming(request.frame_start, scene_frame_rate(scene))
        progress("retargeting", 0, 1)
        done = retarget(actor, rig, scene, rig_map, timing, settings)
        progress("retargeting", 1, 1)
        scene.frame_start = min(scene.frame_start, request.frame_start)
        scene.frame_end = max(scene.frame_end, timing.last_frame(actor.num_frames, actor.fps))
        save_file(temporary[request.out.name])
        if request.save_map is not None:
            write_map(request.save_map, done.rig_map, overwrite=request.overwrite)
    return {
        "event": "result",
        "outputs": [str(path) for path in (request.out, request.save_map) if path is not None],
        "notes": [*doubts, *done.notes],
        "frames": actor.num_frames,
        "fps": actor.fps,
        "map": done.rig_map.label,
        "scale": round(done.scale, 5),
        "lengths_by_the_actor": {k: round(v, 4) for k, v in asdict(done.proportions).items() if isfinite(v)},
        "soles_from": done.soles,
        "hands_and_feet_deviation_mm": round(done.deviation_mm, 3),
        "seconds": round(time.monotonic() - start, 3),
    }


def _actor(request: RetargetRequest) -> tuple[Actor, tuple[str, ...]]:
    """Return the motion that the source holds, and notes on it."""
    from ..retarget.actor_rig import is_actor, read_actor
    from ..retarget.clips import chosen_actor, play_action
    from ..retarget.motion.figures import actor_of_motion
    from ..retarget.recognition import map_rig
    from ..retarget.rig_actor import read_rig_actor
    from ..retarget.scene_files import open_scene
    from ..retarget.user_presets import user_presets_folder

    if request.source.suffix.lower() in (".npz", ""):
        motion = read_motion(request.source)
        body = read_body(request.body or body_path_of(motion.provenance), motion.body_layout)
        require_body(motion, body)
        return actor_of_motion(motion, body), ()
    scene = open_scene(request.source)
    rig = chosen_actor(scene, request.armature, str(request.source))
    if request.action:
        play_action(rig, request.action)
    if is_actor(rig):
        return read_actor(rig, scene)[0], ()
    actor, _, notes = read_rig_actor(rig, scene, map_rig(rig, user_presets_folder()))
    return actor, notes


def _open_target(request: RetargetRequest) -> tuple[bpy.types.Scene, bpy.types.Object]:
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
        message = "One armature is wanted."
    raise TargetUnsuitable(message, where=str(request.target), hint=f"Name one with --object: {names}.")


def _map(request: RetargetRequest, rig: bpy.types.Object) -> RigMap:
    from ..retarget.maps.presets import named_preset
    from ..retarget.maps.rig_map import read_map
    from ..retarget.recognition import map_rig
    from ..retarget.user_presets import user_presets_folder

    names = rig.data.bones.keys()
    if request.map_file is not None:
        return read_map(request.map_file)
    if request.preset:
        return named_preset(request.preset, names, user_presets_folder())
    return map_rig(rig, user_presets_folder())
