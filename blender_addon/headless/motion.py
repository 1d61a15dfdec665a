"""``motion`` and ``add-hands``: clips of any program; what only Blender reads is read here, then the solver works."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from .._exchange.progress import Progress
from .._exchange.skeleton_file import write_skeleton
from .._exchange.verb_results import ClipResult, GlovesResult
from .solver import run_solver

_OWN = (".fbx", ".glb", ".gltf", ".vrm", ".blend")
"""What the solver cannot read."""


@dataclass(frozen=True)
class MotionRequest:
    """What to bring onto the body."""

    clip: Path
    """File with the clip; it is not changed."""
    out: Path
    """Motion file to write."""
    armature: str = ""
    """Which armature of the clip; needed where several move."""
    action: str = ""
    """Which of its actions; "" for the one that it shows."""
    rest: tuple[str, ...] = ()
    """Further options of the solver's verb."""
    python: Path | None = None
    """Python to solve with; None for this one."""


def run_motion(request: MotionRequest, progress: Progress) -> ClipResult:
    """Write a motion file and return the solver's ``result`` event.

    Raises:
        MocapError: the clip is missing, wrong or nobody's, or the output exists.
    """
    with TemporaryDirectory() as folder:
        clip = _readable(request.clip, request.armature, request.action, Path(folder), progress)
        arguments = [str(clip), "--out", str(request.out), *request.rest]
        return run_solver("motion", arguments, progress, python=request.python)


@dataclass(frozen=True)
class HandsRequest:
    """Which hands to add to a motion."""

    motion: Path
    gloves: tuple[Path, ...]
    """Recordings of hands; they are not changed."""
    out: Path
    """Motion file to write."""
    armature: str = ""
    """Which armature of a recording that only Blender reads."""
    rest: tuple[str, ...] = ()
    """Further options of the solver's verb."""
    python: Path | None = None
    """Python to solve with; None for this one."""


def run_add_hands(request: HandsRequest, progress: Progress) -> GlovesResult:
    """Write a motion with the hands of gloves and return the solver's ``result`` event.

    Raises:
        MocapError: a file is missing, wrong or nobody's, or the output exists.
    """
    with TemporaryDirectory() as folder:
        gloves = [
            _readable(path, request.armature, "", Path(folder) / str(number), progress)
            for number, path in enumerate(request.gloves)
        ]
        arguments = [str(request.motion), *map(str, gloves), "--out", str(request.out), *request.rest]
        return run_solver("add-hands", arguments, progress, python=request.python)


def _readable(clip: Path, armature: str, action: str, folder: Path, progress: Progress) -> Path:
    """Return a clip that the solver reads: itself, or a skeleton file in the folder."""
    if clip.suffix.lower() not in _OWN:
        return clip
    from ..retarget.actor_rig import chosen_actor, play_action
    from ..retarget.rig_actor import skeleton_of_rig
    from ..retarget.scene_files import open_scene

    progress("reading the clip", 0, 1)
    scene = open_scene(clip)
    rig = chosen_actor(scene, armature, str(clip))
    if action:
        play_action(rig, action)
    path = folder / f"{clip.stem}.npz"
    write_skeleton(path, skeleton_of_rig(rig, scene))
    return path
