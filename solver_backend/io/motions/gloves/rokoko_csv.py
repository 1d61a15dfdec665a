"""Rokoko Studio's CSV: segments' positions in Unity's left-handed axes, and joints' angles in degrees."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from solver_backend.body.hand_angles import ANGLES, NUM_ANGLES
from solver_backend.exchange.hand_points import FINGERS, NUM_HAND_POINTS, SIDES
from solver_backend.io.motions.gloves.angles_of_points import angles_of_points
from solver_backend.io.motions.gloves.columns import headings, read_columns, rising_times
from solver_backend.types.glove_take import GloveTake

_TIME = "Timestamp"
"""Milliseconds."""
_JOINTS = {"mcp": "Metacarpophalangeal", "pip": "ProximalInterphalangeal", "dip": "DistalInterphalangeal"}
_FLEXIONS = {
    "thumb_mcp_flexion": "Digit1Metacarpophalangeal", "thumb_ip_flexion": "Digit1Interphalangeal",
    **{f"{finger}_{joint}_flexion": f"Digit{n + 1}{name}" for n, finger in enumerate(FINGERS) if n
       for joint, name in _JOINTS.items()},
}  # fmt: skip
"""The file's joint by angle of ours; those of spread and of the thumb's root have other zeros."""
_SEGMENTS = ("ProximalPhalan", "IntermediatePhalan", "DistalPhalan")
_OF_THUMB = ("MetaCarpal", "ProximalPhalan", "DistalPhalan")
"""Segments begin at the joint nearer to the body; versions end the words otherwise, such as Phalangx."""
_COLUMN = re.compile(r"(Left|Right)(Hand|Digit[1-5]\w{0,40}?)_(position_[xyz]|flexion)", re.IGNORECASE)


def is_rokoko_csv(path: Path) -> bool:
    """Return whether a file is a table of Rokoko's with fingers."""
    names = headings(path)[0] if path.suffix.lower() == ".csv" else []
    return _TIME in names and any("Digit2" in name and _COLUMN.fullmatch(name) for name in names)


def read_rokoko_csv(path: Path) -> GloveTake:
    """Read both hands: angles by the positions of the joints, where the table has them, else as the table states them.

    Raises:
        FileMissing, FileDamaged: see ``read_columns``.
        MotionInvalid: times do not rise, or points are no hand's.
    """
    columns = read_columns(path, lambda name: name == _TIME or _COLUMN.fullmatch(name) is not None)
    times = rising_times(columns.pop(_TIME), path)
    lower = {name.lower(): value for name, value in columns.items()}
    angles, palms = np.full((len(times), 2, NUM_ANGLES), np.nan), np.full((len(times), 2, 3, 3), np.nan)
    for number, side in enumerate(SIDES):
        if (points := _points(lower, side, len(times))) is not None:
            angles[:, number], palms[:, number] = angles_of_points(points, number, str(path))
        for angle, joint in _FLEXIONS.items():
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
