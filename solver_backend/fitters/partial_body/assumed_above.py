"""Joints beyond what is measured: the pelvis of an upper body, what is above legs or feet, behind an arm alone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.geometry.symmetric import packed, unpacked

CORE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
"""Joints that place the body where one of them is measured."""
NEAR_M, NEAR_HIP_M = 0.13, 0.17
"""A joint is measured by a landmark so near: the pelvis' markers are 114 mm from its joint and 150 from the hips,
which are 124 from it; the acromion's is 153 from the neck, and a wand on the thigh, which shows no hip,
230 from that."""
BEYOND_CHEST_RAD, BEYOND_LIMBS_RAD, BEYOND_LIMB_RAD = 0.15, 0.25, 0.60
"""Deviation per axis of an assumed joint by its distance from the nearest landmark: where trunk or head is measured,
where two limbs are, and where one is. Of CMU's 02_01 and 135_02 and four takes of UI-PRMD with the other markers
removed, the pelvis is 33 mm off below a chest, 85 above legs or lower legs, 90 between arms, 155 above one leg and 290
below one arm (rms per axis, from the solve of all markers)."""
_LEG = ("hip", "knee", "ankle", "foot")
_WORDS = {
    "pelvis": "pelvis", "hip": "hips", "knee": "knees", "spine": "trunk", "collar": "shoulders",
    "shoulder": "shoulders", "neck": "head", "head": "head",
}  # fmt: skip


def assumed_joints(body: Body, landmarks: Landmarks, offsets: np.ndarray, located: np.ndarray) -> dict[str, float]:
    """Return the deviation per axis, metres, of the joints whose places only a posture determines.

    A joint is measured where a landmark is near it, and where it lies between such joints: between any two where one of
    ``CORE`` is among them, else along one limb alone, as two thighs may both point anywhere from their knees. An arm
    without a trunk does not show its shoulder: the acromion's marker has the joint on an unknown side of it.

    Args:
        body: whose tree.
        landmarks: L landmarks.
        offsets: (L, 3) of the landmarks in the rest frame, metres.
        located: (F, L) bool.
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
    limbs = {(name.split("_")[0], name.endswith(_LEG)) for name in (names[j] for j in near)}
    share = BEYOND_CHEST_RAD if core else BEYOND_LIMBS_RAD if len(limbs) > 1 else BEYOND_LIMB_RAD
    below = set(measured)
    for j, parent in enumerate(parents):
        below |= {j} if parent in below else set()
    return {name: share * float(away[j]) for j, name in enumerate(names) if j not in below}


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
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words), max(kept.values(), default=0)


def _between(near: Collection[int], parents: Sequence[int], *, across: bool) -> set[int]:
    """Return the joints on the paths between joints of a tree; not across, only where one is above the other."""
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
    """Return a joint and those above it, up to the root."""
    line = [j]
    while parents[line[-1]] >= 0:
        line.append(int(parents[line[-1]]))
    return line
