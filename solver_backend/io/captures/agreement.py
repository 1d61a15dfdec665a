"""Make cameras and detections agree: apply the explanation, one frame rate and one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.explain import Applied, Explanation, explain
from solver_backend.agreement.reading import Reading, apply_reading
from solver_backend.agreement.resampled import at_one_rate, rates_by_length
from solver_backend.agreement.unlike_views import ViewReading, explain_unlike, views_match
from solver_backend.cameras.camera_corrections import corrected
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.solve_settings import SYNC_OFF
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up
from solver_backend.io.recognition.start_times import InTime, as_numbered, bring_to_one_time

OTHER_RATE = 0.01
"""Share by which frame rates differ that are not the same: 59.94 is 60."""


def stated_ratios(rates: Sequence[float | None], fps: float) -> np.ndarray:
    """Return (C,) frames of each camera for one of the take, by what the videos state.

    Args:
        rates: (C,) frames a second that the videos state, None where they state nothing.
        fps: frames a second of the take.
    """
    ratios = np.array([fps if rate is None or rate <= 0 else rate for rate in rates]) / fps
    differ = bool((np.abs(ratios / np.median(ratios) - 1) > OTHER_RATE).any())
    return np.where(differ & (np.abs(ratios - 1) > OTHER_RATE), ratios, 1.0)


def of_the_take(relative: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return (C,) frames of each camera for one of the take, and whether the views leave open which is the take's rate.

    The views show how rates are related, not which of them the stated one is. It is that of most cameras; where no rate
    is that of more than half, that of the fastest, so that no frame is lost.

    Args:
        relative: (C,) frames of each for one of any of them.
    """
    same = np.abs(relative[:, None] / relative[None] - 1) <= OTHER_RATE
    usual = int(same.sum(1).argmax())
    if 2 * same[usual].sum() > len(relative):
        return np.where(same[usual], 1.0, relative / relative[usual]), False
    fastest = relative.max()
    return np.where(relative > (1 - OTHER_RATE) * fastest, 1.0, relative / fastest), True


def other_rates(detections: Detections, ratios: np.ndarray, fps: float, *, is_open: bool) -> tuple[Diagnostic, ...]:
    """Return that cameras have other rates than the take's, and whether it is open which is the take's.

    Args:
        ratios: (C,) frames of each for one of the take.
        fps: frames a second of the take.
        is_open: the views leave open which cameras the stated rate is of.
    """
    rates = {name: ratio * fps for name, ratio in zip(detections.cameras, ratios.tolist(), strict=True) if ratio != 1.0}
    named = [f"{name} {rate:.4g}" for name, rate in rates.items()]
    found = diagnostic("camera_rates_differ", cameras=list(rates), rate=fps, rates=named)
    if not is_open:
        return (found,)
    fast = [name for name in detections.cameras if name not in rates]
    return found, diagnostic("frame_rate_ambiguous", cameras=fast, rate=fps)


@dataclass(frozen=True)
class Agreeing:
    """Input of a solve."""

    calibration: Calibration
    """After all corrections."""
    in_time: InTime
    """Detections at moments that cameras recorded together."""
    resampled: tuple[bool, ...]
    """Of each camera, whether its rows are no longer the frames of its video."""
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
    """Return calibration and detections that agree as far as anything explains why they do not.

    Views in step are explained first. If they do not agree, or a single camera is moved, late or unexplained,
    other frame rates and readings are tried at all offsets. Offsets are found last. A single camera is explained after
    that, in the rows that belong together.

    Args:
        calibration: of C cameras.
        detections: of the same, each from its own first frame where frames differ.
        fps: frame rate of the take.
        rates: (C,) frame rates that the videos state, else None.
        options: how the capture is read.

    Raises:
        CalibrationInvalid: all cameras are in one point.
        JobInvalid, NotSynchronised, FrameCountMismatch: see ``bring_to_one_time``.
    """
    count = len(detections.cameras)
    if count == 1:
        return Agreeing(calibration, InTime(detections), (False,))
    if not np.ptp(calibration.cameras.centres, axis=0).any():
        raise CalibrationInvalid(
            "The calibration places all cameras in one point: it has intrinsics alone.", where=str(calibration.source),
            hint="Calibrate the positions of the cameras, too, for example with calibrate-cameras.",
        )  # fmt: skip
    files, ratios = _Files(calibration, detections), np.ones(count)
    searched = not (options.as_calibrated or options.offset or options.sync == SYNC_OFF)
    if searched and (stated_ratios(rates, fps) == 1).all():
        relative = rates_by_length(calibration.cameras, detections, as_numbered(detections, options))
        files, ratios = _at_one_rate(files, relative, fps, options)
    found = None if options.as_calibrated else _explain(files, as_numbered(files.detections, options), options)
    settled = found is not None and (found.agrees or found.changed) and not found.reading.is_of_one_camera
    if not settled and (ratios == 1).all() and not views_match(files.calibration.cameras, files.detections):
        ratios = stated_ratios(rates, fps)
        if (ratios != 1).any():
            problems = other_rates(files.detections, ratios, fps, is_open=False)
            resampled = at_one_rate(files.detections, ratios.tolist())
            files = _Files(files.calibration, resampled, (*files.problems, *problems))
        elif searched:
            files, relative = _explain_out_of_step(files, options)
            files, ratios = _at_one_rate(files, relative, fps, options)
    if found is not None and settled:
        files = _apply(files, found, options)
    in_time = bring_to_one_time(files.calibration.cameras, files.detections, fps, options)
    if found is not None and files.calibration is calibration and not settled:
        rows = replace(files, detections=in_time.detections)
        if in_time.first_rows or (ratios != 1).any():
            found = _explain(rows, rows.detections, options)
        files = _apply(rows, found, options)
        in_time = replace(in_time, detections=files.detections)
    return Agreeing(files.calibration, in_time, tuple((ratios != 1).tolist()), files.problems)


def _at_one_rate(files: _Files, relative: np.ndarray, fps: float, options: ReadOptions) -> tuple[_Files, np.ndarray]:
    """Return the files at the take's rate, and (C,) frames of each camera for one of it.

    Args:
        files: of C cameras.
        relative: (C,) frames of each for one of any of them, as the views show.
        fps: frame rate of the take.
        options: how the capture is read.
    """
    ratios, is_open = of_the_take(relative)
    if (ratios == 1).all():
        return files, ratios
    problems = other_rates(files.detections, ratios, fps, is_open=is_open and options.fps is None)
    resampled = at_one_rate(files.detections, ratios.tolist())
    return _Files(files.calibration, resampled, (*files.problems, *problems)), ratios


def _explain(files: _Files, rows: Detections, options: ReadOptions) -> Explanation:
    """Return what explains rows that belong together, in the world of the calibration's file."""
    cameras, to_world = files.calibration.cameras, rotation_to_z_up(options.up_axis or "z")
    return explain(replace(cameras, R=cameras.R @ to_world), rows, names_stated=bool(options.camera or options.offset))


def _apply(files: _Files, found: Explanation, options: ReadOptions) -> _Files:
    """Return the files as an explanation reads them, with what was corrected among the problems."""
    calibration, names = files.calibration, files.detections.cameras
    if not found.changed:
        problems = (diagnostic("explanations_open", one=found.open[0], other=found.open[1]),) if found.open else ()
        return replace(files, calibration=replace(calibration, problems=(*calibration.problems, *problems)))
    reading = replace(found.reading, late=())  # delays are measured to parts of a frame elsewhere
    to_world = rotation_to_z_up(options.up_axis or "z")
    in_file = replace(calibration.cameras, R=calibration.cameras.R @ to_world)
    cameras, detections = apply_reading(in_file, files.detections, reading)
    if reading != Reading.as_written(len(names)):
        rolls = tuple(reading.correction(view).turn for view in range(len(names)))
        known = tuple(calibration.size_known[owner] for owner in reading.owners) if calibration.size_known else ()
        calibration = replace(
            calibration, cameras=replace(cameras, R=cameras.R @ to_world.T), rolls=rolls, size_known=known
        )
    reported = _report(names, found)
    calibration = replace(calibration, problems=(*calibration.problems, *reported))
    return _Files(calibration, detections, files.problems)


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


def _explain_out_of_step(files: _Files, options: ReadOptions) -> tuple[_Files, np.ndarray]:
    """Return the files, and frames of each camera for one of any of them, under which views match at some offsets."""
    calibration = files.calibration
    to_world = rotation_to_z_up(options.up_axis or "z")
    in_file = replace(calibration.cameras, R=calibration.cameras.R @ to_world)
    readings = explain_unlike(in_file, files.detections)
    if readings is None:
        return files, np.ones(len(files.detections.cameras))
    if (found := _corrected(files.detections.cameras, readings)) is not None:
        cameras = corrected(in_file, [reading.correction for reading in readings])
        cameras = replace(cameras, R=cameras.R @ to_world.T)
        rolls = tuple(reading.correction.turn for reading in readings)
        calibration = replace(calibration, cameras=cameras, rolls=rolls, problems=(*calibration.problems, found))
    return replace(files, calibration=calibration), np.array([reading.rate for reading in readings])


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
