"""How far a resting joint may be from where people have it: what full recordings show, given what is seen."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.geometry.symmetric import packed, unpacked

ANCHORS = {
    "trunk": "pelvis", "head": "spine3", "left_upper_arm": "spine3", "right_upper_arm": "spine3",
    "left_thigh": "pelvis", "right_thigh": "pelvis", "left_forearm": "left_shoulder",
    "right_forearm": "right_shoulder", "left_shank": "left_hip", "right_shank": "right_hip",
}  # fmt: skip
"""The last joint above each part whose place and bone are known; in the order in which parts hang on one another,
read backwards."""
SPREAD_MM: dict[str, dict[str, tuple[float, float, float]]] = {
    "pelvis": {
        "spine2": (10, 5, 26), "spine3": (16, 11, 41), "neck": (43, 23, 82), "head": (49, 47, 98),
        "collar": (32, 22, 69), "shoulder": (27, 44, 73), "elbow": (97, 162, 221), "wrist": (146, 403, 251),
        "hand": (177, 492, 266), "knee": (59, 77, 156), "ankle": (102, 157, 159), "foot": (122, 153, 178),
    },
    "spine3": {"head": (7, 12, 14), "elbow": (90, 184, 138), "wrist": (128, 448, 140), "hand": (153, 535, 150)},
    "shoulder": {"wrist": (182, 130, 68), "hand": (241, 190, 77)},
    "hip": {"ankle": (12, 179, 260), "foot": (32, 142, 290)},
}  # fmt: skip
"""Standard deviations along the anchor bone's axes (left, up and front of the body at rest), millimetres, by anchor
without its side: fitted to the distances between recorded joints and ``rest_rotations`` in 27,326 poses of 228 takes
of CMU so that ellipsoids hold 50, 80 and 95 %. Poses have heavier tails than a normal distribution: 80 % are held
within 1, 50 % hold 50 to 68 and 95 % hold 85 to 95. ``python -m tests.benchmarks.resting_spread`` finds them."""


def with_resting_spread(
    covariance: np.ndarray, rotations: np.ndarray, layout: BodyLayout, below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Return (F, J, 6) covariances with those of resting joints: ``(1 - s) C + s (C_anchor + G D² Gᵀ)``.

    Args:
        covariance: (F, J, 6) of the fit, m² (see ``packed``).
        rotations: (F, J, 3, 3) global rotations G.
        layout: names of the J joints.
        below: joints whose places each part's turns move.
        shares: (F,) of each part, s.
    """
    found = unpacked(covariance)
    for part in reversed(ANCHORS):
        if part not in shares:
            continue
        anchor = layout.joints.index(ANCHORS[part])
        G, table = rotations[:, anchor], SPREAD_MM[_bare(ANCHORS[part])]
        share = shares[part][:, None, None]
        for name in below[part]:
            if _bare(name) in table:  # a body may have joints that no recording shows
                variance = (1e-3 * np.array(table[_bare(name)])) ** 2
                j = layout.joints.index(name)
                found[:, j] += share * (found[:, anchor] + (G * variance) @ np.swapaxes(G, -1, -2) - found[:, j])
    return packed(found)


def _bare(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")
