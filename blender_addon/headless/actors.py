"""Read a file's motions as actors, one per clip, to transfer them to the add-on's body or another rig."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from .._exchange.diagnostics import read_diagnostics, sentence, warnings_in
from .._exchange.motion_file import read_motion
from ..animation.takes import found_in
from ..body.body_file import body_path_of, read_body, require_body
from ..retarget.actor_file import ReadActor
from ..retarget.motion.figures import actor_of_motion
from .foreign_file import limits_of, read_foreign_actor, read_foreign_clips


def read_source(args: Namespace) -> ReadActor:
    """Return the motion in a motion file, or the motion of an armature in any file that Blender reads.

    Args:
        args: ``source``, ``body`` (body file for a motion, or None for the body that it was solved for), ``armature``
        (name, needed if several move), ``action`` (name, or "" for the current action) and the import limits.
    """
    if args.source.suffix.lower() in (".npz", ""):
        return _of_motion(args.source, args.body)
    return read_foreign_actor(args.source, limits_of(args), args.armature, args.action)


def read_clips(path: Path, args: Namespace) -> Iterator[ReadActor]:
    """Yield every clip in a file, named after the file and the action."""
    if path.suffix.lower() == ".npz":
        read = _of_motion(path, args.body)
        yield replace(read, actor=replace(read.actor, name=path.stem))
    else:
        yield from read_foreign_clips(path, limits_of(args), args.armature)


def _of_motion(path: Path, body: Path | None) -> ReadActor:
    motion = read_motion(path)
    chosen = read_body(body or body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, chosen)
    found = warnings_in(read_diagnostics(found_in(motion.provenance)))
    return ReadActor(actor_of_motion(motion, chosen), tuple(sentence(item, motion.fps) for item in found))
