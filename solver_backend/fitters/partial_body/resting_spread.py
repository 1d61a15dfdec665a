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
        "spine2": (7, 12, 14), "spine3": (9, 24, 23), "neck": (20, 41, 40), "head": (22, 70, 43),
        "collar": (18, 39, 30), "shoulder": (22, 21, 41), "elbow": (113, 362, 119), "wrist": (132, 522, 234),
        "hand": (152, 554, 298), "knee": (44, 131, 69), "ankle": (38, 211, 161), "foot": (42, 250, 252),
    },
    "spine3": {"head": (7, 38, 10), "elbow": (140, 252, 84), "wrist": (281, 411, 131), "hand": (145, 590, 199)},
    "shoulder": {"wrist": (130, 222, 88), "hand": (396, 108, 235)},
    "hip": {"ankle": (13, 398, 81), "foot": (13, 352, 166)},
}  # fmt: skip
"""Standard deviations along the anchor bone's axes (left, up and front of the body at rest) of a person whose pelvis is
upright, millimetres, by anchor without its side: fitted to the distances between joints and ``rest_rotations`` in
recordings of CMU, UI-PRMD and running laboratories so that ellipsoids come as near as one can to 50, 80 and 95 %.
``python -m tests.benchmarks.resting_spread`` finds them; those of the trunk and head are 1.1 to 1.35 times as large, as
solves without their markers need (``dev.py bench partial``), whose bones have other lengths too. Poses have heavier
tails than a normal distribution, and a take is one activity: of CMU's clips 58, 82 and 94 % are inside, of partial
takes of CMU, UI-PRMD and nimble 58, 78 and 90."""
TILT_DEG, MOST_DEG = 15.0, 60.0
"""Degrees by which the pelvis leans where the spread of trunk, head and legs is twice that of one upright, and beyond
which it grows no more: who bends, sits, kneels or lies has them three times as far from their rest as who stands."""
ARM_TILT_DEG, ARM_MOST_DEG = 100.0, 45.0
"""The same of arms beyond a lean of ``TILT_DEG``: who bends reaches for something. Of CMU's 229 clips their ellipsoids
are right up to 15 degrees, and 1.1, 1.3 and 1.5 times too small at 25, 40 and 60."""
_ARM = ("elbow", "wrist", "hand")


def with_resting_spread(
    covariance: np.ndarray, rotations: np.ndarray, layout: BodyLayout, below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Return (F, J, 6) covariances with those of resting joints: ``(1 - s) C + s (C_anchor + k² G D² Gᵀ)``.

    k is ``growth`` by the pelvis' lean.

    Args:
        covariance: (F, J, 6) of the fit, m² (see ``packed``).
        rotations: (F, J, 3, 3) global rotations G.
        layout: names of the J joints.
        below: joints whose places each part's turns move.
        shares: (F,) of each part, s.
    """
    found = unpacked(covariance)
    lean = np.degrees(np.arccos(np.clip(rotations[:, layout.joints.index("pelvis"), 2, 1], -1.0, 1.0)))
    for part in reversed(ANCHORS):
        if part not in shares:
            continue
        anchor = layout.joints.index(ANCHORS[part])
        G, table = rotations[:, anchor], SPREAD_MM[_bare(ANCHORS[part])]
        share = shares[part][:, None, None]
        for name in below[part]:
            if _bare(name) in table:  # a body may have joints that no recording shows
                variance = (1e-3 * np.array(table[_bare(name)])) ** 2
                k = growth(lean, _bare(ANCHORS[part]), _bare(name))[:, None, None]
                own = k**2 * ((G * variance) @ np.swapaxes(G, -1, -2))
                j = layout.joints.index(name)
                found[:, j] += share * (found[:, anchor] + own - found[:, j])
    return packed(found)


def growth(lean: np.ndarray, anchor: str, joint: str) -> np.ndarray:
    """Return by how much the spread of a joint about its anchor, both without sides, grows as the pelvis leans.

    ``1 + min(θ, MOST_DEG) / TILT_DEG`` of trunk, head and legs, ``1 + clip(θ - TILT_DEG, 0, ARM_MOST_DEG) /
    ARM_TILT_DEG`` of arms, 1 of a head on a chest that is seen.

    Args:
        lean: (F,) degrees θ.
        anchor: without its side.
        joint: without its side.
    """
    if joint in _ARM:
        return 1.0 + np.clip(lean - TILT_DEG, 0.0, ARM_MOST_DEG) / ARM_TILT_DEG
    return 1.0 + np.minimum(lean, MOST_DEG) / TILT_DEG if anchor in ("pelvis", "hip") else np.ones_like(lean)


def _bare(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")
