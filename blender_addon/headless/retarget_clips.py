"""``retarget FOLDER``: every clip of a folder onto one character, as actions with asset marks and as files."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from .._exchange.errors import MocapError, OutputExists
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..errors import ActorMissing
from .actors import ReadActor, read_clips
from .exit_codes import exit_code
from .result import CommandResult
from .retarget_target import lay_out_time, map_target, open_target

if TYPE_CHECKING:
    from .retarget_request import RetargetRequest

_SAME_RATE = 1e-3
"""Relative difference of frame rates that is none."""
_READ = (".npz", ".fbx", ".glb", ".gltf", ".vrm", ".bvh", ".blend")


class FailedClip(TypedDict):
    """A clip that could not be read or laid."""

    clip: str
    """Its name, or its file's."""
    code: str
    message: str
    exit_code: int


class DoneClip(TypedDict):
    """A clip that was transferred."""

    clip: str
    frames: int
    notes: list[str]


class ClipsResult(CommandResult):
    """Of ``retarget`` of a folder."""

    clips: list[DoneClip]
    failed: list[FailedClip]
    seconds: float


def run_retarget_clips(request: RetargetRequest, formats: tuple[str, ...], progress: Progress) -> ClipsResult:
    """Write a Blender file in which the rig has an action a clip, and beside it a file a clip and format.

    A clip that cannot be read or laid is left out and named; the exit code is that of the worst.

    Args:
        request: what to retarget; its source is a folder.
        formats: keys of ``export.formats.FORMATS`` that each clip is written in, too.
        progress: called for each clip.

    Returns:
        The ``result`` event: outputs, clips with their notes, and those that failed.

    Raises:
        MocapError: there are no clips, the rig or its map is unsuitable, an output exists, or nothing could be laid.
    """
    from ..export.take import take_of
    from ..export.write import export_take, format_of
    from ..retarget.actor_rig import play_action
    from ..retarget.retarget import retarget
    from ..scene.session import save_file

    start = time.monotonic()
    suffixes = {name: format_of(name).suffix for name in formats}
    actors, failed = _read(request, progress)
    _check_free(request, [f"{read.actor.name}{suffix}" for read in actors for suffix in suffixes.values()])
    clips: list[DoneClip] = []
    written: list[Path] = [request.out]
    with atomic_outputs(request.out.parent, (request.out.name,), overwrite=request.overwrite) as temporary:
        scene, rig = open_target(request)
        rig_map = map_target(request, rig)
        timing = lay_out_time(request, scene, [read.actor.fps for read in actors])
        for done, read in enumerate(actors):
            progress("retargeting", done, len(actors))
            name, actor = read.actor.name, read.actor
            try:
                laid = retarget(actor, rig, scene, rig_map, timing, request.settings)
                laid.action.name = name
                laid.action.asset_mark()
                end = timing.last_frame(actor.num_frames, actor.fps)
                take = take_of(scene, rig, (request.frame_start, end))
                for kind, suffix in suffixes.items():
                    path = request.out.parent / f"{name}{suffix}"
                    written.append(export_take(take, kind, path, overwrite=request.overwrite))
            except MocapError as error:
                failed.append(_failure(name, error))
                continue
            finally:
                if rig.animation_data is not None:
                    rig.animation_data.action = None
            scene.frame_end = max(scene.frame_end, end)
            notes = [*read.notes, *laid.notes]
            if suffixes and abs(actor.fps / timing.scene_fps - 1) > _SAME_RATE:
                notes.append(f"Recorded at {actor.fps:g} frames a second, exported at {timing.scene_fps:g}.")
            clips.append({"clip": name, "frames": actor.num_frames, "notes": notes})
        progress("retargeting", len(actors), len(actors))
        if not clips:
            raise ActorMissing(
                "No clip could be transferred to the rig.", where=str(request.source), hint=_listing(failed)
            )
        play_action(rig, clips[0]["clip"])
        save_file(temporary[request.out.name])
    notes = [f"{clip['clip']}: {note}" for clip in clips for note in clip["notes"]]
    return {
        "event": "result", "outputs": [str(path) for path in written], "clips": clips, "failed": failed,
        "notes": [*notes, *(f"{entry['clip']} failed: {entry['message']}" for entry in failed)],
        "map": rig_map.label, "exit_code": max((entry["exit_code"] for entry in failed), default=0),
        "seconds": round(time.monotonic() - start, 3),
    }  # fmt: skip


def _check_free(request: RetargetRequest, names: list[str]) -> None:
    """Refuse to start where a file would be replaced that must not be."""
    if request.out.exists() and request.out.samefile(request.target):
        raise OutputExists("The target's own file would be replaced.", where=str(request.out), hint="Name another.")
    there = [name for name in names if (request.out.parent / name).exists()]
    sources = [name for name in there if (request.out.parent / name).resolve().parent == request.source.resolve()]
    if sources or (there and not request.overwrite):
        raise OutputExists(
            f"{', '.join((sources or there)[:3])} would be replaced.", where=str(request.out.parent),
            hint="Choose another folder for --out.",
        )  # fmt: skip


def _read(request: RetargetRequest, progress: Progress) -> tuple[list[ReadActor], list[FailedClip]]:
    """Return the clips of a folder, each with a name of its own, and those that cannot be read."""
    paths = sorted(path for path in request.source.iterdir() if path.suffix.lower() in _READ and path.is_file())
    if not paths:
        hint = f"Clips are files with the endings {', '.join(_READ)}."
        raise ActorMissing("The folder holds no clips.", where=str(request.source), hint=hint)
    actors: list[ReadActor] = []
    failed: list[FailedClip] = []
    for done, path in enumerate(paths):
        progress("reading clips", done, len(paths))
        try:
            for read in read_clips(path, request.body, request.armature):
                name = _own_name(_file_name(read.actor.name), {other.actor.name.lower() for other in actors})
                actors.append(ReadActor(replace(read.actor, name=name), read.notes))
        except MocapError as error:
            failed.append(_failure(path.name, error))
    if not actors:
        raise ActorMissing("No clip of the folder can be read.", where=str(request.source), hint=_listing(failed))
    return actors, failed


def _file_name(name: str) -> str:
    """Return a name without what file systems or Blender's names do not take."""
    kept = "".join(letter if letter.isalnum() or letter in " -_.()" else "_" for letter in name)
    return kept.strip(" .")[:60] or "clip"


def _own_name(name: str, taken: set[str]) -> str:
    """Return a name that no other clip has, on systems that do not distinguish capitals from small letters either."""
    numbered = (name if number == 1 else f"{name}_{number}" for number in count(1))
    return next(own for own in numbered if own.lower() not in taken)


def _failure(clip: str, error: MocapError) -> FailedClip:
    return {"clip": clip, "code": error.code, "message": str(error), "exit_code": exit_code(error)}


def _listing(failed: list[FailedClip]) -> str:
    return " ".join(f"{entry['clip']}: {entry['message']}" for entry in failed[:3])
