"""``retarget``: transfer a motion, or a folder of clips, to one or more characters."""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Collection
from dataclasses import asdict, replace
from itertools import count
from math import isfinite
from pathlib import Path
from typing import Any

import bpy

from .._exchange.errors import FileMissing, MocapError, OutputExists
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..conventions.timing import TakeTiming, scene_frame_rate, set_scene_frame_rate
from ..errors import ActorMissing, BatchInvalid, TargetUnsuitable
from ..export.take import take_of
from ..export.write import export_take, format_of
from ..retarget.actor_file import ReadActor
from ..retarget.motion.transfer import TransferSettings
from ..retarget.recognition import map_rig, named_preset, user_presets_folder
from ..retarget.retarget import RetargetSettings, retarget
from ..retarget.rig_actor import is_actor, play_action
from ..retarget.rig_map import RigMap, read_map, write_map
from ..scene.session import save_file
from .actors import read_clips, read_source
from .foreign_file import limits_of, open_foreign_scene
from .result import CommandResult, failure, failure_notes, refuse_replacing

_SAME_RATE = 1e-3  # Frame rates are equal if they differ by less than this fraction. Chosen by hand.
_READ = (".npz", ".fbx", ".glb", ".gltf", ".vrm", ".vrma", ".bvh", ".blend")


def run_retarget(args: Namespace, progress: Progress) -> CommandResult:
    """Retarget a motion to each target character. Several targets get separate folders with their names.

    Unsuitable targets are skipped and reported. The worst error determines the exit code.
    """
    targets = list(dict.fromkeys(args.target))
    out = args.out or args.source.with_name(f"{args.source.stem}_retargeted.blend")
    if len(targets) == 1:
        return _onto(targets[0], out, args, progress)
    names = [target.stem for target in targets]
    if len({name.lower() for name in names}) < len(names):
        hint = "Rename one of the files, because their results would be in one folder."
        raise BatchInvalid(f"Two targets have the same name: {', '.join(names)}.", hint=hint)
    if args.save_map is not None:
        raise BatchInvalid("A map file can only contain the map of one rig.", hint="Omit --save-map.")
    results: dict[str, CommandResult] = {}
    failed: list[dict[str, Any]] = []
    for done, (name, target) in enumerate(zip(names, targets, strict=True)):
        progress(f"target {name}", done, len(targets))
        try:
            results[name] = _onto(target, out.parent / name / out.name, args, progress)
        except MocapError as error:
            failed.append(failure("target", name, error))
    if not results:
        message = "The motion could not be transferred to any target."
        raise TargetUnsuitable(message, where=str(args.source), hint=_listing("target", failed, len(failed)))
    notes = [f"{name}: {note}" for name, result in results.items() for note in result["notes"]]
    codes = [entry["exit_code"] for entry in failed] + [result.get("exit_code", 0) for result in results.values()]
    outputs = [path for result in results.values() for path in result["outputs"]]
    about = {"targets": results, "failed": failed, "exit_code": max(codes)}
    return {"outputs": outputs, "notes": notes + failure_notes("target", failed), **about}


def _onto(target: Path, out: Path, args: Namespace, progress: Progress) -> CommandResult:
    args = Namespace(**{**vars(args), "target": target, "out": out})
    if out.exists() and target.exists() and out.samefile(target):
        raise OutputExists("The output would overwrite the target.", where=str(out), hint="Choose another name.")
    return _clips(args, progress) if args.source.is_dir() else _one(args, progress)


def _one(args: Namespace, progress: Progress) -> CommandResult:
    """Write a copy of the target's file in which its rig plays the motion."""
    for path in (args.source, args.target):
        if not path.is_file():
            raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    progress("reading the actor", 0, 1)
    read = read_source(args)
    actor = read.actor
    with atomic_outputs(args.out.parent, (args.out.name,), overwrite=args.overwrite) as temporary:
        scene, rig = _open_target(args)
        rig_map = _map_target(args, rig)
        timing = _lay_out_time(args, scene, [actor.fps])
        progress("retargeting", 0, 1)
        done = retarget(actor, rig, scene, rig_map, timing, _settings(args))
        progress("retargeting", 1, 1)
        scene.frame_start = min(scene.frame_start, args.frame_start)
        scene.frame_end = max(scene.frame_end, timing.last_frame(actor.num_frames, actor.fps))
        save_file(temporary[args.out.name])
        if args.save_map is not None:
            write_map(args.save_map, done.rig_map, overwrite=args.overwrite)
    lengths = {name: round(value, 4) for name, value in asdict(done.proportions).items() if isfinite(value)}
    return {
        "outputs": [str(path) for path in (args.out, args.save_map) if path is not None],
        "notes": [*read.notes, *done.notes],
        "frames": actor.num_frames,
        "fps": actor.fps,
        "map": done.rig_map.label,
        "scale": round(done.scale, 5),
        "soles_from": done.soles,
        "hands_and_feet_deviation_mm": round(done.deviation_mm, 3),
        "lengths_by_the_actor": lengths,
    }


def _clips(args: Namespace, progress: Progress) -> CommandResult:
    """Write a Blender file with one action per clip, and one file per clip and export format.

    Unreadable and unsuitable clips are skipped and reported. The worst error determines the exit code.
    """
    suffixes = {name: format_of(name).suffix for name in dict.fromkeys(args.export)}
    actors, failed = _read_folder(args, progress)
    folder: Path = args.out.parent
    files = [folder / f"{read.actor.name}{suffix}" for read in actors for suffix in suffixes.values()]
    refuse_replacing(files, args.source, overwrite=args.overwrite)
    clips: list[dict[str, Any]] = []
    written: list[Path] = [args.out]
    with atomic_outputs(folder, (args.out.name,), overwrite=args.overwrite) as temporary:
        scene, rig = _open_target(args)
        rig_map = _map_target(args, rig)
        timing = _lay_out_time(args, scene, [read.actor.fps for read in actors])
        for done, read in enumerate(actors):
            progress("retargeting", done, len(actors))
            name, actor = read.actor.name, read.actor
            try:
                laid = retarget(actor, rig, scene, rig_map, timing, _settings(args))
                laid.action.name = name
                laid.action.asset_mark()
                end = timing.last_frame(actor.num_frames, actor.fps)
                take = take_of(scene, rig, (args.frame_start, end))
                for kind, suffix in suffixes.items():
                    written.append(export_take(take, kind, folder / f"{name}{suffix}", overwrite=args.overwrite))
            except MocapError as error:
                failed.append(failure("clip", name, error))
                continue
            finally:
                if rig.animation_data is not None:
                    rig.animation_data.action = None
            scene.frame_end = max(scene.frame_end, end)
            notes = [*read.notes, *laid.notes]
            if suffixes and abs(actor.fps / timing.scene_fps - 1) > _SAME_RATE:
                notes.append(f"Recorded at {actor.fps:g} frames per second, exported at {timing.scene_fps:g}.")
            clips.append({"clip": name, "frames": actor.num_frames, "notes": notes})
        progress("retargeting", len(actors), len(actors))
        if not clips:
            message = "No clip could be transferred to the rig."
            raise ActorMissing(message, where=str(args.source), hint=_listing("clip", failed))
        play_action(rig, clips[0]["clip"])
        save_file(temporary[args.out.name])
    notes = [f"{clip['clip']}: {note}" for clip in clips for note in clip["notes"]]
    notes += failure_notes("clip", failed)
    about = {"clips": clips, "failed": failed, "map": rig_map.label}
    code = max((entry["exit_code"] for entry in failed), default=0)
    return {"outputs": [str(path) for path in written], "notes": notes, "exit_code": code, **about}


def _read_folder(args: Namespace, progress: Progress) -> tuple[list[ReadActor], list[dict[str, Any]]]:
    """Return the clips in a folder under unique names, and the clips that failed."""
    paths = sorted(path for path in args.source.iterdir() if path.suffix.lower() in _READ and path.is_file())
    if not paths:
        hint = f"Clip files end in {', '.join(_READ)}."
        raise ActorMissing("The folder contains no clips.", where=str(args.source), hint=hint)
    actors: list[ReadActor] = []
    failed: list[dict[str, Any]] = []
    for done, path in enumerate(paths):
        progress("reading clips", done, len(paths))
        try:
            for read in read_clips(path, args):
                name = _own_name(_file_name(read.actor.name), {other.actor.name.lower() for other in actors})
                actors.append(ReadActor(replace(read.actor, name=name), read.notes))
        except MocapError as error:
            failed.append(failure("clip", path.name, error))
    if not actors:
        hint = _listing("clip", failed)
        raise ActorMissing("No clip of the folder can be read.", where=str(args.source), hint=hint)
    return actors, failed


def _file_name(name: str) -> str:
    """Remove characters from a name that file systems or Blender do not allow."""
    kept = "".join(letter if letter.isalnum() or letter in " -_.()" else "_" for letter in name)
    return kept.strip(" .")[:60] or "clip"


def _own_name(name: str, taken: set[str]) -> str:
    """Return a clip name that differs from all names in ``taken`` (lower case), by adding a number if needed."""
    numbered = (name if number == 1 else f"{name}_{number}" for number in count(1))
    return next(own for own in numbered if own.lower() not in taken)


def _listing(kind: str, failed: list[dict[str, Any]], most: int = 3) -> str:
    return " ".join(f"{entry[kind]}: {entry['message']}" for entry in failed[:most])


def _open_target(args: Namespace) -> tuple[bpy.types.Scene, bpy.types.Object]:
    scene = open_foreign_scene(args.target, limits_of(args))
    rigs = [o for o in scene.objects if o.type == "ARMATURE" and (args.object or not is_actor(o))]
    found = [o for o in rigs if args.object in ("", o.name)]
    if len(found) == 1:
        return scene, found[0]
    names = ", ".join(o.name_full for o in rigs) or "the file has none"
    if not found:
        message = f"There is no armature '{args.object}'." if args.object else "There is no armature."
    elif args.object:
        message = f"There are {len(found)} armatures '{args.object}': {', '.join(o.name_full for o in found)}."
    else:
        message = "Exactly one armature is needed."
    raise TargetUnsuitable(message, where=str(args.target), hint=f"Specify one with --object: {names}.")


def _lay_out_time(args: Namespace, scene: bpy.types.Scene, rates: Collection[float]) -> TakeTiming:
    """Return the timing of the motions in the scene, based on their most common frame rate."""
    if args.target.suffix.lower() != ".blend":
        set_scene_frame_rate(scene, Counter(rates).most_common(1)[0][0])
    return TakeTiming(args.frame_start, scene_frame_rate(scene))


def _map_target(args: Namespace, rig: bpy.types.Object) -> RigMap:
    if args.map is not None:
        return read_map(args.map)
    if args.preset:
        return named_preset(args.preset, rig.data.bones.keys(), user_presets_folder())
    return map_rig(rig, user_presets_folder())


def _settings(args: Namespace) -> RetargetSettings:
    return RetargetSettings(args.limbs, TransferSettings(args.in_place, args.root_motion, scale=args.scale))
