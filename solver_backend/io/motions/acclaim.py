"""Read Acclaim skeletons (ASF) and motions (AMC), as used in the CMU database.

A bone rotates by ``G = G_parent C M C^T``, with its axes C from the skeleton and the frame's rotation M. It ends at ``p
+ G d l``, with its rest direction d and its length l (Lander, Game Developer Magazine, January 1998).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing, NonFiniteData
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, require_within
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.files import LARGEST_TEXT, read_text
from solver_backend.types import SkeletonMotion

SUFFIXES = (".asf", ".amc")
RATE = 120.0  # Frames per second of CMU takes. AMC files do not state the rate.
_FRAME_DIGITS = 9  # Largest number of digits in a frame number. A longer number means that the file is damaged.
_MOST_BONES, _MOST_FRAMES, _MOST_BYTES = 1000, 1_000_000, 200_000_000
_LONGEST = 1e6  # Largest bone length, and largest component of a direction or axis, in any unit.
_TURNS, _PLACES = ({f"{kind}{axis}": k for k, axis in enumerate("xyz")} for kind in "rt")  # Axis index per channel.


@dataclass
class _Bone:
    """A bone of an Acclaim skeleton. Angles are in degrees, lengths in the file's unit."""

    direction: np.ndarray = field(default_factory=lambda: np.zeros(3))
    length: float = 0.0
    axis: np.ndarray = field(default_factory=lambda: np.zeros(3))
    order: str = "xyz"
    channels: tuple[str, ...] = ()
    parent: str = ""


def read_acclaim(path: Path, fps: float | None = None) -> SkeletonMotion:
    """Read the motion in a pair of ASF and AMC files, given the path of one of them.

    The motion is in the skeleton's unit and axes.

    Raises:
        FileMissing: the other file in the pair is missing or ambiguous.
        FileDamaged: a line does not match the format.
        NonFiniteData: a value is not a number, or is out of range.
    """
    return read_pair(*find_pair(path), fps)


def read_pair(skeleton: Path, motion: Path, fps: float | None = None) -> SkeletonMotion:
    """Read a skeleton (ASF) and its motion (AMC). See ``read_acclaim`` for errors."""
    bones, radians = _read_skeleton(skeleton)
    values, in_radians = _read_frames(motion, bones)
    axes, turns = (
        1.0 if known else np.pi / 180.0 for known in (radians, radians if in_radians is None else in_radians)
    )
    names = list(bones)
    G, heads, ends = _pose(bones, values, axes, turns)
    _, rest, rest_ends = _pose(bones, {name: np.zeros((1, len(bones[name].channels))) for name in names}, axes, turns)
    parents = [names.index(bones[name].parent) if bones[name].parent else -1 for name in names]
    leaves = [b for b, name in enumerate(names) if b not in parents]
    return SkeletonMotion(
        motion.stem,
        (*names, *(f"{names[b]}_end" for b in leaves)),
        (*parents, *leaves),
        np.concatenate([rest[0], rest_ends[0, leaves]]),
        np.concatenate([heads, ends[:, leaves]], axis=1),
        np.concatenate([G, G[:, leaves]], axis=1),
        fps or RATE,
    )


def find_pair(path: Path) -> tuple[Path, Path]:
    """Find the ASF and AMC files that belong together, such as 13.asf and 13_29.amc.

    Files that are numbered for different subjects are not a pair.
    """
    if path.suffix.lower() == ".asf":
        return path, _other(path, ".amc")
    return _other(path, ".asf"), path


def _other(path: Path, suffix: str) -> Path:
    there = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == suffix) if path.parent.is_dir() else []
    same = [p for p in there if p.stem == path.stem]
    number = _subject(path)
    subject = [p for p in there if _subject(p) == number]
    others = [p for p in there if _subject(p).isdigit() and number.isdigit()]
    found = same or subject or [p for p in there if p not in others]
    if len(found) == 1:
        return found[0]
    kind = "skeleton (ASF)" if suffix == ".asf" else "motion (AMC)"
    if not found:
        hint = f"Put it next to {path.name}, with the same name."
        raise FileMissing(f"The {kind} of the pair is missing.", where=str(path), hint=hint)
    listed = ", ".join(p.name for p in found[:5])
    hint = f"Name one of them: {listed}." if suffix == ".amc" else f"Name one of them {path.stem}.asf: {listed}."
    raise FileMissing(f"{len(found)} files could be the {kind} of the pair.", where=str(path), hint=hint)


def _subject(path: Path) -> str:
    """Return the leading number of a file name, such as 131 in 131-dance.asf, or the part before "_"."""
    number = re.match(r"\d+(?=[_\- .]|$)", path.stem)
    return number[0] if number else path.stem.split("_")[0]


def _read_skeleton(path: Path) -> tuple[dict[str, _Bone], bool]:
    """Read the bones of an ASF file, root first. Also return whether its angles are in radians."""
    bones, part, name, radians = {"root": _Bone()}, "", "", False
    for number, line in enumerate(read_text(path, LARGEST_TEXT).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0].startswith(":"):
            part = words[0].lower()
            continue
        key, where = words[0].lower(), f"{path}, line {number}"
        try:
            if part == ":units" and key == "angle":
                radians = words[1].lower().startswith("rad")
            elif part == ":root" and key == "order":
                bones["root"].channels = _channels(words[1:])
            elif part == ":root" and key == "axis":
                bones["root"].order = _order(words[1])
            elif part == ":root" and key == "orientation":
                bones["root"].axis = _vector(words[1:4])
            elif part == ":bonedata" and key == "name":
                name = words[1]
                bones[name] = _Bone()
            elif part == ":bonedata" and key in ("direction", "length", "axis", "dof"):
                _set(bones[name], key, words[1:])
            elif part == ":hierarchy" and key not in ("begin", "end"):
                for child in words[1:]:
                    bones[child].parent = words[0]
        except (KeyError, IndexError, ValueError) as error:
            raise FileDamaged(f"The line of the skeleton is not valid: {line.strip()}", where=where) from error
    if not 1 < len(bones) <= _MOST_BONES:
        raise FileDamaged(f"The skeleton has {len(bones) - 1} bones.", where=str(path), hint="Export the file again.")
    if not bones["root"].channels:
        raise FileDamaged("The skeleton's root has no 'order'.", where=str(path), hint="Export the file again.")
    return _from_root(bones, path), radians


def _set(bone: _Bone, key: str, words: list[str]) -> None:
    if key == "direction":
        bone.direction = _vector(words)
    elif key == "length":
        bone.length = float(_vector([words[0], "0", "0"])[0])
    elif key == "axis":
        bone.axis, bone.order = _vector(words[:3]), _order(words[3])
    else:
        bone.channels = _channels(words)


def _channels(words: list[str]) -> tuple[str, ...]:
    if len({word.lower() for word in words}) < len(words):
        raise ValueError("two channels have the same name")
    return tuple(word.lower() for word in words)


def _vector(words: list[str]) -> np.ndarray:
    values = np.array([float(word) for word in words[:3]])
    if values.shape != (3,) or not (np.abs(values) < _LONGEST).all():
        raise ValueError("three numbers are expected")
    return values


def _order(word: str) -> str:
    if not set(word.lower()) <= set("xyz"):
        raise ValueError("an axis order is expected")
    return word.lower()


def _from_root(bones: dict[str, _Bone], path: Path) -> dict[str, _Bone]:
    order = ["root"]
    for above in order:
        order += [name for name, bone in bones.items() if bone.parent == above and name not in order]
    if lost := [name for name in bones if name not in order]:
        raise FileDamaged(f"These bones are not connected to the root: {', '.join(lost[:5])}.", where=str(path))
    return {name: bones[name] for name in order}


def _read_frames(path: Path, bones: dict[str, _Bone]) -> tuple[dict[str, np.ndarray], bool | None]:
    """Read the channels (F, C) of each bone from an AMC file. Also return whether angles are in radians.

    The second result is None if the file does not state the unit of angles. A bone that no frame mentions stays in its
    rest pose.
    """
    rows: dict[str, list[list[float]]] = {name: [] for name in bones}
    frames, last, radians = 0, 0, None
    for number, line in enumerate(read_text(path, _MOST_BYTES).splitlines(), start=1):
        words, where = line.split("#")[0].split(), f"{path}, line {number}"
        if not words:
            continue
        if words[0].lower() in (":radians", ":degrees"):
            radians = words[0].lower() == ":radians"
        if words[0].startswith(":"):
            continue
        if len(words) == 1 and words[0].isdecimal() and len(words[0]) <= _FRAME_DIGITS:
            if frames and int(words[0]) != last + 1:
                hint = "Export all frames of the take."
                raise FileDamaged(f"Frame {words[0]} comes after frame {last}.", where=where, hint=hint)
            frames, last = frames + 1, int(words[0])
            continue
        bone = bones.get(words[0])
        if bone is None or len(words) - 1 != len(bone.channels):
            known = "an unknown bone" if bone is None else f"{len(words) - 1} numbers instead of {len(bone.channels)}"
            hint = "Choose the skeleton (ASF) of this take, or export both again."
            raise FileDamaged(f"Frame {last} has {known}: {line.strip()[:60]}", where=where, hint=hint)
        if len(rows[words[0]]) != frames - 1:
            message = f"'{words[0]}' is missing or occurs twice before frame {last}."
            raise FileDamaged(message, where=where, hint="Export the motion again.")
        try:
            rows[words[0]].append([float(word) for word in words[1:]])
        except ValueError as error:
            message = f"The line contains something that is not a number: {line[:60]}"
            raise NonFiniteData(message, where=where) from error
    if not 0 < frames <= _MOST_FRAMES:
        raise FileDamaged(f"The motion has {frames} frames.", where=str(path), hint="Export the file again.")
    values = {}
    for name, bone in bones.items():
        if rows[name] and len(rows[name]) != frames:
            raise FileDamaged(f"'{name}' is missing in a frame.", where=str(path), hint="Export the file again.")
        values[name] = np.array(rows[name] or np.zeros((frames, len(bone.channels))), np.float64)
        require_within(f"'{name}'", values[name], FARTHEST_IN_UNITS, NonFiniteData, str(path))
        read = _TURNS.keys() if bone.parent else _TURNS.keys() | _PLACES.keys()
        for channel, column in zip(bone.channels, values[name].T, strict=True):
            if channel not in read and column.any():
                hint = "Export the take with bones that only rotate."
                raise FileDamaged(f"'{name}' has the unsupported channel '{channel}'.", where=str(path), hint=hint)
    return values, radians


def _pose(
    bones: dict[str, _Bone], values: dict[str, np.ndarray], axes: float, turns: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the rotations of the bones from rest (F, B, 3, 3), and their start and end points (F, B, 3).

    Args:
        axes: radians per angle unit in the skeleton.
        turns: radians per angle unit in the frames.
    """
    names = list(bones)
    frames = len(values["root"])
    G, (heads, ends) = np.empty((frames, len(bones), 3, 3)), np.zeros((2, frames, len(bones), 3))
    for b, (name, bone) in enumerate(bones.items()):
        columns = {channel: values[name][:, c] for c, channel in enumerate(bone.channels)}
        angles = np.zeros((frames, 3))
        for channel, axis in _TURNS.items():
            if channel in columns:
                angles[:, axis] = turns * columns[channel]
        order = "".join(channel[1] for channel in bone.channels if channel in _TURNS) or bone.order
        C = _turns(axes * bone.axis[None], bone.order)[0]
        local = C @ _turns(angles, order) @ C.T
        if bone.parent:
            above = names.index(bone.parent)
            G[:, b], heads[:, b] = G[:, above] @ local, ends[:, above]
        else:
            G[:, b] = local
            for channel, axis in _PLACES.items():
                heads[:, b, axis] = columns.get(channel, 0.0)
        ends[:, b] = heads[:, b] + G[:, b] @ (bone.length * bone.direction)
    return G, heads, ends


def _turns(angles: np.ndarray, order: str) -> np.ndarray:
    """Convert angles (F, 3) in radians about fixed X, Y and Z, applied in ``order``, to rotations (F, 3, 3)."""
    turns = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    for letter in order:
        axis = "xyz".index(letter)
        turns = np.asarray(exp_so3(angles[:, axis, None] * np.eye(3)[axis])) @ turns
    return turns
