"""Read hand motions from MANUS and Rokoko tables, and from BVH and skeleton files with fingers."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.body.hand_skeleton import ANGLES, KNUCKLES, NUM_ANGLES
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, hands_of_skeleton
from solver_backend.exchange.errors import FileDamaged, MotionInvalid
from solver_backend.exchange.joint_sets import FINGERS, NUM_HAND_POINTS, SIDES
from solver_backend.exchange.outputs import require_file
from solver_backend.exchange.rigs.names import side_of_name
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.rigs.structure import recognise
from solver_backend.io.files import LONGEST_HEADING
from solver_backend.io.motions.foreign_skeleton import read_stated
from solver_backend.io.text_table import heading_of, read_numbers, read_rows
from solver_backend.types import SkeletonMotion
from solver_backend.types.motion import GloveTake

_LARGEST = 512_000_000  # Size limit of a table in bytes.
_LEAST_FRAMES = 2  # Smallest number of frames that determines a frame rate.
_LEAST_PALM = 1e-6  # Smallest distance from the wrist to the knuckles, in any unit.
_BENDS = np.array([name.endswith(("pip_flexion", "dip_flexion")) and not name.startswith("thumb") for name in ANGLES])
"""Mask of the joint angles that never change sign."""
_MIRROR = np.array([-1.0, 1.0, 1.0])


def _read_columns(path: Path, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Read the columns (F,) with the wanted headings as numbers. Empty cells are NaN."""
    names, rows = read_rows(path, _LARGEST)
    kept = {name: k for k, name in enumerate(name[:LONGEST_HEADING] for name in names) if wanted(name)}
    chosen = [[row[k] if k < len(row) else "" for k in kept.values()] for row in rows if any(map(str.strip, row))]
    if len(chosen) < _LEAST_FRAMES:
        raise FileDamaged(f"The table has {len(chosen)} frames, but needs {_LEAST_FRAMES}.", where=str(path))
    values = read_numbers(chosen, 2, path)
    values = np.pad(values, ((0, 0), (0, len(kept) - values.shape[1])), constant_values=np.nan)
    return dict(zip(kept, values.T, strict=True))


def _rising_times(times: np.ndarray, path: Path) -> np.ndarray:
    """Convert a column of milliseconds to (F,) seconds since the first frame."""
    seconds = (times - times[0]) / 1000.0
    if not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
        raise MotionInvalid("The frame times do not increase.", where=str(path), hint="Export the table again.")
    return seconds


def _no_angles(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return NaN for the joint angles (F, 2, A) and the palm rotations (F, 2, 3, 3) of both hands."""
    return np.full((frames, 2, NUM_ANGLES), np.nan), np.full((frames, 2, 3, 3), np.nan)


def _angles_of_points(points: np.ndarray, side: int, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Compute joint angles (F, A) and palm rotations (F, 3, 3) from hand points (F, 21, 3).

    If the fingers bend backwards, the points are a mirror image and are mirrored first.
    """
    palm = np.linalg.norm(points[:, KNUCKLES[1:]] - points[:, :1], axis=-1)
    if not (palm[:, [0, 1, -1]] > _LEAST_PALM).all(axis=1).any():
        raise MotionInvalid("The palm points are missing.", where=where, hint="Export positions of all joints.")
    angles, palms = finger_angles(points, side)
    if np.nansum(angles[:, _BENDS]) < 0:
        angles, palms = finger_angles(_MIRROR * points, side)
    return angles, palms


_MANUS_TIME = "Elapsed_Time_In_Milliseconds"
_MANUS_JOINTS = dict.fromkeys(FINGERS, ("MCP", "PIP", "DIP", "TIP")) | {"thumb": ("CMC", "MCP", "DIP", "TIP")}
"""MANUS's names of the joints of each finger. The thumb's DIP in the file is the anatomical IP joint."""
_MANUS_POINTS = tuple(
    f"{point}_{axis}"
    for point in ("Hand", *(f"{finger.title()}_{joint}" for finger in FINGERS for joint in _MANUS_JOINTS[finger]))
    for axis in "XYZ"
)
_MANUS_FLEXIONS = {"thumb_mcp_flexion": "Thumb_PIP_Flex", "thumb_ip_flexion": "Thumb_DIP_Flex"} | {
    f"{finger}_{joint}_flexion": f"{finger.title()}_{joint.upper()}_Flex"
    for finger in FINGERS[1:]
    for joint in ("mcp", "pip", "dip")
}
"""MANUS ergonomics angles (degrees) with the same definition as ours. Spreads and thumb base have other zero poses."""


def _read_manus(path: Path, side: str) -> GloveTake:
    """Read a hand from a MANUS table. Joint positions are used if the table has them, otherwise flexion angles."""
    side = side or side_of_name(path.stem)
    if not side:
        raise MotionInvalid("The side of the hand is unknown.", where=str(path), hint="Specify the side with --side.")
    columns = _read_columns(path, {_MANUS_TIME, *_MANUS_POINTS, *_MANUS_FLEXIONS.values()}.__contains__)
    times, number = _rising_times(columns[_MANUS_TIME], path), SIDES.index(side)
    angles, palms = _no_angles(len(times))
    if set(_MANUS_POINTS) <= columns.keys():
        xyz = np.stack([columns[name] for name in _MANUS_POINTS], axis=1).reshape(-1, NUM_HAND_POINTS, 3)
        angles[:, number], palms[:, number] = _angles_of_points(xyz, number, str(path))
    else:
        for angle, name in _MANUS_FLEXIONS.items():
            angles[:, number, ANGLES.index(angle)] = np.deg2rad(columns[name])
    return GloveTake(path.stem, times, angles, palms)


_ROKOKO_TIME = "Timestamp"  # Heading of the time stamp column, in milliseconds.
_ROKOKO_JOINTS = {"mcp": "Metacarpophalangeal", "pip": "ProximalInterphalangeal", "dip": "DistalInterphalangeal"}
_ROKOKO_FLEXIONS = {
    f"{finger}_{joint}_flexion": f"Digit{n}{name}"
    for n, finger in enumerate(FINGERS[1:], 2)
    for joint, name in _ROKOKO_JOINTS.items()
} | {"thumb_mcp_flexion": "Digit1Metacarpophalangeal", "thumb_ip_flexion": "Digit1Interphalangeal"}
"""Rokoko's joint for each of our angles. Spreads and the thumb base have other zero poses."""
_SEGMENTS = ("ProximalPhalan", "IntermediatePhalan", "DistalPhalan")
_OF_THUMB = ("MetaCarpal", "ProximalPhalan", "DistalPhalan")
"""Segments, each starting at its proximal joint. Word endings vary between versions, such as Phalangx."""
_COLUMN = re.compile(r"(Left|Right)(Hand|Digit[1-5]\w{0,40}?)_(position_[xyz]|flexion)", re.IGNORECASE)


def _read_rokoko(path: Path) -> GloveTake:
    """Read both hands from a Rokoko table. Flexion angles are only used where joint positions are missing."""
    columns = _read_columns(path, lambda name: name == _ROKOKO_TIME or _COLUMN.fullmatch(name) is not None)
    times = _rising_times(columns.pop(_ROKOKO_TIME), path)
    lower = {name.lower(): value for name, value in columns.items()}
    angles, palms = _no_angles(len(times))
    for number, side in enumerate(SIDES):
        if (points := _rokoko_points(lower, side, len(times))) is not None:
            angles[:, number], palms[:, number] = _angles_of_points(points, number, str(path))
        for angle, joint in _ROKOKO_FLEXIONS.items():
            stated, column = lower.get(f"{side}{joint}_flexion".lower()), ANGLES.index(angle)
            if stated is not None:
                known = np.isfinite(angles[:, number, column])
                angles[:, number, column] = np.where(known, angles[:, number, column], np.deg2rad(stated))
    return GloveTake(path.stem, times, angles, palms)


def _rokoko_points(columns: dict[str, np.ndarray], side: str, frames: int) -> np.ndarray | None:
    """Return hand points (F, 21, 3) in metres, or None if the table contains no positions. Fingertips are NaN."""
    ending = "_position_x"
    segments = {0: f"{side}hand"} if f"{side}hand{ending}" in columns else {}
    for number in range(len(FINGERS)):
        for k, segment in enumerate(_SEGMENTS if number else _OF_THUMB):
            start = f"{side}digit{number + 1}{segment}".lower()
            found = [name for name in columns if name.startswith(start) and name.endswith(ending)]
            if len(found) != 1:
                return None
            segments[1 + 4 * number + k] = found[0].removesuffix(ending)
    if 0 not in segments:
        return None
    points = np.full((frames, NUM_HAND_POINTS, 3), np.nan)
    for point, segment in segments.items():
        for axis, name in enumerate("xyz"):
            points[:, point, axis] = columns.get(f"{segment}_position_{name}", np.nan)
    return points * _MIRROR


def read_gloves(path: Path, side: str = "") -> GloveTake:
    """Read finger motion from a MANUS or Rokoko CSV, or from a moving skeleton (see ``read_stated``).

    ``side`` is ``left`` or ``right`` for a single hand if the file does not state its side.

    Raises:
        FileMissing, FileDamaged, NonFiniteData: the file is missing or damaged.
        MotionInvalid: the file has no fingers, or their side is unknown.
    """
    where = str(path)
    if path.suffix.lower() != ".csv":
        return _gloves_of_skeleton(read_stated(path, "hands add MOTION.npz")[0], side, where)
    names = heading_of(require_file(path))
    if _MANUS_TIME in names and any(set(known) <= set(names) for known in (_MANUS_POINTS, _MANUS_FLEXIONS.values())):
        return _read_manus(path, side)
    names = [name[:LONGEST_HEADING] for name in names]
    if _ROKOKO_TIME in names and any("Digit2" in name and _COLUMN.fullmatch(name) for name in names):
        return _read_rokoko(path)
    hint = (
        "Tables from MANUS (joint positions or ergonomics) and Rokoko Studio can be read. Otherwise, export BVH or FBX."
    )
    raise MotionInvalid("The table does not come from supported gloves.", where=where, hint=hint)


def _gloves_of_skeleton(motion: SkeletonMotion, side: str, where: str) -> GloveTake:
    """Compute finger angles from a moving skeleton, which may consist of hands only. The unit does not matter."""
    parents = {n: motion.names[p] for n, p in zip(motion.names, motion.parents, strict=True) if p >= 0}
    roles = recognise(Skeleton(dict(zip(motion.names, motion.rest, strict=True)), parents)).roles
    angles, palms = _no_angles(motion.num_frames)
    for named in (roles, hands_of_skeleton(motion, side)):
        for number in range(len(SIDES)):
            points = None if np.isfinite(angles[:, number]).any() else finger_points(motion, named, number)
            if points is not None:
                angles[:, number], palms[:, number] = finger_angles(points, number)
    if not np.isfinite(angles).any():
        hint = "Thumb, index, middle and little finger need three bones each. For a single hand, specify --side."
        raise MotionInvalid("The skeleton has no hand with known fingers and a known side.", where=where, hint=hint)
    return GloveTake(motion.name, np.arange(motion.num_frames) / motion.fps, angles, palms)
