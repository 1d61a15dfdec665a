"""Detect people in several videos at the same time, and track each person from image to image."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import Cancelled, MocapError
from solver_backend.exchange.joint_sets import HAND_COLUMNS, NUM_HAND_POINTS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.parallel import usable_cores
from solver_backend.types import JointSet
from solver_backend.videos.detect.detector import WORKER, DetectorChoice, DetectorProcess, joint_set_of
from solver_backend.videos.files.video import (
    PICTURES_FPS,
    VideoInfo,
    file_hash,
    probe,
    read_pictures,
    recording_hash,
    require_different,
)
from solver_backend.videos.video_detections import VERSION, VideoDetections, read_detections, write_detections


def least_cost_assignment(cost: np.ndarray) -> list[tuple[int, int]]:
    """Assign rows to columns of a cost matrix (N, M) at the smallest total cost. Return ``min(N, M)`` pairs.

    Reference: Kuhn 1955, Jonker and Volgenant 1987.
    """
    cost = np.asarray(cost, dtype=np.float64)
    if cost.shape[0] > cost.shape[1]:
        return sorted((i, j) for j, i in least_cost_assignment(cost.T))
    rows, columns = cost.shape
    row_potential, column_potential = np.zeros(rows + 1), np.zeros(columns + 1)
    row_of = np.zeros(columns + 1, dtype=int)  # 1-based; 0 is free
    for row in range(1, rows + 1):
        row_of[0], column = row, 0
        least, before = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=int)
        used = np.zeros(columns + 1, dtype=bool)
        while row_of[column]:
            used[column] = True
            i = row_of[column]
            reduced = cost[i - 1] - row_potential[i] - column_potential[1:]
            nearer = ~used[1:] & (reduced < least[1:])
            least[1:][nearer], before[1:][nearer] = reduced[nearer], column
            nearest = int(np.where(used[1:], np.inf, least[1:]).argmin()) + 1
            step = least[nearest]
            row_potential[row_of[used]] += step
            column_potential[used] -= step
            least[~used] -= step
            column = nearest
        while column:
            row_of[column] = row_of[before[column]]
            column = before[column]
    return sorted((int(row_of[j]) - 1, j - 1) for j in range(1, columns + 1) if row_of[j])


SPREAD = 0.1  # Standard deviation of a keypoint's movement between two images, relative to the person's size.
WIDENING = 5.0  # Factor by which this deviation grows per second.
LEAST_SIMILARITY = 0.05  # Smallest similarity between a detection and its track.
LOST_S = 1.0  # Seconds without a detection after which a track ends.
MOST_PEOPLE = 12  # Maximum number of people tracked per image. The most confident ones are tracked. Chosen by hand.


def tracked(frames: list[np.ndarray], times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Track people over F images. Return detection indices and track numbers (F, P), -1 where missing.

    The similarity between a detection and a track is ``mean_k exp(-d_k² / (2 s² κ²))`` over their common keypoints.
    Here d is the distance from the position that the track's velocity predicts, s is the person's size, and κ is
    ``SPREAD``, which grows with time. The assignment with the largest total similarity is used.

    Reference: Lin et al. 2014 (object keypoint similarity), Kuhn 1955 (assignment).
    """
    last, new = dict[int, _Sight](), count()
    place, track = np.full((2, len(frames), MOST_PEOPLE), -1)
    for f, (people, time_s) in enumerate(zip(frames, times_s.tolist(), strict=True)):
        last = {n: sight for n, sight in last.items() if time_s - sight.time_s <= LOST_S}
        order = np.argsort(-np.nansum(people[..., 2], axis=1), kind="stable")[:MOST_PEOPLE]
        numbers = _numbers(people[order], last, time_s, new)
        place[f, : len(order)], track[f, : len(order)] = order, numbers
        last |= {n: _Sight.of(people[i], time_s, last.get(n)) for i, n in zip(order, numbers, strict=True)}
    most = int((track >= 0).sum(axis=1).max(initial=1))
    return place[:, :most], track[:, :most]


@dataclass(frozen=True)
class _Sight:
    time_s: float
    person: np.ndarray  # (K, 3) x, y and confidence.
    velocity: np.ndarray  # (2,) px per second.

    @classmethod
    def of(cls, person: np.ndarray, time_s: float, before: _Sight | None) -> _Sight:
        velocity = np.zeros(2)
        if before is not None and time_s > before.time_s:
            both = (person[:, 2] > 0) & (before.person[:, 2] > 0)
            if both.any():
                way = np.median(person[both, :2] - before.person[both, :2], axis=0)
                velocity = 0.5 * before.velocity + 0.5 * way / (time_s - before.time_s)
        return cls(time_s, person, velocity)

    def similarity(self, person: np.ndarray, time_s: float) -> float:
        """Return the similarity (0 to 1) of a detected person to this track's predicted position."""
        both = (person[:, 2] > 0) & (self.person[:, 2] > 0)
        if both.sum() < 3:
            return 0.0
        gone_s = time_s - self.time_s
        expected = self.person[both, :2] + self.velocity * gone_s
        size = max(float(np.hypot(*np.ptp(expected, axis=0))), 1.0)
        square = ((person[both, :2] - expected) ** 2).sum(axis=1)
        return float(np.exp(-square / (2.0 * (SPREAD * (1.0 + WIDENING * gone_s) * size) ** 2)).mean())


def _numbers(people: np.ndarray, last: dict[int, _Sight], time_s: float, new: Iterator[int]) -> list[int]:
    """Assign each person to a track. A person without a track gets the next new number."""
    known = list(last)
    similarity = [last[n].similarity(person, time_s) for person in people for n in known]
    similarity = np.reshape(similarity, (len(people), len(known)))
    pairs = least_cost_assignment(-similarity)
    found = {i: known[j] for i, j in pairs if similarity[i, j] >= LEAST_SIMILARITY}
    return [found[i] if i in found else next(new) for i in range(len(people))]


_POLL_S, _GLANCE_S = 0.2, 2.0  # Seconds between checks of the detectors and between previews. Chosen by hand.


@dataclass(frozen=True)
class Glance:
    """A video's most recent image and the people in it, for a preview."""

    video: Path
    rgb: np.ndarray  # (H, W, 3) uint8 image.
    people: np.ndarray  # (P, K, 3) x and y in pixels, and confidence.
    joint_set: JointSet


def detect_videos(
    videos: Sequence[Path],
    choice: DetectorChoice,
    folder: Path,
    progress: Progress = silent,
    *,
    jobs: int = 0,
    again: bool = False,
    cameras: Sequence[str] = (),
    pictures_fps: float = PICTURES_FPS,
    show: Callable[[Sequence[Glance]], object] = len,
) -> list[VideoDetections]:
    """Detect the people in each video, or read the detections stored by an earlier run.

    Each video has its own detector process. Its detections are stored in ``folder`` as soon as they are complete. The
    file name consists of the video name and a hash of the video's bytes and the detector.

    Args:
        jobs: number of simultaneous processes, or 0 for one per core. Fewer processes use several cores each.
        again: detect the people again, even if detections are stored.
        cameras: camera names. The default is the video names.
        show: called every few seconds with the most recent images.

    Raises:
        SameVideoTwice: two videos consist of the same bytes.
    """
    infos = [probe(video, pictures_fps) for video in videos]
    hashes = {info.path: recording_hash(info.parts or (info.path,)) for info in infos}
    require_different(hashes)
    folder.mkdir(parents=True, exist_ok=True)
    together = min(jobs or usable_cores(), len(infos))
    run = _DetectionRun(choice, sum(info.num_frames for info in infos), again, max(1, usable_cores() // together))
    paths = [_kept_at(folder, info.path, hashes[info.path], choice) for info in infos]
    with ThreadPoolExecutor(together, thread_name_prefix="detector") as pool:
        futures = [pool.submit(run.of_video, i, hashes[i.path], path) for i, path in zip(infos, paths, strict=True)]
        left, shown_s = set(futures), time.monotonic()
        try:
            while left:
                done, left = wait(left, timeout=_POLL_S, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
                progress("Detecting", min(run.done, run.total), run.total)
                if left and run.glances and time.monotonic() - shown_s > _GLANCE_S:
                    show([run.glances[path] for path in sorted(run.glances)])
                    shown_s = time.monotonic()
        except BaseException:
            run.stop()
            raise
    found = [future.result() for future in futures]
    return [replace(item, camera=name) for item, name in zip(found, cameras or [""] * len(found), strict=True)]


def _kept_at(folder: Path, video: Path, digest: str, choice: DetectorChoice) -> Path:
    """Return the path of a video's stored detections. The name contains a hash of the video, model and worker.

    The hash also depends on ``VERSION``, so that detections of incompatible program versions are not reused.
    """
    options = dict(choice.options)
    if "model" in options:
        options["model"] = file_hash(options["model"])
    module = file_hash(choice.module) if choice.module.endswith(WORKER) else choice.module
    key = hashlib.blake2b(json.dumps([VERSION, module, options, digest], sort_keys=True).encode(), digest_size=6)
    return folder / f"{video.stem}_{key.hexdigest()}.npz"


class _DetectionRun:
    def __init__(self, choice: DetectorChoice, total: int, again: bool, threads: int) -> None:
        self._choice, self.total, self._again, self._threads = choice, total, again, threads
        self._lock, self._stopped = threading.Lock(), False
        self._processes: set[DetectorProcess] = set()
        self._done: dict[Path, int] = {}
        self.glances: dict[Path, Glance] = {}

    @property
    def done(self) -> int:
        return sum(self._done.values())

    def stop(self) -> None:
        with self._lock:
            self._stopped = True
            for process in self._processes:
                process.end()

    def of_video(self, info: VideoInfo, digest: str, path: Path) -> VideoDetections:
        with suppress(MocapError):
            kept = None if self._again else read_detections(path, info.path)
            if kept is not None and kept.video_hash == digest:
                self._done[info.path] = info.num_frames
                return kept
        process = DetectorProcess(self._choice, self._threads)
        with self._lock:
            self._processes.add(process)
            if self._stopped:
                process.end()
        try:
            with process:
                found = _detected(process, info, digest, self._counted(info), self._look)
        finally:
            with self._lock:
                self._processes.discard(process)
        write_detections(path, found)
        return found

    def _look(self, glance: Glance) -> None:
        self.glances[glance.video] = glance

    def _counted(self, info: VideoInfo) -> Iterator:
        for picture in read_pictures(info):
            if self._stopped:
                raise Cancelled("The work was cancelled.")
            yield picture
            self._done[info.path] = picture.number + 1


def _detected(
    process: DetectorProcess, info: VideoInfo, digest: str, pictures: Iterator, look: Callable[[Glance], None]
) -> VideoDetections:
    times, bodies, hands, joint_set = [], [], [], joint_set_of(process.about)
    for picture in pictures:
        found = process.detect(picture.rgb, picture.time_s)
        times.append(picture.time_s)
        bodies.append(found["keypoints"])
        hands.append(found.get("hands"))
        look(Glance(info.path, picture.rgb, found["keypoints"], joint_set))
    times_s = np.array(times)
    columns = joint_set.num_keypoints
    if starts := HAND_COLUMNS.get((joint_set, bodies[0].shape[1])):
        hands = [np.stack([body[:, n : n + NUM_HAND_POINTS] for n in starts], axis=1) for body in bodies]
    bodies = [body[:, :columns] for body in bodies]
    place, track = tracked(bodies, times_s)
    keypoints = _placed(bodies, place, (columns, 3))
    confidence = np.clip(np.nan_to_num(keypoints[..., 2]), 0.0, 1.0)
    missing = ~np.isfinite(keypoints).all(-1) | (confidence <= 0)
    xy, confidence = np.where(missing[..., None], np.nan, keypoints[..., :2]), np.where(missing, 0.0, confidence)
    about = (info.path, digest, process.about["name"], joint_set, info.size)
    result = VideoDetections(*about, times_s, xy, confidence, track)
    seen = [hand for hand in hands if hand is not None]
    if not seen or len(seen) < len(times):
        return result
    return replace(result, hands=_placed(seen, place, (2, NUM_HAND_POINTS, 3)))


def _placed(people: list[np.ndarray], place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Arrange the detections of each image by track slot as (F, P, ...). Empty slots are NaN."""
    out = np.full((*place.shape, *shape), np.nan)
    for frame, listed in enumerate(people):
        used = place[frame] >= 0
        out[frame, used] = listed[place[frame, used]]
    return out
