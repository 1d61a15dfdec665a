"""``motion``: a clip of any program onto our body; what only Blender reads is read here, the solver does the rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from .._exchange.progress import Progress
from .._exchange.skeleton_file import write_skeleton
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


def run_motion(request: MotionRequest, progress: Progress) -> dict[str, Any]:
    """Write a motion file and return the solver's ``result`` event.

    Raises:
        MocapError: the clip is missing, wrong or nobody's, or the output exists.
    """
    if request.clip.suffix.lower() not in _OWN:
        return _solved(request.clip, request, progress)
    from ..retarget.clips import chosen_actor, play_action
    from ..retarget.scene_files import open_scene
    from ..retarget.skeleton_of_rig import skeleton_of_rig

    progress("reading the clip", 0, 1)
    scene = open_scene(request.clip)
    rig = chosen_actor(scene, request.armature, str(request.clip))
    if request.action:
        play_action(rig, request.action)
    skeleton = skeleton_of_rig(rig, scene)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{request.clip.stem}.npz"
        write_skeleton(path, skeleton)
        return _solved(path, request, progress)


def _solved(clip: Path, request: MotionRequest, progress: Progress) -> dict[str, Any]:
    arguments = [str(clip), "--out", str(request.out), *request.rest]
    return run_solver("motion", arguments, progress, python=request.python)
