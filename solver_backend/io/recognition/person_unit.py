"""The unit of a calibration by the person who stands in it: nobody is 0.17 m tall, nor 69 m."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections, compared_keypoints, main_person, well_seen_frames
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.recognition.length_unit import METRES
from solver_backend.io.recognition.world_check import LEG_SHARE
from solver_backend.types import Cameras

STATURES_M = (1.25, 2.15)
"""A unit is taken where it makes the person so tall."""
POSSIBLE_M = (0.6, 2.9)
"""Children and giants: with such a person the unit that the cameras' distance shows stays."""
MEAN_STATURE_M = 1.7
ARRAY_M = 6.0
"""Width that cameras are given to triangulate, whose limits are in metres."""
OFF_LINE = 0.05
"""Median residual over the person's extent up to which views agree."""
_UNITS = ("m", "cm", "mm", "inch")
"""Each makes a person of another one impossible. A foot does not: 5.8 of them are 5.8 squares of a board, or of what
structure from motion counts in."""


@dataclass(frozen=True)
class PersonUnit:
    """Cameras in the unit that the person shows."""

    cameras: Cameras
    """In metres, where a known unit explains the person."""
    to_plausible: float = 1.0
    """Factor by which people in these cameras are found: 1 where the person has a possible size."""
    problems: tuple[Diagnostic, ...] = ()
    """What was corrected."""


def unit_by_person(cameras: Cameras, detections: Detections, guessed: str = "") -> PersonUnit:
    """Return cameras in the unit that makes the person possible.

    Args:
        cameras: in metres as far as their calibration shows.
        detections: of everybody; the largest person of each picture counts, if the views agree on that one.
        guessed: the unit that the calibration was read in, where only the cameras' distance suggests it; '' where it is
            known, and stays.
    """
    stature = stature_between(cameras, detections)
    if not np.isfinite(stature) or POSSIBLE_M[0] <= stature <= POSSIBLE_M[1]:
        return PersonUnit(cameras)
    factors = {unit: METRES[unit] / METRES[guessed] for unit in _UNITS} if guessed else {}
    fitting = [unit for unit, factor in factors.items() if STATURES_M[0] <= stature * factor <= STATURES_M[1]]
    if len(fitting) != 1:
        return PersonUnit(cameras, MEAN_STATURE_M / stature)
    (unit,) = fitting
    found = diagnostic("unit_by_person", unit=unit, stature=stature * factors[unit], read=stature, guessed=guessed)
    return PersonUnit(replace(cameras, t=cameras.t * factors[unit]), problems=(found,))


def stature_between(cameras: Cameras, detections: Detections) -> float:
    """Return the main person's stature by the legs in the cameras' unit, NaN where the views agree on nobody.

    Args:
        cameras: C cameras in any unit.
        detections: of everybody.
    """
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    scaled, scale = in_a_room(cameras)
    if len(frames) == 0 or not np.isfinite(scale):
        return float("nan")
    found = triangulate(scaled, xy[:, frames], confidence[:, frames])
    points, residual = np.asarray(found.points), np.asarray(found.residual_px)
    seen = np.where((confidence > 0)[..., None], xy, np.nan)[:, frames]
    extent = np.linalg.norm(np.nanmax(seen, axis=2) - np.nanmin(seen, axis=2), axis=-1)
    off = residual / extent[..., None]
    if not np.isfinite(off).any() or np.nanmedian(off) > OFF_LINE:
        return float("nan")
    columns, _ = compared_keypoints(detections.joint_set)
    names = [detections.joint_set.keypoints[c] for c in columns]
    return sum(_length(points, names, *ends) for ends in (("hip", "knee"), ("knee", "ankle"))) / LEG_SHARE / scale


def _length(points: np.ndarray, names: list[str], upper: str, lower: str) -> float:
    """Return the median length of a bone of both sides."""
    lengths = [
        np.linalg.norm(points[:, names.index(f"{side}_{upper}")] - points[:, names.index(f"{side}_{lower}")], axis=-1)
        for side in ("left", "right")
    ]
    both = np.concatenate(lengths)
    return float(np.nanmedian(both)) if np.isfinite(both).any() else float("nan")


def in_a_room(cameras: Cameras) -> tuple[Cameras, float]:
    """Return cameras of any unit as wide apart as those of a room, with the factor; NaN where they are one place."""
    width = float(np.linalg.norm(np.ptp(cameras.centres, axis=0)))
    if not width > 0:
        return cameras, float("nan")
    return replace(cameras, t=cameras.t * ARRAY_M / width), ARRAY_M / width


def in_persons_unit(calibration: Calibration, detections: Detections, *, keep: bool) -> tuple[Calibration, float]:
    """Return the calibration in the unit that makes the person possible, and the factor by which people are found.

    Args:
        calibration: of the cameras of the detections.
        detections: in step.
        keep: leave the unit as it is.
    """
    found = unit_by_person(calibration.cameras, detections, "" if keep else calibration.guessed_unit)
    if not found.problems:
        return calibration, found.to_plausible
    notes = tuple(note for note in calibration.notes if note.code != "unit_read")
    problems = (*calibration.problems, *found.problems)
    return replace(calibration, cameras=found.cameras, notes=notes, problems=problems), 1.0
