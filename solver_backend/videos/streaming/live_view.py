"""One camera while it films: a thread takes its pictures in, another has them detected; neither waits for the other."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np

from solver_backend.exchange.errors import MocapError, SolverFailed
from solver_backend.videos.streaming.pictures import LivePicture, PictureSource

KEPT = 4
"""Pictures that are kept, the newest, so that cameras meet at a moment that all of them have."""


class KeypointDetector(Protocol):
    """What finds keypoints: a detector's process, see ``DetectorProcess``."""

    about: dict[str, Any]
    """What it reports of itself."""

    def detect(self, rgb: np.ndarray, time_s: float) -> dict[str, np.ndarray]:
        """Return ``keypoints`` (P, K, 3): x, y in pixels and confidence."""
        ...


MakeDetector = Callable[[], AbstractContextManager[KeypointDetector]]
"""Makes a detector for one camera; entering it makes it ready."""


class LiveView:
    """A camera and its detector; what changes is announced by a condition, under which all is read."""

    def __init__(self, source: PictureSource, make: MakeDetector, changed: threading.Condition) -> None:
        self.source, self._make, self.changed = source, make, changed
        self.newest: deque[LivePicture] = deque(maxlen=KEPT)
        self.about: dict[str, Any] = {}
        """What the detector reports of itself; {} until it is ready."""
        self.busy = False
        """Whether a picture is being detected."""
        self.used = -1
        """Number of the last moment that it was asked for."""
        self.answer: tuple[int, np.ndarray] | None = None
        """The moment that was asked for last, and the (P, K, 3) people found there."""
        self.failure: MocapError | None = None
        """Why there is nothing more to come, if it is no end of a video."""
        self.ended = False
        self._asked: tuple[int, LivePicture] | None = None
        self._stopped = False

    def make_ready(self) -> None:
        """Start the detector."""
        threading.Thread(target=self._detect, name=f"detect {self.source.name}", daemon=True).start()

    def begin(self, start: float) -> None:
        """Take pictures in, on a clock that is 0 at ``start``."""
        threading.Thread(target=self._read, args=(start,), name=f"film {self.source.name}", daemon=True).start()

    def ask(self, moment: int, picture: LivePicture) -> None:
        """Have a picture detected; the condition is held."""
        self.busy, self.used, self._asked = True, moment, (moment, picture)
        self.changed.notify_all()

    def stop(self) -> None:
        """End both threads; what they are at is not waited for."""
        with self.changed:
            self._stopped = self.ended = True
            self.changed.notify_all()
        self.source.close()

    def _read(self, start: float) -> None:
        try:
            for picture in self.source.pictures(start):
                with self.changed:
                    if self._stopped:
                        return
                    self.newest.append(picture)
                    self.changed.notify_all()
        except Exception as error:
            self._end(_named(error, self.source.name))
        else:
            self._end(None)

    def _detect(self) -> None:
        try:
            with self._make() as detector:
                width, height = self.source.size
                detector.detect(np.zeros((height, width, 3), np.uint8), 0.0)  # no first picture is late by loading
                self._announce(about=detector.about)
                while (asked := self._wait()) is not None:
                    moment, picture = asked
                    found = detector.detect(picture.rgb(), picture.time_s)["keypoints"]
                    self._announce(answer=(moment, np.asarray(found, np.float64)), busy=False)
        except Exception as error:
            self._end(_named(error, self.source.name))

    def _wait(self) -> tuple[int, LivePicture] | None:
        with self.changed:
            while self._asked is None and not self._stopped:
                self.changed.wait()
            asked, self._asked = self._asked, None
            return None if self._stopped else asked

    def _announce(self, **values: Any) -> None:
        with self.changed:
            for name, value in values.items():
                setattr(self, name, value)
            self.changed.notify_all()

    def _end(self, failure: MocapError | None) -> None:
        with self.changed:
            self.ended, self.failure, self.busy = True, self.failure or failure, False
            self.changed.notify_all()


def _named(error: Exception, camera: str) -> MocapError:
    """Return an error with a name: a thread that broke without one would leave the others waiting for it."""
    if isinstance(error, MocapError):
        return error
    return SolverFailed(f"The camera's thread failed: {type(error).__name__}: {error}", where=camera)
