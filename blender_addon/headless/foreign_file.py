"""Open files from other programs in a child process with memory and time limits.

Blender's importers can expand a few kilobytes to any amount of memory, and damaged files can crash them. Therefore a
child process opens the file and samples its frames, and this process reads the arrays that the child wrote. The target
rig of a retarget must remain Blender data. The child converts it to a Blender file if it is from another program. It
only checks that a Blender file opens, because a copy would lose relative paths. Scripts in files never run.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any
from urllib.parse import unquote

import bpy

from .._exchange.diagnostics import sentence
from .._exchange.errors import FileDamaged, FileMissing, MocapError
from .._exchange.progress import Progress
from .._exchange.skeleton_file import write_skeleton
from ..animation.curves import current_action
from ..animation.takes import warnings_of_take
from ..errors import ImportStopped, SolverStopped
from ..retarget.actor_file import ReadActor, read_actor_file, write_actor
from ..retarget.recognition import map_rig, open_scene, read_header, user_presets_folder
from ..retarget.rig_actor import (
    chosen_actor,
    clips_of,
    is_actor,
    play_action,
    read_actor,
    read_rig_actor,
    skeleton_of_rig,
)
from ..scene.session import save_file
from ..solving.child_memory import resident_mb
from .children import run_to_its_end, start_verb
from .result import CommandResult

VERB = "import-file"  # The verb of the child.
_LEAST_MB, _MB_PER_MB, _MOST_MB = 512.0, 100.0, 2048.0
"""Memory of the child: 512 MB plus 100 times the file's size, at most 2 GB. Blender alone uses 254 MB, and FBX and glTF
files of 0.9 to 3 MB added 20 to 62 times their size (``tests/blender_addon/headless/test_foreign_file.py``). A Blender
file can link libraries of any size, so it gets 2 GB, or no limit if it is the target of an export or retarget."""
_LEAST_S, _S_PER_MB = 60.0, 20.0
"""Time limit of the child: 60 s plus 20 s per MB, once for opening a file and again for each clip. A glTF file of 3 MB
took 1.6 s per MB."""
_MB = 2**20  # Bytes per megabyte.
_NAMES = "{:04d}.npz"


@dataclass(frozen=True)
class ImportLimits:
    """Limits of one import. None derives a limit from the file's size."""

    memory_mb: float | None = None  # Resident memory of the child process in megabytes.
    seconds: float | None = None

    def of_file(self, path: Path, *, whole: bool = False) -> tuple[float, float]:
        """Return the allowed memory in MB and seconds. With ``whole``, .blend files have no default memory limit."""
        size_mb = _size_mb(path)
        memory_mb = min(_LEAST_MB + _MB_PER_MB * size_mb, _MOST_MB)
        if path.suffix.lower() == ".blend":
            memory_mb = inf if whole else _MOST_MB
        seconds = _LEAST_S + _S_PER_MB * size_mb if self.seconds is None else self.seconds
        return memory_mb if self.memory_mb is None else self.memory_mb, seconds


def _size_mb(path: Path) -> float:
    """Return a file's size in megabytes, including the buffers and images that a ``.gltf`` file refers to."""
    files = {path}
    if path.suffix.lower() == ".gltf":
        header = read_header(path)
        entries = [
            entry for key in ("buffers", "images") if isinstance(found := header.get(key), list) for entry in found
        ]
        uris = [entry.get("uri") for entry in entries if isinstance(entry, dict)]
        files |= {path.parent / unquote(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")}
    size = 0
    for file in files:
        with suppress(OSError, ValueError):  # names that no system accepts
            size += file.stat().st_size if file.is_file() else 0
    return size / _MB


def limits_of(args: Namespace) -> ImportLimits:
    """Return the import limits in a command line's arguments."""
    return ImportLimits(args.import_memory, args.import_seconds)


def write_skeleton_of(path: Path, folder: Path, limits: ImportLimits, armature: str = "", action: str = "") -> Path:
    """Convert a clip to a file that the solver reads as a moving skeleton, and return the file's path."""
    _run("skeleton", path, folder, limits, armature=armature, action=action)
    return (folder / _NAMES.format(0)).rename(folder / f"{path.stem}.npz")


def read_foreign_actor(path: Path, limits: ImportLimits, armature: str = "", action: str = "") -> ReadActor:
    """Return the motion that an armature in a file plays, or the motion of one of its actions."""
    with TemporaryDirectory() as folder:
        _run("actor", path, Path(folder), limits, armature=armature, action=action)
        return read_actor_file(Path(folder) / _NAMES.format(0))


def read_foreign_clips(path: Path, limits: ImportLimits, armature: str = "") -> Iterator[ReadActor]:
    """Yield every action in a file that moves the armature, named after the file and the action."""
    with TemporaryDirectory() as folder:
        _run("clips", path, Path(folder), limits, armature=armature)
        for file in sorted(Path(folder).glob("*.npz")):
            yield read_actor_file(file)


def open_foreign_scene(path: Path, limits: ImportLimits) -> bpy.types.Scene:
    """Import a file in a child process with these limits, then open the result here and return its scene."""
    with TemporaryDirectory() as folder:
        _run("scene", path, Path(folder), limits)
        made = Path(folder) / "scene.blend"
        return open_scene(made if made.is_file() else path)


def run_import(args: Namespace, progress: Progress) -> CommandResult:
    """Open a file and write its contents for the parent process."""
    progress("opening the file", 0, 1)
    scene = open_scene(args.source)
    if args.kind == "scene":
        scene.frame_set(scene.frame_current)  # runs modifiers and drivers, which may need far more memory than the file
        if args.source.suffix.lower() != ".blend":
            save_file(args.out / "scene.blend")
        return {"outputs": [], "notes": []}
    rig = chosen_actor(scene, args.armature, str(args.source))
    names = [action.name for action in clips_of(rig)] if args.kind == "clips" else []
    for number, name in enumerate(names or [args.action]):
        if name:
            play_action(rig, name)
        path = args.out / _NAMES.format(number)
        if args.kind == "skeleton":
            write_skeleton(path, skeleton_of_rig(rig, scene))
            continue
        own = None if args.kind == "actor" else " ".join([args.source.stem, *[name] * (len(names) > 1)])
        write_actor(path, _of_rig(rig, scene), own)
        progress("reading the clips", number + 1, max(1, len(names)))
    return {"outputs": [], "notes": []}


def _of_rig(rig: bpy.types.Object, scene: bpy.types.Scene) -> ReadActor:
    if is_actor(rig):
        action = current_action(rig)
        found = () if action is None else warnings_of_take(action)
        return ReadActor(read_actor(rig, scene)[0], tuple(sentence(item) for item in found))
    actor, _, notes = read_rig_actor(rig, scene, map_rig(rig, user_presets_folder()))
    return ReadActor(actor, notes)


def _run(kind: str, path: Path, folder: Path, limits: ImportLimits, **options: Any) -> None:
    if not path.is_file():
        raise FileMissing("There is no such file.", where=str(path), hint="Check the path.")
    memory_mb, seconds = limits.of_file(path, whole=kind == "scene")
    began, reached = monotonic(), ("", 0)

    def note(stage: str, done: int, total: int) -> None:
        nonlocal began, reached
        if (stage, done) != reached:
            began, reached = monotonic(), (stage, done)

    def stopped(pid: int) -> MocapError | None:
        if (used_mb := resident_mb(pid)) is not None and used_mb > memory_mb:
            what, hint = f"{used_mb:.0f} MB of memory, but {memory_mb:.0f} MB are allowed", "--import-memory"
        elif monotonic() - began > seconds:
            what, hint = f"more than {seconds:.0f} s", "--import-seconds"
        else:
            return None
        hint = f"If you trust the file, allow more with {hint}."
        return ImportStopped(f"Blender's import of the file needs {what}. It was stopped.", where=str(path), hint=hint)

    words = [str(path.absolute()), "--kind", kind, "--out", str(folder)]
    words += [word for name, value in options.items() if value for word in (f"--{name}={value}",)]
    try:
        run_to_its_end(start_verb(VERB, words, Path.cwd()), note, stopped, f"Blender's process ({VERB})")
    except SolverStopped as error:
        if error.code != "solver_died" or not reached[0]:  # the child ended before it opened the file
            raise
        hint = "Open it in the program that wrote it and export it again."
        raise FileDamaged("Blender crashed while reading the file.", where=str(path), hint=hint) from error
