"""Attach markers with unknown labels to a bone, or group them as a rigid prop."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import is_unnamed
from solver_backend.body.markers import ON_BONE
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.geometry.arrays import quantile, to_numpy
from solver_backend.types import NUM_BODY_JOINTS, SMPL_JOINTS, MarkerCloud

LEAST_MARKERS = 3  # Smallest number of markers on a prop, because fewer have no orientation.
STRAYS_M, SHARE = 0.006, 0.95
"""Largest change of a distance in a rigid body, and share of frames below it. Noise of 2 mm needs 5.5 mm."""
MOVES_M = 0.05  # Smallest movement of a prop's marker from its median position. Others are part of the room.
LEAST_FRAMES, FRAMES = 15, 400  # Fewest frames that show two markers together, and number of frames used.
MOST = 100  # Largest number of markers compared, because all pairs are. The most visible ones are used.


def rigid_groups(points: np.ndarray) -> list[list[int]]:
    """Find groups of three or more moving markers at constant distances, largest first.

    Each group is a clique. It starts with the marker that has the largest number of constant distances, and adds the
    best-fitting marker at each step. A marker that was never visible together with a member must fit three other
    members. ``points`` are (F, N, 3) in metres, NaN where missing.
    """
    frames = np.unique(np.linspace(0, len(points) - 1, min(len(points), FRAMES)).astype(int))
    seen = np.isfinite(points).all(-1)
    looked = np.argsort(-seen.sum(axis=0), kind="stable")[:MOST]
    constant, together = _constant(points[np.ix_(frames, looked)])
    groups, left = list[list[int]](), set(range(len(looked)))
    while left:
        group = _clique(constant, together, sorted(left))
        if len(group) < LEAST_MARKERS:
            break
        left -= set(group)
        groups.append(sorted(int(looked[m]) for m in group))
    return [group for group in groups if _moves(points[:, group])]


def _constant(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, N) masks of marker pairs at a constant distance, and of pairs that are visible together."""
    count = points.shape[1]
    constant, together = np.zeros((count, count), dtype=bool), np.zeros((count, count), dtype=bool)
    for m in range(count):
        away = np.linalg.norm(points - points[:, m : m + 1], axis=-1)
        together[m] = np.isfinite(away).sum(axis=0) >= min(LEAST_FRAMES, len(points))
        strays = quantile(np.abs(away - quantile(away, 0.5, axis=0)), SHARE, axis=0)
        constant[m] = together[m] & (np.nan_to_num(strays, nan=np.inf) < STRAYS_M)
    np.fill_diagonal(constant, False)
    return constant, together


def _clique(constant: np.ndarray, together: np.ndarray, left: list[int]) -> list[int]:
    degree = constant[np.ix_(left, left)].sum(axis=0)
    group = [left[int(degree.argmax())]]
    while True:
        fits = constant[group].sum(axis=0)
        apart = (together[:, group] & ~constant[:, group]).any(axis=1)
        least = min(len(group), LEAST_MARKERS)
        fitting = [m for m in left if m not in group and not apart[m] and fits[m] >= least]
        if not fitting:
            return group
        group.append(max(fitting, key=lambda m: (fits[m], degree[left.index(m)])))


def _moves(points: np.ndarray) -> bool:
    away = np.linalg.norm(points - quantile(points, 0.5, axis=0), axis=-1)
    return bool(np.nanmax(quantile(away, 0.98, axis=0)) > MOVES_M)


NUM_ATTACHED = 1 + NUM_BODY_JOINTS  # Number of bones that can carry markers with unknown names.
LEAST_FRAMES_OF_BONE = 8  # Smallest number of frames of a marker needed to identify its bone.
RESIDUAL_M, REACH_M = 0.03, 0.45
"""Largest median distance in metres from a marker to its position on the bone, and from this position to the joint."""
_MEDIAN_LENGTH = 1.54  # Median length of a three-dimensional Gaussian, in standard deviations per axis.


@dataclass(frozen=True)
class Attachment:
    """Bone that a marker moves with, and the marker's offset from it."""

    place: str  # ``@`` and the name of the bone's joint.
    offset: np.ndarray  # (3,) metres from the joint, in the bone's axes at rest.
    sigma_m: float  # Standard deviation around it per axis, metres.

    @classmethod
    def on_bone(cls, bone: int, offset: np.ndarray, spread: np.ndarray) -> Attachment:
        """Create the attachment to one bone from the results of ``bone_offsets``."""
        return cls(ON_BONE + SMPL_JOINTS[bone], offset[bone], float(spread[bone] / _MEDIAN_LENGTH))


@dataclass(frozen=True)
class BonePoses:
    """Joint positions (F, 24, 3) in metres and global bone rotations (F, 24, 3, 3)."""

    joints: np.ndarray
    rotations: np.ndarray

    @classmethod
    def of(cls, subject: Subject, frames: PosedFrames) -> BonePoses:
        """Compute a person's bones in the given poses."""
        skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
        return cls(to_numpy(skeleton.joints), to_numpy(skeleton.G))

    def carry(self, points: np.ndarray) -> bool:
        """Return whether a single bone carries all markers (F, M, 3) at constant offsets."""
        offsets = [bone_offsets(points[:, m], self.joints, self.rotations) for m in range(points.shape[1])]
        spread, reach = (np.median([item[k] for item in offsets], axis=0) for k in (1, 2))
        return bool(((spread < RESIDUAL_M) & (reach < REACH_M)).any())


def attach(points: np.ndarray, bones: BonePoses, named: str | None = None) -> Attachment | None:
    """Attach a marker to the bone with the most constant offset, or return None if no bone fits.

    The offset on bone j is ``o_j = median_f G_jᵀ (x - p_j)`` per axis, which is robust to wrong points. The bone with
    the smallest median distance from the offset is chosen. If several bones are equally good within the noise, the one
    with the nearest joint is chosen. ``points`` (F, 3) are in metres, NaN where missing. If the marker's label names a
    bone, ``named`` is that bone's joint, and no other bone is allowed.
    """
    if np.isfinite(points).all(-1).sum() < LEAST_FRAMES_OF_BONE:
        return None
    offset, spread, reach = bone_offsets(points, bones.joints, bones.rotations)
    spread = np.where(reach > REACH_M, np.inf, spread)
    if named is not None:
        spread = np.where(np.arange(len(spread)) == SMPL_JOINTS.index(named), spread, np.inf)
    near = np.flatnonzero(spread <= 1.1 * spread.min() + 1e-4)
    best = int(near[np.argmin(reach[near])])
    return Attachment.on_bone(best, offset, spread) if spread[best] < RESIDUAL_M else None


def common_bones(
    points: np.ndarray, labels: Sequence[str], bones: BonePoses, known: Mapping[str, tuple[int, ...]]
) -> dict[str, str]:
    """Map the label of each unknown marker in a rigid group to the joint of its bone.

    Markers on a rigid plate are on one bone: a possible bone of the group's known markers, or else any bone. The bone
    with the most constant offsets of the whole group is chosen, because single markers may fit a neighbouring bone.

    Args:
        points: (F, N, 3) positions in metres, NaN where missing.
        known: numbers of the possible bones by label. A wrist marker moves with the forearm, not with the hand.
    """
    found = dict[str, str]()
    for group in rigid_groups(points):
        loose = [m for m in group if labels[m] not in known]
        if not loose:
            continue
        offsets = [bone_offsets(points[:, m], bones.joints, bones.rotations) for m in loose]
        spread, reach = (np.median([item[k] for item in offsets], axis=0) for k in (1, 2))
        named = [known[labels[m]] for m in group if labels[m] in known]
        allowed = max(named, key=named.count) if named else np.flatnonzero(reach <= REACH_M).tolist()
        if allowed:
            found |= dict.fromkeys([labels[m] for m in loose], SMPL_JOINTS[min(allowed, key=lambda bone: spread[bone])])
    return found


def bone_offsets(
    points: np.ndarray, joints: np.ndarray, rotations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a marker's offset from each bone, the median distance from this offset, and the offset's length.

    ``points`` (F, 3) and ``joints`` (F, 24, 3) are in metres, and ``rotations`` (F, 24, 3, 3) are global.
    """
    seen, count = np.isfinite(points).all(-1), NUM_ATTACHED
    away = points[seen, None] - joints[seen, :count]
    local = (np.swapaxes(rotations[seen, :count], -1, -2) @ away[..., None])[..., 0]
    offset = np.median(local, axis=0)
    return offset, np.median(np.linalg.norm(local - offset, axis=-1), axis=0), np.linalg.norm(offset, axis=-1)


SEPARATOR = ":"  # Between a subject's prefix and a label.
_OTHER = {"l": "R", "r": "L", "left": "right", "right": "left"}
_SIDE = tuple(re.compile(text, re.IGNORECASE) for text in (r"left|right", r"^[lr]", r"[lr](?=[\W\d_]*$)"))
_NO_PARTS = {"LAT", "MED", "FRONT", "BACK", "TOP", "UPPER", "BIG", "GREATER", "FIRST", "SECOND", "THIRD", "FIFTH"}
"""Words in labels that are not names of body parts."""
_FIRST_WORD = re.compile(r"[^\W\d_]([A-Z]+(?![a-z])|[^\W\dA-Z_]*)")
LEAST_NAME = 3
"""Smallest number of initial letters that labels must share to name a prop."""


@dataclass(frozen=True)
class LooseGroup:
    """Group of markers on one prop."""

    name: str  # The shared prefix or beginning of their labels, or else a number.
    columns: tuple[int, ...]  # Their columns in the cloud.


def loose_groups(cloud: MarkerCloud, bones: BonePoses | None = None) -> list[LooseGroup]:
    """Find groups of markers that move as rigid bodies and share a label prefix.

    ``cloud`` contains markers without a known location on a body. Groups carried by one of ``bones`` are excluded.
    """
    labels, found = cloud.names, list[LooseGroup]()
    prefixes = [label.rpartition(SEPARATOR)[0].strip() for label in labels]
    for prefix in dict.fromkeys(prefixes):
        own = [i for i, name in enumerate(prefixes) if name == prefix]
        for group in rigid_groups(cloud.positions[:, own]):
            columns = tuple(own[m] for m in group)
            names = {labels[i] for i in columns}
            worn = bones is not None and (
                _is_one_of_a_pair(names, labels) or _names_a_part(names) or bones.carry(cloud.positions[:, columns])
            )
            if not worn:
                found.append(LooseGroup(_name([labels[i] for i in columns], len(found) + 1), columns))
    names = [group.name for group in found]
    return [
        group if names.index(group.name) == n else LooseGroup(f"{group.name} {n + 1}", group.columns)
        for n, group in enumerate(found)
    ]


def _name(labels: list[str], number: int) -> str:
    prefix = labels[0].rpartition(SEPARATOR)[0].strip()
    if any(is_unnamed(label) for label in labels):
        return f"Prop {number}"
    texts = [label.rpartition(SEPARATOR)[2].strip() for label in labels]
    alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*texts, strict=False))
    shared = "".join(letters[0] for letters in alike).rstrip(" _-.0123456789")
    return prefix or (shared if len(shared) >= LEAST_NAME else f"Prop {number}")


def _is_one_of_a_pair(group: set[str], labels: Sequence[str]) -> bool:
    """Return whether most markers in a group have a counterpart on the other side of the body."""
    outside = {label.casefold() for label in labels if label not in group}
    paired = [label for label in group if mirrored_labels(label) & outside]
    return 2 * len(paired) > len(group)


def _names_a_part(group: set[str]) -> bool:
    """Return whether most labels begin with a body part: ``Head.L``, not ``RacketHead``."""
    words = load_layouts().words
    first = [(_FIRST_WORD.match(label.rpartition(SEPARATOR)[2].strip()) or [""])[0] for label in group]
    return 2 * sum(bool(set(words.of(word)[1]) - _NO_PARTS) for word in first) > len(group)


def mirrored_labels(label: str) -> set[str]:
    """Return possible labels of the corresponding marker on the other side. L and R, or left and right, are swapped."""
    prefix, colon, name = label.rpartition(SEPARATOR)
    turned = {pattern.sub(lambda found: _OTHER[found[0].lower()], name, count=1) for pattern in _SIDE}
    return {(prefix + colon + text).casefold() for text in turned} - {label.casefold()}
