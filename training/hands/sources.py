"""Recorded and keyed hands as angles: Godot's named poses, Mesh2Motion's clips, optical markers of finger exercises."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.hand_angles import measure_angles
from solver_backend.exchange.errors import FileMissing
from solver_backend.exchange.npz import read_npz
from solver_backend.geometry.quaternions import matrix_from_quat

_GODOT = ("Thumb", "Index", "Middle", "Ring", "Little")
_GODOT_JOINTS = (("Metacarpal", "Proximal", "Distal", "Tip"), ("Proximal", "Intermediate", "Distal", "Tip"))
"""Of the thumb, and of the other fingers, whose metacarpals are no joints of ours."""
_KEYED = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")
_KEYED_TIP = 0.8
"""Length of a distal bone as a share of the bone before: the clips' skeleton ends at its joint."""
_MARKERS = (
    ("CMC1", "MP1", "IP", "FT1"), ("MP2", "PP2", "DP2", "FT2"), ("MP3", "PP3", "DP3", "FT3"),
    ("MP4", "PP4", "DP4", "FT4"), ("MP5", "PP5", "DP5", "FT5"),
)  # fmt: skip
_MARKER_STRIDE = 15
"""Every tenth of a second of the 150 Hz recordings."""
_RIGHT = 1


@dataclass(frozen=True)
class HandPoses:
    """Angles of hands from one source."""

    name: str
    """Of the source."""
    licence: str
    """And who is to be named."""
    angles: np.ndarray
    """(n, A) radians."""


def load_sources(folder: Path | str) -> tuple[HandPoses, ...]:
    """Return the poses of all sources in the data's folder of hands.

    Raises:
        FileMissing: one is not there.
    """
    folder = Path(folder)
    return (_godot(folder), _keyed(folder), _markers(folder))


def _godot(folder: Path) -> HandPoses:
    """Return the named poses of one hand: the other is its mirror image."""
    arrays = read_npz(folder / "godot_xr_hand_poses.npz")
    names, parents = [str(n) for n in arrays["bones"]], arrays["parents"].astype(int)
    G, place = [], []
    local, offsets = _matrices(arrays["pose_xyzw"][0]), arrays["offsets"][0]
    for b, p in enumerate(parents):
        G.append(local[:, b] if p < 0 else G[p] @ local[:, b])
        place.append(np.broadcast_to(offsets[b], (len(local), 3)) if p < 0 else place[p] + G[p] @ offsets[b])
    columns = [names.index("Wrist")]
    for f, finger in enumerate(_GODOT):
        columns += [names.index(f"{finger}_{joint}") for joint in _GODOT_JOINTS[min(f, 1)]]
    points = np.stack([place[c] for c in columns], axis=1)
    return HandPoses("godot-xr-tools", "CC0 1.0", measure_angles(points, 0))


def _keyed(folder: Path) -> HandPoses:
    """Return the distinct poses of both hands of Mesh2Motion's clips."""
    arrays = read_npz(folder / "mesh2motion_fingers.npz")
    names = [str(n) for n in arrays["joints"]]
    turns = np.concatenate([arrays["rotation_xyzw"], arrays["still_xyzw"]])
    found = []
    for side, letter in enumerate("LR"):
        columns = np.array([[names.index(f"DEF-{f}.0{k}.{letter}") for k in (1, 2, 3)] for f in _KEYED])
        local, offsets = _matrices(turns[:, columns]), arrays["offsets"][columns]
        points = [np.zeros((len(turns), 1, 3))]
        for f in range(5):
            G, place = local[:, f, 0], np.broadcast_to(offsets[f, 0], (len(turns), 3))
            chain = [place]
            for k in (1, 2):
                place = place + G @ offsets[f, k]
                G = G @ local[:, f, k]
                chain.append(place)
            points.append(np.stack([*chain, place + _KEYED_TIP * (G @ offsets[f, 2])], axis=1))
        found.append(measure_angles(np.concatenate(points, axis=1), side))
    return HandPoses("Mesh2Motion", "CC0 1.0", _distinct(np.concatenate(found)))


def _markers(folder: Path) -> HandPoses:
    """Return the frames of the finger exercises in which the whole hand is seen."""
    found = []
    for path in sorted((folder / "leap").glob("*.npz")):
        points = marker_points(read_npz(path))[::_MARKER_STRIDE]
        found.append(measure_angles(points[np.isfinite(points).all((1, 2))], _RIGHT))
    if not found:
        raise FileMissing("The recordings of finger exercises are missing.", where=str(folder / "leap"))
    licence = "CC BY 4.0: Ganguly, Rashidi and Mombaur 2021, Sensors 21, 1750"
    return HandPoses("Leap and motion capture", licence, np.concatenate(found))


def marker_points(arrays: dict[str, Any]) -> np.ndarray:
    """Return (F, 21, 3) metres of ``HAND_POINTS`` as markers on the back of a hand have them; NaN where missing."""
    labels, recorded = [str(n) for n in arrays["labels"]], arrays["positions_01mm"].astype(np.float64)
    recorded = np.where(recorded == np.iinfo(np.int16).min, np.nan, recorded) * 1e-4
    wrist = 0.5 * (recorded[:, labels.index("RS")] + recorded[:, labels.index("US")])
    columns = [labels.index(name) for finger in _MARKERS for name in finger]
    return np.concatenate([wrist[:, None], recorded[:, columns]], axis=1)


def _distinct(angles: np.ndarray) -> np.ndarray:
    """Return the rows that differ by a degree from each other."""
    return angles[np.unique(np.round(np.rad2deg(angles)), axis=0, return_index=True)[1]]


def _matrices(xyzw: np.ndarray) -> np.ndarray:
    return matrix_from_quat(np.roll(xyzw.astype(np.float64), 1, axis=-1))
