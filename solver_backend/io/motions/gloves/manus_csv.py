"""MANUS gloves' CSV: a hand a file, joints' positions or ergonomics' angles (docs.manus-meta.com, "Exporting CSV")."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.body.hand_angles import ANGLES, NUM_ANGLES
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.hand_points import FINGERS, NUM_HAND_POINTS, SIDES
from solver_backend.exchange.rigs.names import side_of_name
from solver_backend.io.motions.gloves.angles_of_points import angles_of_points
from solver_backend.io.motions.gloves.columns import headings, read_columns, rising_times
from solver_backend.types.glove_take import GloveTake

_TIME = "Elapsed_Time_In_Milliseconds"
_HAND = "Hand"
_AXES = ("X", "Y", "Z")
_JOINTS = {
    "thumb": ("CMC", "MCP", "DIP", "TIP"), **dict.fromkeys(FINGERS[1:], ("MCP", "PIP", "DIP", "TIP")),
}  # fmt: skip
"""The file's joints at the points of each finger; its thumb's DIP is what others call IP."""
_POINTS = (_HAND, *(f"{finger.title()}_{joint}" for finger in FINGERS for joint in _JOINTS[finger]))
_FLEXIONS = {
    "thumb_mcp_flexion": "Thumb_PIP_Flex", "thumb_ip_flexion": "Thumb_DIP_Flex",
    **{f"{finger}_{joint}_flexion": f"{finger.title()}_{joint.upper()}_Flex"
       for finger in FINGERS[1:] for joint in ("mcp", "pip", "dip")},
}  # fmt: skip
"""Angles of ergonomics that mean what ours do, degrees. Spreads and the thumb's root have other zeros."""


def is_manus_csv(path: Path) -> bool:
    """Return whether a file is a table of MANUS's."""
    names = headings(path)[0] if path.suffix.lower() == ".csv" else []
    return _TIME in names and (set(_columns_of_points()) <= set(names) or set(_FLEXIONS.values()) <= set(names))


def read_manus_csv(path: Path, side: str = "") -> GloveTake:
    """Read a hand; positions are taken where the table has them.

    Args:
        path: the file.
        side: ``left`` or ``right``; "" takes it from the file's name.

    Raises:
        FileMissing, FileDamaged: see ``read_columns``.
        MotionInvalid: the side is not known, times do not rise, or points are no hand's.
    """
    side = side or side_of_name(path.stem)
    if not side:
        raise MotionInvalid("Which hand this is does not show.", where=str(path), hint="Name it with --side.")
    points = set(_columns_of_points())
    wanted = {_TIME, *points, *_FLEXIONS.values()}
    columns = read_columns(path, wanted.__contains__)
    times, number = rising_times(columns[_TIME], path), SIDES.index(side)
    angles, palms = np.full((len(times), 2, NUM_ANGLES), np.nan), np.full((len(times), 2, 3, 3), np.nan)
    if points <= columns.keys():
        xyz = np.stack([columns[name] for name in _columns_of_points()], axis=1).reshape(-1, NUM_HAND_POINTS, 3)
        angles[:, number], palms[:, number] = angles_of_points(xyz, number, str(path))
    else:
        for angle, name in _FLEXIONS.items():
            angles[:, number, ANGLES.index(angle)] = np.deg2rad(columns[name])
    return GloveTake(path.stem, times, angles, palms)


def _columns_of_points() -> list[str]:
    return [f"{point}_{axis}" for point in _POINTS for axis in _AXES]
