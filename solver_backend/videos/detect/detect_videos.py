"""Runs a detector over videos, several at a time; what was done before is kept."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import Cancelled, MocapError
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.parallel import usable_cores
from solver_backend.types import JointSet
from solver_backend.videos.detect.choice import WORKER, DetectorChoice
from solver_backend.videos.detect.errors import DetectorOutputsUnknown
from solver_backend.videos.detect.process import DetectorProcess
from solver_backend.videos.detect.tracking import tracked
from solver_backend.videos.files.identity import file_hash, recording_hash, require_different
from solver_backend.videos.files.probe import PICTURES_FPS, VideoInfo, probe
from solver_backend.videos.files.read import read_pictures
from solver_backend.videos.video_detections import VideoDetections, read_detections, write_detections

_POLL_S = 0.2
"""Seconds from one look at the detectors to the next; chosen by hand."""


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
) -> list[VideoDetections]:
    """Return what is found in each video; a video that was done with this detector before is not done again.

    One process of the detector a video, ``jobs`` of them at a time. A finished video's detections are in ``folder``
    at once, under a name made of the video's, its bytes' hash and the detector.

    Args:
        videos: at least one.
        choice: the detector.
        folder: where detections are kept.
        progress: called with the pictures that are done.
        jobs: processes at a time; 0 is one a core.
        again: also videos that were done before.
        cameras: names of the cameras; those of the videos if left out.
        pictures_fps: rate of folders of pictures.

    Raises:
        SameVideoTwice: two videos have the same bytes.
        BackendMissing, VideoUnreadable: see ``probe`` and ``read_pictures``.
        DetectorMissing, DetectorOutputsUnknown, DetectorFailed: see ``DetectorProcess``.
    """
    infos = [probe(video, pictures_fps) for video in videos]
    hashes = {info.path: recording_hash(info.parts or (info.path,)) for info in infos}
    require_different(hashes)
    folder.mkdir(parents=True, exist_ok=True)
    run = _DetectionRun(choice, sum(info.num_frames for info in infos), again)
    wanted = [
        _Wanted(info, hashes[info.path], _kept_at(folder, info.path, hashes[info.path], choice)) for info in infos
    ]
    workers = min(jobs or usable_cores(), len(infos))
    with ThreadPoolExecutor(workers, thread_name_prefix="detector") as pool:
        futures = [pool.submit(run.of_video, item) for item in wanted]
        try:
            _watch(futures, run, progress)
        except BaseException:
            run.stop()
            raise
    found = [future.result() for future in futures]
    return [replace(item, camera=name) for item, name in zip(found, cameras or [""] * len(found), strict=True)]


def _watch(futures: list[Future[VideoDetections]], run: _DetectionRun, progress: Progress) -> None:
    left = set(futures)
    while left:
        done, left = wait(left, timeout=_POLL_S, return_when=FIRST_COMPLETED)
        for future in done:
            future.result()
        progress("Detecting", min(run.done, run.total), run.total)


def _kept_at(folder: Path, video: Path, digest: str, choice: DetectorChoice) -> Path:
    """Return where a video's detections are kept; a model and a worker of the user's own count by their bytes."""
    options = dict(choice.options)
    if "model" in options:
        options["model"] = file_hash(options["model"])
    module = file_hash(choice.module) if choice.module.endswith(WORKER) else choice.module
    key = hashlib.blake2b(json.dumps([module, options, digest], sort_keys=True).encode(), digest_size=6)
    return folder / f"{video.stem}_{key.hexdigest()}.npz"


class _Wanted:
    """A video, the hash of its bytes, and where its detections belong."""

    def __init__(self, info: VideoInfo, digest: str, path: Path) -> None:
        self.info, self.digest, self.path = info, digest, path


class _DetectionRun:
    """What the threads share: the processes to be ended, the pictures that are done."""

    def __init__(self, choice: DetectorChoice, total: int, again: bool) -> None:
        self._choice, self.total, self._again = choice, total, again
        self._lock, self._stopped = threading.Lock(), False
        self._processes: set[DetectorProcess] = set()
        self._done: dict[Path, int] = {}

    @property
    def done(self) -> int:
        """Number of pictures that are done."""
        return sum(self._done.values())

    def stop(self) -> None:
        """End all processes; their threads end with an error that nobody asks for."""
        with self._lock:
            self._stopped = True
            for process in self._processes:
                process.end()

    def of_video(self, wanted: _Wanted) -> VideoDetections:
        """Return the detections of one video, kept or made now."""
        with suppress(MocapError):
            kept = None if self._again else read_detections(wanted.path, wanted.info.path)
            if kept is not None and kept.video_hash == wanted.digest:
                self._done[wanted.info.path] = wanted.info.num_frames
                return kept
        process = DetectorProcess(self._choice)
        with self._lock:
            self._processes.add(process)
            if self._stopped:
                process.end()
        try:
            with process:
                found = _detected(process, wanted, self._counted(wanted.info))
        finally:
            with self._lock:
                self._processes.discard(process)
        write_detections(wanted.path, found)
        return found

    def _counted(self, info: VideoInfo) -> Iterator:
        for picture in read_pictures(info):
            if self._stopped:
                raise Cancelled("The work was cancelled.")
            yield picture
            self._done[info.path] = picture.number + 1


def _detected(process: DetectorProcess, wanted: _Wanted, pictures: Iterator) -> VideoDetections:
    times, bodies, hands = [], [], []
    for picture in pictures:
        found = process.detect(picture.rgb, picture.time_s)
        times.append(picture.time_s)
        bodies.append(found["keypoints"])
        hands.append(found.get("hands"))
    joint_set = joint_set_of(process.about)
    columns = joint_set.num_keypoints
    times_s = np.array(times)
    place, track = tracked([body[:, :columns] for body in bodies], times_s)
    keypoints = _placed([body[:, :columns] for body in bodies], place, (columns, 3))
    confidence = np.clip(np.nan_to_num(keypoints[..., 2]), 0.0, 1.0)
    missing = ~np.isfinite(keypoints).all(-1) | (confidence <= 0)
    result = VideoDetections(
        video=wanted.info.path,
        video_hash=wanted.digest,
        detector=process.about["name"],
        joint_set=joint_set,
        size=wanted.info.size,
        times_s=times_s,
        xy=np.where(missing[..., None], np.nan, keypoints[..., :2]),
        confidence=np.where(missing, 0.0, confidence),
        track=track,
    )
    seen = [hand for hand in hands if hand is not None]
    if not seen or len(seen) < len(times):
        return result
    return replace(result, hands=_placed(seen, place, (2, NUM_HAND_POINTS, 3)))


def _placed(people: list[np.ndarray], place: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return (F, P, ...) what each picture's list holds at its places, NaN where there is nothing."""
    out = np.full((*place.shape, *shape), np.nan)
    for frame, listed in enumerate(people):
        used = place[frame] >= 0
        out[frame, used] = listed[place[frame, used]]
    return out


def joint_set_of(about: dict) -> JointSet:
    """Return the joint set of what a detector states about itself.

    Raises:
        DetectorOutputsUnknown: no joint set has so many keypoints.
    """
    if about.get("joint_set") in list(JointSet):
        return JointSet(about["joint_set"])
    count = int(about.get("num_keypoints", 0))
    fitting = [s for s in JointSet.fitting(count) if s is not JointSet.H36M_17]
    if not fitting:
        raise DetectorOutputsUnknown(
            f"The model finds {count} keypoints, which fit no known joint set.", where=str(about.get("name", "")),
            hint="Use a model of 17 (COCO), 26 (Halpe), 33 (MediaPipe) or 133 (COCO WholeBody) keypoints.",
        )  # fmt: skip
    return fitting[0]
