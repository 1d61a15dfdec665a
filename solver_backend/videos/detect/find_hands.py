"""Detect hands in a capture's footage. They are searched near the wrists and where other views see them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from queue import SimpleQueue

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.camera_corrections import resized
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, Severity, diagnostic
from solver_backend.exchange.errors import CaptureInvalid
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS, SIDES
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.parallel import usable_cores
from solver_backend.priors.lifted_take import lift_take
from solver_backend.types import NUM_BETAS, UNSEEN_POINT, Cameras, Capture, Keypoints2D
from solver_backend.types.shapes import Float
from solver_backend.videos.detect.assemble import CROPPED_SHARE
from solver_backend.videos.detect.child.pose_workers.crops import SquareCrop, direction
from solver_backend.videos.detect.detector import DetectorChoice, DetectorProcess
from solver_backend.videos.files.video import Picture, VideoInfo, probe, read_pictures

SIDE = 224  # Side length of a crop in pixels.
HAND_M = 0.19  # Length from the wrist to the tip of the middle finger, in metres.
MARGIN = 1.3  # Side length of a crop in hand lengths. Chosen on hand detections, see docs/research-log/hands.md.
AHEAD = 0.45  # Distance from the wrist to the centre of the crop along the forearm, in hand lengths.
SECOND_MARGIN = 1.9  # Side length of the second crop relative to the extent of the points found in the first.
_WRIST, _KNUCKLE = 0, 9


def first_crop(wrist_px: np.ndarray, elbow_px: np.ndarray, hand_px: float, side: int) -> SquareCrop:
    """Return the crop for a hand, given the pixels (2,) of wrist and elbow. ``side`` is 0 for left and 1 for right."""
    up, length = direction(elbow_px, wrist_px, 1.0)
    # If a forearm points at the camera, the hand is near the wrist in the image, so the crop is centred there.
    forearm = min(1.0, length / (1.3 * hand_px))
    return _crop(wrist_px + AHEAD * forearm * hand_px * up, up, MARGIN * hand_px, side)


def second_crop(points: np.ndarray, side: int) -> SquareCrop:
    """Return a tighter crop around detected hand points (21, 2), rotated so that the fingers point up."""
    up, _ = direction(points[_WRIST], points[_KNUCKLE], 1.0)
    across = np.array([-up[1], up[0]])
    own = np.stack([points @ across, points @ up], axis=-1)
    low, high = own.min(axis=0), own.max(axis=0)
    middle = 0.5 * (low + high)
    extent = float((high - low).max())
    return _crop(middle[0] * across + middle[1] * up, up, SECOND_MARGIN * max(extent, 8.0), side)


def _crop(middle: np.ndarray, up: np.ndarray, length: float, side: int) -> SquareCrop:
    """Return the crop of a hand. Crops of left hands are mirrored, so that every hand looks like a right hand."""
    return SquareCrop.around(middle, up, length, SIDE, 0.5 * (SIDE - 1), mirrored=side == 0)


PRESENCE = 0.5  # Smallest presence at which a hand counts as visible, as in MediaPipe.
PLACED = 0.05  # Smallest presence in a first crop that leads to a second one. The model was trained on better crops.
AWAY_M = 0.1  # Largest distance in metres between the wrists of a detected hand and of the arm. Chosen on two takes.
ALIKE = 0.1  # Largest distance, in hand lengths, at which the projected and the detected arm need only one crop.
NEAREST_M = 0.1  # Smallest distance between a hand and a camera, in metres.
SURE = 0.3  # Smallest confidence of wrist and elbow in a view. Chosen on two takes.
SIGMA = 0.06  # Standard deviation of a point, relative to the hand length, used to test whether views agree.
RIGHT, LEAST_TRUST = 0.5, 0.1
"""If the probability of a right hand is below the first value, the confidence is multiplied by their ratio, but at
least by the second value. The probability is low if the back of a hand is mistaken for its palm, which swaps the
fingers. Chosen on crossed fingers, see docs/research-log/hands.md.
"""


@dataclass(frozen=True)
class HandInCrop:
    """Output of the hand model for one crop."""

    points: np.ndarray  # (21, 2) points in px, either of the crop or of the image.
    presence: float  # Probability that there is a hand, 0 to 1.
    right: float = 1.0  # Probability that it is a right hand, 0 to 1. Left hands are mirrored in their crops.

    def counted(self) -> np.ndarray:
        """Return the points with a confidence (21, 3), which is lower if the side of the hand is uncertain."""
        trust = self.presence * min(1.0, max(LEAST_TRUST, self.right / RIGHT))
        return np.column_stack([self.points, np.full(len(self.points), trust)])


Look = Callable[[np.ndarray], HandInCrop]  # Detects the hand in a (224, 224, 3) crop.
Each = Callable[[Callable[[int], object], Iterable[int]], Iterable[object]]  # Like ``map``, but may use threads.


@dataclass(frozen=True)
class Arms:
    """Elbows and wrists over F frames or in one frame, left side first."""

    places: np.ndarray  # (F, 2, 2, 3) elbow and wrist of each side in metres, NaN if no views agree.
    detected: np.ndarray  # (C, F, 2, 2, 3) pixels and confidence of the same points in each view.

    def at(self, frame: int) -> Arms:
        """Return the arms in one frame."""
        return Arms(self.places[frame], self.detected[:, frame])


def _unseen(*shape: int) -> np.ndarray:
    return np.tile(np.array(UNSEEN_POINT), (*shape, NUM_HAND_POINTS, 1))


def search_hands(
    pictures: Mapping[int, np.ndarray],
    cameras: Cameras,
    arms: Arms,
    look: Look,
    before: np.ndarray | None = None,
    due: np.ndarray | None = None,
    each: Each = map,
) -> np.ndarray:
    """Search for both hands in each view. Return (C, 2, 21, 3) x, y and confidence, NaN if undetected.

    Args:
        pictures: (H, W, 3) uint8 image from each view.
        before: (C, 2, 21, 3) hands in the previous frame. A hand that is still there needs only one crop.
        due: (C, 2) mask of the hands that are searched in each view. None searches all.
        each: function like ``map`` that calls ``look`` for each view, possibly in several threads.
    """
    due = np.ones((len(cameras), len(SIDES)), bool) if due is None else due
    found = _unseen(len(cameras), 2)
    px = project(cameras, arms.places)
    depth = (arms.places[1] @ cameras.R[:, 2].T + cameras.t[:, 2]).T
    there = np.isfinite(px).all((1, 3)) & (depth > NEAREST_M)

    def search_view(view: int) -> None:
        for side in np.flatnonzero(due[view] & there[view]):
            earlier = None if before is None else before[view, side]
            hand_px = HAND_M * float(cameras.K[view, 0, 0]) / float(depth[view, side])
            arm, own = px[view, :, side], arms.detected[view, :, side]
            found[view, side] = _HandSearch(pictures[view], side, look).at_arm(arm, own, hand_px, earlier)

    for _ in each(search_view, pictures):
        pass
    for side in range(len(SIDES)):
        looking = {view: _HandSearch(rgb, side, look) for view, rgb in pictures.items() if due[view, side]}
        _where_others_see_it(looking, cameras, found[:, side])
    return found


@dataclass(frozen=True)
class _HandSearch:
    rgb: np.ndarray
    side: int
    look: Look

    def shows(self, place: np.ndarray) -> bool:
        return bool(((place >= 0) & (place < self.rgb.shape[1::-1])).all())

    def once(self, crop: SquareCrop) -> HandInCrop:
        seen = self.look((crop.cut(self.rgb, SIDE, 0.0) + np.float32(0.5)).astype(np.uint8))
        return replace(seen, points=crop.in_picture(seen.points))

    def twice(self, crop: SquareCrop) -> np.ndarray | None:
        """Detect a hand (21, 3) in a crop, then in a second crop around its points. Return None if undetected."""
        first = self.once(crop)
        if first.presence < PLACED:
            return None
        second = self.once(second_crop(first.points, self.side))
        return second.counted() if second.presence >= PRESENCE else None

    def at_arm(self, arm: np.ndarray, own: np.ndarray, hand_px: float, before: np.ndarray | None) -> np.ndarray:
        """Search for a hand (21, 3) at its previous position, then at the end of an arm. Return NaN if it is not found.

        ``arm`` (2, 2) contains the projected elbow and wrist in px, and ``own`` (2, 3) the detected elbow and wrist.
        """
        there = np.where(own[:, 2:] >= SURE, own[:, :2], arm)
        alike = float(np.linalg.norm(there - arm, axis=-1).max()) < ALIKE * hand_px
        places = [place for place in ([arm] if alike else [arm, there]) if self.shows(place[1])]

        def near(points: np.ndarray) -> bool:
            return any(float(np.linalg.norm(points[0, :2] - wrist)) < AWAY_M / HAND_M * hand_px for _, wrist in places)

        if before is not None and before[0, 2] > 0:
            again = self.once(second_crop(before[:, :2], self.side))
            if again.presence >= PRESENCE and near(again.points):
                return again.counted()
        for elbow, wrist in places:
            found = self.twice(first_crop(wrist, elbow, hand_px, self.side))
            if found is not None and near(found):
                return found
        return _unseen()


def _where_others_see_it(searches: Mapping[int, _HandSearch], cameras: Cameras, found: np.ndarray) -> None:
    """Search again for a hand in the views that missed it, at the position that other views triangulate."""
    seen = found[:, 0, 2] > 0
    missing = [view for view in searches if not seen[view]]
    if seen.sum() < 2 or not missing:
        return
    xy, confidence = found[:, None, :, :2], found[:, None, :, 2]
    length = np.nanmedian(np.linalg.norm(xy[seen] - xy[seen][..., :1, :], axis=-1).max(-1))
    points = triangulate(cameras, xy, confidence, SIGMA * float(length)).points[0]
    if np.isfinite(points).all(-1).mean() < 0.5:
        return
    px = project(cameras, points)
    for view in missing:
        search, there = searches[view], px[view]
        there = np.where(np.isfinite(there), there, np.nanmean(there, axis=0))
        if search.shows(there) and (again := search.twice(second_crop(there, search.side))) is not None:
            found[view] = again


def footage_scale(cameras: Cameras, videos: Sequence[VideoInfo | None]) -> Float[np.ndarray, "views 2"]:
    """Return scale factors (C, 2) from calibrated images to footage, or 1 if their aspect ratios differ.

    The footage has a displayed and a stored size, which differ if pixels are not square. A calibration may refer to
    either size.
    """
    scale = np.ones((len(cameras), 2))
    for view, video in enumerate(videos):
        if video is None:
            continue
        shown, stored = (np.array(size) / cameras.image_size[view] for size in (video.size, video.stored))
        alike = any(abs(wide / high - 1.0) < CROPPED_SHARE for wide, high in (shown, stored))
        if alike and np.abs(shown - 1.0).max() > CROPPED_SHARE:
            scale[view] = shown
    return scale


def in_footage(cameras: Cameras, arms: Arms, scale: np.ndarray) -> tuple[Cameras, Arms]:
    """Scale cameras and detected arms to footage pixels by factors (C, 2)."""
    for view in np.flatnonzero((scale != 1.0).any(axis=1)):
        wide, high = np.round(cameras.image_size[view] * scale[view]).astype(int).tolist()
        cameras = resized(cameras, int(view), (wide, high))
    return cameras, replace(arms, detected=_scaled(arms.detected, scale))


def _scaled(points: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Scale pixels in points (C, ..., 3): ``u' + 0.5 = s (u + 0.5)``."""
    by = scale.reshape(-1, *(1,) * (points.ndim - 2), 2)
    same = by == 1.0
    moved = np.where(same, points[..., :2], (points[..., :2] + 0.5) * by - 0.5)
    return np.concatenate([moved, points[..., 2:]], axis=-1)


REACH = 5  # Largest detectable shift of the footage in frames. With larger shifts, the crops miss the hands.
LEAST_FRAMES = 20  # Minimum number of frames that contain a hand and its wrist. Chosen by hand.
MOVES, AGREE = 0.5, 0.75
"""Largest ratio of the error at the best shift to the error at the worst shift, and smallest fraction of hands that the
shift moves closer to their wrists. Chosen by ``python -m tests.benchmarks.hands.late_footage``
(docs/research-log/hands.md).
"""


def footage_shift(
    hands: Float[np.ndarray, "views frames 2 21 3"], wrists: Float[np.ndarray, "views frames 2 3"]
) -> int:
    """Estimate the footage's delay relative to the detections in frames, or return 0 if it is unknown.

    The delay d minimises ``Σ |h_f - w_(f - d) - median|² / s²`` over the hands h and wrists w in all views, where s is
    the hand size. The minimum is refined by a parabola. Subtracting the median difference removes the constant offset
    between the two detectors.
    """
    each = [_errors(hands[view, :, side], wrists[view, :, side]) for view in range(len(hands)) for side in (0, 1)]
    errors = np.array([found for found in each if found is not None])
    if len(errors) < 2:
        return 0
    total = errors.sum(axis=0)
    best = int(np.argmin(total))
    if not 0 < best < len(total) - 1 or total[best] > MOVES * total.max():
        return 0
    before, least, after = total[best - 1 : best + 2]
    shift = round(best - REACH + 0.5 * (before - after) / max(before - 2.0 * least + after, 1e-12))
    nearer = errors[:, REACH + shift] < errors[:, REACH]
    return shift if nearer.mean() >= AGREE else 0


def in_time(hands: Float[np.ndarray, "views frames 2 21 3"], shift: int) -> Float[np.ndarray, "views frames 2 21 3"]:
    """Shift hands (C, F, 2, 21, 3) earlier by ``shift`` frames, so that they match the frames of the detections."""
    moved = _unseen(*hands.shape[:3])
    count = hands.shape[1] - abs(shift)
    moved[:, max(-shift, 0) :][:, :count] = hands[:, max(shift, 0) :][:, :count]
    return moved


def _errors(hand: np.ndarray, wrist: np.ndarray) -> np.ndarray | None:
    """Return the error between a hand (F, 21, 3) and a detected wrist (F, 3) for each tested shift in frames.

    Return None if too few frames show the hand and the wrist.
    """
    frames = np.flatnonzero(hand[:, 0, 2] > 0)
    frames = frames[(frames >= REACH) & (frames < len(hand) - REACH)]
    if len(frames) < LEAST_FRAMES:
        return None
    length = float(np.median(np.linalg.norm(hand[frames, 1:, :2] - hand[frames, :1, :2], axis=-1).max(axis=1)))
    errors = np.zeros(2 * REACH + 1)
    for number, shift in enumerate(range(-REACH, REACH + 1)):
        there = wrist[frames - shift]
        sure = there[:, 2] >= SURE
        if sure.sum() < LEAST_FRAMES:
            return None
        apart = hand[frames[sure], 0, :2] - there[sure, :2]
        apart -= np.median(apart, axis=0)
        # The error of an outlier is limited to one hand length.
        capped = np.minimum((apart**2).sum(axis=1) / max(length, 1.0) ** 2, 1.0)
        errors[number] = capped.sum() * len(frames) / sure.sum()
    return errors


_STEP = 25  # Number of frames between progress reports. Chosen by hand.
AGAIN_S, ENOUGH = 0.05, 2
"""Seconds between searches for a hidden hand, which need up to six crops each. Number of views with a hand above which
the other views only search for it in turn (docs/research-log/hands.md)."""


def find_hands(capture: Capture, choice: DetectorChoice, progress: Progress = silent) -> Capture:
    """Detect the hands in a capture's footage, and add them to the keypoints.

    Wrists and elbows are triangulated, or lifted if only one view shows the person. They determine the crops in every
    view. If two views find a hand, the other views search for it again at its triangulated position. If the footage has
    a delay, the hands are shifted in time.
    """
    cameras, keypoints = capture.require_views()
    cameras = replace(cameras, path=None)  # Crops need positions relative to the camera, not to the world.
    if not any(capture.footage):
        raise CaptureInvalid("The capture has no footage.", where=capture.name, hint="Read its folder again.")
    arms, found = arms_of(capture)
    scale = footage_scale(cameras, [None if path is None else probe(path) for path in capture.footage])
    filmed, arms = in_footage(cameras, arms, scale)
    hands = _unseen(len(cameras), keypoints.num_frames, 2)
    together = min(usable_cores(), sum(path is not None for path in capture.footage))
    with ExitStack() as stack:
        idle: SimpleQueue[DetectorProcess] = SimpleQueue()
        for _ in range(together):
            idle.put(stack.enter_context(DetectorProcess(choice, usable_cores() // together)))
        each = stack.enter_context(ThreadPoolExecutor(together)).map

        def look(crop: np.ndarray) -> HandInCrop:
            process = idle.get()
            try:
                answer = process.detect(crop, 0.0)
            finally:
                idle.put(process)
            points, presence, right = answer["points"], answer["presence"], answer["right"]
            return HandInCrop(points.astype(np.float64), float(presence[0]), float(right[0]))

        for frame, pictures in pictures_of(capture, each):
            before = hands[:, frame - 1] if frame else None
            due = is_due(before, frame, round(capture.fps * AGAIN_S))
            hands[:, frame] = search_hands(pictures, filmed, arms.at(frame), look, before, due, each)
            if frame % _STEP == 0:
                progress("Finding hands", frame, keypoints.num_frames)
    progress("Finding hands", keypoints.num_frames, keypoints.num_frames)
    wanted = np.isfinite(arms.places).all(axis=(0, 1, 3))
    unseen = np.flatnonzero(wanted & ~(hands[..., 2] > 0).any((0, 1, 3)))
    found += [_not_found("picture", side, Severity.NOTE) for side in unseen]
    shift = footage_shift(hands, arms.detected[:, :, 1])
    if shift:
        firsts = capture.footage_first or (0,) * len(capture.footage)
        hands, capture = in_time(hands, shift), replace(capture, footage_first=tuple(n + shift for n in firsts))
        found.append(diagnostic("footage_late", size=shift, remedy=Remedy.REPAIRED))
    keypoints = replace(keypoints, hands=_scaled(hands, 1.0 / scale))  # back to calibrated pixels
    return replace(capture, keypoints=keypoints, notes=(*capture.notes, *found))


def is_due(before: np.ndarray | None, frame: int, every: int) -> np.ndarray | None:
    """Return a mask (C, 2) of the hands to search for in each view, or None for all hands.

    ``before`` contains the hands (C, 2, 21, 3) in the previous frame, or is None. If at least ``ENOUGH`` views detected
    a hand in that frame, the other views only search for it in every ``every``-th frame.
    """
    if before is None or every <= 1:
        return None
    had = (before[..., 2] > 0).any(axis=-1)
    turn = np.arange(had.size).reshape(had.shape)
    return had | ((frame + turn) % every == 0) | (had.sum(axis=0) < ENOUGH)


def seen_by(capture: Capture, least: int) -> dict[str, float]:
    """For each side, return the percentage of frames with a hand in at least ``least`` views."""
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    views = (capture.keypoints.hands[..., 2] > 0).any(axis=-1).sum(axis=0)
    return {side: round(100.0 * float((views[:, s] >= least).mean()), 1) for s, side in enumerate(SIDES)}


def arms_of(capture: Capture) -> tuple[Arms, list[Diagnostic]]:
    """Triangulate or lift the elbows and wrists, and interpolate gaps. Also report sides without an arm."""
    cameras, keypoints = capture.require_views()
    cameras = replace(cameras, path=None)  # Crops need positions relative to the camera, not to the world.
    names = keypoints.joint_set.keypoints
    columns = [names.index(f"{side}_{part}") for part in ("elbow", "wrist") for side in SIDES]
    xy, confidence = keypoints.xy[:, :, columns], keypoints.confidence[:, :, columns]
    if capture.is_one_view:
        points = _lifted(cameras, keypoints)[:, columns]
    else:
        points = np.asarray(triangulate(cameras, xy, confidence).points)
    frames = np.arange(len(points))
    for track in points.transpose(1, 2, 0):  # the (3, F) positions of each joint
        known = np.isfinite(track).all(axis=0)
        if known.any():
            track[:] = [np.interp(frames, frames[known], axis[known]) for axis in track]
    places = points.reshape(len(points), 2, 2, 3)
    lost = ~np.isfinite(places).all(axis=(0, 1, 3))
    found = [_not_found("wrist", side, Severity.WARNING) for side in np.flatnonzero(lost)]
    detected = np.concatenate([xy, confidence[..., None]], axis=-1).reshape(*xy.shape[:2], 2, 2, 3)
    return Arms(places, detected), found


def _lifted(cameras: Cameras, keypoints: Keypoints2D) -> np.ndarray:
    """Lift a single view to keypoints (F, K, 3) in metres, in camera axes, for a person of average size."""
    view = int(np.flatnonzero((keypoints.confidence > 0).any(axis=(1, 2)))[0])
    camera, body = cameras.subset([view]), load_body()
    lifted = lift_take(camera, keypoints.views([view]), body, up=camera.R[0, :, 2])
    landmarks = keypoint_landmarks(body, keypoints.joint_set)
    return (lifted.placed(body, landmarks, np.zeros(NUM_BETAS))[0] - camera.t[0]) @ camera.R[0]


def _not_found(reason: str, side: int, severity: Severity) -> Diagnostic:
    return diagnostic("hand_not_found", severity=severity, reason=reason, joints=[f"{SIDES[side]}_wrist"])


def pictures_of(capture: Capture, each: Each = map) -> Iterator[tuple[int, dict[int, np.ndarray]]]:
    """Yield each frame number of the take, with the image from each view."""
    firsts, waiting = capture.footage_first or (0,) * len(capture.footage), dict[int, Picture]()
    streams = {view: read_pictures(probe(path)) for view, path in enumerate(capture.footage) if path is not None}
    for frame in range(capture.num_frames):
        pictures = dict[int, np.ndarray]()

        def read(view: int, frame: int = frame, pictures: dict[int, np.ndarray] = pictures) -> None:
            number, stream = frame + firsts[view], streams[view]
            picture = waiting.pop(view, None) or next(stream, None)
            while picture is not None and picture.number < number:
                picture = next(stream, None)
            if picture is not None and picture.number == number:
                pictures[view] = picture.rgb
            elif picture is not None:
                waiting[view] = picture

        for _ in each(read, streams):
            pass
        yield frame, {view: pictures[view] for view in streams if view in pictures}
