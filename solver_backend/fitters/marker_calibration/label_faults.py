"""Find and correct wrong labels and ghost points in a take, by comparison with the fitted body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.errors import MarkersMirrored
from solver_backend.fitters.marker_calibration.calibrate import varied_frames
from solver_backend.fitters.marker_calibration.person_doubts import mirror_image, over_takes
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_to_points, posed
from solver_backend.geometry.arrays import Array, quantile, to_numpy, true_runs
from solver_backend.geometry.marker_jumps import neighbours_of
from solver_backend.geometry.small_matrices import unit
from solver_backend.labelling.label_like import NameChange, NamesOverTakes, names_over_takes, with_exchanged
from solver_backend.residuals.terms import geman_mcclure
from solver_backend.types import MARKER_GHOST, MARKER_SWAPPED, MarkerCloud

WINDOW_S = 0.1  # Window in seconds for averaging hypotheses, because single frames are noisy.
SIGMA_M, SCALE = 0.02, 4.0  # Deviation per axis of a marker from its rough position, and robust scale in these.
GAIN = 3.0  # Smallest mean gain of a swap per marker over a window, in half squared deviations.
GHOST_M = 0.11  # Smallest distance between a ghost and the expected position.
MOST_NAMED = 5  # Largest number of markers with separate diagnostics. More share a cause and get one diagnostic.


@dataclass(frozen=True)
class LabelFault:
    """Wrong label in the frames from ``first`` to ``last``."""

    marker: int  # Column of the label.
    other: int  # Marker that it was swapped with, or the same one for a ghost.
    first: int
    last: int


@dataclass(frozen=True)
class CleanedLabels:
    """Markers of a take with corrected labels."""

    points: np.ndarray  # (F, M, 3) metres, NaN where missing or excluded as a ghost.
    flags: np.ndarray  # (F, M) uint8 flags ``MARKER_SWAPPED`` and ``MARKER_GHOST``.
    faults: tuple[LabelFault, ...]  # In order of the first frame.


def clean_labels(
    points: np.ndarray, expected: np.ndarray, around: np.ndarray, tested: np.ndarray, fps: float
) -> CleanedLabels:
    """Correct swapped labels, and exclude ghost points.

    For two neighbours a and b, ``g(t) = ρ(x_a - y_a) + ρ(x_b - y_b) - ρ(x_a - y_b) - ρ(x_b - y_a)`` is the gain from a
    label swap, where ρ is a robust square. The labels are swapped if the mean of g over a window is large. If only one
    of the two markers is visible, it gets the other label.

    Args:
        points: (F, M, 3) measured markers x in metres, NaN where missing.
        expected: (F, M, 3) the same markers y on the body.
        around: (M, n) neighbours of each marker.
        tested: (M,) bool, true for labels that may be wrong.
    """
    points, flags, faults = points.copy(), np.zeros(points.shape[:2], np.uint8), []
    shifted = expected + shared_error(points - expected, around)
    pairs = {(min(a, b), max(a, b)) for a in np.flatnonzero(tested) for b in around[a]}
    gains = {pair: _gain(points, shifted, *pair) for pair in pairs}
    half = max(1, round(0.5 * WINDOW_S * fps))
    for a, b in sorted(pairs, key=lambda pair: -gains[pair].sum(where=gains[pair] > 0)):
        gain = _gain(points, shifted, a, b) / np.maximum(np.isfinite(points[:, [a, b], 0]).sum(-1), 1)
        for first, last in true_runs(_smoothed(gain, half) > GAIN):
            first, last = _trimmed(gain, first, last)
            if last < first:
                continue
            stretch = slice(first, last + 1)
            points[stretch, [a, b]] = points[stretch, [b, a]]
            flags[stretch, a] |= MARKER_SWAPPED
            flags[stretch, b] |= MARKER_SWAPPED
            faults.append(LabelFault(int(a), int(b), first, last))
    off = np.linalg.norm(points - shifted, axis=-1)
    ghosts = (np.nan_to_num(off) > GHOST_M) & tested
    for m in np.flatnonzero(ghosts.any(axis=0)):
        faults += [LabelFault(int(m), int(m), first, last) for first, last in true_runs(ghosts[:, m])]
    points[ghosts] = np.nan
    flags[ghosts] |= MARKER_GHOST
    return CleanedLabels(points, flags, tuple(sorted(faults, key=lambda fault: (fault.first, fault.marker))))


def shared_error(off: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Estimate the error (F, M, 3) in metres of the fitted body near each marker, 0 where unknown.

    It is the median of the errors ``off`` (F, M, 3) of the neighbours ``around`` (M, n) of the marker.
    """
    ordered = np.sort(off[:, around], axis=2)  # (F, M, n, 3). Missing values come last
    count = np.maximum(np.isfinite(ordered).sum(axis=2, keepdims=True), 1)
    middle = [np.take_along_axis(ordered, place, 2) for place in ((count - 1) // 2, count // 2)]
    return np.nan_to_num(0.5 * (middle[0] + middle[1])[:, :, 0])


def _gain(points: np.ndarray, expected: np.ndarray, a: int, b: int) -> np.ndarray:
    straight = _misfit(points[:, a] - expected[:, a]) + _misfit(points[:, b] - expected[:, b])
    return straight - _misfit(points[:, a] - expected[:, b]) - _misfit(points[:, b] - expected[:, a])


def _misfit(off: np.ndarray) -> np.ndarray:
    """Return half the robust squares (F,) of errors (F, 3), 0 where an error is missing."""
    squared = (off * off).sum(-1) / SIGMA_M**2
    return 0.5 * geman_mcclure(np.nan_to_num(squared), SCALE)[0]


def _smoothed(gain: np.ndarray, half: int) -> np.ndarray:
    total = np.concatenate([[0.0], np.cumsum(gain)])
    index = np.arange(len(gain))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(gain))
    return (total[high] - total[low]) / (high - low)


def _trimmed(gain: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Extend a range by adjacent frames with a positive swap gain, and remove end frames without a positive gain."""
    while first > 0 and gain[first - 1] > 0:
        first -= 1
    while last < len(gain) - 1 and gain[last + 1] > 0:
        last += 1
    while first <= last and gain[first] <= 0:
        first += 1
    while last >= first and gain[last] <= 0:
        last -= 1
    return first, last


def diagnose_labels(still: np.ndarray, faults: tuple[LabelFault, ...], labels: tuple[str, ...]) -> list[Diagnostic]:
    """Return warnings about stationary markers, given as an (F, M) mask, and about wrong labels."""
    found = [
        diagnostic("marker_still", markers=[labels[m]], frames=[run], remedy=Remedy.BRIDGED)
        for m in np.flatnonzero(still.any(axis=0))
        for run in true_runs(still[:, m])
    ]
    for fault in faults:
        frames = [(fault.first, fault.last)]
        if fault.marker == fault.other:
            ghost = [labels[fault.marker]]
            found.append(diagnostic("marker_ghost", markers=ghost, frames=frames, remedy=Remedy.BRIDGED))
        else:
            pair = sorted((labels[fault.marker], labels[fault.other]))
            found.append(diagnostic("markers_exchanged", markers=pair, frames=frames, remedy=Remedy.REPAIRED))
    return sorted(found, key=lambda item: (item.where.frames, item.where.markers))


def gathered(found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Merge warnings about ghost points or stationary markers if they concern more than ``MOST_NAMED`` markers."""
    items = list(found)
    for code in ("marker_ghost", "marker_still"):
        alike = [item for item in items if item.code == code]
        labels = list(dict.fromkeys(label for item in alike for label in item.where.markers))
        if len(labels) <= MOST_NAMED:
            continue
        frames = {frame for item in alike for a, b in item.where.frames for frame in range(a, b + 1)}
        there = np.isin(np.arange(max(frames) + 1), list(frames))
        several = diagnostic(code, markers=labels, frames=true_runs(there), remedy=alike[0].remedy)
        items = [several if item is alike[0] else item for item in items if item is alike[0] or item.code != code]
    return items


WAIST, SHOULDERS = ("FWT", "BWT", "MWT", "GTR"), ("SHO", "FSH", "BSH")
LEGS, ARMS = ("KNE", "KNM", "SHN", "TTB", "ANK", "ANM", "HEE", "TOE", "MT1", "MT5"), ("UPA", "ELB", "ELM")
TOES, HEELS = ("TOE", "MT1", "MT5"), ("HEE", "ANK", "ANM")
NEAR_BASE = {"legs": ("THI", "KNE", "KNM"), "arms": ARMS}  # Markers that stay on their side if limbs cross.
_CENTRES = "hip FWT, knee KNE, ankle ANK, heel HEE, foot TOE, big_toe TOE, shoulder SHO, elbow ELB"
OF_CENTRES = dict[str, str](map(str.split, _CENTRES.split(", ")))  # Skin markers that correspond to joint centres.
_SIDES = {"L": ("left", "right", 1.0), "R": ("right", "left", -1.0)}  # Side, other side, sign of its direction.
LEAST_PAIRS = 2  # Smallest number of marker pairs on a limb.
MIRRORED, CROSSED_M, SIDES_SHARE = -0.3, -0.05, 0.75
"""Limit for the median sine of the feet's direction, limit in metres for a quantile of how far the left leg is on the
left, and this quantile. In 45 recordings, the median sine exceeds 0.5, and the 0.75 quantile exceeds 0.12 m."""
INNER_M, FOOT_M = -0.015, 0.1
"""Smallest distance in metres of the outer ankle towards the outer side of the foot, and largest plausible one. In 160
recordings, 320 feet have 27 to 58 mm, except one (btkdata's ADemo1) with -4 mm."""
KNEE_BENT, KNEELS = 0.08, 0.3
"""Smallest distance of a bent knee from the line of hip and ankle, relative to its length (18 degrees), and of a knee
that shows the forward direction better than the foot (62 degrees), because kneeling feet point backwards."""
_SHIN = ("KNE", "KNM"), ("ANK", "ANM", "HEE")


def check_sides(points: np.ndarray, landmarks: Landmarks) -> None:
    """Check that left limbs are on the left, and that feet point forward.

    Let l point from right to left, u from feet to waist and f from heels to toes. Then ``(l × u) · f > 0``. For
    strongly bent knees and for joint centres without toes, f points from the line between hip and ankle to the forward
    knee. For other joint centres, it points from neck or ears to the nose. In addition, each limb is compared with the
    middle of the waist or shoulders, and each foot with its outer ankle marker.

    Raises:
        MarkersMirrored: a condition does not hold in most frames.
    """
    names = [_on_skin(name) for name in landmarks.names]
    column = {name: i for i, name in reversed(list(enumerate(names)))}
    for base, limb, which in ((WAIST, LEGS, "legs"), (SHOULDERS, ARMS, "arms")):
        own, beyond = (_lateral(points, column, places, least) for places, least in ((base, 1), (limb, LEAST_PAIRS)))
        if own is not None and beyond is not None and _usual((unit(own) * beyond).sum(-1), SIDES_SHARE) < CROSSED_M:
            raise _mirrored(
                f"The left markers of the {which} are on the right of the body. Their left and right labels are "
                "swapped.",
                f"of the {which}",
            )
        for side in "LR" if own is not None else "":
            _check_limb(points, column, base, [side + place for place in NEAR_BASE[which]], which[:-1])
    centres = tuple(names) != tuple(landmarks.names)
    forward = _feet_forward(points, column)
    if forward is None and centres:
        forward = _centres_forward(points, column)
    if forward is not None and _usual(forward) < MIRRORED:
        raise mirror_image("joint centres" if centres else "legs' markers")
    if not centres:
        _check_ankles(points, column)


def _mirrored(text: str, labels: str) -> MarkersMirrored:
    return MarkersMirrored(text, where="markers", hint=f"Swap L and R in the labels {labels}.")


def _check_limb(
    points: np.ndarray, column: dict[str, int], base: Sequence[str], names: Sequence[str], limb: str
) -> None:
    lateral, near = _lateral(points, column, base, 1), _mean(points, column, names)
    middle = _mean(points, column, _both([place for place in base if {"L" + place, "R" + place} <= column.keys()]))
    if lateral is None or middle is None or near is None:
        return
    own, other, sign = _SIDES[names[0][0]]
    if _usual(sign * (unit(lateral) * (near - middle)).sum(-1), SIDES_SHARE) < CROSSED_M:
        raise _mirrored(
            f"The markers of the {own} {limb} are on the {other} of the body. They belong to the {other} {limb}.",
            f"of this {limb}",
        )


def _check_ankles(points: np.ndarray, column: dict[str, int]) -> None:
    """Raise ``MarkersMirrored`` if the outer ankle marker is on the inner side of a foot.

    With u from ankle to knee, heel h and f from heel to toes, ``± (u × f) · (ankle - h) > 0`` for left and right.
    """
    for side, (own, other, sign) in _SIDES.items():
        foot = [side + place for place in ("ANK", "HEE", "TOE")]
        above = next((side + place for place in ("KNE", "SHN", "TTB", "KNM") if side + place in column), None)
        if above is None or not set(foot) <= column.keys():
            continue
        ankle, heel, toe = (points[:, column[name]] for name in foot)
        up, forward = points[:, column[above]] - ankle, toe - heel
        outwards = sign * (unit(np.cross(up, forward)) * (ankle - heel)).sum(-1)
        # Labels swapped within a foot, which are found later, put the ankle below the heel or nearer to the toes.
        sound = ((ankle - heel) * up).sum(-1) > 0.0
        sound &= np.linalg.norm(ankle - heel, axis=-1) < np.linalg.norm(ankle - toe, axis=-1)
        outwards = np.where(sound & (abs(outwards) < FOOT_M), outwards, np.nan)
        if _usual(outwards) < INNER_M:
            raise _mirrored(
                f"The outer ankle of the {own} leg is on the inner side of the foot. The markers belong to the "
                f"{other} leg, or an axis is reversed.",
                "of this leg, or export the take with right-handed axes",
            )


def _on_skin(name: str) -> str:
    side, _, part = name[1:].partition("_")
    if is_joint_centre(name) and part in OF_CENTRES:
        return side[0].upper() + OF_CENTRES[part]
    return name


def _feet_forward(points: np.ndarray, column: dict[str, int]) -> np.ndarray | None:
    """Return the sines (n, F) of the direction of each foot relative to waist and legs, positive forwards.

    The feet of kneeling legs point backwards, so legs with strongly bent knees are judged by the direction of the
    knees. Return None if waist, legs or feet lack markers.
    """
    lateral = _lateral(points, column, WAIST, 1)
    lateral = _lateral(points, column, LEGS, LEAST_PAIRS) if lateral is None else lateral
    waist, feet = (_mean(points, column, _both(places)) for places in (WAIST, (*TOES, *HEELS)))
    known = {side: step for side in "LR" if (step := _along(points, column, side)) is not None}
    if lateral is None or waist is None or feet is None or not known:
        return None
    across = np.cross(unit(lateral), unit(waist - feet))
    found = []
    for side, step in known.items():
        sine = (across * step).sum(-1)
        knee, ankle = (_mean(points, column, [side + place for place in places]) for places in _SHIN)
        if knee is not None and ankle is not None:
            bent = _knee_forward(lateral, waist, knee, ankle, KNEELS)
            sine = np.where(np.isfinite(bent), bent, sine)
        found.append(sine)
    return np.stack(found)


def _knee_forward(
    lateral: np.ndarray, hip: np.ndarray, knee: np.ndarray, ankle: np.ndarray, least: float
) -> np.ndarray:
    """Return the sines (F,) of the direction in which a knee bends, positive forwards, NaN for straight knees."""
    along, bend = unit(hip - ankle), knee - ankle
    bend = bend - (bend * along).sum(-1, keepdims=True) * along
    bent = np.linalg.norm(bend, axis=-1) > least * np.linalg.norm(hip - ankle, axis=-1)
    return np.where(bent, (np.cross(unit(lateral), along) * unit(bend)).sum(-1), np.nan)


def _centres_forward(points: np.ndarray, column: dict[str, int]) -> np.ndarray | None:
    """Return the sines (n, F) of the directions of bent knees and nose, positive forwards, or None without markers."""
    found = []
    hips, shoulders = _lateral(points, column, ("FWT",), 1), _lateral(points, column, ("SHO",), 1)
    if hips is not None:
        for side in "LR":
            leg = [side + place for place in ("FWT", "KNE", "ANK")]
            if set(leg) <= column.keys():
                hip, knee, ankle = (points[:, column[name]] for name in leg)
                found.append(_knee_forward(hips, hip, knee, ankle, KNEE_BENT))
    if shoulders is not None and "~nose" in column:
        base = _mean(points, column, [name for name in ("~left_ear", "~right_ear") if name in column])
        base = _mean(points, column, [name for name in ("~neck", "=neck") if name in column]) if base is None else base
        if base is not None:
            across = np.cross(unit(shoulders), [0.0, 0.0, 1.0])
            found.append((across * unit(points[:, column["~nose"]] - base)).sum(-1))
    return np.stack(found) if found else None


def _lateral(points: np.ndarray, column: dict[str, int], places: Sequence[str], least: int) -> np.ndarray | None:
    """Return the mean vectors (F, 3) in metres from right to left markers, or None for fewer than ``least`` pairs."""
    pairs = [(column["L" + p], column["R" + p]) for p in places if {"L" + p, "R" + p} <= column.keys()]
    if len(pairs) < least:
        return None
    return np.mean([points[:, left] - points[:, right] for left, right in pairs], axis=0)


def _along(points: np.ndarray, column: dict[str, int], side: str) -> np.ndarray | None:
    toes, heel = (_mean(points, column, [side + place for place in places]) for places in (TOES, HEELS))
    return None if toes is None or heel is None else unit(toes - heel)


def _mean(points: np.ndarray, column: dict[str, int], names: Sequence[str]) -> np.ndarray | None:
    chosen = [column[name] for name in names if name in column]
    return points[:, chosen].mean(axis=1) if chosen else None


def _both(places: Sequence[str]) -> list[str]:
    return [side + place for side in "LR" for place in places]


def _usual(values: np.ndarray, share: float = 0.5) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if known.size else 1.0


ELBOW_BENT = 0.35  # Smallest sine of a bend that counts. The elbow marker on a straight arm shows 0.3.
EXCHANGED = -0.3
"""Median cosine below which names are swapped. In 347 of 351 arms it is above 0.37
(docs/research-log/marker_files.md)."""
LEAST_FRAMES = 20  # Smallest number of frames with a bent elbow.
_SHOULDERS, _ELBOWS = (("SHO",), ("FSH", "BSH")), ("ELB", "ELM")


def exchanged_wrists(points: np.ndarray, places: Sequence[str]) -> list[tuple[int, int]]:
    """Find sides where the wrist labels WRA and WRB are swapped. Return the columns of these pairs.

    For every rotation of the hand, the thumb side of the wrist is within 90 degrees of the upper arm, measured across
    the forearm. If f points from elbow to wrist and u from elbow to shoulder, ``(x_A - x_B) · (u - (u · f) f) > 0``.
    ``points`` are (F, L, 3) in metres, NaN where missing.
    """
    column = {place: i for i, place in enumerate(places)}
    pairs: list[tuple[int, int]] = []
    for side in "LR":
        inner, outer = (column.get(side + place) for place in ("WRA", "WRB"))
        shoulders = (_mean(points, column, [side + name for name in names]) for names in _SHOULDERS)
        shoulder = next((found for found in shoulders if found is not None), None)
        elbow = _mean(points, column, [side + name for name in _ELBOWS])
        if inner is None or outer is None or shoulder is None or elbow is None:
            continue
        if _towards_upper_arm(points[:, inner], points[:, outer], shoulder, elbow) < EXCHANGED:
            pairs.append((inner, outer))
    return pairs


def with_wrists_named(clouds: Sequence[MarkerCloud], own: Mapping[str, str]) -> NamesOverTakes:
    """Correct swapped wrist labels in several takes. Return the corrected takes and a record of the changes."""
    takes, changes = list(clouds), list[NameChange]()
    for number, cloud in enumerate(clouds):
        labels = cloud.labels or ()
        known = name_markers([label for label in labels if not is_unnamed(label)], own).known
        for a, b in exchanged_wrists(cloud.positions, [known.get(label, "") for label in labels]):
            if {labels[a], labels[b]} & set(own):
                continue
            takes[number] = with_exchanged(takes[number], labels[a], labels[b])
            changes.append(NameChange(number, labels[a], labels[b], mended=True))
    return NamesOverTakes(tuple(takes), tuple(changes))


def _towards_upper_arm(inner: np.ndarray, outer: np.ndarray, shoulder: np.ndarray, elbow: np.ndarray) -> float:
    """Return the median cosine between the line of the wrist markers and the upper arm, measured across the forearm."""
    forearm = unit(0.5 * (inner + outer) - elbow)
    upper = shoulder - elbow
    across = upper - (upper * forearm).sum(-1, keepdims=True) * forearm
    size, line = np.linalg.norm(across, axis=-1), inner - outer
    cosine = (line * across).sum(-1) / np.maximum(size * np.linalg.norm(line, axis=-1), 1e-9)
    bent = np.isfinite(cosine) & (size > ELBOW_BENT * np.linalg.norm(upper, axis=-1))
    return float(quantile(cosine[bent], 0.5, axis=0)) if bent.sum() >= LEAST_FRAMES else 1.0


FRAMES = 16  # Number of varied frames compared before a person is calibrated.
OFF_M, EXCHANGE_LEAVES = 0.04, 0.3
"""Smallest RMS distance in metres of both markers from their positions, and largest share of it that may remain after a
swap."""
LEAST = 8  # Smallest number of frames that show both markers.


def exchanged_labels(problem: Problem, like: Array) -> list[tuple[int, int]]:
    """Find pairs of markers with swapped labels by fitting the average person.

    Markers known only by their bone have no expected position, so they are excluded.
    """
    subject = Subject.average(problem.body, problem.measurements.landmarks, like)
    frames = varied_frames(problem.measurements.points, FRAMES)
    states = fit_to_points(problem, subject, frames)
    found = to_numpy(pose(subject, posed(problem.prior, states)).points)
    on_skin = np.array([not name.startswith(ON_BONE) for name in problem.measurements.landmarks.names])
    return exchanged_throughout(np.where(on_skin[:, None], problem.measurements.points[frames], np.nan), found)


def exchanged_throughout(points: np.ndarray, expected: np.ndarray) -> list[tuple[int, int]]:
    """Find pairs of markers that are at each other's position in most frames.

    ``m(|x_a - y_b|² + |x_b - y_a|²) < s m(|x_a - y_a|² + |x_b - y_b|²)``, where m is the median over frames, and s is
    ``EXCHANGE_LEAVES``. The expected positions y are corrected by the body's error near each marker.
    """
    around = neighbours_of(points)
    shifted = expected + shared_error(points - expected, around)
    pairs = np.array(sorted({(min(a, b), max(a, b)) for a, near in enumerate(around) for b in near}))
    a, b = pairs[:, 0], pairs[:, 1]
    straight, crossed = (
        ((points[:, a] - shifted[:, i]) ** 2 + (points[:, b] - shifted[:, j]) ** 2).sum(-1) for i, j in ((a, b), (b, a))
    )
    compared = np.flatnonzero(np.isfinite(straight).sum(0) >= min(LEAST, len(points)))
    straight, crossed = (np.nanmedian(part[:, compared], axis=0) for part in (straight, crossed))
    wrong = (straight > 2 * OFF_M**2) & (crossed < EXCHANGE_LEAVES * straight)
    found: list[tuple[int, int]] = []
    for k in np.flatnonzero(wrong)[np.argsort(crossed[wrong] - straight[wrong])]:
        pair = int(a[compared[k]]), int(b[compared[k]])
        if not any(set(pair) & set(other) for other in found):
            found.append(pair)
    return found


def named_alike(
    clouds: Sequence[MarkerCloud], own: Mapping[str, str]
) -> tuple[tuple[MarkerCloud, ...], dict[str, Any]]:
    """Make labels consistent across takes. Return the corrected takes, and the changes for the provenance."""
    wrists = with_wrists_named(clouds, own)
    named = names_over_takes(wrists.clouds, own)
    return named.clouds, over_takes((*wrists.changes, *named.changes))
