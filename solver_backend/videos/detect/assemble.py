"""Assemble the detections of several videos into a capture on one clock, of one person, with any calibrated cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.one_view import select_in_one_view
from solver_backend.agreement.person_selection import SelectedPerson, select_people
from solver_backend.cameras.camera_corrections import resized
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, notes_in, warnings_in
from solver_backend.exchange.errors import CalibrationMismatch, KeypointCountMismatch, NoDetections, TooFewViews
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.recognition.world_fit import find_people, fit_world
from solver_backend.types import Cameras, Capture, Keypoints2D
from solver_backend.videos.sync.clocks import Clocks, at_times, common_times
from solver_backend.videos.video_detections import VideoDetections, extent

CROPPED_SHARE = 0.02
"""Largest difference from the calibrated size of a cropped picture, as a share. Coders cut pictures to whole blocks."""
SHORT_SHARE = 0.5
"""Least common time of the videos without a warning, as a share of the longest."""


@dataclass(frozen=True)
class KnownOfOne:
    """Facts about a single camera and its person, see ``Capture``."""

    stature_m: float = 0.0
    """Stature of the person, 0 if unknown."""
    floor_from_person: bool = False
    focal_sigma: float = 0.0
    """Standard deviation of its focal length, as a share."""


def everybody(found: Sequence[VideoDetections], clocks: Clocks) -> tuple[Detections, float]:
    """Return the detections of all people at common moments, and the moments per second.

    Raises:
        KeypointCountMismatch: the detectors have different joint sets.
        NoDetections: no video shows a person, or the videos have no common moment.
    """
    sets = {item.joint_set for item in found}
    if len(sets) > 1:
        message = f"The detections are of different joint sets: {', '.join(sorted(sets))}."
        raise KeypointCountMismatch(message, hint="Use one detector for all.")
    if not any((item.confidence > 0).any() for item in found):
        message = "The detector found nobody in any video."
        hint = "Check in a preview that the person is in sight, upright and large enough, or try another detector."
        raise NoDetections(message, where=", ".join(item.video.name for item in found), hint=hint)
    rates = [item.fps for item in found if item.fps > 0]
    fps = float(np.median(rates)) if rates else 0.0
    fps = round(fps) if fps and abs(fps - round(fps)) < 2e-3 * fps else fps
    relative = [item.times_s - item.times_s[0] for item in found]
    wanted = common_times([(0.0, float(t[-1])) for t in relative], clocks, fps or 1.0)
    if not len(wanted):
        hint = "Leave out the camera that was started or stopped at another time, or give its offset."
        raise NoDetections("No moment is in all videos.", where=", ".join(item.video.name for item in found), hint=hint)
    most = max(item.xy.shape[1] for item in found)
    xy, confidence, hands = [], [], []
    with_hands = any(item.hands is not None for item in found)
    for c, item in enumerate(found):
        places, sureness, of_hands = _by_track(item, most)
        when = clocks.in_video(c, wanted)
        xy.append(at_times(places, relative[c], when))
        confidence.append(at_times(sureness, relative[c], when))
        if with_hands:
            hands.append(at_times(of_hands, relative[c], when))
    notes, problems = _timing(found, clocks, wanted, fps)
    stacked = np.stack(xy)
    sure = np.where(np.isfinite(stacked).all(-1), np.nan_to_num(np.stack(confidence)), 0.0).astype(np.float32)
    both = np.stack(hands).astype(np.float32) if with_hands else None
    names, xy = tuple(item.name for item in found), stacked.astype(np.float32)
    return Detections(names, xy, sure, sets.pop(), both, notes=notes, problems=problems), fps


def assembled(
    name: str,
    found: Sequence[VideoDetections],
    clocks: Clocks,
    calibration: Calibration | None,
    progress: Progress = silent,
    *,
    world: WorldSettings = WorldSettings(),
    one: KnownOfOne = KnownOfOne(),
) -> Capture:
    """Return the capture of a take.

    With cameras it shows the person with the most agreeing views. Otherwise it shows the most visible person per view.

    Args:
        calibration: of the cameras in the same order, or None.
        one: facts about a single camera.
    """
    detections, fps = everybody(found, clocks)
    footage = tuple(Path(item.video).absolute() for item in found)
    sources, detector = tuple(str(item) for item in footage), found[0].detector
    if calibration is None:
        if len(found) < 2:
            hint = "Add another camera's video, or `from-videos VIDEO`."
            raise TooFewViews("One video alone does not make a capture.", where=name, hint=hint)
        notes = (*detections.notes, diagnostic("person_chosen", basis="most_seen"))
        problems = (*detections.problems, diagnostic("cameras_not_calibrated"))
        made_of = {"footage": footage, "sources": sources, "detector": detector}
        return Capture(name, None, _main_person(detections, fps), notes=notes, problems=problems, **made_of)
    cameras, size_notes = in_video_pixels(calibration, found)

    def select(cameras: Cameras) -> tuple[SelectedPerson, ...]:
        one_view = len(cameras) == 1
        return select_in_one_view(detections, fps) if one_view else select_people(cameras, detections, fps, progress)

    cameras, people, scaled = find_people(cameras, select, world)
    person = people[0]
    fitted = fit_world(cameras, person.keypoints, world)
    notes = (*calibration.notes, *size_notes, *detections.notes, *person.notes, *notes_in(scaled))
    notes = (*notes, *fitted.notes, *fitted.check.notes())
    problems = (*calibration.problems, *detections.problems, *person.problems, *warnings_in(scaled))
    problems = (*problems, *fitted.problems, *fitted.check.problems())
    return Capture(
        name,
        fitted.cameras,
        person.keypoints,
        footage=footage,
        sources=(*sources, str(calibration.source)),
        notes=notes,
        problems=problems,
        stature_m=one.stature_m,
        floor_from_person=one.floor_from_person or fitted.from_person,
        focal_sigma=one.focal_sigma,
        detector=detector,
        world_checked=True,
    )


def _by_track(item: VideoDetections, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return xy (F, P, K, 2), confidence (F, P, K) and hands (F, P, 2, 21, 3) with one slot per person.

    Interpolation joins the same slot of neighbouring frames, so a person keeps it.
    """
    frames, people = item.track.shape
    xy = np.full((frames, most, *item.xy.shape[2:]), np.nan)
    confidence = np.full(xy.shape[:-1], np.nan)
    hands = np.full((frames, most, 2, NUM_HAND_POINTS, 3), np.nan)
    changed = np.flatnonzero((item.track[1:] != item.track[:-1]).any(axis=1)) + 1
    place_of: dict[int, int] = {}
    for first, stop in pairwise([0, *changed.tolist(), frames]):  # the same people are present in these frames
        present = item.track[first].tolist() if stop > first else []
        place_of = {n: place for n, place in place_of.items() if n in present}
        for slot in range(people):
            number = present[slot] if present else -1
            if number < 0:
                continue
            free = (p for p in range(most) if p not in place_of.values())
            place = place_of.setdefault(number, next(free, 0)) if number not in place_of else place_of[number]
            xy[first:stop, place] = item.xy[first:stop, slot]
            confidence[first:stop, place] = item.confidence[first:stop, slot]
            if item.hands is not None:
                hands[first:stop, place] = item.hands[first:stop, slot]
    return xy, confidence, hands


def _main_person(detections: Detections, fps: float) -> Keypoints2D:
    strength = (detections.confidence.mean(-1) * extent(detections.xy))[..., None]
    best = np.argmax(np.nan_to_num(strength), axis=2)[..., None]
    xy = np.take_along_axis(detections.xy, best[..., None], axis=2)[:, :, 0]
    confidence = np.take_along_axis(detections.confidence, best, axis=2)[:, :, 0]
    hands = detections.hands
    if hands is not None:
        hands = np.take_along_axis(hands, best[..., None, None, None], axis=2)[:, :, 0]
    return Keypoints2D(xy, confidence, detections.joint_set, fps, hands)


@dataclass(frozen=True)
class FilmedSize:
    """Picture size of a filming camera."""

    video: Path
    size: tuple[int, int]
    """Width and height in pixels."""


def in_video_pixels(
    calibration: Calibration, found: Sequence[VideoDetections | FilmedSize]
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Return the cameras in the pixels of the videos, and notes on scaling.

    Raises:
        CalibrationMismatch: a video's pictures have another shape than in its calibration.
    """
    cameras, notes = calibration.cameras, list[Diagnostic]()
    for c, item in enumerate(found):
        size = tuple(int(n) for n in cameras.image_size[c])
        if size != item.size:
            scale = item.size[0] / size[0]
            name, made, filmed = cameras.names[c], *(f"{width} x {height}" for width, height in (size, item.size))
            if not calibration.size_known[c]:
                sizes = cameras.image_size.copy()
                sizes[c] = item.size
                cameras = replace(cameras, image_size=sizes)
            elif abs(scale - 1) < CROPPED_SHARE:
                notes.append(diagnostic("calibration_scaled", how="cropped", cameras=[name], made=made, filmed=filmed))
            elif abs(item.size[0] * size[1] / (item.size[1] * size[0]) - 1) < CROPPED_SHARE:
                cameras = resized(cameras, c, item.size)
                notes.append(diagnostic("calibration_scaled", how="scaled", cameras=[name], made=made, filmed=filmed))
            else:
                message = f"The calibration of {name}: made at {made}, filmed at {filmed} px: another shape of picture."
                hint = "Calibrate in the mode that is filmed in; a portrait video needs a portrait calibration."
                raise CalibrationMismatch(message, where=str(item.video), hint=hint)
    return cameras, tuple(notes)


def _timing(
    found: Sequence[VideoDetections], clocks: Clocks, wanted: np.ndarray, fps: float
) -> tuple[tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    longest = max(item.times_s[-1] - item.times_s[0] for item in found)
    span = float(wanted[-1] - wanted[0])
    used = {"detector": found[0].detector, "moments": len(wanted), "rate": fps, "videos": len(found)}
    notes = [diagnostic("detector_used", **used), *clocks.notes()]
    problems = list(clocks.findings)
    if span < SHORT_SHARE * longest:
        problems.append(diagnostic("common_time_short", span=span, longest=float(longest)))
    rates = {f"{item.fps:.3g}" for item in found}
    if len(rates) > 1:
        notes.append(diagnostic("video_rates_differ", severity=Severity.NOTE, rates=sorted(rates), rate=fps))
    for item in found:
        gaps = np.diff(item.times_s)
        if len(gaps) and gaps.max() > 1.5 * np.median(gaps):
            gap_ms = 1e3 * float(gaps.max())
            notes.append(diagnostic("intervals_uneven", cameras=[item.name], file=item.video.name, gap_ms=gap_ms))
    return tuple(notes), tuple(problems)
