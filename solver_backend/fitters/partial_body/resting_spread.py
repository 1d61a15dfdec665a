"""Spread of a resting joint about its usual place, from full recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.geometry.small_matrices import packed, unpacked

ANCHORS = {
    "trunk": "pelvis", "head": "spine3", "left_upper_arm": "spine3", "right_upper_arm": "spine3",
    "left_thigh": "pelvis", "right_thigh": "pelvis", "left_forearm": "left_shoulder",
    "right_forearm": "right_shoulder", "left_shank": "left_hip", "right_shank": "right_hip",
}  # fmt: skip
"""The last joint above each part whose place and bone are known; in the order in which parts hang on one another,
read backwards."""
SPREAD_MM: dict[str, dict[str, tuple[float, float, float]]] = {
    "pelvis": {
        "spine2": (9, 20, 36), "spine3": (12, 30, 45), "neck": (24, 41, 72), "head": (26, 70, 85),
        "collar": (22, 39, 62), "shoulder": (26, 28, 66), "elbow": (113, 362, 119), "wrist": (132, 522, 234),
        "hand": (152, 554, 298), "knee": (44, 131, 69), "ankle": (38, 211, 161), "foot": (42, 250, 252),
    },
    "spine3": {"head": (7, 38, 10), "elbow": (140, 252, 84), "wrist": (281, 411, 131), "hand": (145, 590, 199)},
    "shoulder": {"wrist": (130, 222, 88), "hand": (396, 108, 235)},
    "hip": {"ankle": (13, 398, 81), "foot": (13, 352, 166)},
}  # fmt: skip
"""Standard deviations along the anchor bone's axes (left, up and front of the body at rest) of a person whose pelvis is
upright, millimetres, by anchor without its side: fitted to the distances between joints and ``rest_rotations`` in
recordings of CMU, UI-PRMD and running laboratories so that ellipsoids come as near as one can to 50, 80 and 95 %.
``python -m tests.benchmarks.resting_spread`` finds them. Those of trunk and head are 1.2 to 2.5 times as large, as a
solve without their markers needs: of five other takes its pelvis leans 8 degrees off and its trunk has another length
(deviations along up and front of 16 and 45 mm at spine2, 24 and 79 at the neck)."""
BESIDE_MM: dict[str, dict[str, float]] = {
    "trunk": {"pelvis": 7.0, "hip": 9.5, "spine1": 20.0}, "thigh": {"pelvis": 6.5, "hip": 9.5},
}  # fmt: skip
"""Deviation per axis, millimetres, that joints beside a resting part have more than the fit states: its markers would
show how the pelvis leans and how large the person is. By part without its side. Of two thighs both count."""
TILT_DEG, MOST_DEG = 15.0, 60.0
"""Lean of the pelvis that doubles the spread of trunk, head and legs, and beyond which it grows no more: people who
bend, sit, kneel or lie have them three times as far from their rest as people who stand."""
ARM_TILT_DEG, ARM_MOST_DEG = 100.0, 45.0
"""The same of arms beyond a lean of ``TILT_DEG``: people bend to reach for something. Of CMU's 229 clips their
ellipsoids are right up to 15 degrees, and 1.1, 1.3 and 1.5 times too small at 25, 40 and 60."""
SLOW_M_S, FAST_M_S, WINDOW_S = 0.3, 0.8, 0.5
"""Largest speed of a pelvis along the ground that stays, least speed of a walk, and seconds over which it is taken."""
WALKING = {"arm": 0.62, "upper": 0.75}
"""Spread of arms, and of head and shoulders above a seen pelvis, of people who walk by that of people who stay: a
walk's arms hang, a stander's do anything. Radii that hold 50, 80 and 95 % of the arms of CMU's walks are 0.47, 0.66 and
0.81 times as large as those of people who stay, of the upper body 0.74, 0.73 and 0.75."""
LOW_M, LOWEST_M, LOW = 0.03, 0.14, 1.35
"""Depth of the pelvis below its highest in the take from which legs bend and beyond which their spread grows no more,
metres, and its factor then: 1.4 (knees), 1.2 (ankles) in CMU's clips."""
_ARM, _LEG, _UPPER = ("elbow", "wrist", "hand"), ("knee", "ankle", "foot"), ("neck", "head", "collar", "shoulder")


@dataclass(frozen=True)
class Stance:
    """Stance of a person by the pelvis, (F,) each."""

    lean: np.ndarray  # Degrees between its axis and the vertical.
    walking: np.ndarray  # From 0, staying in place, to 1, walking.
    low: np.ndarray  # From 0, standing, to 1, sitting, squatting, kneeling or lying.


def stance(rotations: np.ndarray, places: np.ndarray, fps: float) -> Stance:
    """Return the stance by (F, 3, 3) rotations and (F, 3) places of a pelvis, metres, Z up."""
    lean = np.degrees(np.arccos(np.clip(rotations[:, 2, 1], -1.0, 1.0)))
    half, every = max(1, round(0.5 * WINDOW_S * fps)), np.arange(len(places))
    first, last = np.maximum(every - half, 0), np.minimum(every + half, len(places) - 1)
    speed = np.linalg.norm(places[last, :2] - places[first, :2], axis=-1) * fps / np.maximum(last - first, 1)
    drop = float(np.quantile(places[:, 2], 0.95)) - places[:, 2]
    walking, low = (speed - SLOW_M_S) / (FAST_M_S - SLOW_M_S), (drop - LOW_M) / (LOWEST_M - LOW_M)
    return Stance(lean, np.clip(walking, 0.0, 1.0), np.clip(low, 0.0, 1.0))


def with_resting_spread(
    covariance: np.ndarray,
    rotations: np.ndarray,
    shown: Stance,
    layout: BodyLayout,
    below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> np.ndarray:
    """Return (F, J, 6) covariances with those of resting joints: ``(1 - s) C + s (C_anchor + k² G D² Gᵀ)``.

    k is ``growth``. Joints of ``BESIDE_MM`` have their variances added, times s.

    Args:
        covariance: (F, J, 6) of the fit, m² (see ``packed``).
        rotations: (F, J, 3, 3) global rotations G.
        below: joints that each part's turns move.
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
                k = growth(shown, _bare(ANCHORS[part]), _bare(name))[:, None, None]
                own = k**2 * ((G * variance) @ np.swapaxes(G, -1, -2))
                j = layout.joints.index(name)
                found[:, j] += share * (found[:, anchor] + own - found[:, j])
    for part, share in shares.items():
        beside = BESIDE_MM.get(_bare(part), {})
        for j, name in enumerate(layout.joints):
            if _bare(name) in beside:
                found[:, j] += share[:, None, None] * (1e-3 * beside[_bare(name)]) ** 2 * np.eye(3)
    return packed(found)


def growth(shown: Stance, anchor: str, joint: str) -> np.ndarray:
    """Return the factor of a joint's spread about its anchor, both without sides, against an upright stander's.

    ``1 + min(θ, MOST_DEG) / TILT_DEG`` of trunk, head and legs, ``1 + clip(θ - TILT_DEG, 0, ARM_MOST_DEG) /
    ARM_TILT_DEG`` of arms, 1 of a head on a seen chest; times ``WALKING`` and, of legs, ``LOW``. θ is the pelvis' lean.
    """
    if joint in _ARM:
        leaning = 1.0 + np.clip(shown.lean - TILT_DEG, 0.0, ARM_MOST_DEG) / ARM_TILT_DEG
        return leaning * (1.0 + (WALKING["arm"] - 1.0) * shown.walking)
    if anchor not in ("pelvis", "hip"):
        return np.ones_like(shown.lean)
    leaning = 1.0 + np.minimum(shown.lean, MOST_DEG) / TILT_DEG
    if joint in _LEG:
        return leaning * (1.0 + (LOW - 1.0) * shown.low)
    return leaning * (1.0 + (WALKING["upper"] - 1.0) * shown.walking) if joint in _UPPER else leaning


def _bare(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


CORE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
"""Joints that place the body where one of them is measured."""
NEAR_M, NEAR_HIP_M = 0.13, 0.17
"""Largest distance of a landmark that measures a joint: the pelvis' markers are 114 mm from its joint and 150 from the
hips, which are 124 from it. The acromion's is 153 from the neck, and a wand on the thigh, which shows no hip, 230 from
that."""
BEYOND_CHEST_RAD, BEYOND_LIMBS_RAD, BEYOND_LIMB_RAD = 0.15, 0.25, 0.60
"""Deviation per axis of an assumed joint by its distance from the nearest landmark: with a measured trunk or head, with
two measured limbs, and with one. Of CMU's 02_01 and 135_02 and four takes of UI-PRMD with the other markers removed,
the pelvis is 33 mm off below a chest, 85 above legs or lower legs, 90 between arms, 155 above one leg and 290 below one
arm (rms per axis, from the solve of all markers)."""
_LEG_JOINTS = ("hip", "knee", "ankle", "foot")
_WORDS = {
    "pelvis": "pelvis", "hip": "hips", "knee": "knees", "spine": "trunk", "collar": "shoulders",
    "shoulder": "shoulders", "neck": "head", "head": "head",
}  # fmt: skip


def assumed_joints(body: Body, landmarks: Landmarks, offsets: np.ndarray, located: np.ndarray) -> dict[str, float]:
    """Return the deviation per axis, metres, of the joints that only a posture determines.

    A joint is measured where a landmark is near it, and where it lies between such joints: between any two where one of
    ``CORE`` is among them, else along one limb alone, as two thighs may both point anywhere from their knees. An arm
    without a trunk does not show its shoulder: the acromion's marker has the joint on an unknown side of it.
    """
    names, ever = body.layout.joints, located.any(axis=0)
    if not ever.any():
        return {}
    anchors, joints = landmarks.anchors.sum(axis=1), body.joints_template[:, None]
    away = np.linalg.norm(joints - (anchors + offsets)[ever], axis=-1).min(axis=1)
    named = ever & np.array([not name.startswith(ON_BONE) for name in landmarks.names])
    if named.any():  # places of names do not depend on how large the person is
        away = np.minimum(away, np.linalg.norm(joints - anchors[named], axis=-1).min(axis=1))
    near = {j for j, name in enumerate(names) if away[j] < (NEAR_HIP_M if name.endswith("hip") else NEAR_M)}
    core = any(names[j] in CORE for j in near)
    if not core:
        near -= {j for j in near if away[j] > 0.0 and names[j].endswith(("collar", "shoulder"))}
    measured, parents = _between(near, body.parents, across=core), body.parents
    limbs = {(names[j].split("_")[0], names[j].endswith(_LEG_JOINTS)) for j in near}
    share = BEYOND_CHEST_RAD if core else BEYOND_LIMBS_RAD if len(limbs) > 1 else BEYOND_LIMB_RAD
    known = set(measured)
    for j, parent in enumerate(parents):
        known |= {j} if parent in known else set()
    return {name: share * float(away[j]) for j, name in enumerate(names) if j not in known}


def with_assumed_spread(covariance: np.ndarray, layout: BodyLayout, assumed: Mapping[str, float]) -> np.ndarray:
    """Return (F, J, 6) covariances in m² with ``σ² I`` added to those of assumed joints."""
    found = unpacked(covariance)
    for name, sigma in assumed.items():
        if name in layout.joints:
            found[:, layout.joints.index(name)] += sigma**2 * np.eye(3)
    return packed(found)


def assumed_places(assumed: Mapping[str, float], at_rest: Collection[str]) -> tuple[str, float]:
    """Return the words for assumed joints that are not at rest, and the largest deviation among them in metres."""
    kept = {name: sigma for name, sigma in assumed.items() if name not in at_rest}
    words = list(dict.fromkeys(word for name in kept if (word := _WORDS.get(name.split("_")[-1].rstrip("123")))))
    return joined_words(words), max(kept.values(), default=0)


def joined_words(words: Sequence[str]) -> str:
    """Return an enumeration: "arms, trunk and head"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _between(near: Collection[int], parents: Sequence[int], *, across: bool) -> set[int]:
    lines = {j: _line(j, parents) for j in near}
    found = set(near)
    for line in lines.values():
        above = [k for k, a in enumerate(line) if k and a in near]
        found |= set(line[: above[-1]]) if above else set()
    if across and near:
        shared = set.intersection(*map(set, lines.values()))
        top = max(shared, key=lambda j: len(_line(j, parents)))
        found |= {a for line in lines.values() for a in line[: line.index(top) + 1]}
    return found


def _line(j: int, parents: Sequence[int]) -> list[int]:
    line = [j]
    while parents[line[-1]] >= 0:
        line.append(int(parents[line[-1]]))
    return line
