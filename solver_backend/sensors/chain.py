"""Compute marker clouds from sensors, either live with one process per sensor or from a recording."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.errors import CommandLineInvalid, MocapError
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.acquisition.acquire import Acquisition, SensorSightings
from solver_backend.sensors.acquisition.blobs import learned_mask
from solver_backend.sensors.devices.device import Device, NoMarkers, SensorFailed, SensorFrame
from solver_backend.sensors.devices.recorded import Recording, SensorFiles, SensorFolder, SensorRecorder
from solver_backend.sensors.fusion.moments import Finding, Gatherer, MarkerTracks, TrackedPoints, build_cloud, fuse
from solver_backend.types import Cameras, Capture, MarkerCloud
from solver_backend.videos.sync.clocks import Clocks

KEPT = 4096  # Number of recent latencies that the statistics include.


@dataclass
class ChainStatistics:
    """Running statistics about fused frames, in constant memory. A moment is one frame of every sensor."""

    moments: int = 0
    points: int = 0
    skipped: int = 0  # Number of complete moments skipped in favour of newer ones.
    frames: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)  # Number of missing frames for each sensor.
    _latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    _first_s: float = 0.0
    _last_s: float = 0.0

    def add(self, latency_s: float, points: int, now: float) -> None:
        """Add a moment with its latency and number of points, fused at host time ``now``."""
        if not self.moments:
            self._first_s = now
        self.moments += 1
        self.points += points
        self._latency_ms.append(1e3 * latency_s)
        self._last_s = now

    def summary(self) -> dict[str, object]:
        """Return the statistics as JSON values."""
        data: dict[str, object] = {"moments": self.moments, "points": self.points}
        data |= {"frames": dict(self.frames), "lost": dict(self.lost), "skipped": self.skipped}
        if self.moments > 1 and self._last_s > self._first_s:
            data["fps"] = round((self.moments - 1) / (self._last_s - self._first_s), 2)
        if self._latency_ms:
            median, p99 = np.percentile(self._latency_ms, [50, 99])
            data |= {"latency_ms": round(float(median), 2), "latency_p99_ms": round(float(p99), 2)}
        return data


RETRY_S = 1.0  # Seconds between attempts to open a lost sensor.


@dataclass(frozen=True)
class SensorTask:
    """Picklable instructions for the process of one sensor."""

    device: Device
    cameras: Cameras
    mask: np.ndarray | None = None
    record: Path | None = None  # Folder of a recording that has been started, or None.
    kind: str = "raw"
    live: bool = True  # True if the sensor sets the pace. A slow disk then loses frames, and a lost sensor may return.


@dataclass(frozen=True)
class SensorEnd:
    """Number of frames and processor time of a sensor's process that has ended."""

    frames: int
    cpu_s: float
    written: int
    dropped: int


def run_sensor(task: SensorTask, out: Connection) -> None:
    """Send a sensor's markers through a pipe until the sensor or the reader stops.

    The first message is ``("ready",)``. The reader answers with the host time for the start of a replay. Then follow
    ``("like", SensorFiles)`` once if frames are recorded, ``("seen", SensorSightings)`` per frame, ``("trouble", code,
    sentence)``, and ``("end", SensorEnd)``.
    """
    with suppress(ValueError):  # the parent ends the process, and also receives Ctrl-C
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    run = _SensorRun(task, out)
    try:
        with suppress(BrokenPipeError, ConnectionError, EOFError):
            run.go()
    finally:
        run.close()


class _SensorRun:
    def __init__(self, task: SensorTask, out: Connection) -> None:
        self._task, self._out, self._stop = task, out, threading.Event()
        self._recorder: SensorRecorder | None = None
        self._frames, self._end_reported = 0, False

    def _watch(self) -> None:
        with suppress(EOFError, OSError):
            self._out.recv()
        self._stop.set()

    def go(self) -> None:
        task, device = self._task, self._task.device
        try:
            acquisition = Acquisition(task.cameras, task.device.name, task.mask)
        except MocapError as error:
            self._out.send(("trouble", error.code, str(error)))
            return
        self._out.send(("ready",))
        start = self._out.recv()
        if not isinstance(start, float):
            return
        threading.Thread(target=self._watch, daemon=True).start()
        if task.live:
            device = device.starting(start)
        while not self._stop.is_set():
            ended = False
            try:
                device.open()
                for frame in device.frames():
                    if self._stop.is_set():
                        return
                    self._record(frame)  # recorded first, so that unusable frames can be inspected later
                    self._out.send(("seen", acquisition(frame)))
                    self._frames += 1
                ended = True
            except MocapError as error:
                self._out.send(("trouble", error.code, str(error)))
            finally:
                device.close()
            if ended or not task.live or self._stop.wait(RETRY_S):
                return

    def _record(self, frame: SensorFrame) -> None:
        if self._task.record is None:
            return
        if self._recorder is None:
            like = SensorFiles.of(frame)
            self._out.send(("like", like))
            self._recorder = SensorRecorder(self._task.record, like, self._task.kind, patient=not self._task.live)
        self._recorder(frame)
        if self._recorder.ended and not self._end_reported:
            self._end_reported = True
            self._out.send(("trouble", "recording_ended", f"recording ended: {self._recorder.ended}"))

    def close(self) -> None:
        written = dropped = 0
        if self._recorder is not None:
            self._recorder.close()
            written, dropped = self._recorder.written, self._recorder.dropped
        with suppress(OSError):
            self._out.send(("end", SensorEnd(self._frames, time.process_time(), written, dropped)))
            self._out.close()


WAIT_S = 0.012  # Longest time in seconds that a moment waits for its last sensor.
LISTEN_S = 0.005  # Longest time in seconds that one step waits for messages.
MOST_WAITING = 1  # Number of complete moments that are fused, newest first. A late one would delay all that follow.
MOST_AHEAD = 8  # Maximum number of frames per sensor that may wait if no sensor is live.
READY_S, AHEAD_S = 60.0, 0.05
"""Time limit for starting the sensors, and delay of a replay's start after they are ready, in seconds."""
END_S, END_RECORDING_S = 5.0, 15.0
"""Time limits in seconds for ending a sensor's process: without a recording, and with one to complete. Blender waits
20 s for all processes."""


@dataclass(frozen=True)
class LiveMoment:
    """Markers that all sensors saw at one time, fused and tracked."""

    tracked: TrackedPoints
    arrived: float  # Arrival of the first sensor's frame, in seconds of host time.
    seen: tuple[SensorSightings, ...] = ()


def _start(process: Any) -> None:
    """Start a process that Ctrl-C cannot interrupt while it loads its libraries. Blocked signals are inherited."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        process.start()
        return
    resource_tracker.ensure_running()  # its start unblocks the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class MarkerChain:
    """Locates, fuses and tracks markers with one process per sensor. Use it as a context manager.

    With a live sensor, the chain skips frames if it is too slow. Without live sensors, the sensors wait, and no frame
    is skipped.
    """

    def __init__(
        self, tasks: list[SensorTask], fps: float, clusters: str = "test", recording: Recording | None = None
    ) -> None:
        self._tasks, self._clusters, self._recording = tasks, clusters, recording
        names, present = tasks[0].cameras.names, {task.device.name for task in tasks}
        self._patient = not any(task.live for task in tasks)
        self._gatherer = Gatherer(names, 1.0 / fps, None if self._patient else WAIT_S)
        for name in set(names) - present:
            self._gatherer.ended(names.index(name))
        self._tracks = MarkerTracks()
        self._number: dict[int, int] = {}
        self._open: dict[Connection, int] = {}
        self._processes: list[Any] = []
        self._waited_for: set[Connection] = set()
        self._ending = False
        self.start = 0.0
        """Start of the chain in seconds of host time."""
        self.statistics = ChainStatistics()
        self.ends: dict[str, SensorEnd] = {}
        """Result of each sensor's process, by sensor name."""
        self.cpu_s = 0.0
        """Processor time spent on fusion, in seconds."""

    @property
    def cameras(self) -> Cameras:
        """The calibrated sensors."""
        return self._tasks[0].cameras

    def __enter__(self) -> MarkerChain:
        context = multiprocessing.get_context("spawn")
        for index, task in enumerate(self._tasks):
            here, there = context.Pipe()
            process = context.Process(target=run_sensor, args=(task, there), daemon=True)
            _start(process)
            there.close()
            self._open[here] = index
            self._processes.append(process)
        self._waited_for = set(self._open)
        deadline = time.monotonic() + READY_S
        while self._waited_for & set(self._open) and time.monotonic() < deadline:
            self._listen(0.1)
        self.start = time.perf_counter() + AHEAD_S
        for connection in self._open:
            with suppress(OSError):
                connection.send(self.start)
        return self

    def __exit__(self, *_: object) -> None:
        self._ending = True
        for connection in self._open:
            with suppress(OSError):
                connection.send("stop")
        deadline = time.monotonic() + (END_S if self._recording is None else END_RECORDING_S)
        while self._open and time.monotonic() < deadline:
            self._listen(0.1)
        for process in self._processes:
            process.join(max(0.1, deadline - time.monotonic()))
            if process.is_alive():
                process.terminate()
                process.join()

    def moments(self, until: float = float("inf")) -> Iterator[LiveMoment | Finding]:
        """Yield fused markers and sensor diagnostics until all sensors have ended or the host time is ``until``."""
        while self._open and time.perf_counter() <= until:
            self._listen(LISTEN_S)
            yield from self._fused(time.perf_counter())
        yield from self._fused(float("inf"))

    def _fused(self, now: float) -> Iterator[LiveMoment | Finding]:
        ready = self._gatherer.moments(None if self._patient else now)
        findings, self._gatherer.findings = self._gatherer.findings, []
        yield from findings
        if len(ready) > MOST_WAITING and not self._patient:
            self.statistics.skipped += len(ready) - MOST_WAITING
            ready = ready[-MOST_WAITING:]
        for moment in ready:
            begin = time.process_time()
            tracked = self._tracks.update(fuse(moment, self._clusters))
            self.cpu_s += time.process_time() - begin
            arrived, done = min(s.host_s for s in moment), time.perf_counter()
            self.statistics.add(done - arrived, len(tracked.points), done)
            yield LiveMoment(tracked, arrived, tuple(moment))

    def _listen(self, seconds: float) -> None:
        heard = [c for c in self._open if not self._is_ahead(c)]
        if not heard:
            time.sleep(seconds)  # without connections, ``wait`` returns immediately on some systems
        for connection in wait(heard, seconds) if heard else ():
            assert isinstance(connection, Connection)
            try:
                while connection.poll() and not self._is_ahead(connection):
                    self._take(connection.recv(), connection)
            except (EOFError, OSError):
                self._gone(connection)

    def _is_ahead(self, connection: Connection) -> bool:
        if not self._patient or self._ending:
            return False
        index = self._index(self._tasks[self._open[connection]].device.name)
        return index >= 0 and self._gatherer.waiting(index) >= MOST_AHEAD

    def _index(self, name: str) -> int:
        return self.cameras.names.index(name) if name in self.cameras.names else -1

    def _take(self, message: tuple[Any, ...], connection: Connection) -> None:
        what, name = message[0], self._tasks[self._open[connection]].device.name
        if what == "ready":
            self._waited_for.discard(connection)
        elif what == "seen":
            seen: SensorSightings = message[1]
            self.statistics.frames[name] += 1
            before = self._number.get(seen.sensor, seen.number)
            self._number[seen.sensor] = seen.number
            if seen.number > before + 1:
                self.statistics.lost[name] += seen.number - before - 1
            self._gatherer.push(seen)
        elif what == "like" and self._recording is not None:
            self._recording.add(message[1])
        elif what == "trouble":
            self._report(message[1], name, message[2])
        elif what == "end":
            self.ends[name] = message[1]

    def _gone(self, connection: Connection) -> None:
        name = self._tasks[self._open.pop(connection)].device.name
        connection.close()
        if (index := self._index(name)) >= 0:
            self._gatherer.ended(index)
        if name not in self.ends:
            self._report("sensor_failed", name, "its process ended without a message. The other sensors continue")

    def _report(self, kind: str, name: str, message: str) -> None:
        found = diagnostic("sensor_failed", cameras=[name], reason=message)
        self._gatherer.findings.append(Finding(kind, self._index(name), float("nan"), found))


@dataclass(frozen=True)
class SensorTake:
    """The marker cloud of a sensor recording."""

    cloud: MarkerCloud  # Unlabelled points with covariances. The residual is each point's standard deviation.
    frames: dict[str, int]
    findings: tuple[Diagnostic, ...]


def cloud_of(
    folder: SensorFolder,
    *,
    masks: Mapping[str, np.ndarray] = MappingProxyType({}),
    clusters: str = "test",
    progress: Progress = silent,
) -> SensorTake:
    """Compute the marker cloud of a sensor recording. ``masks`` come from ``masks_of``.

    Raises:
        NoMarkers: no sensor saw a marker in any frame.
        PicturesDiffer: infrared images, depth images and calibration have different sizes.
        RecordingInvalid: an index cannot be read.
    """
    finders = [Acquisition(folder.cameras, d.name, masks.get(d.name)) for d in folder.devices]
    gatherer = Gatherer(folder.cameras.names, 1.0 / folder.fps)
    tracks, tracked = MarkerTracks(), []
    frames: Counter[str] = Counter()
    ended: list[Diagnostic] = []
    expected = max((device.count() for device in folder.devices), default=0)
    for name in folder.missing:
        gatherer.ended(folder.cameras.names.index(name))
    going = {finder: device.frames() for finder, device in zip(finders, folder.devices, strict=True)}
    clock = dict.fromkeys(going, -np.inf)
    while going:
        # Read from the sensor that is furthest behind, so that few frames have to wait.
        finder, frame = min(going, key=lambda f: clock[f]), None
        try:
            frame = next(going[finder], None)
        except SensorFailed as error:
            ended.append(diagnostic("sensor_failed", cameras=[finder.lens.name], reason=str(error)))
        if frame is None:
            del going[finder]
            gatherer.ended(finder.index)
        else:
            clock[finder] = frame.device_s
            frames[frame.sensor] += 1
            gatherer.push(finder(frame))
        for moment in gatherer.moments():
            tracked.append(tracks.update(fuse(moment, clusters)))
            progress("Markers from sensors", len(tracked), max(len(tracked), expected))
    cloud = build_cloud(tracked, folder.fps)
    found = (*ended, *counted(gatherer.findings))
    if not cloud.positions.shape[1]:
        hint = "; ".join(map(sentence, found)) or "Check that the markers are retro-reflective and lit."
        raise NoMarkers("No sensor detected a marker.", where=str(folder.path), hint=hint)
    missing = [diagnostic("sensor_failed", reason="missing", cameras=[name]) for name in folder.missing]
    return SensorTake(cloud, dict(frames), (*missing, *found))


def capture_of(
    folder: SensorFolder, take: SensorTake | None = None, name: str = "", *, progress: Progress = silent
) -> Capture:
    """Convert a sensor recording to a capture: unlabelled points, cameras and problems."""
    take, name = take or cloud_of(folder, progress=progress), name or folder.path.name
    source = (str(folder.path),)
    return Capture(name, cameras=folder.cameras, markers=take.cloud, sources=source, problems=take.findings)


def counted(findings: Sequence[Finding]) -> list[Diagnostic]:
    """Merge equal findings into one diagnostic, with the time of the first finding and the number of findings."""
    alike: dict[str, list[Finding]] = {}
    for finding in findings:
        alike.setdefault(finding.message, []).append(finding)
    found = []
    for first, *others in alike.values():
        times, when = 1 + len(others), []
        if np.isfinite(first.time):
            when.append(f"at {first.time:.2f} s")
        if others:
            when.append(f"{times} times")
        words = f" ({', '.join(when)})" if when else ""
        found.append(replace(first.found, values={**first.found.values, "when": words, "times": times}))
    return found


def masks_of(empty: SensorFolder) -> dict[str, np.ndarray]:
    """Compute each sensor's mask of constant lights from a recording of the empty scene."""
    return {d.name: learned_mask(frame.infrared for frame in d.frames()) for d in empty.devices if d.count()}


LARGEST_INTERLEAVE_S = 0.02  # Longest delay in seconds between the exposures of neighbouring sensors. Chosen by hand.


def triggered(names: tuple[str, ...], interleave_s: float = 0.0) -> Clocks:
    """Return the clocks of sensors on one trigger. Sensor c exposes ``c · interleave_s`` seconds after the trigger.

    Raises:
        CommandLineInvalid: the interleave is negative or too long.
    """
    if not 0.0 <= interleave_s <= LARGEST_INTERLEAVE_S:
        hint = f"Use 160 for time-of-flight sensors and 0 for others. The limit is {1e6 * LARGEST_INTERLEAVE_S:.0f}."
        raise CommandLineInvalid(f"An interleave of {1e6 * interleave_s:.0f} microseconds is impossible.", hint=hint)
    late = interleave_s * np.arange(len(names))
    return replace(Clocks.alike(names), offset_s=-late, method="trigger")
