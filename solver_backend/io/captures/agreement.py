"""Make cameras and detections consistent by correcting conventions, frame rates and start times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.agreement.explain import Explanation, explain
from solver_backend.agreement.hypotheses import ROWS, diagnose_views, exchange_names
from solver_backend.agreement.reading import Reading, apply_reading, unturn
from solver_backend.agreement.single_view import pictures_of_one_view
from solver_backend.agreement.starts import (
    CameraStarts,
    StartEvidence,
    align_rows,
    as_numbered,
    at_one_rate,
    common_rows,
    find_starts,
    rates_by_length,
    rates_match,
    read_out_of_step,
)
from solver_backend.agreement.synchronisation import reach_frames, synchronised
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic, notes_in, warnings_in, word
from solver_backend.exchange.errors import CalibrationInvalid, JobInvalid, NotSynchronised
from solver_backend.exchange.reading_settings import offsets_by_camera
from solver_backend.exchange.solve_settings import SYNC_OFF, SYNC_ON
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.camera_names import listing, name_key
from solver_backend.io.reader import ReadOptions
from solver_backend.io.recognition.frame_numbers import different_frames
from solver_backend.io.units_and_axes import rotation_to_z_up, with_up_axis
from solver_backend.types import Cameras, Capture, Detections, Keypoints2D


@dataclass(frozen=True)
class InTime:
    """Detections whose rows are simultaneous in all cameras."""

    detections: Detections  # Detections in the frames that are kept.
    first_rows: tuple[int, ...] = ()  # First kept row of each camera. Empty if every camera keeps all its rows.
    found: tuple[Diagnostic, ...] = ()  # Notes and warnings.


def bring_to_one_time(cameras: Cameras, detections: Detections, fps: float, options: ReadOptions) -> InTime:
    """Align the rows of the detections in time across all cameras.

    Offsets from the user always win. Otherwise a camera is shifted if its views agree far better at another offset than
    at the offset of its frame numbers, and at no third offset (``find_starts``). Uncertain cameras keep their frame
    numbers and are reported.

    Args:
        detections: row 0 of each camera is its own first frame.

    Raises:
        JobInvalid: an offset names no recorded camera.
        NotSynchronised: synchronisation is required, and the views confirm no offset.
        FrameCountMismatch: the frame numbers differ, and nothing shows which frames are simultaneous.
    """
    numbered = detections.starts[0] - detections.starts
    given = _given_offsets(detections.cameras, options.offset)
    if options.offset or options.sync == SYNC_OFF:
        shifts = _shifts(detections, given).items()
        notes = (diagnostic("start_given", cameras=[name], size=abs(by), direction=way) for name, (by, way) in shifts)
        return _aligned(detections, numbered - given, options, *notes)
    found = find_starts(cameras, detections, fps, numbered)
    if found.evidence is StartEvidence.APART:  # the solve corrects small delays to a fraction of a frame
        if np.abs(found.offsets - numbered).max() > 0.5 * reach_frames(fps):
            return _moved(detections, found, numbered, options)
    elif found.evidence is not StartEvidence.IN_STEP:
        names = [detections.cameras[c] for c in found.doubtful]
        one, other = (-offset for offset in found.rivals)
        doubt = diagnostic("start_unknown", cameras=names)
        if found.evidence is StartEvidence.AMBIGUOUS:
            doubt = diagnostic("start_ambiguous", cameras=[names[0], detections.cameras[0]], one=one, other=other)
        why = word(doubt).what
        if options.sync == SYNC_ON:
            hint = "Use --offset CAMERA=FRAMES, or --sync auto."
            raise NotSynchronised(why, where=listing(detections.cameras), hint=hint)
        if detections.first_frames and not (options.trim or options.by_order):
            raise different_frames(_spans(detections), why)
        if found.evidence is StartEvidence.AMBIGUOUS or len(found.doubtful) == len(cameras):
            return _aligned(detections, numbered, options, doubt)
    return _aligned(detections, numbered, options)


def bring_capture_to_one_time(capture: Capture, options: ReadOptions) -> Capture:
    """Align all cameras of a keypoint capture in time. Args and raises: as in ``bring_to_one_time``."""
    keypoints = capture.keypoints
    if capture.cameras is None or keypoints is None:
        return capture
    everybody = [person.keypoints for person in capture.people] or [keypoints]
    detections = Detections.of_people(capture.cameras.names, everybody)
    found = bring_to_one_time(capture.cameras, detections, capture.fps, options)
    notes, problems = (*capture.notes, *notes_in(found.found)), (*capture.problems, *warnings_in(found.found))
    capture = replace(capture, notes=notes, problems=problems)
    if not found.first_rows:
        return capture
    late = np.array(found.first_rows) - found.first_rows[0]
    used = (found.detections.confidence > 0).any(axis=(1, 2, 3))[:, None, None]

    def shift(keypoints: Keypoints2D) -> Keypoints2D:
        shifted = synchronised(keypoints, late)
        return replace(shifted, confidence=np.where(used, shifted.confidence, 0.0))

    first = max(found.first_rows[0], 0)
    stop = min(found.first_rows[0] + found.detections.num_frames, capture.num_frames)
    people = tuple(replace(person, keypoints=shift(person.keypoints)) for person in capture.people)
    cut = replace(capture, keypoints=shift(keypoints), people=people).frames(first, stop)
    pictures = tuple(picture + by for picture, by in zip(cut.footage_first, late.tolist(), strict=False))
    return replace(cut, footage_first=pictures)


def _moved(detections: Detections, found: CameraStarts, numbered: np.ndarray, options: ReadOptions) -> InTime:
    late = numbered - found.offsets
    moved = _shifts(detections, late - late[0])
    values: dict[str, Any] = {"starts": [f"{name} {abs(by)} frames {way}" for name, (by, way) in moved.items()]}
    values |= {"reference": detections.cameras[0], "late": [by for by, _ in moved.values()]}
    problems = [diagnostic("starts_apart", cameras=list(moved), remedy=Remedy.REPAIRED, **values)]
    if found.doubtful:
        out = list(found.doubtful)
        names = [detections.cameras[c] for c in out]
        problems.append(diagnostic("start_left_out", cameras=names, remedy=Remedy.EXCLUDED))
        confidence, lengths = detections.confidence.copy(), detections.counts
        confidence[out], lengths[out] = 0.0, 0
        detections = replace(detections, confidence=confidence, lengths=tuple(lengths.tolist()))
    return _aligned(detections, found.offsets, options, *problems)


def _aligned(detections: Detections, offsets: np.ndarray, options: ReadOptions, *found: Diagnostic) -> InTime:
    if not detections.first_frames and not (offsets - offsets[0]).any():
        return InTime(detections, (), found)
    first, stop = common_rows(offsets, detections.counts, every=options.trim)
    if stop <= first:
        raise different_frames(_spans(detections), "With these offsets no two cameras recorded at the same time.")
    rows = tuple(int(first + offset) for offset in offsets)
    starts = [f"{row} of {name}" for name, row in zip(detections.cameras, rows, strict=True)]
    kept = diagnostic("take_in_common", cameras=detections.cameras, count=stop - first, starts=starts, rows=rows)
    return InTime(align_rows(detections, offsets, first, stop), rows, (*found, kept))


def _given_offsets(cameras: Sequence[str], texts: Sequence[str]) -> np.ndarray:
    """Return the (C,) delays in frames that the user gives. Cameras without a given delay have 0."""
    late = np.zeros(len(cameras), int)
    keys = [name_key(name) for name in cameras]
    for name, frames in offsets_by_camera(texts).items():
        same = [c for c, camera in enumerate(cameras) if camera == name or keys[c] == name_key(name)]
        if len(same) != 1:
            raise JobInvalid(f"Unknown camera '{name}'.", where="offset", hint=f"The cameras are {listing(cameras)}.")
        late[same[0]] = frames
    return late


def _shifts(detections: Detections, late: np.ndarray) -> dict[str, tuple[int, str]]:
    """Return the delay in frames and its direction, for each camera that starts before or after the first one."""
    delays = zip(detections.cameras, late.tolist(), strict=True)
    return {name: (by, "later" if by > 0 else "earlier") for name, by in delays if by}


def _spans(detections: Detections) -> dict[str, tuple[int, int]]:
    spans = np.stack([detections.starts, detections.starts + detections.counts - 1], axis=1)
    return dict(zip(detections.cameras, map(tuple, spans.tolist()), strict=True))


OTHER_RATE = 0.01  # Smallest relative difference of two frame rates. 59.94 counts as 60.


def stated_ratios(rates: Sequence[float | None], fps: float) -> np.ndarray:
    """Return (C,) camera frames per frame of the take, from the frame rates of the videos."""
    ratios = np.array([fps if rate is None or rate <= 0 else rate for rate in rates]) / fps
    differ = bool((np.abs(ratios / np.median(ratios) - 1) > OTHER_RATE).any())
    return np.where(differ & (np.abs(ratios - 1) > OTHER_RATE), ratios, 1.0)


def of_the_take(relative: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return (C,) camera frames per frame of the take, and whether the rate of the take is ambiguous.

    The take has the rate of more than half of the cameras. Without such a majority it has the fastest rate, so that no
    frame is lost.

    Args:
        relative: (C,) frame rates relative to one of the cameras.
    """
    alike = (np.abs(relative[:, None] / relative - 1) <= OTHER_RATE).sum(axis=0)
    is_open = bool(2 * alike.max() <= len(relative))
    ratios = relative / (relative.max() if is_open else relative[alike.argmax()])
    return np.where(np.abs(ratios - 1) <= OTHER_RATE, 1.0, ratios), is_open


@dataclass(frozen=True)
class Agreeing:
    """Calibration and detections after the corrections so far."""

    calibration: Calibration
    detections: Detections
    resampled: tuple[bool, ...]  # True for each camera whose rows are no longer the frames of its video.
    first_rows: tuple[int, ...] = ()  # See ``InTime``.
    found: tuple[Diagnostic, ...] = ()  # Corrections, open alternatives, and notes.
    turned: bool = False  # True if a single camera's detections were rotated and no longer fit its video.

    def report(self, *found: Diagnostic) -> Agreeing:
        """Return a copy of this object with additional diagnostics."""
        return replace(self, found=(*self.found, *found))

    def in_file(self, options: ReadOptions) -> Cameras:
        """Return the cameras in the world of the calibration file, before its up axis became Z."""
        cameras = self.calibration.cameras
        return replace(cameras, R=cameras.R @ rotation_to_z_up(options.up_axis or "z"))

    def explained(self, options: ReadOptions) -> Explanation:
        """Find the interpretation of the files that fits the person in most views."""
        rows = [row for row in ROWS if row is not exchange_names or not (options.camera or options.offset)]
        return explain(self.in_file(options), self.detections, rows)

    def at_rates(self, ratios: np.ndarray, fps: float, *, is_open: bool = False) -> Agreeing:
        """Resample from (C,) relative camera rates to the take's rate. With ``is_open``, that rate is a guess."""
        if (ratios == 1).all():
            return self
        names = self.detections.cameras
        rates = {name: ratio * fps for name, ratio in zip(names, ratios.tolist(), strict=True) if ratio != 1.0}
        named = [f"{name} {rate:.4g}" for name, rate in rates.items()]
        values = {"rate": fps, "rates": named, "basis": "assumed" if is_open else "known"}
        problem = diagnostic("camera_rates_differ", cameras=list(rates), **values)
        detections, resampled = at_one_rate(self.detections, ratios), tuple((ratios != 1).tolist())
        return replace(self, detections=detections, resampled=resampled).report(problem)

    def read(self, reading: Reading, options: ReadOptions) -> Agreeing:
        """Correct the calibration and the detections as an interpretation requires."""
        if reading == Reading.as_written(len(reading.owners)):
            return self
        cameras, detections = apply_reading(self.in_file(options), self.detections, reading)
        rolls = tuple(reading.correction(view).turn for view in range(len(reading.owners)))
        known = tuple(self.calibration.size_known[owner] for owner in reading.owners if self.calibration.size_known)
        cameras = with_up_axis(cameras, options.up_axis or "z")
        calibration = replace(self.calibration, cameras=cameras, rolls=rolls, size_known=known)
        return replace(self, calibration=calibration, detections=detections)

    def apply(self, found: Explanation, options: ReadOptions) -> Agreeing:
        """Apply the interpretation of an explanation, and report the corrections or open alternatives."""
        if found.changed:  # delays below a frame are measured elsewhere
            in_step = replace(found.reading, late=Reading.as_written(len(found.reading.late)).late)
            return self.read(in_step, options).report(*_report(self.detections.cameras, found))
        if not found.open:
            return self
        return self.report(diagnostic("explanations_open", one=found.open[0], other=found.open[1]))


def bring_to_agreement(
    calibration: Calibration, detections: Detections, fps: float, rates: Sequence[float | None], options: ReadOptions
) -> Agreeing:
    """Correct all disagreements between calibration and detections that a hypothesis explains.

    First, frames with equal numbers are treated as simultaneous. If the views then do not agree, or one camera is
    moved, late or unexplained, the frame rates of the videos and other interpretations of all files are tried at all
    offsets. Offsets are estimated last. A single deviating camera is then explained in simultaneous frames.

    Args:
        detections: row 0 of each camera is its own first frame.
        fps: frame rate of the take.
        rates: (C,) frame rates of the videos, None if unknown.

    Raises:
        CalibrationInvalid: all cameras are at one point.
        JobInvalid, NotSynchronised, FrameCountMismatch: see ``bring_to_one_time``.
    """
    files = Agreeing(calibration, detections, (False,) * len(detections.cameras))
    if len(detections.cameras) == 1:
        return _read_one_view(files, options)
    if not np.ptp(np.hstack([calibration.cameras.centres, calibration.cameras.t]), axis=0).any():
        what = "All cameras are at one point, because the calibration has only intrinsics."
        hint = "Also calibrate the positions of the cameras, for example with `cameras calibrate`."
        raise CalibrationInvalid(what, where=str(calibration.source), hint=hint)
    stated = stated_ratios(rates, fps)
    searched = not (options.as_calibrated or options.offset or options.sync == SYNC_OFF)
    if searched and (stated == 1).all():
        relative = rates_by_length(calibration.cameras, detections)
        ratios, is_open = of_the_take(relative)
        files = files.at_rates(ratios, fps, is_open=is_open and options.fps is None)
    numbered = replace(files, detections=as_numbered(files.detections))
    found = None if options.as_calibrated else numbered.explained(options)
    settled = found is not None and (found.agrees or found.changed) and not found.reading.is_of_one_camera
    if found is not None and settled:
        files = files.apply(found, options)
    elif (stated != 1).any():
        if rates_match(calibration.cameras, detections, stated):
            files = files.at_rates(stated, fps)
    elif searched and not any(files.resampled):
        reading = read_out_of_step(files.in_file(options), files.detections)
        if reading is not None:
            where = {"cameras": files.detections.cameras, "meanings": reading.correction(0).meaning()}
            corrected = diagnostic("calibration_corrected", result="never", **where)
            files = files.read(reading, options).report(corrected)
    in_time = bring_to_one_time(files.calibration.cameras, files.detections, fps, options)
    files = replace(files, detections=in_time.detections, first_rows=in_time.first_rows).report(*in_time.found)
    if found is not None and files.calibration is calibration and not settled:
        if files.first_rows or any(files.resampled):
            found = files.explained(options)
        files = files.apply(found, options)
    return files


def _read_one_view(files: Agreeing, options: ReadOptions) -> Agreeing:
    camera, seen = files.in_file(options), files.detections
    found = None if options.as_calibrated else pictures_of_one_view(camera, seen)
    if found is None:
        return files
    meaning, turn = found.picture.correction.meaning(), found.picture.turn
    if found.rival:
        return files.report(diagnostic("explanations_open", one=found.rival, other=meaning))
    values = {"meanings": meaning, "percent": 100 * found.outside, "cameras": seen.cameras}
    files = files.report(diagnostic("calibration_corrected", result=found.shown_by, **values))
    if turn:  # poses are lifted from upright images
        size, hands = camera.image_size[0], None if seen.hands is None else seen.hands.copy()
        if hands is not None:
            hands[..., :2] = unturn(hands[..., :2], turn, size)
        return replace(files, detections=replace(seen, xy=unturn(seen.xy, turn, size), hands=hands), turned=True)
    return files.read(Reading.as_written(1).with_view(0, pictures=found.picture), options)


def _report(names: Sequence[str], found: Explanation) -> list[Diagnostic]:
    evidence = {"gain": max(a.gain for a in found.applied), "runner_up": found.runner_up, "margin": found.margin}
    reported = list[Diagnostic]()
    corrections = [a for a in found.applied if a.code == "calibration_corrected"]
    if corrections:
        of_all = len(corrections) == 1 and len(corrections[0].views) == len(names)
        listed = (f"{a.meaning} ({', '.join(names[view] for view in a.views)})" for a in corrections)
        meanings = corrections[0].meaning if of_all else "; ".join(listed)
        shares = {"percent": 100 * found.share, "percent_written": 100 * found.share_written}
        reported.append(diagnostic("calibration_corrected", result="shares", meanings=meanings, **shares, **evidence))
    return reported + diagnose_views(found.reading, names, remedy=Remedy.REPAIRED, **evidence)
