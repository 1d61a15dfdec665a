"""Find the up axis and the length unit of a marker file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.agreement.body_evidence import POSSIBLE_M
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.geometry.arrays import quantile
from solver_backend.io.units_and_axes import METRES, UP_AXES, metres_in, rotation_to_z_up, unit_named

CLEAR = 1.5
"""Ratio of two lengths that chance does not explain: of a standing body along two axes, and of a person's size beyond
the limits of people. Crouching people and cameras that look down by 30 degrees stay below it."""
FLOOR_M = 0.3  # Largest distance in metres of feet or a lying person from the floor, also on slopes and stairs.
BELOW_M = 0.05  # Largest depth in metres of markers under an inaccurate floor.
_USUAL = ("y", "z")  # Usual up axes. A person along another axis may lie.

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
"""Label patterns of feet, knees, pelvis and upper body. Head, shoulders and lower chest are for an upper body alone."""
_COMPARED = {
    (3, 0): (0.5, 1.4, 2.5), (3, 2): (0.2, 0.5, 1.2), (2, 0): (0.3, 0.9, 1.5), (1, 0): (0.15, 0.4, 0.8),
    (4, 6): (0.15, 0.4, 0.7), (4, 5): (0.07, 0.2, 0.4), (5, 6): (0.05, 0.2, 0.4),
}  # fmt: skip
"""Pairs of levels, the most reliable first, and their smallest, usual and largest distance in metres. The smallest is
of a crouching child. The knees of a sitting person are as high as the pelvis."""


@dataclass(frozen=True)
class Recognised:
    """The up axis or the length unit of a file."""

    name: str  # Key of ``UP_AXES`` or ``METRES``.
    note: Diagnostic  # Note on how it was found.
    problem: Diagnostic | None = None  # Problem with the file's statement, None if there is none.

    @property
    def metres(self) -> float:
        """Metres per length unit of the file."""
        return METRES[self.name]


def find_up_axis(
    positions: np.ndarray, labels: Sequence[str], stated: str, given: str | None, default: str
) -> Recognised:
    """Find the up axis of marker positions.

    The axis ``given`` by the user wins. Next is the axis along which a body stands with its feet at 0, unless the
    person may be lying. Then the stated axis and the default follow.

    Args:
        positions: (F, M, 3) positions in metres, NaN where missing.
        stated: up axis that the file states, or an empty text.
        default: most common up axis of the format.
    """
    if given is not None:
        rotation_to_z_up(given)
        return _axis(given.lower().lstrip("+"), "given")
    positions, expected = positions[:: max(1, len(positions) // 500)], stated or default
    raised, apart, (least, _, most) = raised_part(positions, labels)
    # The labels of two parts may belong to two people, or to a prop.
    body = _standing_along(positions, raised if least / CLEAR <= apart <= most * CLEAR else None)
    if body is None or body == expected or _may_lie(positions, expected, body):
        if stated:
            return _axis(stated, "file")
        if body == expected:
            return _axis(expected, "body")
        ends = {axis: (_lowest(positions, axis), _lowest(positions, axis, 0.98)) for axis in UP_AXES}
        above = [axis for axis, (low, high) in ends.items() if -BELOW_M < low < FLOOR_M and high > 2 * FLOOR_M]
        return _axis(above[0], "floor") if len(above) == 1 else _axis(expected, "kind")
    feet_at_zero = abs(_lowest(positions, body)) < FLOOR_M
    afloat = not abs(_lowest(positions, expected)) <= FLOOR_M  # a person in a handstand has the hands at 0
    if not stated and (feet_at_zero or afloat or body.lstrip("-") != expected.lstrip("-")):
        doubted = not feet_at_zero and body.lstrip("-") not in _USUAL
        problem = diagnostic("up_axis_doubted", conflict="unusual", along=body.upper()) if doubted else None
        return _axis(body, "body", problem)
    conflict = "corrected" if feet_at_zero else "stated"
    doubt = diagnostic("up_axis_doubted", stated=expected.upper(), along=body.upper(), conflict=conflict)
    return _axis(body, "corrected", doubt) if feet_at_zero else _axis(expected, "file" if stated else "kind", doubt)


def _axis(name: str, source: str, problem: Diagnostic | None = None) -> Recognised:
    return Recognised(name, diagnostic("up_axis_read", source=source, axis=name.upper()), problem)


def _standing_along(positions: np.ndarray, raised: np.ndarray | None) -> str | None:
    """Return the signed axis from feet to head along which the body is clearly longest, otherwise None.

    Without labelled body parts, this is an axis of the box around all markers. The feet are at the end near 0.
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
    if sign[axis] == 0 or not length[axis] > CLEAR * np.delete(length, axis).max():
        return None
    return ("" if sign[axis] > 0 else "-") + "xyz"[axis]


def raised_part(
    positions: np.ndarray, labels: Sequence[str]
) -> tuple[np.ndarray | None, float, tuple[float, float, float]]:
    """Return vectors (F, 3) between two labelled body parts, their median length, and its limits in humans, metres.

    The vectors point upwards in a standing person. Without two labelled parts the vectors are None, and the length is
    NaN.
    """
    frames = positions[:: max(1, len(positions) // 500)]
    names = [re.sub(r"[^A-Z0-9]", "", label.rpartition(":")[2].upper()) for label in labels]
    levels = [[i for i, name in enumerate(names) if level.fullmatch(name)] for level in _LEVELS]
    for (a, b), length in _COMPARED.items():
        if levels[a] and levels[b]:
            high, low = (quantile(frames[:, levels[k]], 0.5, 1, "nearest") for k in (a, b))
            apart = float(quantile(np.linalg.norm(high - low, axis=-1), 0.5, 0, "nearest"))
            return high - low, apart, length
    return None, np.nan, (0.0, 1.0, np.inf)


def _lowest(positions: np.ndarray, axis: str, share: float = 0.01) -> float:
    with np.errstate(invalid="ignore"):  # missing markers
        heights = positions @ rotation_to_z_up(axis)[2]
    return float(quantile(heights.ravel(), share, 0, "nearest"))


def _may_lie(positions: np.ndarray, axis: str, body: str) -> bool:
    """Return whether a body along the axis ``body`` may lie on the floor of a world with the up axis ``axis``."""
    low = _lowest(positions, axis) > -BELOW_M and _lowest(positions, axis, 0.75) < FLOOR_M
    return low and not -BELOW_M < _lowest(positions, body) < FLOOR_M


SPREADS_M = (0.03, 30.0)  # Range of the marker spread in metres. Outside it, the stated unit is wrong.


def spread(positions: np.ndarray) -> float:
    """Return the longest side of the box around most markers (median over frames), NaN without markers."""
    frames = positions[:: max(1, len(positions) // 200)]
    sides = quantile(frames, 0.9, 1, "nearest") - quantile(frames, 0.1, 1, "nearest")
    return float(quantile(sides.max(axis=-1), 0.5, 0, "nearest"))


def find_unit(
    positions: np.ndarray, stated: str, given: str | None, default: str, labels: Sequence[str] = ()
) -> Recognised:
    """Find the length unit of marker positions.

    The unit ``given`` by the user wins, then the unit of the file. The unit of the file is rejected if the marker
    spread is outside ``SPREADS_M``, or if the distance between labelled body parts is not human. Then the unit that
    gives a human size is used.

    Args:
        positions: (F, M, 3) positions in the unit of the file.
        stated: name of the unit in the file, or an empty text.
        default: most common unit of the format.
    """
    if given is not None:
        metres_in(given)
        return _unit(given, "given")
    size = spread(positions)
    name = unit_named(stated)
    _, apart, (least, usual, most) = raised_part(positions, labels)

    def fits(unit: str, spreads: tuple[float, float], factor: float = 1.0) -> bool:
        body = not np.isfinite(apart) or least / factor <= apart * METRES[unit] <= most * factor
        return spreads[0] <= size * METRES[unit] <= spreads[1] and body

    if name is not None and (not size > 0 or fits(name, SPREADS_M, CLEAR)):
        return _unit(name, "file")
    units = (default, "mm", "m", "cm")
    if np.isfinite(apart):  # an adult in inches resembles a crouching person in centimetres
        units = tuple(sorted(METRES, key=lambda unit: abs(np.log(max(apart, 1e-9) * METRES[unit] / usual))))
    for other in dict.fromkeys(units):
        if fits(other, (POSSIBLE_M[0] / CLEAR**2, POSSIBLE_M[1] * CLEAR)):  # a small child may also sit
            if name is None:
                return _unit(other, "spread", spread=size)
            problem = diagnostic("marker_unit_not_as_stated", stated=name, spread=size * METRES[name], unit=other)
            return _unit(other, "corrected", problem)
    if name is None:
        return _unit(default, "kind")
    return _unit(name, "file", diagnostic("marker_spread_unlikely", likely="file", spread=size * METRES[name]))


def _unit(name: str, source: str, problem: Diagnostic | None = None, **values: Any) -> Recognised:
    return Recognised(name, diagnostic("unit_read", source=source, unit=name, **values), problem)
