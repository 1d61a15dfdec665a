"""Make cameras and detections agree: apply the explanation, one frame rate and one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.explain import Applied, Explanation, explain, turn_of_one_view
from solver_backend.agreement.reading import PictureReading, Reading, apply_reading
from solver_backend.agreement.resampled import at_one_rate, rates_by_length, rates_match
from solver_backend.agreement.starts import read_out_of_step
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.solve_settings import SYNC_OFF
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up
from solver_backend.io.recognition.start_times import InTime, as_numbered, bring_to_one_time
from solver_backend.types import Cameras

OTHER_RATE = 0.01  # Relative difference from which frame rates are not the same: 59.94 is 60.


def stated_ratios(rates: Sequence[float | None], fps: float) -> np.ndarray:
    """Return (C,) frames of each camera per frame of the take from the rates of the videos, None if unknown."""
    ratios = np.array([fps if rate is None or rate <= 0 else rate for rate in rates]) / fps
    differ = bool((np.abs(ratios / np.median(ratios) - 1) > OTHER_RATE).any())
    return np.where(differ & (np.abs(ratios - 1) > OTHER_RATE), ratios, 1.0)


def of_the_take(relative: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return (C,) frames of each camera per frame of the take, and whether the take's rate is ambiguous.

    The views show only the ratios of rates. The take has the rate of most cameras or, if no rate is that of more than
    half, the fastest, so that no frame is lost.

    Args:
        relative: (C,) frames of each camera per frame of any of them.
    """
    same = np.abs(relative[:, None] / relative[None] - 1) <= OTHER_RATE
    usual = int(same.sum(1).argmax())
    if 2 * same[usual].sum() > len(relative):
        return np.where(same[usual], 1.0, relative / relative[usual]), False
    fastest = relative.max()
    return np.where(relative > (1 - OTHER_RATE) * fastest, 1.0, relative / fastest), True


def _other_rates(detections: Detections, ratios: np.ndarray, fps: float, *, is_open: bool) -> tuple[Diagnostic, ...]:
    """Report cameras with other rates than the take's, and an ambiguous rate if ``is_open``."""
    rates = {name: ratio * fps for name, ratio in zip(detections.cameras, ratios.tolist(), strict=True) if ratio != 1.0}
    named = [f"{name} {rate:.4g}" for name, rate in rates.items()]
    found = diagnostic("camera_rates_differ", cameras=list(rates), rate=fps, rates=named)
    if not is_open:
        return (found,)
    fast = [name for name in detections.cameras if name not in rates]
    return found, diagnostic("frame_rate_ambiguous", cameras=fast, rate=fps)


@dataclass(frozen=True)
class Agreeing:
    """Input of a solve after all corrections."""

    calibration: Calibration
    in_time: InTime
    """Detections at moments that cameras recorded together."""
    resampled: tuple[bool, ...]
    """Whether each camera's rows are no longer the frames of its video."""
    problems: tuple[Diagnostic, ...] = ()
    """Corrections of detections and frame rates."""


@dataclass(frozen=True)
class _Files:
    """Calibration and detections after some corrections."""

    calibration: Calibration
    detections: Detections
    problems: tuple[Diagnostic, ...] = ()


def bring_to_agreement(
    calibration: Calibration, detections: Detections, fps: float, rates: Sequence[float | None], options: ReadOptions
) -> Agreeing:
    """Return calibration and detections that agree as far as the disagreement can be explained.

    Synchronous views are explained first. If they do not agree, or a single camera is moved, late or unexplained, the
    frame rates of videos and other readings of all cameras are tried at all offsets. Offsets are found last. A single
    camera is explained after that, in synchronous rows.

    Args:
        calibration: of C cameras.
        detections: of the same, each from its own first frame if frames differ.
        fps: frame rate of the take.
        rates: (C,) frame rates of the videos, None if unknown.
        options: of reading.

    Raises:
        CalibrationInvalid: all cameras are in one point.
        JobInvalid, NotSynchronised, FrameCountMismatch: see ``bring_to_one_time``.
    """
    count = len(detections.cameras)
    if count == 1:
        files = _turn_one_view(_Files(calibration, detections), options)
        return Agreeing(files.calibration, InTime(files.detections), (False,))
    if not np.ptp(calibration.cameras.centres, axis=0).any():
        what = "The calibration places all cameras in one point: it has intrinsics alone."
        hint = "Calibrate the positions of the cameras, too, for example with calibrate-cameras."
        raise CalibrationInvalid(what, where=str(calibration.source), hint=hint)
    files, ratios, stated = _Files(calibration, detections), np.ones(count), stated_ratios(rates, fps)
    searched = not (options.as_calibrated or options.offset or options.sync == SYNC_OFF)
    if searched and (stated == 1).all():
        relative = rates_by_length(calibration.cameras, detections, as_numbered(detections, options))
        ratios, is_open = of_the_take(relative)
        files = _at_one_rate(files, ratios, fps, is_open=is_open and options.fps is None)
    found = None if options.as_calibrated else _explain(files, as_numbered(files.detections, options), options)
    settled = found is not None and (found.agrees or found.changed) and not found.reading.is_of_one_camera
    if found is not None and settled:
        files = _apply(files, found, options)
    elif (stated != 1).any():
        if rates_match(calibration.cameras, detections, stated):
            ratios, files = stated, _at_one_rate(files, stated, fps, is_open=False)
    elif searched and (ratios == 1).all():
        reading = read_out_of_step(_in_file(files, options), files.detections)
        if reading is not None:
            meanings = reading.correction(0).meaning()
            names = files.detections.cameras
            corrected = diagnostic("calibration_corrected", result="never", cameras=names, meanings=meanings)
            files = _read(files, reading, options, [corrected])
    in_time = bring_to_one_time(files.calibration.cameras, files.detections, fps, options)
    if found is not None and files.calibration is calibration and not settled:
        rows = replace(files, detections=in_time.detections)
        if in_time.first_rows or (ratios != 1).any():
            found = _explain(rows, rows.detections, options)
        files = _apply(rows, found, options)
        in_time = replace(in_time, detections=files.detections)
    return Agreeing(files.calibration, in_time, tuple((ratios != 1).tolist()), files.problems)


def _at_one_rate(files: _Files, ratios: np.ndarray, fps: float, *, is_open: bool) -> _Files:
    """Return the files at the take's rate, from (C,) frames of each camera per frame of the take."""
    if (ratios == 1).all():
        return files
    problems = _other_rates(files.detections, ratios, fps, is_open=is_open)
    resampled = at_one_rate(files.detections, ratios.tolist())
    return _Files(files.calibration, resampled, (*files.problems, *problems))


def _in_file(files: _Files, options: ReadOptions) -> Cameras:
    """Return the cameras in the world of the calibration's file."""
    cameras = files.calibration.cameras
    return replace(cameras, R=cameras.R @ rotation_to_z_up(options.up_axis or "z"))


def _explain(files: _Files, rows: Detections, options: ReadOptions) -> Explanation:
    return explain(_in_file(files, options), rows, names_stated=bool(options.camera or options.offset))


def _apply(files: _Files, found: Explanation, options: ReadOptions) -> _Files:
    """Return the files as an explanation reads them, with the corrections among the problems."""
    if found.changed:  # delays are measured to parts of a frame elsewhere
        return _read(files, replace(found.reading, late=()), options, _report(files.detections.cameras, found))
    problems = [diagnostic("explanations_open", one=found.open[0], other=found.open[1])] if found.open else []
    return _read(files, Reading.as_written(len(files.detections.cameras)), options, problems)


def _read(files: _Files, reading: Reading, options: ReadOptions, problems: Sequence[Diagnostic]) -> _Files:
    calibration, detections, views = files.calibration, files.detections, range(len(files.detections.cameras))
    if reading != Reading.as_written(len(views)):
        cameras, detections = apply_reading(_in_file(files, options), detections, reading)
        cameras = replace(cameras, R=cameras.R @ rotation_to_z_up(options.up_axis or "z").T)
        rolls = tuple(reading.correction(view).turn for view in views)
        known = tuple(calibration.size_known[owner] for owner in reading.owners) if calibration.size_known else ()
        calibration = replace(calibration, cameras=cameras, rolls=rolls, size_known=known)
    if problems:
        calibration = replace(calibration, problems=(*calibration.problems, *problems))
    return _Files(calibration, detections, files.problems)


def _turn_one_view(files: _Files, options: ReadOptions) -> _Files:
    found = None if options.as_calibrated else turn_of_one_view(_in_file(files, options), files.detections)
    if found is None:
        return files
    reading = Reading.as_written(1).with_picture(0, PictureReading(turn=found[0]))
    values = {"meanings": reading.correction(0).meaning(), "percent": 100 * found[1]}
    corrected = diagnostic("calibration_corrected", result="alone", cameras=files.detections.cameras, **values)
    return _read(files, reading, options, [corrected])


def _report(names: Sequence[str], found: Explanation) -> list[Diagnostic]:
    """Return one diagnostic for each kind of correction, with its gain and the runner-up."""
    evidence = {"gain": max(a.gain for a in found.applied), "runner_up": found.runner_up, "margin": found.margin}
    reported = list[Diagnostic]()
    corrections = [a for a in found.applied if a.code == "calibration_corrected"]
    if corrections:
        everybody = len(corrections) == 1 and len(corrections[0].views) == len(names)
        meanings = "; ".join(a.meaning if everybody else f"{a.meaning} ({_listed(names, a)})" for a in corrections)
        shares = {"percent": 100 * found.share, "percent_written": 100 * found.share_written}
        reported.append(diagnostic("calibration_corrected", result="shares", meanings=meanings, **shares, **evidence))
    for applied in found.applied:
        named = [names[view] for view in applied.views]
        if applied.code == "detections_corrected" and len(named) == len(names):
            reported.append(diagnostic("detections_corrected", found=applied.meaning, **evidence))
        elif applied.code == "detections_corrected":
            code = (
                "image_mirrored"
                if any(found.reading.pictures[v].mirrored for v in applied.views)
                else "sides_exchanged"
            )
            reported += [diagnostic(code, cameras=[name], remedy=Remedy.REPAIRED, **evidence) for name in named]
        elif applied.code == "camera_names_exchanged":
            owners = [names[found.reading.owners[view]] for view in applied.views]
            pairs = [f"{name} is the calibration's {owner}" for name, owner in zip(named, owners, strict=True)]
            reported.append(diagnostic("camera_names_exchanged", cameras=named, pairs=pairs, **evidence))
        elif applied.code == "camera_placed":
            reported.append(diagnostic("camera_placed", cameras=named, remedy=Remedy.REPAIRED, **evidence))
        elif applied.code == "camera_unexplained":
            reported.append(diagnostic("camera_unexplained", cameras=named, **evidence))
    return reported


def _listed(names: Sequence[str], applied: Applied) -> str:
    return ", ".join(names[view] for view in applied.views)
