"""Read BVH motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, NonFiniteData
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS, require_within
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.skeleton_file import require_distinct
from solver_backend.exchange.torn_lines import torn_line
from solver_backend.io.files import read_text
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.io.units_and_axes import metres_in, rotation_to_z_up
from solver_backend.types import SkeletonMotion

METRES_PER_UNIT = 0.01  # BVH does not state a unit. Centimetres are the most common.
_LARGEST, _LARGEST_HIERARCHY = 256_000_000, 5_000_000  # Size limits: a file in bytes, and HIERARCHY in characters.
_MOST_JOINTS, _MOST_FRAMES, _MOST_POSES = 1000, 10_000_000, 15_000_000
"""Largest number of joints in a skeleton, frames in a take, and their product. A joint needs 100 bytes per frame."""
_BLOCK = 1 << 20  # Number of characters to split at a time, chosen by hand.
_AXES = {"X": 0, "Y": 1, "Z": 2}  # Column of each axis.


@dataclass(frozen=True)
class BvhClip:
    """A moving skeleton in metres with Z up.

    Joint j is at ``p_j = p_parent + G_parent @ local_j``, where G is the rotation to world axes and local_j is the
    offset from the parent. Offsets are in the skeleton's rest axes (usually Y up). The root's rotation includes the
    conversion to Z up.
    """

    names: tuple[str, ...]  # (J,) joint names, parents before children.
    parents: np.ndarray  # (J,) index of each joint's parent, -1 for the root.
    offsets: np.ndarray  # (J, 3) offsets from the parent in the rest pose, metres.
    rotations: np.ndarray  # (F, J, 3, 3) rotations from joint axes to parent axes. For the root, to world axes.
    root_positions: np.ndarray  # (F, 3) root positions in the world, metres.
    fps: float
    translations: np.ndarray | None = None
    """(F, J, 3) offsets from the parent in metres, if joints other than the root have position channels."""
    end_offsets: dict[str, np.ndarray] = field(default_factory=dict)  # (3,) metres from a joint to its End Site.

    def positions(self) -> np.ndarray:
        """Compute the joint positions (F, J, 3) in the world, in metres."""
        return self.posed()[0]

    def posed(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute joint positions (F, J, 3) in metres and rotations from rest axes to world axes (F, J, 3, 3)."""
        frames, joints = self.rotations.shape[:2]
        local = np.broadcast_to(self.offsets, (frames, joints, 3)) if self.translations is None else self.translations
        p, G = np.empty((frames, joints, 3)), np.empty((frames, joints, 3, 3))
        for j, parent in enumerate(self.parents):
            if parent < 0:
                p[:, j], G[:, j] = self.root_positions, self.rotations[:, j]
            else:
                p[:, j] = p[:, parent] + (G[:, parent] @ local[:, j, :, None])[..., 0]
                G[:, j] = G[:, parent] @ self.rotations[:, j]
        return p, G


@dataclass
class _Skeleton:
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)
    ends: dict[str, np.ndarray] = field(default_factory=dict)


def read_bvh(path: Path | str, *, metres_per_unit: float = METRES_PER_UNIT, up_axis: str = "y") -> BvhClip:
    """Read a BVH file in a given unit and with a given up axis.

    ``R_j = R_first R_second R_third`` in channel order. The root's position channels replace its offset. For other
    joints, most programs also replace the offset, but some add to it. Each joint votes for the interpretation that is
    closer to its rest offset, so that a single translating joint cannot decide.

    Raises:
        FileMissing, FileDamaged: the file is missing, truncated or not BVH.
        NonFiniteData: a value is NaN, infinite, or too large in any unit.
        JobInvalid: the axis is unknown.
    """
    to_z_up = rotation_to_z_up(up_axis)
    head, found, motion = read_text(path, _LARGEST).partition("MOTION")
    if not found or "HIERARCHY" not in head:
        raise FileDamaged("The file is truncated or is not BVH: HIERARCHY and MOTION are expected.", where=str(path))
    if len(head) > _LARGEST_HIERARCHY:
        raise FileDamaged(f"HIERARCHY has {len(head):,} characters, too many for a skeleton.", where=str(path))
    skeleton = _read_skeleton(head, path)
    values, fps = _read_motion(motion, skeleton, path)
    for name, numbers in (("OFFSET", [*skeleton.offsets, *skeleton.ends.values()]), ("MOTION", values)):
        require_within(name, np.asarray(numbers), FARTHEST_IN_UNITS, NonFiniteData, str(path))
    rotations, translations = _apply_channels(skeleton, values)
    moving = any("position" in name for channels in skeleton.channels[1:] for name in channels)
    rotations[:, 0] = to_z_up @ rotations[:, 0]
    return BvhClip(
        names=tuple(skeleton.names),
        parents=np.array(skeleton.parents),
        offsets=np.array(skeleton.offsets) * metres_per_unit,
        rotations=rotations,
        root_positions=translations[:, 0] @ to_z_up.T * metres_per_unit,
        fps=fps,
        translations=translations * metres_per_unit if moving else None,
        end_offsets={name: offset * metres_per_unit for name, offset in skeleton.ends.items()},
    )


def _read_skeleton(text: str, path: Path | str) -> _Skeleton:
    skeleton, stack, depth_of_end = _Skeleton(), [], 0
    for line in text.replace("{", "\n{\n").replace("}", "\n}\n").splitlines():
        words = line.split()
        kind = words[0].upper() if words else ""
        try:
            if kind in ("ROOT", "JOINT"):
                if len(words) < 2:
                    raise ValueError("a joint needs a name")
                skeleton.names.append(" ".join(words[1:]))
                skeleton.parents.append(stack[-1] if stack else -1)
                stack.append(len(skeleton.names) - 1)
                skeleton.offsets.append([0.0, 0.0, 0.0])
                skeleton.channels.append([])
            elif kind == "END":
                depth_of_end = 1
            elif kind == "OFFSET":
                offset = [float(word) for word in words[1:4]]
                if len(offset) < 3:
                    raise ValueError("three numbers are expected")
                if depth_of_end:
                    skeleton.ends[skeleton.names[stack[-1]]] = np.array(offset)
                else:
                    skeleton.offsets[stack[-1]] = offset
            elif kind == "CHANNELS":
                skeleton.channels[stack[-1]] = _channels(words)
            elif kind == "}" and depth_of_end:
                depth_of_end = 0
            elif kind == "}":
                stack.pop()
        except (ValueError, IndexError) as error:
            what = f"'{line.strip()[:60]}' in HIERARCHY is not understood: {error}."
            raise FileDamaged(what, where=str(path)) from error
    if stack or not skeleton.names or skeleton.parents.count(-1) != 1:
        raise FileDamaged("HIERARCHY is not one tree of joints with closed brackets.", where=str(path))
    if len(skeleton.names) > _MOST_JOINTS:
        raise FileDamaged(
            f"HIERARCHY has {len(skeleton.names):,} joints, but at most {_MOST_JOINTS} are supported.", where=str(path)
        )
    return skeleton


def _channels(words: list[str]) -> list[str]:
    names = [word[0].upper() + word[1:].lower() for word in words[2:]]
    known = {f"{axis}{kind}" for axis in _AXES for kind in ("position", "rotation")}
    if len(names) != int(words[1]) or not set(names) <= known or len(names) > len(known):
        raise ValueError(f"channels are {', '.join(sorted(known))}")
    return names


def _read_motion(text: str, skeleton: _Skeleton, path: Path | str) -> tuple[np.ndarray, float]:
    """Read the channel values (F, channels) and the frame rate."""
    channels = sum(len(names) for names in skeleton.channels)
    head, _, rest = text.partition("Time:")
    words = head.split()
    try:
        frames = int(words[words.index("Frames:") + 1])
        time, *numbers = rest.split(maxsplit=1)
        frame_time = float(time)
        table = numbers[0] if numbers else ""
        values = np.concatenate([np.array(words, np.float64) for words in _blocks(table)])
    except (ValueError, IndexError) as error:
        what = f"MOTION is truncated or contains something other than numbers ({error})."
        raise FileDamaged(what, where=torn_line(path, read_text(path, _LARGEST))) from error
    if not 0 < frame_time < np.inf or not 1 <= frames <= _MOST_FRAMES:
        raise FileDamaged(
            f"MOTION states {str(frames)[:20]} frames of {frame_time:g} s, which is impossible.", where=str(path)
        )
    if not channels or frames * len(skeleton.names) > _MOST_POSES:
        what = f"{frames} frames of {len(skeleton.names)} joints with {channels} channels cannot be read at once."
        raise FileDamaged(what, where=str(path), hint="Cut the take.")
    if values.size != frames * channels:
        needed = f"{frames} frames of {channels} channels need {frames * channels}"
        what = f"MOTION contains {values.size} numbers, but {needed}."
        where, hint = torn_line(path, read_text(path, _LARGEST)), "Copy or export the file again."
        hint = hint if where == str(path) else "Correct the line, or copy or export the file again."
        raise FileDamaged(what, where=where, hint=hint)
    return values.reshape(frames, channels), 1.0 / frame_time


def _blocks(text: str) -> Iterator[list[str]]:
    at = 0
    while at < len(text) or not at:
        end = at + _BLOCK
        while end < len(text) and not text[end].isspace():
            end += 1
        yield text[at:end].split()
        at = end


def _apply_channels(skeleton: _Skeleton, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Convert channel values to local rotations (F, J, 3, 3) and translations (F, J, 3) in the file's unit."""
    frames, joints = len(values), len(skeleton.names)
    rotations = np.tile(np.eye(3), (frames, joints, 1, 1))
    translations = np.tile(np.array(skeleton.offsets), (frames, 1, 1))
    column = 0
    for j, channels in enumerate(skeleton.channels):
        for name in channels:
            axis, value = _AXES[name[0]], values[:, column]
            if name.endswith("position"):
                translations[:, j, axis] = value
            else:
                rotations[:, j] = rotations[:, j] @ _about(axis, np.radians(value))
            column += 1
    moved = [j for j, channels in enumerate(skeleton.channels) if j and any("position" in n for n in channels)]
    offsets = np.array(skeleton.offsets)[moved]
    replacing = np.median(np.linalg.norm(translations[:, moved] - offsets, axis=-1), axis=0)
    adding = np.median(np.linalg.norm(translations[:, moved], axis=-1), axis=0)
    if (adding < replacing).sum() > (replacing < adding).sum():
        translations[:, moved] += offsets
    return rotations, translations


def _about(axis: int, angle: np.ndarray) -> np.ndarray:
    """Return rotations (F, 3, 3) about a coordinate axis by angles (F,) in radians."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    R = np.tile(np.eye(3), (len(angle), 1, 1))
    R[:, a, a] = R[:, b, b] = np.cos(angle)
    R[:, b, a] = np.sin(angle)
    R[:, a, b] = -R[:, b, a]
    return R


def _read(path: Path, options: ReadOptions) -> BvhClip:
    scale = METRES_PER_UNIT if options.unit is None else metres_in(options.unit)
    return read_bvh(path, metres_per_unit=scale, up_axis=options.up_axis or "y")


READER = Reader("BVH .bvh", lambda path: path.suffix.lower() == ".bvh", _read, frozenset({"unit", "up_axis"}))


def bvh_skeleton(clip: BvhClip, where: str = "BVH") -> Skeleton:
    """Return the rest skeleton of a clip. End sites become joints."""
    ends = {name: f"{name} end" for name, offset in clip.end_offsets.items() if np.linalg.norm(offset) > 0.0}
    require_distinct((*clip.names, *ends.values()), where)
    places: dict[str, np.ndarray] = {}
    parents: dict[str, str] = {}
    for j, (name, parent) in enumerate(zip(clip.names, clip.parents, strict=True)):
        places[name] = clip.offsets[j] + (places[clip.names[parent]] if parent >= 0 else 0.0)
        if parent >= 0:
            parents[name] = clip.names[parent]
    for name, end in ends.items():
        places[end], parents[end] = places[name] + clip.end_offsets[name], name
    return Skeleton(places, parents)


def bvh_motion(clip: BvhClip, skeleton: Skeleton, name: str) -> SkeletonMotion:
    """Convert a clip to a motion of the skeleton from ``bvh_skeleton``, in the clip's unit and axes."""
    joints, turns = clip.posed()
    ends = [(clip.names.index(end.removesuffix(" end")), end) for end in skeleton.names[len(clip.names) :]]
    if ends:
        bones = [bone for bone, _ in ends]
        offsets = np.array([clip.end_offsets[clip.names[bone]] for bone in bones])
        tips = joints[:, bones] + (turns[:, bones] @ offsets[..., None])[..., 0]
        joints, turns = np.concatenate([joints, tips], axis=1), np.concatenate([turns, turns[:, bones]], axis=1)
    return SkeletonMotion(name, skeleton.names, tuple(skeleton.parents), skeleton.heads, joints, turns, clip.fps)
