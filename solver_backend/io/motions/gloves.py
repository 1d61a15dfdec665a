"""Hands of any supported recording: tables of MANUS and Rokoko, BVH and skeleton files with fingers."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.body.hand_angles import ANGLES, KNUCKLES, NUM_ANGLES
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, hands_of_skeleton
from solver_backend.exchange.errors import FileDamaged, MotionInvalid
from solver_backend.exchange.hand_points import FINGERS, NUM_HAND_POINTS, SIDES
from solver_backend.exchange.rigs.names import side_of_name
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.rigs.structure import recognise
from solver_backend.exchange.skeleton_file import read_skeleton
from solver_backend.io.files import LONGEST_HEADING, read_text
from solver_backend.io.motions.bvh import bvh_motion, bvh_skeleton, read_bvh
from solver_backend.io.text_table import cells_of, decimal_comma, number_table
from solver_backend.types import SkeletonMotion
from solver_backend.types.motion import GloveTake
from solver_backend.types.shapes import Float

_LARGEST = 512_000_000
"""Bytes of a table."""
_LEAST_FRAMES = 2
"""Without two no frame rate is known."""


def headings(path: Path) -> tuple[list[str], str]:
    """Return the headings of a table and what separates its cells.

    Raises:
        FileMissing, FileDamaged: see ``read_text``.
    """
    line = read_text(path, _LARGEST).lstrip("\ufeff").partition("\n")[0]
    delimiter = max(",;\t", key=line.count)
    return [cell[:LONGEST_HEADING] for cell in cells_of(line.rstrip("\r"), delimiter)], delimiter


def read_columns(path: Path, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Return (F,) numbers by heading of the columns that are wanted, NaN where cells are blank.

    Raises:
        FileMissing, FileDamaged: the file is not there, has no frames, or a cell is no number.
    """
    names, delimiter = headings(path)
    kept = [(k, name) for k, name in enumerate(names) if wanted(name)]
    lines = read_text(path, _LARGEST).splitlines()[1:]
    try:
        rows = [row for row in csv.reader(lines, delimiter=delimiter) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise FileDamaged(f"The table cannot be read: {error}.", where=str(path)) from error
    if len(rows) < _LEAST_FRAMES:
        raise FileDamaged(f"The table has {len(rows)} frames; {_LEAST_FRAMES} are the least.", where=str(path))
    chosen = [[row[k] if k < len(row) else "" for k, _ in kept] for row in rows]
    comma = delimiter != "," and decimal_comma(cell for row in chosen[:100] for cell in row)
    values = number_table(chosen, 2, path, comma=comma)
    values = np.pad(values, ((0, 0), (0, max(0, len(kept) - values.shape[1]))), constant_values=np.nan)
    return {name: values[:, column] for column, (_, name) in enumerate(kept)}


def rising_times(times: np.ndarray, path: Path) -> np.ndarray:
    """Return (F,) seconds from the first frame of a column in milliseconds.

    Raises:
        MotionInvalid: they do not rise.
    """
    seconds = (times - times[0]) / 1000.0
    if not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
        raise MotionInvalid("The times of the frames do not rise.", where=str(path), hint="Export the table again.")
    return seconds


_BENDS = np.array([name.endswith(("pip_flexion", "dip_flexion")) and not name.startswith("thumb") for name in ANGLES])
"""Joints that bend one way only."""
_MIRROR = np.array([-1.0, 1.0, 1.0])
_LEAST_PALM = 1e-6
"""Of any unit: the wrist's distance from the knuckles."""


def angles_of_points(
    points: Float[np.ndarray, "frames 21 3"], side: int, where: str
) -> tuple[Float[np.ndarray, "frames a"], Float[np.ndarray, "frames 3 3"]]:
    """Return angles (F, A), radians, and rotations of the palm (F, 3, 3) of a hand's points in any axes.

    Mirrored points bend fingers towards the back of the hand, which people cannot: they are mirrored again.

    Args:
        points: (F, 21, 3) of ``HAND_POINTS`` in any unit; NaN where missing.
        side: 0 left, 1 right.
        where: for the error.

    Raises:
        MotionInvalid: the points of the palm are one, or missing.
    """
    palm = np.linalg.norm(points[:, KNUCKLES[1:]] - points[:, :1], axis=-1)
    if not (palm[:, [0, 1, -1]] > _LEAST_PALM).all(axis=1).any():
        raise MotionInvalid("The points of the palm are missing.", where=where, hint="Export positions of all joints.")
    angles, palms = finger_angles(points, side)
    if np.nansum(angles[:, _BENDS]) < 0:
        angles, palms = finger_angles(_MIRROR * points, side)
    return angles, palms


_MANUS_TIME = "Elapsed_Time_In_Milliseconds"
_HAND = "Hand"
_AXES = ("X", "Y", "Z")
_MANUS_JOINTS = dict.fromkeys(FINGERS, ("MCP", "PIP", "DIP", "TIP")) | {"thumb": ("CMC", "MCP", "DIP", "TIP")}
"""The file's joints at the points of each finger; its thumb's DIP is what others call IP."""
_POINTS = (_HAND, *(f"{finger.title()}_{joint}" for finger in FINGERS for joint in _MANUS_JOINTS[finger]))
_MANUS_FLEXIONS = {"thumb_mcp_flexion": "Thumb_PIP_Flex", "thumb_ip_flexion": "Thumb_DIP_Flex"} | {
    f"{finger}_{joint}_flexion": f"{finger.title()}_{joint.upper()}_Flex"
    for finger in FINGERS[1:]
    for joint in ("mcp", "pip", "dip")
}
"""Angles of ergonomics that mean what ours do, degrees. Spreads and the thumb's root have other zeros."""


def is_manus_csv(path: Path) -> bool:
    """Return whether a file is a table of MANUS's."""
    names = headings(path)[0] if path.suffix.lower() == ".csv" else []
    return _MANUS_TIME in names and (
        set(_columns_of_points()) <= set(names) or set(_MANUS_FLEXIONS.values()) <= set(names)
    )


def read_manus_csv(path: Path, side: str = "") -> GloveTake:
    """Read a hand; positions are taken where the table has them.

    Args:
        side: ``left`` or ``right``; "" takes it from the file's name.

    Raises:
        FileMissing, FileDamaged: see ``read_columns``.
        MotionInvalid: the side is not known, times do not rise, or points are no hand's.
    """
    side = side or side_of_name(path.stem)
    if not side:
        raise MotionInvalid("Which hand this is does not show.", where=str(path), hint="Name it with --side.")
    points = set(_columns_of_points())
    wanted = {_MANUS_TIME, *points, *_MANUS_FLEXIONS.values()}
    columns = read_columns(path, wanted.__contains__)
    times, number = rising_times(columns[_MANUS_TIME], path), SIDES.index(side)
    angles, palms = np.full((len(times), 2, NUM_ANGLES), np.nan), np.full((len(times), 2, 3, 3), np.nan)
    if points <= columns.keys():
        xyz = np.stack([columns[name] for name in _columns_of_points()], axis=1).reshape(-1, NUM_HAND_POINTS, 3)
        angles[:, number], palms[:, number] = angles_of_points(xyz, number, str(path))
    else:
        for angle, name in _MANUS_FLEXIONS.items():
            angles[:, number, ANGLES.index(angle)] = np.deg2rad(columns[name])
    return GloveTake(path.stem, times, angles, palms)


def _columns_of_points() -> list[str]:
    return [f"{point}_{axis}" for point in _POINTS for axis in _AXES]


_ROKOKO_TIME = "Timestamp"
"""Milliseconds."""
_ROKOKO_JOINTS = {"mcp": "Metacarpophalangeal", "pip": "ProximalInterphalangeal", "dip": "DistalInterphalangeal"}
_ROKOKO_FLEXIONS = {
    f"{finger}_{joint}_flexion": f"Digit{n}{name}"
    for n, finger in enumerate(FINGERS[1:], 2)
    for joint, name in _ROKOKO_JOINTS.items()
} | {"thumb_mcp_flexion": "Digit1Metacarpophalangeal", "thumb_ip_flexion": "Digit1Interphalangeal"}
"""The file's joint by angle of ours; those of spread and of the thumb's root have other zeros."""
_SEGMENTS = ("ProximalPhalan", "IntermediatePhalan", "DistalPhalan")
_OF_THUMB = ("MetaCarpal", "ProximalPhalan", "DistalPhalan")
"""Segments begin at the joint nearer to the body; versions end the words otherwise, such as Phalangx."""
_COLUMN = re.compile(r"(Left|Right)(Hand|Digit[1-5]\w{0,40}?)_(position_[xyz]|flexion)", re.IGNORECASE)


def is_rokoko_csv(path: Path) -> bool:
    """Return whether a file is a table of Rokoko's with fingers."""
    names = headings(path)[0] if path.suffix.lower() == ".csv" else []
    return _ROKOKO_TIME in names and any("Digit2" in name and _COLUMN.fullmatch(name) for name in names)


def read_rokoko_csv(path: Path) -> GloveTake:
    """Read both hands: angles by the positions of the joints, where the table has them, else as the table states them.

    Raises:
        FileMissing, FileDamaged: see ``read_columns``.
        MotionInvalid: times do not rise, or points are no hand's.
    """
    columns = read_columns(path, lambda name: name == _ROKOKO_TIME or _COLUMN.fullmatch(name) is not None)
    times = rising_times(columns.pop(_ROKOKO_TIME), path)
    lower = {name.lower(): value for name, value in columns.items()}
    angles, palms = np.full((len(times), 2, NUM_ANGLES), np.nan), np.full((len(times), 2, 3, 3), np.nan)
    for number, side in enumerate(SIDES):
        if (points := _points(lower, side, len(times))) is not None:
            angles[:, number], palms[:, number] = angles_of_points(points, number, str(path))
        for angle, joint in _ROKOKO_FLEXIONS.items():
            stated, column = lower.get(f"{side}{joint}_flexion".lower()), ANGLES.index(angle)
            if stated is not None:
                known = np.isfinite(angles[:, number, column])
                angles[:, number, column] = np.where(known, angles[:, number, column], np.deg2rad(stated))
    return GloveTake(path.stem, times, angles, palms)


def _points(columns: dict[str, np.ndarray], side: str, frames: int) -> np.ndarray | None:
    """Return (F, 21, 3) metres of a hand, its tips NaN, in right-handed axes; None where the table lacks them."""
    points = np.full((frames, NUM_HAND_POINTS, 3), np.nan)
    for number in range(len(FINGERS)):
        for k, segment in enumerate(_SEGMENTS if number else _OF_THUMB):
            start = f"{side}digit{number + 1}{segment}".lower()
            found = [name for name in columns if name.startswith(start) and name.endswith("_position_x")]
            if len(found) != 1:
                return None
            points[:, 1 + 4 * number + k] = _place(columns, found[0].removesuffix("_position_x"))
    if f"{side}hand_position_x" not in columns:
        return None
    points[:, 0] = _place(columns, f"{side}hand")
    return points


def _place(columns: dict[str, np.ndarray], segment: str) -> np.ndarray:
    """Return (F, 3) a segment's place; x is turned about, so that the axes are right-handed."""
    nothing = np.full(len(next(iter(columns.values()))), np.nan)
    x, y, z = (columns.get(f"{segment}_position_{axis}", nothing) for axis in "xyz")
    return np.stack([-x, y, z], axis=-1)


_THROUGH_BLENDER = (".fbx", ".glb", ".gltf", ".vrm", ".blend")


def read_gloves(path: Path, side: str = "") -> GloveTake:
    """Read the hands of a recording, of a whole person or of hands alone.

    Args:
        path: CSV of MANUS or Rokoko, BVH, or a skeleton file from Blender.
        side: ``left`` or ``right`` of a single hand whose names do not show it.

    Raises:
        FileMissing, FileDamaged, NonFiniteData: the file is not there, or is none of its kind.
        MotionInvalid: it holds no fingers, or which side they are of does not show.
    """
    suffix, where = path.suffix.lower(), str(path)
    if suffix == ".csv":
        if is_manus_csv(path):
            return read_manus_csv(path, side)
        if is_rokoko_csv(path):
            return read_rokoko_csv(path)
        hint = "Tables of MANUS (joint positions or ergonomics) and Rokoko Studio are read; or export BVH or FBX."
        raise MotionInvalid("The table is not one of known gloves.", where=where, hint=hint)
    if suffix == ".bvh":
        clip = read_bvh(path, metres_per_unit=1.0)
        return gloves_of_skeleton(bvh_motion(clip, bvh_skeleton(clip, where), 1.0, path.stem), side, where)
    if suffix == ".npz":
        return gloves_of_skeleton(read_skeleton(path), side, where)
    if suffix in _THROUGH_BLENDER:
        hint = f"python -m blender_addon add-hands MOTION.npz {path.name} reads it with Blender's importer."
        raise MotionInvalid(f"{suffix[1:].upper()} is read through Blender.", where=where, hint=hint)
    hint = "CSV, BVH and FBX are read."
    raise MotionInvalid(f"Not supported: {suffix or 'files without an ending'}.", where=where, hint=hint)


def gloves_of_skeleton(motion: SkeletonMotion, side: str, where: str) -> GloveTake:
    """Return the hands of a moving skeleton.

    Args:
        motion: of a person or of hands, in any unit.
        side: ``left`` or ``right`` of a single hand whose names do not show it.
        where: for the error.

    Raises:
        MotionInvalid: no hand has four fingers of three bones, or its side is not known.
    """
    parents = {n: motion.names[p] for n, p in zip(motion.names, motion.parents, strict=True) if p >= 0}
    roles = recognise(Skeleton(dict(zip(motion.names, motion.rest, strict=True)), parents)).roles
    angles = np.full((motion.num_frames, 2, NUM_ANGLES), np.nan)
    palms = np.full((motion.num_frames, 2, 3, 3), np.nan)
    for named in (roles, hands_of_skeleton(motion, side)):
        for number in range(len(SIDES)):
            if np.isfinite(angles[:, number]).any():
                continue
            if (points := finger_points(motion, named, number)) is not None:
                angles[:, number], palms[:, number] = finger_angles(points, number)
    if not np.isfinite(angles).any():
        hint = "Thumb, index, middle and little finger of three bones each are needed; --side names a single hand."
        raise MotionInvalid("The skeleton has no hand whose fingers and side are known.", where=where, hint=hint)
    return GloveTake(motion.name, np.arange(motion.num_frames) / motion.fps, angles, palms)
