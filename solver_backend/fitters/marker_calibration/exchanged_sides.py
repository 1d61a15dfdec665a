"""Whether left and right labels of legs or arms are exchanged in all of a take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.errors import MarkersMirrored

WAIST = ("FWT", "BWT", "MWT", "GTR")
SHOULDERS = ("SHO", "FSH", "BSH")
LEGS = ("KNE", "KNM", "SHN", "TTB", "ANK", "ANM", "HEE", "TOE", "MT1", "MT5")
ARMS = ("UPA", "ELB", "ELM")
NEAR_BASE = {"legs": ("THI", "KNE", "KNM"), "arms": ("UPA", "ELB", "ELM")}
"""Places of a limb that stay on its side of the body when limbs are crossed."""
TOES, HEELS = ("TOE", "MT1", "MT5"), ("HEE", "ANK", "ANM")
"""Places without their side."""
OF_CENTRES = {
    "hip": "FWT", "knee": "KNE", "ankle": "ANK", "heel": "HEE", "foot": "TOE", "big_toe": "TOE", "shoulder": "SHO",
    "elbow": "ELB",
}  # fmt: skip
"""The places of a skin that stand for joint centres and keypoints here."""
LEAST_PAIRS = 2
"""Pairs of a limb's markers that have to be there."""
MIRRORED, CROSSED_M, SHARE = -0.3, -0.05, 0.75
"""Sine of feet that point backwards; metres by which left legs are on the right, and in which share of the frames. In
45 recordings the sine's median is above 0.5, and left legs are 0.12 m on the left in a quarter of the frames at
least."""
INNER_M, FOOT_M = -0.015, 0.1
"""Metres that the outer ankle lies on the inner side of the foot's axis in a leg of the other side, and at most. Of 320
feet in 160 recordings it lies 27 to 58 mm on the outer side, but in one recording (btkdata's ADemo1) 4 on the inner."""
BENT = 0.08
"""Distance of a knee from the line between hip and ankle by its length, from which it shows where it bends: at 18
degrees."""


def check_sides(points: np.ndarray, landmarks: Landmarks) -> None:
    """Make sure that left legs and arms are on the left of waist and shoulders, and that feet point forward.

    With l from the right to the left side, u from the feet to the waist and f from heels to toes, ``(l × u) · f > 0``.
    Joint centres without toes are compared by f from the middle of hip and ankle to the knee, which bends forwards, and
    by f from the neck or the ears to the nose. A limb alone is compared with waist or shoulders, a leg alone with its
    ankle.

    Args:
        points: (F, L, 3) metres, NaN where missing.
        landmarks: the L places.

    Raises:
        MarkersMirrored: it is not so in most frames.
    """
    names = [_on_skin(name) for name in landmarks.names]
    column = {name: i for i, name in reversed(list(enumerate(names)))}
    for base, limb, which in ((WAIST, LEGS, "legs"), (SHOULDERS, ARMS, "arms")):
        own, beyond = (_lateral(points, column, places, least) for places, least in ((base, 1), (limb, LEAST_PAIRS)))
        if own is not None and beyond is not None and _usual((_unit(own) * beyond).sum(-1), SHARE) < CROSSED_M:
            raise MarkersMirrored(
                f"The {which}' left markers are on the right of the body: their left and right labels are exchanged.",
                where="markers", hint=f"Exchange L and R in the labels of the {which}.",
            )  # fmt: skip
        for side in "LR" if own is not None else "":
            _check_limb(points, column, base, [side + place for place in NEAR_BASE[which]], which[:-1])
    centres = tuple(names) != tuple(landmarks.names)
    forward = _feet_forward(points, column)
    if forward is None and centres:
        forward = _centres_forward(points, column)
    if forward is not None and _usual(forward) < MIRRORED:
        what = "joint centres" if centres else "legs' markers"
        raise MarkersMirrored(
            f"The {what} are a mirror image of a body's: left and right "
            "labels are exchanged, or an axis points the other way.", where="markers",
            hint="Exchange L and R in the labels, or export the take with right-handed axes.",
        )  # fmt: skip
    if not centres:
        _check_ankles(points, column)


def _check_limb(
    points: np.ndarray, column: dict[str, int], base: Sequence[str], names: Sequence[str], limb: str
) -> None:
    """Raise ``MarkersMirrored`` where one limb is on the other side of waist or shoulders in most frames."""
    lateral, middle = _lateral(points, column, base, 1), _middle(points, column, base)
    near = _mean(points, column, names)
    if lateral is None or middle is None or near is None:
        return
    side = names[0][0]
    outwards = (1.0 if side == "L" else -1.0) * (_unit(lateral) * (near - middle)).sum(-1)
    if _usual(outwards, SHARE) < CROSSED_M:
        own, other = ("left", "right") if side == "L" else ("right", "left")
        raise MarkersMirrored(
            f"The {own} {limb}'s markers are on the {other} of the body: they are the {other} {limb}'s.",
            where="markers", hint=f"Exchange L and R in the labels of this {limb}.",
        )  # fmt: skip


def _check_ankles(points: np.ndarray, column: dict[str, int]) -> None:
    """Raise ``MarkersMirrored`` where the outer ankle is on the inner side of a foot: the leg is the other one.

    With u from ankle to knee, h the heel and f from it to the toes, ``± (u × f) · (ankle - h) > 0`` of left and right.
    """
    for side, sign in (("L", 1.0), ("R", -1.0)):
        foot = [side + place for place in ("ANK", "HEE", "TOE")]
        above = next((side + place for place in ("KNE", "SHN", "TTB", "KNM") if side + place in column), None)
        if above is None or not set(foot) <= column.keys():
            continue
        ankle, heel, toe = (points[:, column[name]] for name in foot)
        up, forward = points[:, column[above]] - ankle, toe - heel
        outwards = sign * (_unit(np.cross(up, forward)) * (ankle - heel)).sum(-1)
        # Exchanged labels of a foot, which are found later, leave the ankle lower than the heel or nearer to the toes.
        sound = ((ankle - heel) * up).sum(-1) > 0.0
        sound &= np.linalg.norm(ankle - heel, axis=-1) < np.linalg.norm(ankle - toe, axis=-1)
        outwards = np.where(sound & (abs(outwards) < FOOT_M), outwards, np.nan)
        if _usual(outwards) < INNER_M:
            own, other = ("left", "right") if side == "L" else ("right", "left")
            raise MarkersMirrored(
                f"The {own} leg's outer ankle is on the inner side of its foot: the markers are those of a {other} "
                "leg, or an axis points the other way.", where="markers",
                hint="Exchange L and R in the labels of this leg, or export the take with right-handed axes.",
            )  # fmt: skip


def _on_skin(name: str) -> str:
    """Return the place on the skin that stands for a joint centre, any other place as it is."""
    side, _, part = name[1:].partition("_")
    if is_joint_centre(name) and part in OF_CENTRES:
        return side[0].upper() + OF_CENTRES[part]
    return name


def _feet_forward(points: np.ndarray, column: dict[str, int]) -> np.ndarray | None:
    """Return the (n, F) sines of feet in front of waist and legs; None where they are not known."""
    lateral = _lateral(points, column, WAIST, 1)
    lateral = _lateral(points, column, LEGS, LEAST_PAIRS) if lateral is None else lateral
    waist, feet = (_mean(points, column, _both(places)) for places in (WAIST, (*TOES, *HEELS)))
    known = [step for side in "LR" if (step := _along(points, column, side)) is not None]
    if lateral is None or waist is None or feet is None or not known:
        return None
    across = np.cross(_unit(lateral), _unit(waist - feet))
    return np.stack([(across * step).sum(-1) for step in known])


def _centres_forward(points: np.ndarray, column: dict[str, int]) -> np.ndarray | None:
    """Return (n, F) sines of knees and noses in front of the body, those of bends that show; None where none does."""
    found = []
    hips, shoulders = _lateral(points, column, ("FWT",), 1), _lateral(points, column, ("SHO",), 1)
    if hips is not None:
        for side in "LR":
            leg = [side + place for place in ("FWT", "KNE", "ANK")]
            if set(leg) <= column.keys():
                hip, knee, ankle = (points[:, column[name]] for name in leg)
                along, bend = _unit(hip - ankle), knee - ankle
                bend = bend - (bend * along).sum(-1, keepdims=True) * along
                bent = np.linalg.norm(bend, axis=-1) > BENT * np.linalg.norm(hip - ankle, axis=-1)
                found.append(np.where(bent, (np.cross(_unit(hips), along) * _unit(bend)).sum(-1), np.nan))
    if shoulders is not None and "~nose" in column:
        base = _mean(points, column, [name for name in ("~left_ear", "~right_ear") if name in column])
        base = _mean(points, column, [name for name in ("~neck", "=neck") if name in column]) if base is None else base
        if base is not None:
            across = np.cross(_unit(shoulders), [0.0, 0.0, 1.0])
            found.append((across * _unit(points[:, column["~nose"]] - base)).sum(-1))
    return np.stack(found) if found else None


def _lateral(points: np.ndarray, column: dict[str, int], places: Sequence[str], least: int) -> np.ndarray | None:
    """Return (F, 3) metres from the right to the left, the mean of pairs; None where there are too few."""
    there = [place for place in places if {"L" + place, "R" + place} <= column.keys()]
    pairs = [(column["L" + place], column["R" + place]) for place in there]
    if len(pairs) < least:
        return None
    return np.mean([points[:, left] - points[:, right] for left, right in pairs], axis=0)


def _middle(points: np.ndarray, column: dict[str, int], places: Sequence[str]) -> np.ndarray | None:
    """Return (F, 3) the middle of pairs of places; None without any."""
    there = [place for place in places if {"L" + place, "R" + place} <= column.keys()]
    return _mean(points, column, _both(there)) if there else None


def _along(points: np.ndarray, column: dict[str, int], side: str) -> np.ndarray | None:
    """Return (F, 3) unit directions from a foot's heel to its toes; None without both."""
    toes, heel = (_mean(points, column, [side + place for place in places]) for places in (TOES, HEELS))
    return None if toes is None or heel is None else _unit(toes - heel)


def _mean(points: np.ndarray, column: dict[str, int], names: Sequence[str]) -> np.ndarray | None:
    """Return (F, 3) means of the places that are there; None where none is."""
    chosen = [column[name] for name in names if name in column]
    return points[:, chosen].mean(axis=1) if chosen else None


def _both(places: Sequence[str]) -> list[str]:
    return [side + place for side in "LR" for place in places]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def _usual(values: np.ndarray, share: float = 0.5) -> float:
    """Return the quantile of what is known; 1 where nothing is."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if known.size else 1.0
