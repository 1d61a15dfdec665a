"""Cameras and detections that agree: calibrations as they are meant, one frame rate, and rows of one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.calibration_fit import AGREES, CalibrationFit
from solver_backend.agreement.camera_assignment import assigned_by_views
from solver_backend.agreement.detections import Detections
from solver_backend.agreement.picture_flips import find_flip, flipped
from solver_backend.agreement.rates_by_length import rates_by_length
from solver_backend.agreement.resampled import at_one_rate
from solver_backend.agreement.unlike_views import ViewReading, explain_unlike, views_match
from solver_backend.cameras.camera_corrections import corrected
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.solve_settings import SYNC_OFF
from solver_backend.io.calibration.as_meant import as_fitted, as_meant, fit_as_meant
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.captures.frame_rates import of_the_take, other_rates, stated_ratios
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.start_times import InTime, as_numbered, bring_to_one_time
from solver_backend.io.recognition.up_axis import rotation_to_z_up


@dataclass(frozen=True)
class Agreeing:
    """What a recording is solved from."""

    calibration: Calibration
    """As it is meant."""
    in_time: InTime
    """Detections at moments that cameras recorded together."""
    resampled: tuple[bool, ...]
    """Of each camera, whether its rows are no longer the frames of its video."""
    problems: tuple[Diagnostic, ...] = ()
    """What was done to detections and their frame rates."""


def bring_to_agreement(
    calibration: Calibration, detections: Detections, fps: float, rates: Sequence[float | None], options: ReadOptions
) -> Agreeing:
    """Return calibration and detections that agree as far as anything explains why they do not.

    One camera alone agrees with itself. A number of frames may be that of another rate. Pictures that are flipped in
    all views come next. Cameras that match as they are stay. Else cameras may bear each other's names; else the
    calibration is read as the views in step show; else other frame rates and readings are tried at all offsets. Offsets
    are found last.

    Args:
        calibration: of C cameras.
        detections: of the same, each from its own first frame where frames differ.
        fps: frames a second of the take.
        rates: (C,) frames a second that the videos state, None where they state nothing.
        options: how the capture is read.

    Raises:
        JobInvalid, NotSynchronised, FrameCountMismatch: see ``bring_to_one_time``.
    """
    if len(detections.cameras) == 1:
        return Agreeing(calibration, InTime(detections), (False,))
    ratios, problems = np.ones(len(detections.cameras)), ()
    searched = not (options.as_calibrated or options.offset or options.sync == SYNC_OFF)
    fit, flips, written = None, (), calibration
    if searched and (stated_ratios(rates, fps) == 1).all():
        relative = rates_by_length(calibration.cameras, detections, as_numbered(detections, options))
        detections, ratios, problems = _at_one_rate(detections, relative, fps, options)
    if not options.as_calibrated:
        detections, fit, flips = _unflipped(calibration, detections, options)
    in_step = fit is not None and fit.written >= AGREES
    if not in_step:
        calibration = _unexchanged(calibration, fit, detections, options)
    known = in_step or calibration is not written or (ratios != 1).any()
    if not known and not views_match(calibration.cameras, detections):
        ratios = stated_ratios(rates, fps)
        if (ratios != 1).any():
            problems = other_rates(detections, ratios, fps, is_open=False)
            detections = at_one_rate(detections, ratios.tolist())
        elif searched and fit is not None:
            calibration, relative = _explained(calibration, fit, detections, options)
            detections, ratios, problems = _at_one_rate(detections, relative, fps, options)
    in_time = bring_to_one_time(calibration.cameras, detections, fps, options)
    if fit is not None and calibration is written and not in_time.first_rows and (ratios == 1).all():
        calibration = as_fitted(calibration, fit)  # of the same rows
    elif not options.as_calibrated:
        calibration = as_meant(calibration, in_time.detections, options.up_axis)
    return Agreeing(calibration, in_time, tuple((ratios != 1).tolist()), flips + problems)


def _at_one_rate(
    detections: Detections, relative: np.ndarray, fps: float, options: ReadOptions
) -> tuple[Detections, np.ndarray, tuple[Diagnostic, ...]]:
    """Return the detections at the take's rate, (C,) frames of each camera for one of it, and what is to be known.

    Args:
        detections: of C cameras.
        relative: (C,) frames of each for one of any of them, as the views show.
        fps: frames a second of the take.
        options: how the capture is read.
    """
    ratios, is_open = of_the_take(relative)
    if (ratios == 1).all():
        return detections, ratios, ()
    problems = other_rates(detections, ratios, fps, is_open=is_open and options.fps is None)
    return at_one_rate(detections, ratios.tolist()), ratios, problems


def _unflipped(
    calibration: Calibration, detections: Detections, options: ReadOptions
) -> tuple[Detections, CalibrationFit, tuple[Diagnostic, ...]]:
    """Return the detections with what is flipped in all views undone, how they fit in step, and what is wrong."""
    in_step = as_numbered(detections, options)
    fit = fit_as_meant(calibration, in_step, options.up_axis)
    found = find_flip(fit, in_step, calibration.cameras)
    if found.flip is None:
        return detections, fit, (diagnostic("person_mirrored"),) if found.is_mirrored else ()
    detections = flipped(detections, found.flip, found.image_size)
    fit = fit_as_meant(calibration, as_numbered(detections, options), options.up_axis)
    return detections, fit, (diagnostic("detections_corrected", found=found.flip.meaning()),)


def _unexchanged(
    calibration: Calibration, fit: CalibrationFit | None, detections: Detections, options: ReadOptions
) -> Calibration:
    """Return the calibration with cameras that bear each other's names exchanged, as it is where none do.

    A ring of cameras that bear their neighbours' names nearly agrees, better so under a wrong reading. So exchanges
    come first; those that only show under a reading are found with it.
    """
    if fit is None or options.offset:
        return calibration
    names, rows = calibration.cameras.names, as_numbered(detections, options)
    as_it_is = list(range(len(names)))
    order = assigned_by_views(calibration.cameras, rows, None)
    if order in (None, as_it_is) and fit.changed:
        order = assigned_by_views(calibration.cameras, rows, None, fit.corrections)
    if order is None or order == as_it_is:
        return calibration
    swapped = calibration.cameras.subset(order)
    others = {name: names[i] for i, name in zip(order, names, strict=True) if names[i] != name}
    pairs = [f"{name} is the calibration's {other}" for name, other in others.items()]
    exchanged = diagnostic("camera_names_exchanged", cameras=list(others), pairs=pairs)
    return replace(
        calibration,
        cameras=replace(swapped, names=names),
        size_known=tuple(calibration.size_known[i] for i in order),
        problems=(*calibration.problems, exchanged),
    )


def _explained(
    calibration: Calibration, fit: CalibrationFit, detections: Detections, options: ReadOptions
) -> tuple[Calibration, np.ndarray]:
    """Return the calibration, and frames of each camera for one of any of them, under which all views match."""
    ratios = np.ones(len(detections.cameras))
    if fit.changed:
        return as_fitted(calibration, fit), ratios
    to_world = rotation_to_z_up(options.up_axis or "z")
    in_file = replace(calibration.cameras, R=calibration.cameras.R @ to_world)
    readings = explain_unlike(in_file, detections)
    if readings is None:
        return calibration, ratios
    if (found := _corrected(detections.cameras, readings)) is not None:
        cameras = corrected(in_file, [reading.correction for reading in readings])
        cameras = replace(cameras, R=cameras.R @ to_world.T)
        rolls = tuple(reading.correction.turn for reading in readings)
        calibration = replace(calibration, cameras=cameras, rolls=rolls, problems=(*calibration.problems, found))
    return calibration, np.array([reading.rate for reading in readings])


def _corrected(names: Sequence[str], readings: Sequence[ViewReading]) -> Diagnostic | None:
    """Return what was corrected in the calibration, None where nothing was."""
    meanings: dict[str, list[str]] = {}
    for name, reading in zip(names, readings, strict=True):
        if reading.correction.changes:
            meanings.setdefault(reading.correction.meaning(), []).append(name)
    if not meanings:
        return None
    parts = [f"{meaning} ({', '.join(cameras)})" for meaning, cameras in meanings.items()]
    changed = [name for named in meanings.values() for name in named]
    return diagnostic("calibration_corrected", result="never", cameras=changed, meanings="; ".join(parts))
