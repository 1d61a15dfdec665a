"""A calibration that was read, made what it is meant as: by the views, and by the person's size."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.agreement.calibration_fit import CalibrationFit, fit_calibration
from solver_backend.agreement.detections import Detections
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.recognition.person_unit import unit_by_person
from solver_backend.io.recognition.up_axis import rotation_to_z_up


def as_meant(calibration: Calibration, detections: Detections, up_axis: str | None = None) -> Calibration:
    """Return the calibration read as the views show it is meant, with what was corrected among its problems.

    Args:
        calibration: of the cameras of the detections.
        detections: in step.
        up_axis: axis of the file's world that was stated to point up.
    """
    return as_fitted(calibration, fit_as_meant(calibration, detections, up_axis))


def fit_as_meant(calibration: Calibration, detections: Detections, up_axis: str | None) -> CalibrationFit:
    """Return how the views show that a calibration is meant.

    Args: those of ``as_meant``.
    """
    return fit_calibration(calibration.cameras, detections, rotation_to_z_up(up_axis or "z"))


def as_fitted(calibration: Calibration, fit: CalibrationFit) -> Calibration:
    """Return the calibration as it is meant, with what was corrected among its problems.

    Args:
        calibration: as written.
        fit: of its cameras.
    """
    if not fit.changed:
        return calibration
    found = diagnostic(
        "calibration_corrected",
        result="shares",
        meanings=fit.meanings(),
        percent=100 * fit.agreement,
        percent_written=100 * fit.written,
    )
    rolls = tuple(correction.turn for correction in fit.corrections)
    return replace(calibration, cameras=fit.cameras, rolls=rolls, problems=(*calibration.problems, found))


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
