"""Joints of recorded skeletons for CMU's markers, in the frames of a subsampled take."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from tests.support.cmu_marker_take import read_take
from tests.support.recordings import recordings_folder

_TO_WALK = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of the walk's skeleton, which has its axes rotated by 90 degrees about the vertical."""
_TO_FIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation of the fight's skeleton, which has Y up: (X, Y, Z) are the markers' (y, z, x)."""
_FIGHT_EVERY = 4  # The fight's skeleton has every fourth frame of the markers.
_BONES = {
    "hip": "femur", "knee": "tibia", "ankle": "foot", "shoulder": "humerus", "elbow": "radius", "wrist": "hand",
}  # fmt: skip


def walk_joints(step: int) -> dict[str, np.ndarray]:
    """Return (F, 3) joint positions in metres of CMU 02_01 for every ``step``-th frame."""
    return {name: (places @ _TO_WALK)[::step] for name, places in read_take(recordings_folder()).joints.items()}


def fight_joints(first: int, step: int) -> dict[str, np.ndarray]:
    """Return (F, 3) joint positions in metres of CMU 135_02 from a marker frame on. ``step`` must be 4n."""
    with np.load(recordings_folder() / "motion_cmu" / "asfamc" / "135_02.npz") as data:
        names, parents, offsets = [str(name) for name in data["names"]], data["parents"], data["offsets"]
        turns = data["rotvec"].astype(np.float64)
        turns[:, 0] = data["root_rotvec"]
        chosen = slice(1 + first // _FIGHT_EVERY, None, step // _FIGHT_EVERY)  # the first is the T-pose
        turns, root = exp_so3(turns[chosen]), data["root"][chosen].astype(np.float64)
    G, places = [turns[:, 0]], [root]
    for j in range(1, len(names)):
        parent = int(parents[j])
        G.append(G[parent] @ turns[:, j])
        places.append(places[parent] + G[parent] @ offsets[j])
    return {
        f"{side}_{joint}": places[names.index(side[0] + bone)] @ _TO_FIGHT.T
        for joint, bone in _BONES.items()
        for side in ("left", "right")
    }
