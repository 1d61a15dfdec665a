"""Judge marker labels in nats: directions of limbs, feet, knees, faces and wrists, and the shape of the trunk."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.agreement.body_evidence import CONCENTRATION, MEAN_STATURE_M
from solver_backend.agreement.evidence import BLOCKS, BOUND, POSES, group_poses
from solver_backend.agreement.reading import sample
from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.errors import MarkersMirrored
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.small_matrices import unit

PARTS = {
    "legs": ("THI", "KNE", "KNM", "SHN", "TTB", "ANK", "ANM", "HEE", "TOE", "MT1", "MT5"),
    "arms": ("UPA", "ELB", "ELM"),
    "waist": ("FWT", "BWT", "MWT", "GTR"),
    "shoulders": ("SHO", "FSH", "BSH"),
}
"""Markers of each part, without side. Left and right may be swapped in some of the parts."""
NEAR = {"legs": ("THI", "KNE", "KNM"), "arms": PARTS["arms"]}  # Markers that stay on their side if limbs cross.
SIDES = ("L", 1.0), ("R", -1.0)  # With the sign of their direction.
TOES, HEELS, SHINS = ("TOE", "MT1", "MT5"), ("HEE", "ANK", "ANM"), ("KNE", "KNM", "SHN", "TTB")
TRUNK = ("C7", "T2", "T4", "T8", "T10", "T12", "CLAV", "STRN", "SACR", "SHO", "FSH", "BSH", "FWT", "BWT", "MWT")
"""Marker locations, without side, that are nearly rigid relative to each other."""
_CENTRES = "hip FWT, knee KNE, ankle ANM, heel HEE, foot TOE, big_toe TOE, shoulder SHO, elbow ELB"
OF_CENTRES = dict[str, str](map(str.split, _CENTRES.split(", ")))  # Skin markers that correspond to joint centres.
ODD = 0.001  # Probability of a wrong direction. None of 2,100 legs, arms and feet in 554 recordings has one.
ANKLE = 0.15  # Distance of the outer ankle from the plane of shin and foot, relative to the foot's length.
ELBOW_BENT = 0.35  # Smallest sine of a bend that counts. The elbow marker on a straight arm shows 0.3.


@dataclass(frozen=True)
class LabelledMarkers:
    """Markers of a take under one interpretation of their labels."""

    points: np.ndarray  # (F, M, 3) metres, NaN where missing.
    names: tuple[str, ...]  # Marker location of each label.
    group: np.ndarray  # (F,) number of each frame's pose. Frames with similar poses are one observation.

    @classmethod
    def of(cls, points: np.ndarray, names: Sequence[str]) -> LabelledMarkers:
        """Choose frames of markers (F, M, 3), and group them by poses relative to the markers' centre."""
        some = points[sample(len(points), POSES)].astype(np.float64)
        around = some - _middle(some)[:, None]
        apart = quantile(np.linalg.norm(around[:, None] - around, axis=-1), 0.5, -1, "lower")
        return cls(some, tuple(names), group_poses(np.nan_to_num(apart) / MEAN_STATURE_M, BLOCKS))

    def mean(self, side: str, places: Sequence[str]) -> np.ndarray:
        """Return the mean (F, 3) of the visible markers at some places, NaN if there is none."""
        return _middle(self.points[:, [n[:1] in side and n[1:] in places for n in self.names]])

    def lateral(self, places: Sequence[str]) -> np.ndarray:
        """Return the mean vector (F, 3) in metres from right to left markers, NaN without visible pairs."""
        paired = [place for place in places if {"L" + place, "R" + place} <= {*self.names}]
        left, right = ([self.names.index(side + place) for place in paired] for side in "LR")
        return _middle(self.points[:, left] - self.points[:, right])

    def exchanged(self, parts: Sequence[str]) -> LabelledMarkers:
        """Swap left and right in the labels of some parts."""
        places = {place for part in parts for place in PARTS[part]}
        other = {"L": "R", "R": "L"}
        names = (other[n[0]] + n[1:] if n[:1] in other and n[1:] in places else n for n in self.names)
        return replace(self, names=tuple(names))

    def has(self, part: str) -> set[str]:
        """Return the sides, L and R, with markers of a part."""
        return {name[0] for name in self.names if name[:1] in ("L", "R") and name[1:] in PARTS[part]}

    def log_odds(self, cosine: np.ndarray) -> np.ndarray:
        """Return the log probabilities (2,) in nats that a direction (F,) is right, and that it is reversed.

        ``cosine`` is 1 for the usual direction. Directions have a von Mises distribution. Each pose counts once.
        """
        known = np.isfinite(cosine)
        count = np.bincount(self.group[known])
        mean = np.bincount(self.group[known], cosine[known])[count > 0] / count[count > 0]
        right = 1 / (1 + np.exp(-2 * CONCENTRATION * np.stack([mean, -mean])))
        return np.log(ODD + (1 - 2 * ODD) * right).sum(1)


def _middle(points: np.ndarray) -> np.ndarray:
    """Return the mean (F, 3) of the points (F, n, 3) that are visible, NaN if none is."""
    count = np.isfinite(points).sum(axis=1)
    return np.where(count > 0, np.nan_to_num(points).sum(axis=1) / np.maximum(count, 1), np.nan)


def _forward(across: np.ndarray, up: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Return the sine ``(l × u) · f`` of unit vectors: positive if the direction f points forward."""
    return (np.cross(unit(across), unit(up)) * unit(front)).sum(-1)


def _directions(take: LabelledMarkers) -> Iterator[np.ndarray]:
    """Yield the cosine (F,) of each direction that left and right determine. It is positive for correct labels.

    Limbs are compared with the waist or the shoulders, where they begin. With l from right to left, toes and knees
    point along ``l × u``, where u is the direction of the shin or of the leg, and faces along ``l × u`` with the
    trunk's direction u. The outer ankle is on the outer side of its foot.
    """
    left, hips = {part: take.lateral(places) for part, places in PARTS.items()}, take.mean("LR", PARTS["waist"])
    for limb, base in (("legs", "waist"), ("arms", "shoulders")):
        across, centre = left[base], take.mean("LR", PARTS[base])
        yield (unit(left[limb]) * unit(across)).sum(-1)
        for side, sign in SIDES if np.isnan(left[limb]).all() else ():
            near = take.mean(side, NEAR[limb]) - centre
            yield np.clip(2 * sign * (near * across).sum(-1) / (across**2).sum(-1), -1, 1)
    across = np.where(np.isnan(left["waist"]), left["legs"], left["waist"])
    for side, sign in SIDES:
        parts = TOES, HEELS, SHINS, ("ANK", "ANM"), ("KNE", "KNM"), ("HEE",), ("ANK",)
        toes, heel, shin, ankle, knee, back, outer = (take.mean(side, places) for places in parts)
        foot, rise, up = toes - back, outer - back, shin - ankle
        yield _forward(across, np.where(np.isnan(up), hips - heel, up), toes - heel)
        yield _forward(across, hips - ankle, knee - ankle)
        # Labels swapped within a foot, which are found later, put the ankle below the heel or nearer to the toes.
        sound = ((rise * up).sum(-1) > 0) & (np.linalg.norm(rise, axis=-1) < np.linalg.norm(toes - outer, axis=-1))
        aside = sign * (np.cross(unit(up), unit(foot)) * rise).sum(-1) / (ANKLE * np.linalg.norm(foot, axis=-1))
        yield np.where(sound, np.clip(aside, -1, 1), np.nan)
    necks = take.mean("~", ("left_ear", "right_ear")), take.mean("~=", ("neck",))
    neck, nose = np.where(np.isnan(necks[0]), necks[1], necks[0]), take.mean("~", ("nose",))
    yield _forward(left["shoulders"], np.where(np.isnan(hips), [0.0, 0.0, 1.0], neck - hips), nose - neck)


def _trunk(take: LabelledMarkers, rest: dict[str, np.ndarray]) -> float:
    """Return the log-likelihood of the trunk's shape in nats, 0 if too few frames show it.

    The K markers of a frame are aligned with the average body by a similarity (Umeyama 1991). With normal errors of
    unknown size, the log-likelihood is ``-(3 K - 7) / 2 log r²``, where r² is the residual's share of the variance. The
    trunk is rigid, so all frames are one observation.
    """
    chosen = [i for i, name in enumerate(take.names) if name in rest]
    points, body = take.points[:, chosen], np.array([rest[take.names[i]] for i in chosen]).reshape(-1, 3)
    points = points[np.isfinite(points).all((1, 2))]
    if 3 * len(chosen) <= 7 or not len(points):
        return 0.0
    points, body = points - points.mean(axis=1, keepdims=True), body - body.mean(axis=0)
    U, S, Vt = np.linalg.svd(np.swapaxes(points, 1, 2) @ body)
    S[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    r2 = 1 - S.sum(1) ** 2 / ((points**2).sum((1, 2)) * (body**2).sum())
    return float(-0.5 * (3 * len(chosen) - 7) * np.log(np.median(np.maximum(r2, ODD))))


MIRRORED = "mirrored"  # Interpretation with an axis reversed.


def check_sides(points: np.ndarray, landmarks: Landmarks) -> None:
    """Check that left and right are not swapped in the labels, and that no axis is reversed.

    The points (F, M, 3) in metres are judged as labelled, mirrored, and with left and right swapped in every
    combination of ``PARTS``. The simplest interpretation within ``BOUND`` of the best one counts.

    Raises:
        MarkersMirrored: the labels as written are less likely than the best interpretation by ``BOUND``.
    """
    names = [_on_skin(name) for name in landmarks.names]
    take = LabelledMarkers.of(points, names)
    kept = [name in TRUNK or (name[1:] in TRUNK and {"L" + name[1:], "R" + name[1:]} <= {*names}) for name in names]
    rest = {names[i]: landmarks.anchors[i].sum(axis=0) for i in np.flatnonzero(kept)}
    mirror = replace(take, points=take.points * [-1.0, 1.0, 1.0])
    known = [part for part in PARTS if take.has(part)]
    ways = [(), (MIRRORED,), *(parts for count in range(1, 5) for parts in combinations(known, count))]
    takes = [mirror if way == (MIRRORED,) else take.exchanged(way) for way in ways]
    shape = np.array([_trunk(one, rest) for one in takes])
    total = shape + [sum(one.log_odds(cosine)[0] for cosine in _directions(one)) for one in takes]
    likely = np.flatnonzero(total > total.max() - BOUND)
    if likely[0] == 0:
        return
    mirrored = "joint centres" if names != [*landmarks.names] else "legs' markers"
    mirrored = "markers of the trunk" if shape[1] - shape[0] >= BOUND else mirrored
    raise _swapped([ways[likely[0]], ways[total.argmax()]], take, mirrored)


def _swapped(near: Sequence[tuple[str, ...]], take: LabelledMarkers, mirrored: str) -> MarkersMirrored:
    """Return the error that names the simplest and the best of the likely interpretations of a take's labels."""
    part = near[0][0]
    sides = sorted({side for known in (PARTS if part == MIRRORED else (part,)) for side in take.has(known)})
    own, other = ("left", "right") if sides == ["L"] else ("right", "left")
    if part == MIRRORED and len(sides) == 1:
        return _mirrored(
            f"The outer ankle of the {own} leg is on the inner side of the foot. The markers belong to the {other} "
            "leg, or an axis is reversed.",
            " of this leg, or export the take with right-handed axes",
        )
    if part == MIRRORED:
        return _mirrored(
            f"The {mirrored} are mirrored. Left and right labels are swapped, or an axis is reversed.",
            ", or export the take with right-handed axes",
        )
    which = " or ".join(dict.fromkeys(" and ".join(way) for way in near))
    if len(sides) == 1 and which in NEAR:
        limb = which[:-1]
        return _mirrored(
            f"The markers of the {own} {limb} are on the {other} of the body. They belong to the {other} {limb}.",
            f" of this {limb}",
        )
    return _mirrored(
        f"The left markers of the {which} are on the right of the body. Their left and right labels are swapped.",
        f" of the {which}",
    )


def _mirrored(text: str, labels: str) -> MarkersMirrored:
    return MarkersMirrored(text, where="markers", hint=f"Swap L and R in the labels{labels}.")


def _on_skin(name: str) -> str:
    side, _, part = name[1:].partition("_")
    if is_joint_centre(name) and part in OF_CENTRES:
        return side[0].upper() + OF_CENTRES[part]
    return name


def exchanged_wrists(points: np.ndarray, places: Sequence[str]) -> list[tuple[int, int]]:
    """Find sides where the wrist labels WRA and WRB are swapped. Return the columns of these pairs.

    For every rotation of the hand, the thumb side of the wrist is within 90 degrees of the upper arm, measured across
    the forearm. If f points from elbow to wrist and u from elbow to shoulder, ``(x_A - x_B) · (u - (u · f) f) > 0``.
    Each pose of a bent arm is evidence, and ``BOUND`` decides. ``points`` are (F, L, 3) in metres, NaN where missing.
    """
    take, pairs = LabelledMarkers(points, tuple(places), np.zeros(len(points), int)), list[tuple[int, int]]()
    for side in "LR":
        parts = ("WRA",), ("WRB",), ("SHO",), ("FSH", "BSH"), ("ELB", "ELM")
        inner, outer, top, around, elbow = (take.mean(side, part) for part in parts)
        arm = np.stack([inner, outer, np.where(np.isnan(top), around, top), elbow], axis=1)
        _, bend = _thumb_side(arm)
        if (bend > ELBOW_BENT).any():
            bent = LabelledMarkers.of(arm[bend > ELBOW_BENT], ())
            written, swapped = bent.log_odds(_thumb_side(bent.points)[0])
            wrist = places.index(side + "WRA"), places.index(side + "WRB")
            pairs += [wrist] if swapped - written >= BOUND else []
    return pairs


def _thumb_side(arm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the cosine (F,) between the wrist line and the upper arm across the forearm, and the sine of the bend.

    ``arm`` (F, 4, 3) are the wrist's two markers, the shoulder and the elbow.
    """
    inner, outer, shoulder, elbow = np.moveaxis(arm, 1, 0)
    forearm, upper = unit(0.5 * (inner + outer) - elbow), unit(shoulder - elbow)
    across = upper - (upper * forearm).sum(-1, keepdims=True) * forearm
    return (unit(inner - outer) * unit(across)).sum(-1), np.linalg.norm(across, axis=-1)
