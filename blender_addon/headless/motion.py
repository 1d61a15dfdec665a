"""``motion convert`` and ``hands add`` for files that only Blender can read."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from tempfile import TemporaryDirectory

from .._exchange.progress import Progress
from .children import pass_on
from .foreign_file import limits_of, write_skeleton_of
from .result import CommandResult

_OWN = (".fbx", ".glb", ".gltf", ".vrm", ".vrma", ".blend")  # File types that the solver cannot read.


def run_motion(args: Namespace, progress: Progress) -> CommandResult:
    """Convert a clip from another program to a motion of the add-on's body."""
    with TemporaryDirectory() as folder:
        clip = _readable(args.clip, args, args.action, Path(folder), progress)
        return pass_on(args, progress, [str(clip), "--out", str(args.out)])


def run_add_hands(args: Namespace, progress: Progress) -> CommandResult:
    """Add hands from glove recordings to a motion, and write the new motion."""
    with TemporaryDirectory() as folder:
        gloves = [
            str(_readable(path, args, "", Path(folder) / str(number), progress))
            for number, path in enumerate(args.gloves)
        ]
        return pass_on(args, progress, [str(args.hands_of), *gloves, "--out", str(args.out)])


def _readable(clip: Path, args: Namespace, action: str, folder: Path, progress: Progress) -> Path:
    """Return a clip that the solver can read: the file itself, or a skeleton file written to the folder."""
    if clip.suffix.lower() not in _OWN:
        return clip
    progress("reading the clip", 0, 1)
    folder.mkdir(exist_ok=True)
    return write_skeleton_of(clip, folder, limits_of(args), args.armature, action)
