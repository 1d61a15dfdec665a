"""Hands in the footage of a capture, looked for where its body has the wrists."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.errors import CaptureInvalid
from solver_backend.exchange.hand_points import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.progress import Progress, silent
from solver_backend.priors.lifted_take import lift_take
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import NUM_BETAS, Cameras, Capture, Keypoints2D
from solver_backend.videos.detect.choice import DetectorChoice
from solver_backend.videos.detect.footage_shift import footage_shift, in_time
from solver_backend.videos.detect.footage_size import footage_scale, from_footage, in_footage
from solver_backend.videos.detect.process import DetectorProcess
from solver_backend.videos.detect.search_hands import ArmsInViews, HandInCrop, search_hands
from solver_backend.videos.files.probe import probe
from solver_backend.videos.files.read import Picture, read_pictures

_STEP = 25
"""Frames from one report of progress to the next; chosen by hand."""

AGAIN_S = 0.05
"""Seconds from one search for a hidden hand to the next: hands hide for longer, and each search costs up to six looks.
See docs/research-log/hands.md."""

ENOUGH = 2
"""Views that had a hand, which locate it, so that the others look for it in turn. With 3, a tenth more looks find it in
1 % more frames (docs/research-log/hands.md)."""


def find_hands(capture: Capture, choice: DetectorChoice, progress: Progress = silent) -> Capture:
    """Return the capture with the hands that its footage shows.

    Wrists and elbows are triangulated, or lifted where one view alone shows the person. In every view a crop is placed
    from them, or where the view itself has them, turned upright, mirrored for the left hand, and placed once more from
    what was found. Views that miss a hand look for it where two others agree that it is. Nobody else's hand is looked
    for. Footage that is some frames late or early of the detections is moved in time.

    Args:
        capture: calibrated cameras, keypoints and footage.
        choice: a detector of hands in crops.
        progress: called with the pictures that are done.

    Raises:
        CaptureInvalid: it has no footage.
        TooFewViews, NoDetections: see ``Capture.require_views``.
        BackendMissing, VideoUnreadable: see ``read_pictures``.
        DetectorMissing, DetectorOutputsUnknown, DetectorFailed: see ``DetectorProcess``.
    """
    cameras, keypoints = capture.require_views()
    if not any(capture.footage):
        raise CaptureInvalid("The capture names no footage.", where=capture.name, hint="Read it from its folder again.")
    arms, found = arms_of(capture)
    scale = footage_scale(cameras, [None if path is None else probe(path).size for path in capture.footage])
    filmed, arms = in_footage(cameras, arms, scale)
    hands = np.full((len(cameras), keypoints.num_frames, 2, NUM_HAND_POINTS, 3), np.nan)
    hands[..., 2] = 0.0
    with DetectorProcess(choice) as process:

        def look(crop: np.ndarray) -> HandInCrop:
            answer = process.detect(crop, 0.0)
            return HandInCrop(
                answer["points"].astype(np.float64), float(answer["presence"][0]), float(answer["right"][0])
            )

        for frame, pictures in pictures_of(capture):
            before = hands[:, frame - 1] if frame else None
            due = is_due(before, frame, round(capture.fps * AGAIN_S))
            hands[:, frame] = search_hands(pictures, filmed, arms.of(frame), look, before, due)
            if frame % _STEP == 0:
                progress("Finding hands", frame, keypoints.num_frames)
    progress("Finding hands", keypoints.num_frames, keypoints.num_frames)
    wanted = np.isfinite(arms.places).all(axis=(0, 1, 3))
    found += [
        _at_wrist("hand_not_found", side) for side in np.flatnonzero(wanted & ~(hands[..., 2] > 0).any((0, 1, 3)))
    ]
    shift = footage_shift(hands, arms.detected[:, :, 1])
    if shift:
        firsts = capture.footage_first or (0,) * len(capture.footage)
        hands, capture = in_time(hands, shift), replace(capture, footage_first=tuple(n + shift for n in firsts))
        found.append(diagnostic("footage_late", size=shift, remedy=Remedy.REPAIRED))
    hands = from_footage(hands, scale)
    return replace(capture, keypoints=replace(keypoints, hands=hands), notes=(*capture.notes, *found))


def is_due(before: np.ndarray | None, frame: int, every: int) -> np.ndarray | None:
    """Return (C, 2) which views look for which hand: those that had it, others in turn where enough views had it.

    Args:
        before: (C, 2, 21, 3) hands of the frame before; None: all views look.
        frame: number of the frame.
        every: frames from one search for a hidden hand to the next.
    """
    if before is None or every <= 1:
        return None
    had = (before[..., 2] > 0).any(axis=-1)
    turn = np.arange(had.size).reshape(had.shape)
    return had | ((frame + turn) % every == 0) | (had.sum(axis=0) < ENOUGH)


def seen_by_two(capture: Capture) -> dict[str, float]:
    """Return the share of the frames, per cent, in which two views or more show a hand, by side."""
    return seen_by(capture, 2)


def seen_by(capture: Capture, least: int) -> dict[str, float]:
    """Return the share of the frames, per cent, in which so many views or more show a hand, by side."""
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    views = (capture.keypoints.hands[..., 2] > 0).any(axis=-1).sum(axis=0)
    return {side: round(100.0 * float((views[:, s] >= least).mean()), 1) for s, side in enumerate(SIDES)}


def arms_of(capture: Capture) -> tuple[ArmsInViews, list[Diagnostic]]:
    """Return elbows and wrists, triangulated or lifted, bridged where there are none, and which sides have none."""
    cameras, keypoints = capture.require_views()
    names = keypoints.joint_set.keypoints
    columns = [names.index(f"{side}_{part}") for part in ("elbow", "wrist") for side in SIDES]
    xy, confidence = keypoints.xy[:, :, columns], keypoints.confidence[:, :, columns]
    if capture.is_one_view:
        points = _lifted(cameras, keypoints)[:, columns]
    else:
        points = np.asarray(triangulate(cameras, xy, confidence).points)
    frames = np.arange(len(points))
    for joint in range(len(columns)):
        known = np.isfinite(points[:, joint]).all(-1)
        if known.any():
            for axis in range(3):
                points[:, joint, axis] = np.interp(frames, frames[known], points[known, joint, axis])
    places = points.reshape(len(points), 2, 2, 3)
    lost = ~np.isfinite(places).all(axis=(0, 1, 3))
    found = [_at_wrist("hand_without_wrist", side) for side in np.flatnonzero(lost)]
    detected = np.concatenate([xy, confidence[..., None]], axis=-1).reshape(*xy.shape[:2], 2, 2, 3)
    return ArmsInViews(places, detected), found


def _lifted(cameras: Cameras, keypoints: Keypoints2D) -> np.ndarray:
    """Return (F, K, 3) where an average person's keypoints are before the one camera that sees the person, metres."""
    view = int(np.flatnonzero((keypoints.confidence > 0).any(axis=(1, 2)))[0])
    camera, body = cameras.subset([view]), load_body()
    prior, landmarks = prior_on_body(load_sposer(), body.layout), keypoint_landmarks(body, keypoints.joint_set)
    lifted = lift_take(camera, keypoints.views([view]), body, prior, camera.R[0, :, 2])
    return (lifted.placed(body, landmarks, np.zeros(NUM_BETAS))[0] - camera.t[0]) @ camera.R[0]


def _at_wrist(code: str, side: int) -> Diagnostic:
    return diagnostic(code, joints=[f"{SIDES[side]}_wrist"])


def pictures_of(capture: Capture) -> Iterator[tuple[int, dict[int, np.ndarray]]]:
    """Yield the take's frames and the pictures that its views have of them."""
    firsts, streams = capture.footage_first or (0,) * len(capture.footage), dict[int, Iterator[Picture]]()
    waiting = dict[int, Picture]()
    for view, path in enumerate(capture.footage):
        if path is not None:
            streams[view] = read_pictures(probe(path))
    for frame in range(capture.num_frames):
        pictures = dict[int, np.ndarray]()
        for view, stream in streams.items():
            number = frame + firsts[view]
            picture = waiting.pop(view, None) or next(stream, None)
            while picture is not None and picture.number < number:
                picture = next(stream, None)
            if picture is not None and picture.number == number:
                pictures[view] = picture.rgb
            elif picture is not None:
                waiting[view] = picture
        yield frame, pictures
