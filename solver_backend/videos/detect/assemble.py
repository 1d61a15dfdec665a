"""Combine the detections from several videos into a capture, and correct them for camera rotation."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.agreement.person_selection import SelectedPerson, select_in_one_view, select_people
from solver_backend.camera_calibration.adjustment.lens import homogeneous
from solver_backend.camera_calibration.extrinsics.person_session import main_person
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.cameras.camera_corrections import resized
from solver_backend.cameras.projection import undistort
from solver_backend.cameras.refinement import rotated_back
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic, notes_in, warnings_in
from solver_backend.exchange.errors import (
    BackendMissing,
    CalibrationMismatch,
    KeypointCountMismatch,
    NoDetections,
    TooFewViews,
)
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.recognition.world_fit import find_people, fit_world
from solver_backend.types import Cameras, Capture, Detections
from solver_backend.videos.files.video import probe, read_pictures
from solver_backend.videos.sync.clocks import Clocks, at_times, common_times
from solver_backend.videos.video_detections import VideoDetections

CROPPED_SHARE = 0.02  # Largest relative size change caused by cropping. Encoders crop images to whole blocks.
SHORT_SHARE = 0.5  # Overlap of all videos below which to warn, relative to the longest video.


@dataclass(frozen=True)
class KnownOfOne:
    """Known facts about the person, the floor and the lens of a single-camera take (see ``Capture``)."""

    stature_m: float = 0.0  # Stature of the person in metres, or 0 if unknown.
    floor_from_person: bool = False
    focal_sigma: float = 0.0  # Relative standard deviation of the focal length.


def everybody(found: Sequence[VideoDetections], clocks: Clocks) -> tuple[Detections, float]:
    """Resample the detections of all people at common times. Also return the frame rate in 1/s."""
    sets = {item.joint_set for item in found}
    if len(sets) > 1:
        message = f"The detections use different joint sets: {', '.join(sorted(sets))}."
        raise KeypointCountMismatch(message, hint="Use one detector for all videos.")
    if not any((item.confidence > 0).any() for item in found):
        message = "The detector did not find a person in the videos."
        hint = "Use a preview to check that the person is visible, upright and large enough, or try another detector."
        raise NoDetections(message, where=", ".join(item.video.name for item in found), hint=hint)
    rates = [item.fps for item in found if item.fps > 0]
    fps = float(np.median(rates)) if rates else 0.0
    fps = round(fps) if fps and abs(fps - round(fps)) < 2e-3 * fps else fps
    relative = [item.times_s - item.times_s[0] for item in found]
    wanted = common_times([(0.0, float(t[-1])) for t in relative], clocks, fps or 1.0)
    if not len(wanted):
        hint = "Omit the camera that started or stopped at another time, or specify its offset."
        raise NoDetections("The videos do not overlap.", where=", ".join(item.video.name for item in found), hint=hint)
    most = max(item.xy.shape[1] for item in found)
    parts = 3 if any(item.hands is not None for item in found) else 2
    by_view = []
    for c, item in enumerate(found):
        when = clocks.in_video(c, wanted)
        by_view.append([at_times(part, relative[c], when) for part in _by_track(item, most)[:parts]])
    notes, problems = _timing(found, clocks, wanted, fps)
    xy, sure, *hands = (np.stack(part) for part in zip(*by_view, strict=True))
    sure = np.where(np.isfinite(xy).all(-1), np.nan_to_num(sure), 0.0).astype(np.float32)
    both = hands[0].astype(np.float32) if hands else None
    names = tuple(item.name for item in found)
    return Detections(names, xy.astype(np.float32), sure, sets.pop(), both, notes=notes, problems=problems), fps


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
    """Build the capture of a single person.

    With calibrated cameras, this is the person on whom the views agree best. With a single camera, it is the largest
    and longest visible person. Without a calibration, ``main_person`` selects the person in each view.
    """
    detections, fps = everybody(found, clocks)
    footage = tuple(Path(item.video).absolute() for item in found)
    made_of: dict[str, Any] = {"footage": footage, "detector": found[0].detector}
    if calibration is None:
        if len(found) < 2:
            hint = "Add the video of another camera, or use `from-videos VIDEO` for a single camera."
            raise TooFewViews("A capture needs more than one video.", where=name, hint=hint)
        made_of["notes"] = (*detections.notes, diagnostic("person_chosen", basis="most_seen"))
        made_of["problems"] = (*detections.problems, diagnostic("cameras_not_calibrated"))
        return Capture(name, None, main_person(detections, fps), sources=tuple(map(str, footage)), **made_of)
    cameras, size_notes = in_video_pixels(calibration, found)

    def select(cameras: Cameras) -> tuple[SelectedPerson, ...]:
        one_view = len(cameras) == 1
        return select_in_one_view(detections, fps) if one_view else select_people(cameras, detections, fps, progress)

    cameras, (person, *_), scaled = find_people(cameras, select, world)
    fitted = fit_world(cameras, person.keypoints, world)
    parts = (calibration, detections, person)
    changed = (*scaled, *fitted.found, *fitted.check.found())
    notes = (*calibration.notes, *size_notes, *detections.notes, *person.notes, *notes_in(changed))
    problems = (*(item for part in parts for item in part.problems), *warnings_in(changed))
    made_of |= {"notes": notes, "problems": problems, "sources": (*map(str, footage), str(calibration.source))}
    made_of |= {"stature_m": one.stature_m, "focal_sigma": one.focal_sigma, "world_checked": True}
    made_of["floor_from_person"] = one.floor_from_person or fitted.from_person
    return Capture(name, fitted.cameras, person.keypoints, **made_of)


def _by_track(item: VideoDetections, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arrange the people detected in one video in ``most`` slots, one per person.

    Return xy (F, P, K, 2), confidence (F, P, K) and hands (F, P, 2, 21, 3). Each person keeps one slot, because
    interpolation connects equal slots in neighbouring frames.
    """
    frames = len(item.track)
    xy = np.full((frames, most, *item.xy.shape[2:]), np.nan)
    confidence = np.full(xy.shape[:-1], np.nan)
    hands = np.full((frames, most, 2, NUM_HAND_POINTS, 3), np.nan)
    changed = np.flatnonzero((item.track[1:] != item.track[:-1]).any(axis=1)) + 1
    place_of: dict[int, int] = {}
    for first, stop in pairwise([0, *changed.tolist(), frames]):  # the same people are present from first to stop
        present = item.track[first].tolist()
        place_of = {n: place for n, place in place_of.items() if n in present}
        for slot, number in enumerate(present):
            if number < 0:
                continue
            if number not in place_of:
                place_of[number] = next((p for p in range(most) if p not in place_of.values()), 0)
            here, there = (slice(first, stop), place_of[number]), (slice(first, stop), slot)
            xy[here], confidence[here] = item.xy[there], item.confidence[there]
            if item.hands is not None:
                hands[here] = item.hands[there]
    return xy, confidence, hands


@dataclass(frozen=True)
class FilmedSize:
    """Image size of a video without detections."""

    video: Path
    size: tuple[int, int]  # Width and height in pixels.


def in_video_pixels(
    calibration: Calibration, found: Sequence[VideoDetections | FilmedSize]
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Convert calibrated cameras to the pixels of their videos. Also return notes about the scaling."""
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
            elif any(abs(w * size[1] / (h * size[0]) - 1) < CROPPED_SHARE for w, h in (item.size, _stored_size(item))):
                cameras = resized(cameras, c, item.size)
                notes.append(diagnostic("calibration_scaled", how="scaled", cameras=[name], made=made, filmed=filmed))
            else:
                shapes = f"is for {made} px, but the video has {filmed} px, another aspect ratio"
                message = f"The calibration of {name} {shapes}."
                hint = "Calibrate in the video mode of the takes. A portrait video needs a portrait calibration."
                raise CalibrationMismatch(message, where=str(item.video), hint=hint)
    return cameras, tuple(notes)


def _stored_size(item: VideoDetections | FilmedSize) -> tuple[int, int]:
    """Return the size at which a video is stored, or the displayed size if the video is missing.

    If pixels are not square, other programs calibrate cameras at the stored size.
    """
    return probe(item.video).stored if item.video.exists() else item.size


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


WIDTH_PX = 640  # Width in pixels of the images being processed. A feature is located to within 1/20 of such a pixel.
FEATURES, FEWEST = 400, 40  # Maximum and minimum number of tracked features. New ones are added below half the maximum.
FEWEST_STILL = 8  # Number of features that suffice to show that a camera is still, for plain walls.
MARGIN = 0.25  # Margin around people's boxes relative to their size. Hair, clothes and shadows move with people.
STILL_DEG = 0.25  # Largest apparent rotation of a still camera in degrees. Image noise can reach this over a take.
LEFT_SHARE, LEFT_PX = 0.15, 1.0  # Largest movement not explained by rotation: fraction, and pixels (640 px width).
SCALES_PX = (30.0, 10.0, 3.0, 1.0, 1.0)  # Scales of the Geman-McClure weights in pixels, from least squares to robust.


@dataclass(frozen=True)
class CameraTurns:
    """Rotations of a camera over F images."""

    rotations: np.ndarray  # (F, 3) rotation vectors relative to the first image in radians, in camera axes.
    moved_px: float  # Largest background movement (median over the features) in pixels at a width of 640.
    left_px: float  # Largest movement that rotation does not explain, in the same pixels.

    @property
    def largest_deg(self) -> float:
        """Largest rotation relative to the first image, in degrees."""
        return float(np.rad2deg(np.linalg.norm(self.rotations, axis=1)).max(initial=0.0))

    @property
    def explain(self) -> bool:
        """True if rotation alone explains the background motion, so the camera neither moved nor zoomed."""
        return self.left_px <= max(LEFT_PX, LEFT_SHARE * self.moved_px)


def steadied(
    found: tuple[VideoDetections, ...], calibration: Calibration, progress: Progress = silent
) -> tuple[tuple[VideoDetections, ...], list[Diagnostic]]:
    """Correct the detections in a single video for camera rotation, as if the camera had been static."""
    if len(found) != 1:
        return found, []
    only, (cameras, _) = found[0], in_video_pixels(calibration, found)
    try:
        opencv()
    except BackendMissing:
        return found, [diagnostic("camera_turns", turn="unchecked", cameras=[only.name])]
    shown = (picture.rgb for picture in read_pictures(probe(only.video)))
    still, diagnostics = as_if_still(only, cameras, shown, progress)
    return (still,), diagnostics


def as_if_still(
    found: VideoDetections, camera: Cameras, pictures: Iterable[np.ndarray], progress: Progress = silent
) -> tuple[VideoDetections, list[Diagnostic]]:
    """Correct detections for camera rotation by following the background in the given images."""
    turns = camera_turns(found, camera, pictures, progress)
    if turns is None:
        return found, [diagnostic("camera_turns", severity=Severity.WARNING, turn="unknown", cameras=[found.name])]
    if turns.largest_deg < STILL_DEG and turns.explain:
        return found, []
    if not turns.explain:
        figures = {"moved": turns.moved_px, "left": turns.left_px}
        return found, [diagnostic("camera_moves", path="unknown", cameras=[found.name], **figures)]

    def back(px: np.ndarray) -> np.ndarray:
        return rotated_back(camera, px.reshape(found.num_frames, -1, 2), turns.rotations).reshape(px.shape)

    hands = found.hands
    if hands is not None:
        hands = hands.copy()
        hands[..., :2] = back(hands[..., :2])
    figures = {"remedy": Remedy.REPAIRED, "size": turns.largest_deg}
    note = diagnostic("camera_turns", turn="measured", cameras=[found.name], **figures)
    return replace(found, xy=back(found.xy), hands=hands), [note]


def camera_turns(
    found: VideoDetections, camera: Cameras, pictures: Iterable[np.ndarray], progress: Progress = silent
) -> CameraTurns | None:
    """Estimate the camera's rotation in each image, or return None if too little background is visible.

    Features are tracked from image to image (Lucas and Kanade 1981). When few remain, new features are detected in a
    reference image. The rotation ω since the reference minimises ``Σ ρ(|d_i - exp(ω) d_i0|)``, where d_i and d_i0 are
    the rays of feature i now and in the reference. The rotations between references are multiplied together. A plain
    wall with few features can show that a camera is still, but cannot show how it rotates.
    """
    cv2 = opencv()
    scale = min(1.0, WIDTH_PX / found.size[0])
    focal = scale * float(np.sqrt(camera.K[0, 0, 0] * camera.K[0, 1, 1]))
    rotations, moved, left = list[np.ndarray](), [0.0], [0.0]
    before, turn, since, few = None, np.eye(3), np.eye(3), False
    points, start_rays = np.zeros((0, 2), np.float32), np.zeros((0, 3))
    for number, rgb in zip(range(found.num_frames), pictures, strict=False):
        grey = cv2.resize(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if before is not None and len(points):
            points, kept = followed(cv2, before, grey, points)
            start_rays = start_rays[kept]
            if len(points) < (FEWEST_STILL if few else FEWEST):
                return None
            rays = _rays(camera, points / scale)
            if few:  # Too few features for a rotation can still show that nothing moves.
                if np.percentile(np.linalg.norm(rays - start_rays, axis=1), 75.0) > np.deg2rad(STILL_DEG):
                    return None
                rotations.append(np.zeros(3))
                before = grey
                progress("Following the background", number + 1, found.num_frames)
                continue
            step, off = _turn(start_rays, rays, focal)
            turn = step @ since
            moved.append(focal * float(np.median(np.linalg.norm(rays - start_rays, axis=1))))
            left.append(off)
        rotations.append(log_so3(turn))
        if len(points) < FEATURES // 2:
            corners = cv2.goodFeaturesToTrack(
                grey, FEATURES, 0.01, 7, mask=background_mask(found, number, grey.shape, scale)
            )
            points = np.zeros((0, 2), np.float32) if corners is None else corners[:, 0]
            few = number == 0 and len(points) < FEWEST
            if len(points) < (FEWEST_STILL if few else FEWEST):
                return None
            start_rays, since = _rays(camera, points / scale), turn
        before = grey
        progress("Following the background", number + 1, found.num_frames)
    if not rotations:
        return None
    rotations += rotations[-1:] * (found.num_frames - len(rotations))
    return CameraTurns(np.array(rotations), max(moved), max(left))


def followed(cv2: Any, before: np.ndarray, now: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track points from one image to the next. Also return a mask of consistently tracked points."""
    window = {"winSize": (15, 15), "maxLevel": 3}
    onward, there, _ = cv2.calcOpticalFlowPyrLK(before, now, points[:, None], None, **window)
    back, again, _ = cv2.calcOpticalFlowPyrLK(now, before, onward, None, **window)
    kept = (there[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm(back[:, 0] - points, axis=1) < 0.5)
    return onward[kept, 0], kept


def _rays(camera: Cameras, px: np.ndarray) -> np.ndarray:
    """Return the (N, 3) unit viewing directions of (N, 2) pixels."""
    return unit(homogeneous(np.asarray(undistort(camera, px[None].astype(float)))[0]))


def _turn(before: np.ndarray, now: np.ndarray, focal: float) -> tuple[np.ndarray, float]:
    """Robustly estimate the rotation between two sets of rays. Also return the median residual in px.

    Each iteration is Kabsch's (1976) solution with Geman-McClure weights from the previous iteration.
    """
    R, weight, off = np.eye(3), np.ones(len(now)), np.zeros(len(now))
    for scale in SCALES_PX:
        R = nearest_rotation((now * weight[:, None]).T @ before)
        off = focal * np.linalg.norm(now - before @ R.T, axis=1)
        weight = (scale**2 / (scale**2 + off**2)) ** 2
    return R, float(np.median(off))


def background_mask(found: VideoDetections, number: int, shape: tuple[int, ...], scale: float) -> np.ndarray:
    """Return a mask (H, W) of the image outside people's boxes."""
    mask = np.full(shape, 255, np.uint8)
    for xy, sure in zip(found.xy[number], found.confidence[number], strict=True):
        seen = xy[sure > 0] * scale
        if len(seen) < 2:
            continue
        low, high = seen.min(axis=0), seen.max(axis=0)
        low, high = low - MARGIN * (high - low).max(), high + MARGIN * (high - low).max()
        x0, y0, x1, y1 = np.clip([*low, *high], 0, [shape[1], shape[0]] * 2).astype(int)
        mask[y0:y1, x0:x1] = 0
    return mask
