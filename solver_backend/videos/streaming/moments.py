"""Read live cameras or replayed videos, and group simultaneous detections."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from solver_backend.exchange.errors import BackendMissing, MocapError, SolverFailed, TooFewViews
from solver_backend.exchange.events import EventLine, event_line
from solver_backend.live.frames import ViewMoment
from solver_backend.videos.detect.child.pose_workers.serve import PoseDetector
from solver_backend.videos.detect.detector import DetectorFailed
from solver_backend.videos.files.video import VideoUnreadable, decoded_pictures, library, probe


@dataclass(frozen=True)
class LivePicture:
    """An image from a live camera, decoded on demand."""

    number: int  # Index of the image.
    time_s: float  # Time in seconds on the clock that all cameras share.
    arrived: float  # ``time.perf_counter()`` on arrival, or when a replayed image was due.
    rgb: Callable[[], np.ndarray]  # Returns the (H, W, 3) uint8 image.


class PictureSource(Protocol):
    """Interface of live cameras and replayed videos."""

    name: str
    size: tuple[int, int]  # Width and height in pixels, known after opening.
    fps: float  # Images per second, known after opening.

    def open(self) -> None:
        """Connect to the camera. Raise ``MocapError`` if it is not available."""

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield images as they arrive, until the source ends. Their times count from ``start`` (``perf_counter``)."""
        ...

    def close(self) -> None:
        """Stop the source. Any thread may call this repeatedly."""


SIZE, FPS = (1280, 720), 30.0  # Requested image size and rate of a webcam. The actual ones may differ.
_FORMATS = {"linux": ("v4l2", "/dev/video{}"), "darwin": ("avfoundation", "{}"), "win32": ("dshow", "video={}")}
"""FFmpeg's input format and device name for each operating system."""


class Webcam:
    """A webcam, identified by its number. Each image gets its arrival time."""

    def __init__(self, name: str, index: int) -> None:
        self.name, self.index = name, index
        self.size, self.fps = SIZE, FPS
        self._next: Callable[[], Callable[[], np.ndarray] | None] | None = None
        self._close: Callable[[], Any] = lambda: None

    def open(self) -> None:
        """Connect to the webcam. Raise ``VideoUnreadable`` if there is none with this number."""
        try:
            import cv2
        except ModuleNotFoundError:
            self._open_by_av()
            return
        camera = cv2.VideoCapture(self.index)
        if not camera.isOpened():
            raise _missing(self.index)
        wide, high, rate = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS
        for key, value in ((wide, SIZE[0]), (high, SIZE[1]), (rate, FPS)):
            camera.set(key, value)
        self.size, self.fps = (int(camera.get(wide)), int(camera.get(high))), float(camera.get(rate)) or FPS

        def read() -> Callable[[], np.ndarray] | None:
            there, bgr = camera.read()
            return partial(np.ascontiguousarray, bgr[..., ::-1]) if there else None

        self._next, self._close = read, camera.release

    def _open_by_av(self) -> None:
        try:
            av = library()
        except BackendMissing as error:
            hint = "Install it with: pip install av."
            raise BackendMissing("A webcam needs OpenCV or PyAV, and neither is installed.", hint=hint) from error
        kind, name = _FORMATS.get(sys.platform, _FORMATS["linux"])
        options = {"video_size": f"{SIZE[0]}x{SIZE[1]}", "framerate": f"{FPS:g}"}
        try:
            container = av.open(name.format(self.index), format=kind, options=options)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise _missing(self.index) from error
        stream = container.streams.video[0]
        self.size = (stream.codec_context.width, stream.codec_context.height)
        frames = container.decode(stream)

        def read() -> Callable[[], np.ndarray] | None:
            try:
                frame = next(frames, None)
            except (av.error.FFmpegError, OSError):
                return None
            return None if frame is None else partial(frame.to_ndarray, format="rgb24")

        self._next, self._close = read, container.close

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield images as they arrive, until the webcam is unplugged."""
        number = 0
        while self._next is not None and (rgb := self._next()) is not None:
            arrived = time.perf_counter()
            yield LivePicture(number, arrived - start, arrived, rgb)
            number += 1

    def close(self) -> None:
        """Release the webcam."""
        self._next = None
        self._close()


def _missing(index: int) -> VideoUnreadable:
    hint = "Check its cable and number, and check that no other program is using it."
    return VideoUnreadable("The webcam cannot be opened.", where=f"webcam:{index}", hint=hint)


class ReplayedVideo:
    """A video file that is played in real time, once or repeatedly."""

    def __init__(self, name: str, path: Path, *, repeat: bool = False) -> None:
        self.name, self.path = name, path
        self.size, self.fps = (0, 0), 0.0
        self._repeat, self._closed = repeat, threading.Event()

    def open(self) -> None:
        """Read the size, frame rate and duration of the video."""
        info = probe(self.path)
        self.size, self.fps, self._first_s = info.size, info.fps, float(info.times_s[0])
        self._length_s = float(info.times_s[-1] - info.times_s[0]) + 1.0 / max(info.fps, 1.0)

    def pictures(self, start: float) -> Iterator[LivePicture]:
        """Yield each image when it is due, or as soon as it is decoded if that is later."""
        number, late_s = 0, 0.0
        while not self._closed.is_set():
            for time_s, picture in decoded_pictures(self.path):
                at = time_s - self._first_s + late_s
                self._closed.wait(max(start + at - time.perf_counter(), 0.0))
                if self._closed.is_set():
                    return
                yield LivePicture(number, at, start + at, picture)
                number += 1
            if not self._repeat:
                return
            late_s += self._length_s

    def close(self) -> None:
        """End the replay."""
        self._closed.set()


KEPT = 4  # Number of recent images kept per camera, so that all cameras have simultaneous images. Chosen by hand.
MakeDetector = Callable[[], AbstractContextManager[PoseDetector]]  # Creates the detector for one camera.


class LiveView:
    """A camera and its detector, each in its own thread. Acquire ``changed`` before reading the fields."""

    def __init__(self, source: PictureSource, make: MakeDetector, changed: threading.Condition) -> None:
        self.source, self._make, self.changed = source, make, changed
        self.newest: deque[LivePicture] = deque(maxlen=KEPT)
        self.about: dict[str, Any] = {}  # Description of the detector, or {} until it is ready.
        self.busy = False  # True while an image is being processed.
        self.used = -1  # Number of the most recently requested moment.
        self.answer: tuple[int, np.ndarray] | None = None  # Number of the last detected moment, and people (P, K, 3).
        self.failure: MocapError | None = None  # Reason if the view ended early.
        self.ended = False
        self._asked: queue.SimpleQueue[tuple[int, LivePicture] | None] = queue.SimpleQueue()

    def make_ready(self) -> None:
        """Start the detector in a thread."""
        threading.Thread(target=self._detect, name=f"detect {self.source.name}", daemon=True).start()

    def begin(self, start: float) -> None:
        """Start reading images in a thread. Image times count from ``start`` (``perf_counter``)."""
        threading.Thread(target=self._read, args=(start,), name=f"film {self.source.name}", daemon=True).start()

    def ask(self, moment: int, picture: LivePicture) -> None:
        """Request the detection of an image. The caller must hold the condition ``changed``."""
        self.busy, self.used = True, moment
        self._asked.put((moment, picture))

    def stop(self) -> None:
        """Stop both threads, without waiting for detections in progress."""
        with self.changed:
            self.ended = True
            self.changed.notify_all()
        self._asked.put(None)
        self.source.close()

    def _read(self, start: float) -> None:
        try:
            for picture in self.source.pictures(start):
                with self.changed:
                    if self.ended:
                        return
                    self.newest.append(picture)
                    self.changed.notify_all()
        except Exception as error:
            self._end(error)
        else:
            self._end(None)

    def _detect(self) -> None:
        try:
            with self._make() as detector:
                width, height = self.source.size
                # The first image makes the detector load its model, so this must happen before camera images arrive.
                detector.detect(np.zeros((height, width, 3), np.uint8), 0.0)
                self._announce(about=detector.about)
                for moment, picture in iter(self._asked.get, None):
                    if self.ended:
                        break
                    found = detector.detect(picture.rgb(), picture.time_s)["keypoints"]
                    self._announce(answer=(moment, np.asarray(found, np.float64)), busy=False)
        except Exception as error:
            self._end(error)

    def _announce(self, **values: Any) -> None:
        with self.changed:
            for name, value in values.items():
                setattr(self, name, value)
            self.changed.notify_all()

    def _end(self, error: Exception | None) -> None:
        if error is not None and not isinstance(error, MocapError):
            message = f"The camera's thread failed: {type(error).__name__}: {error}"
            error = SolverFailed(message, where=self.source.name)
        with self.changed:
            self.ended, self.failure, self.busy = True, self.failure or error, False
            self.changed.notify_all()


FEWEST = 2  # Minimum number of views needed for triangulation.
_NEW = 0.2  # Weight of a new duration in the running mean.
_EASY = 0.8  # Largest predicted duration at which a view is added, relative to the interval.


class ViewBudget:
    """Number of views that can be processed in time. It starts with all views and adapts to the speed."""

    def __init__(self, views: int, interval_s: float) -> None:
        self.most, self.interval_s, self.count = views, interval_s, views
        self._usual_s: float | None = None

    def took(self, count: int, seconds: float) -> None:
        """Update the mean detection time for this number of views, and adapt the number of views."""
        if count != self.count:
            return
        before = self._usual_s
        self._usual_s = seconds if before is None else before + _NEW * (seconds - before)
        if self._usual_s > self.interval_s and count > FEWEST:
            self._set(count - 1)
        elif count < self.most and self._usual_s * (count + 1) / count < _EASY * self.interval_s:
            self._set(count + 1)

    def _set(self, count: int) -> None:
        assert self._usual_s is not None
        self._usual_s *= count / self.count
        self.count = count


RATE_HZ = 30.0  # Largest rate of processed moments, even if the cameras are faster.
SAME_SHARE = 0.6  # Largest time difference between simultaneous images, relative to the image interval.
STALL_S = 0.15  # Longest wait in seconds for a camera or its detector while two other views are ready.
BEHIND_S = 2.0  # A camera is reported once if its newest image is older than this many seconds.
READY_S = 120.0  # Time limit in seconds for starting the detectors.
AHEAD_S = 0.05  # Seconds between the detectors being ready and the start of the shared clock.
_LOOK_S = 0.05  # Longest uninterrupted wait in seconds.


@dataclass
class MomentCounts:
    """Numbers of processed and skipped moments and views. A moment is a set of simultaneous images."""

    moments: int = 0
    dropped: int = 0  # Number of filmed moments that were not processed.
    views_left_out: int = 0  # Number of views that were skipped at processed moments.


class LiveMoments:
    """Live cameras and their detectors. Entering the context opens the cameras, and leaving it stops them."""

    def __init__(self, sources: Sequence[PictureSource], make: MakeDetector, rate_hz: float = RATE_HZ) -> None:
        self._changed = threading.Condition()
        self.views = [LiveView(source, make, self._changed) for source in sources]
        self._rate_hz = rate_hz
        self.counts = MomentCounts()
        self._last_s = -np.inf
        self._named: set[str] = set()
        self._behind: set[str] = set()

    @property
    def about(self) -> dict[str, Any]:
        """Description of the detectors."""
        return self.views[0].about

    def __enter__(self) -> LiveMoments:
        """Open the cameras, and wait until every detector is ready."""
        try:
            for view in self.views:
                view.source.open()
            for view in self.views:
                view.make_ready()
            self._wait_until_ready()
        except BaseException:
            self._end()
            raise
        fps = max(view.source.fps for view in self.views)
        self._interval_s = 1.0 / max(fps, 1.0)
        self.budget = ViewBudget(len(self.views), max(1.0 / self._rate_hz, self._interval_s))
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def _end(self) -> None:
        for view in self.views:
            view.stop()

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + READY_S
        with self._changed:
            while not all(view.about for view in self.views):
                if failure := next((view.failure for view in self.views if view.failure), None):
                    raise failure
                if time.monotonic() > deadline:
                    raise DetectorFailed("The detectors did not start.", hint="Detect a single video first.")
                self._changed.wait(_LOOK_S)

    def moments(self) -> Iterator[ViewMoment | EventLine]:
        """Yield moments and camera events until fewer than two cameras remain.

        A moment is a set of simultaneous images. The next one is processed by the detectors while the current one is
        solved.
        """
        start = time.perf_counter() + AHEAD_S
        for view in self.views:
            view.begin(start)
        asked = None
        while True:
            asked = asked or self._ask(wait=True)
            yield from self._events()
            if asked is None and self._alive() < FEWEST:
                return
            if asked is None:
                continue
            found = self._answered(*asked)
            asked = self._ask(wait=False)
            if found is not None:
                yield found

    def _ask(self, *, wait: bool) -> tuple[dict[int, LivePicture], float] | None:
        """Request the detection of the next moment. Return its images by view, and the time of the request.

        Return None if there is no new moment yet, or if a camera event must be reported first.
        """
        with self._changed:
            while True:
                now = time.perf_counter()
                if self._alive() < FEWEST or self._late(now):
                    return None
                if chosen := self._chosen(now):
                    break
                if not wait:
                    return None
                self._changed.wait(_LOOK_S)
            for index, picture in chosen.items():
                self.views[index].ask(self.counts.moments, picture)
            self._last_s = max(picture.time_s for picture in chosen.values())
            counts = self.counts
            counts.moments += 1
            counts.views_left_out += sum(not view.ended for view in self.views) - len(chosen)
            counts.dropped = max(max(p.number for p in chosen.values()) + 1 - counts.moments, counts.dropped)
            return chosen, time.perf_counter()

    def _chosen(self, now: float) -> dict[int, LivePicture]:
        """Select simultaneous images for the next moment, by view. Views that have waited longest have priority."""
        there = [c for c, view in enumerate(self.views) if view.newest and not view.ended]
        prompt = [c for c in there if now - self.views[c].newest[-1].arrived < STALL_S + self._interval_s]
        idle = sorted((c for c in prompt if not self.views[c].busy), key=lambda c: self.views[c].used)
        began = min((self.views[c].newest[0].arrived for c in there), default=now)
        if len(idle) < FEWEST or (len(there) < self._alive() and now - began < STALL_S):
            return {}
        chosen = idle[: self.budget.count]
        at = min(self.views[c].newest[-1].time_s for c in chosen)
        if at < self._last_s + self.budget.interval_s - SAME_SHARE * self._interval_s:
            return {}
        near = {c: min(self.views[c].newest, key=lambda picture: abs(picture.time_s - at)) for c in chosen}
        same = {c: p for c, p in near.items() if abs(p.time_s - at) < SAME_SHARE * self._interval_s}
        return same if len(same) >= FEWEST else {}

    def _alive(self) -> int:
        return sum(not view.ended for view in self.views)

    def _answered(self, asked: dict[int, LivePicture], begun: float) -> ViewMoment | None:
        moment = self.counts.moments - 1
        with self._changed:
            while True:
                answers = {c: self.views[c].answer for c in asked}
                found = {c: answer[1] for c, answer in answers.items() if answer is not None and answer[0] == moment}
                left = [c for c in asked if c not in found and not self.views[c].ended]
                if not left or (len(found) >= FEWEST and time.perf_counter() - begun > STALL_S):
                    break
                self._changed.wait(_LOOK_S)
        self.counts.views_left_out += len(left)
        self.budget.took(len(asked), time.perf_counter() - begun)
        if len(found) < FEWEST:
            return None
        people = tuple(found.get(c) for c in range(len(self.views)))
        taken = [asked[c] for c in found]
        times = tuple(asked[c].time_s if c in found else np.nan for c in range(len(self.views)))
        return ViewMoment(float(np.mean([p.time_s for p in taken])), max(p.arrived for p in taken), people, times)

    def _late(self, now: float) -> list[LiveView]:
        known = [view for view in self.views if view.newest and not view.ended and view.source.name not in self._behind]
        return [view for view in known if now - view.newest[-1].arrived > BEHIND_S]

    def _events(self) -> Iterator[EventLine]:
        """Yield an event for each camera that has newly failed or fallen behind."""
        failed = {view.source.name: view.failure.message for view in self.views if view.failure is not None}
        for name in [name for name in failed if name not in self._named]:
            self._named.add(name)
            yield event_line("camera_lost", f"{name}: {failed[name]}")
        with self._changed:
            late = [view.source.name for view in self._late(time.perf_counter())]
            self._behind |= set(late)
        for name in late:
            message = (
                f"{name}: no frame arrived in time for {BEHIND_S:g} s. The camera stopped, or its frames cannot be"
            )
            yield event_line("camera_behind", f"{message} read fast enough.")

    def require_views(self) -> None:
        """Raise ``TooFewViews`` if cameras failed and fewer than two remain."""
        failed = [view for view in self.views if view.failure is not None]
        if failed and len(self.views) - len(failed) < FEWEST:
            names = ", ".join(view.source.name for view in failed)
            raise TooFewViews(f"Fewer than two cameras are left: {failed[0].failure}", where=names)
