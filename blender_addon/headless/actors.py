"""Read the motions of a file as actors, of bodies and of any other rig, one per clip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from .._exchange.diagnostics import read_diagnostics, sentence, warnings_in
from .._exchange.motion_file import read_motion
from ..animation.curves import current_action
from ..animation.takes import found_in, warnings_of_take
from ..body.body_file import body_path_of, read_body, require_body
from ..retarget.motion.figures import Actor, actor_of_motion
from ..retarget.recognition import map_rig, open_scene, user_presets_folder
from ..retarget.rig_actor import chosen_actor, clips_of, is_actor, play_action, read_actor, read_rig_actor


@dataclass(frozen=True)
class ReadActor:
    """A motion, and notes about it."""

    actor: Actor
    notes: tuple[str, ...] = ()


def read_source(path: Path, body: Path | None = None, armature: str = "", action: str = "") -> ReadActor:
    """Return the motion of a motion file, or of the armature in any file that Blender reads.

    Args:
        body: body file for a motion, None for the body of its solve.
        armature: name, if several move.
        action: one of its actions, "" for the shown one.
    """
    if path.suffix.lower() in (".npz", ""):
        return _of_motion(path, body)
    scene, rig = _opened(path, armature)
    if action:
        play_action(rig, action)
    return _of_rig(rig, scene)


def read_clips(path: Path, body: Path | None = None, armature: str = "") -> Iterator[ReadActor]:
    """Yield every clip of a file, named after file and action: one of a motion file, one per action of others."""
    if path.suffix.lower() == ".npz":
        read = _of_motion(path, body)
        yield replace(read, actor=replace(read.actor, name=path.stem))
        return
    scene, rig = _opened(path, armature)
    names = [action.name for action in clips_of(rig)]
    for name in names:
        play_action(rig, name)
        read = _of_rig(rig, scene)
        own = path.stem if len(names) == 1 else f"{path.stem} {name}"
        yield ReadActor(replace(read.actor, name=own), read.notes)
    if not names:
        yield _of_rig(rig, scene)  # which names what is missing


def _of_motion(path: Path, body: Path | None) -> ReadActor:
    motion = read_motion(path)
    chosen = read_body(body or body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, chosen)
    found = warnings_in(read_diagnostics(found_in(motion.provenance)))
    return ReadActor(actor_of_motion(motion, chosen), tuple(sentence(item, motion.fps) for item in found))


def _opened(path: Path, armature: str) -> tuple[bpy.types.Scene, bpy.types.Object]:
    scene = open_scene(path)
    return scene, chosen_actor(scene, armature, str(path))


def _of_rig(rig: bpy.types.Object, scene: bpy.types.Scene) -> ReadActor:
    if is_actor(rig):
        action = current_action(rig)
        found = () if action is None else warnings_of_take(action)
        return ReadActor(read_actor(rig, scene)[0], tuple(sentence(item) for item in found))
    actor, _, notes = read_rig_actor(rig, scene, map_rig(rig, user_presets_folder()))
    return ReadActor(actor, notes)
