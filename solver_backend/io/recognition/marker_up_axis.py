"""Find the up axis of a file of markers: given, stated, or inferred from the body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.geometry.arrays import quantile
from solver_backend.types import Cameras

UP_AXES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
}
"""Rotation from a world with the named axis up to ours with Z up."""


def rotation_to_z_up(up_axis: str) -> np.ndarray:
    """Return the (3, 3) rotation ``A`` with ``x_ours = A @ x_source``.

    Args:
        up_axis: the source's axis that points up: 'z', 'y', '-y' and so on, in any case.
    """
    axis = up_axis.lower().lstrip("+")
    if axis not in UP_AXES:
        raise JobInvalid(f"Unknown up axis '{up_axis}'. Known axes: {', '.join(UP_AXES)}.", where="up_axis")
    return np.array(UP_AXES[axis], dtype=np.float64)


def with_up_axis(cameras: Cameras, up_axis: str) -> Cameras:
    """Return the cameras in a world rotated so that ``up_axis`` of the old one becomes Z.

    ``x_cam = R x_old + t = (R Aᵀ) x_new + t`` with ``x_new = A x_old``.
    """
    return replace(cameras, R=cameras.R @ rotation_to_z_up(up_axis).T)


METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}  # Metres in a unit.
UPRIGHT = 2.0  # Least length ratio of a standing body's axis to every other axis.
LEANING = 1.2  # The same in the axes of a camera that looks down by up to 40 degrees, without a floor at 0.
FLOOR_M = 0.3  # Largest height of a standing person's feet.
LYING_M = 0.4  # Largest height of a person on the floor.
PERSON_FACTOR = 2.0
"""By so much less and more than people's may two parts of a body be apart, for a person who is coiled up, of two
people, and the tallest in a unit that is not far off. Units taken for another are mostly ten times as large."""
MARKER_M = (-0.05, 0.12)
"""Height of the lowest markers of feet on the floor, where a person may also lie along the axis."""
_USUAL = ("y", "z")  # Axes that point up in nearly all files: who is long along another one may lie.

_LEVELS = tuple(
    re.compile(rf"([LR]|LEFT|RIGHT)?({words})(L|R|LEFT|RIGHT)?")
    for words in (
        "TOE|TOES|TOEBASE|HEE|HEEL|ANK|ANKLE|CAL|CALC|MT[125]|MT[15]P|MMAL|LMAL|5META|FOOT|HALLUX|HLX|BIGTOE",
        "KNE|KNEE|MKNE|LKNE|KJC|LEG|LOWERLEG|SHIN",
        "ASI|ASIS|PSI|PSIS|SACR|SACRUM|FWT|BWT|HIP|HIPS|PELVIS|MIDHIP|UPLEG|UPPERLEG|HJC|SPINEBASE",
        "(F|B|FR|TOP)?(HD|HEAD|HEA|SHO|SHOULD|SHOULDER|ACR|ACROMION)|CLAV|STRN|STERN|STERNUM|C7|T8|T10|IJ|PX|NOSE|NECK|"
        "UPPERARM|SJC",
        "(F|B|FR|TOP)?(HD|HEAD|HEA)|NOSE|ARIEL",
        "SHO|SHOULD|SHOULDER|ACR|ACROMION|CLAV|C7|IJ|NECK|SJC",
        "STRN|PX|XIPH|XIPHOID|T8|T10|T12",
    )
)
"""Labels of feet, knees, pelvis, and of head, shoulders and chest, and of an upper body alone head, shoulders and lower
chest."""
_COMPARED = {
    (3, 0): (0.5, 1.4, 2.5), (3, 2): (0.2, 0.5, 1.2), (2, 0): (0.3, 0.9, 1.5), (1, 0): (0.15, 0.4, 0.8),
    (4, 6): (0.15, 0.4, 0.7), (4, 5): (0.07, 0.2, 0.4), (5, 6): (0.05, 0.2, 0.4),
}  # fmt: skip
"""Levels with compared heights, the surest first (sitting people have knees as high as the pelvis), and the metres of
their distance: the least of children of one metre, who may crouch, an adult's, and the most of the tallest."""


@dataclass(frozen=True)
class Recognised:
    """The up axis or the length unit of a file."""

    name: str  # A key of ``UP_AXES`` or ``METRES``.
    note: Diagnostic  # How it was found.
    problem: Diagnostic | None = None  # What is wrong with the file's own statement, None if nothing is.

    @property
    def metres(self) -> float:
        """Metres in the unit."""
        return METRES[self.name]


def find_up_axis(
    positions: np.ndarray, labels: Sequence[str], stated: str, given: str | None, default: str
) -> Recognised:
    """Return the axis of positions that points up.

    The user's axis wins. A body along another axis than the file states (or its format implies), with its feet at 0 of
    that axis, decides unless it may be a lying person.

    Args:
        positions: (F, M, 3) metres, NaN where missing.
        stated: the axis the file states, empty if none.
        default: the axis of most files of the format.
    """
    if given is not None:
        rotation_to_z_up(given)
        return _axis(given.lower().lstrip("+"), "given")
    positions, expected = positions[:: max(1, len(positions) // 500)], stated or default
    raised = _person_raised(positions, labels)
    # Who stands on the hands has them at 0.
    afloat = not abs(_lowest(positions, expected)) <= FLOOR_M
    leans = afloat and not stated and raised is not None
    body = _standing_along(positions, raised, LEANING if leans else UPRIGHT)
    if body is None or body == expected or _may_lie(positions, expected, body):
        if stated:
            return _axis(stated, "file")
        if body == expected:
            return _axis(expected, "body")
        floor = _above_floor(positions)
        if floor is not None:
            return _axis(floor, "floor")
        return _axis(expected, "kind")
    feet_at_zero = abs(_lowest(positions, body)) < FLOOR_M
    if not stated and (feet_at_zero or afloat or body.lstrip("-") != expected.lstrip("-")):
        doubted = not feet_at_zero and body.lstrip("-") not in _USUAL
        problem = diagnostic("up_axis_doubted", conflict="unusual", along=body.upper()) if doubted else None
        return _axis(body, "body", problem)
    against = partial(diagnostic, "up_axis_doubted", stated=expected.upper(), along=body.upper())
    if feet_at_zero:
        return _axis(body, "corrected", against(conflict="corrected"))
    if stated:
        return _axis(stated, "file", against(conflict="stated"))
    return _axis(expected, "kind", against(conflict="usual"))


def _axis(name: str, source: str, problem: Diagnostic | None = None) -> Recognised:
    return Recognised(name, diagnostic("up_axis_read", source=source, axis=name.upper()), problem)


def _standing_along(positions: np.ndarray, raised: np.ndarray | None, ratio: float) -> str | None:
    """Return the axis along which the body is this many times longer, with the sign of the head's end.

    Without a known part of the body, the box around the markers counts, and the end that is not at the level 0 that a
    floor has.
    """
    if raised is not None:
        up = quantile(raised, 0.5, 0, "nearest")
        length, sign = np.abs(up), np.nan_to_num(np.sign(up))
    else:
        box = quantile(positions, 0.95, 1, "nearest") - quantile(positions, 0.05, 1, "nearest")
        low, high = (quantile(positions.reshape(-1, 3), share, 0, "nearest") for share in (0.02, 0.98))
        length = quantile(box, 0.5, 0, "nearest")
        sign = (np.abs(low) < FLOOR_M).astype(float) - (np.abs(high) < FLOOR_M)
    length = np.nan_to_num(length)
    axis = int(np.argmax(length))
    if sign[axis] == 0 or not length[axis] > ratio * np.delete(length, axis).max():
        return None
    return ("" if sign[axis] > 0 else "-") + "xyz"[axis]


def _person_raised(positions: np.ndarray, labels: Sequence[str]) -> np.ndarray | None:
    """Return ``raised_part`` where its ends are as far apart as a person's are, within ``PERSON_FACTOR``.

    Labels of two parts may be of two people, or of a prop.
    """
    raised, (least, _, most) = raised_part(positions, labels)
    if raised is None:
        return None
    apart = float(quantile(np.linalg.norm(raised, axis=-1), 0.5, 0, "nearest"))
    return raised if least / PERSON_FACTOR <= apart <= most * PERSON_FACTOR else None


def raised_part(positions: np.ndarray, labels: Sequence[str]) -> tuple[np.ndarray | None, tuple[float, float, float]]:
    """Return (F, 3) vectors from a lower part of the body to a higher one, and people's least, usual and most metres.

    None without two such parts. Long takes are thinned.
    """
    frames = positions[:: max(1, len(positions) // 500)]
    names = [re.sub(r"[^A-Z0-9]", "", label.rpartition(":")[2].upper()) for label in labels]
    levels = [[i for i, name in enumerate(names) if level.fullmatch(name)] for level in _LEVELS]
    for (a, b), length in _COMPARED.items():
        if levels[a] and levels[b]:
            high, low = (quantile(frames[:, levels[k]], 0.5, 1, "nearest") for k in (a, b))
            return high - low, length
    return None, (0.0, 1.0, np.inf)


def _above_floor(positions: np.ndarray) -> str | None:
    """Return the only axis along which all markers are on one side of 0, from near it on."""
    ends = {axis: (_lowest(positions, axis), _lowest(positions, axis, 0.98)) for axis in UP_AXES}
    above = [axis for axis, (low, high) in ends.items() if MARKER_M[0] < low < FLOOR_M and high > 2 * FLOOR_M]
    return above[0] if len(above) == 1 else None


def _lowest(positions: np.ndarray, axis: str, share: float = 0.01) -> float:
    """Return the height below which this fraction of all markers is if the axis is up. NaN without seen markers."""
    with np.errstate(invalid="ignore"):  # markers that are not seen
        heights = positions @ rotation_to_z_up(axis)[2]
    return float(quantile(heights.ravel(), share, 0, "nearest"))


def _may_lie(positions: np.ndarray, axis: str, body: str) -> bool:
    """Return whether a person who is long along ``body`` may lie on the floor of a world with ``axis`` up."""
    low = MARKER_M[0] < _lowest(positions, axis) and _lowest(positions, axis, 0.75) < LYING_M
    return low and not MARKER_M[0] < _lowest(positions, body) < MARKER_M[1]


def metres_in(unit: str) -> float:
    """Return the metres in a unit.

    Raises:
        JobInvalid: the unit is unknown.
    """
    if unit not in METRES:
        hint = "For any other unit, such as squares of a board, give its length in metres with --scale."
        raise JobInvalid(f"Unknown unit '{unit}'. Known units: {', '.join(METRES)}.", where="unit", hint=hint)
    return METRES[unit]


SMALLEST_M, LARGEST_M = 0.03, 30.0
"""Markers that spread less or more than this over most frames were not recorded in the unit that the file states."""
PERSON_M = (0.25, 4.0)  # Spread of the markers of a person, in metres.
_STARTS = {"mm": "mm", "mil": "mm", "cm": "cm", "cen": "cm", "m": "m", "met": "m", "in": "inch", "f": "foot"}
"""Units by how their names begin: files have mm, Millimeters, METERS, mete, m, inches, ft."""


def unit_named(text: str) -> str | None:
    """Return the key of ``METRES`` for a unit in a file, None if it is unknown."""
    word = text.strip().lower()
    if word in METRES:
        return word
    starts = [start for start in _STARTS if word.startswith(start)]
    return _STARTS[max(starts, key=len)] if starts else None


def spread(positions: np.ndarray) -> float:
    """Return the largest side of the box around most markers, the median over frames. NaN where none are seen."""
    frames = positions[:: max(1, len(positions) // 200)]
    sides = quantile(frames, 0.9, 1, "nearest") - quantile(frames, 0.1, 1, "nearest")
    return float(quantile(sides.max(axis=-1), 0.5, 0, "nearest"))


def find_unit(
    positions: np.ndarray, stated: str, given: str | None, default: str, labels: Sequence[str] = ()
) -> Recognised:
    """Return the unit of positions.

    The user's unit wins, then the file's unless markers then spread over less than ``SMALLEST_M`` or more than
    ``LARGEST_M``, or the parts that labels name are no person's distance apart, then the unit in which they have a
    person's size.

    Args:
        positions: (F, M, 3) in the file's unit.
        stated: the file's word for it, empty if there is none.
        default: what the format's files are mostly in.
    """
    if given is not None:
        metres_in(given)
        return _unit(given, "given")
    size = spread(positions)
    name = unit_named(stated)
    raised, (least, usual, most) = raised_part(positions, labels)
    apart = np.nan if raised is None else float(quantile(np.linalg.norm(raised, axis=-1), 0.5, 0, "nearest"))

    def fits(unit: str, low: float, high: float, factor: float = 1.0) -> bool:
        body = not np.isfinite(apart) or least / factor <= apart * METRES[unit] <= most * factor
        return low <= size * METRES[unit] <= high and body

    if name is not None and not (size > 0 and not fits(name, SMALLEST_M, LARGEST_M, PERSON_FACTOR)):
        return _unit(name, "file")
    units = (default, "mm", "m", "cm")
    if np.isfinite(apart):  # inches of an adult are centimetres of one who crouches
        units = tuple(sorted(METRES, key=lambda unit: abs(np.log(max(apart, 1e-9) * METRES[unit] / usual))))
    for other in dict.fromkeys(units):
        if fits(other, *PERSON_M):
            if name is None:
                return Recognised(other, diagnostic("unit_read", source="spread", unit=other, spread=size))
            problem = diagnostic("marker_unit_not_as_stated", stated=name, spread=size * METRES[name], unit=other)
            return _unit(other, "corrected", problem)
    if name is not None:
        problem = diagnostic("marker_spread_unlikely", likely="file", spread=size * METRES[name])
        return _unit(name, "file", problem)
    return _unit(default, "kind")


def _unit(name: str, source: str, problem: Diagnostic | None = None) -> Recognised:
    return Recognised(name, diagnostic("unit_read", source=source, unit=name), problem)
