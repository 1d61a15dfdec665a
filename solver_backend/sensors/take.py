"""Turn a folder of sensor recordings into a point cloud, and model the clocks of triggered sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.sensors.acquisition.acquire import Acquisition, SensorSightings
from solver_backend.sensors.acquisition.blobs import learned_mask
from solver_backend.sensors.devices.device import NoMarkers, SensorFailed
from solver_backend.sensors.devices.recorded import SensorFolder
from solver_backend.sensors.fusion.moments import Finding, Gatherer, MarkerTracks, build_cloud, fuse
from solver_backend.types import Capture, MarkerCloud
from solver_backend.videos.sync.clocks import Clocks


@dataclass(frozen=True)
class SensorTake:
    """Point cloud of a folder of sensors."""

    cloud: MarkerCloud  # Unnamed points with covariances. The residual is each point's standard deviation.
    frames: dict[str, int]
    findings: tuple[Diagnostic, ...]


def cloud_of(
    folder: SensorFolder,
    *,
    masks: Mapping[str, np.ndarray] = MappingProxyType({}),
    clusters: str = "test",
    progress: Progress = silent,
) -> SensorTake:
    """Return the point cloud of a folder of sensors. ``masks`` are the ones of ``masks_of``.

    Raises:
        NoMarkers: no sensor saw a marker in any frame.
        PicturesDiffer: infrared, depth and calibration have different sizes.
        RecordingInvalid: an index cannot be read.
    """
    finders = [Acquisition(folder.cameras, d.name, masks.get(d.name)) for d in folder.devices]
    gatherer = Gatherer(folder.cameras.names, 1.0 / folder.fps)
    tracks, tracked = MarkerTracks(), []
    frames: Counter[str] = Counter()
    ended: list[Diagnostic] = []
    expected = max((device.count() for device in folder.devices), default=0)
    for moment in _moments(folder, gatherer, finders, frames, ended):
        tracked.append(tracks.update(fuse(moment, clusters)))
        progress("Markers from sensors", len(tracked), max(len(tracked), expected))
    cloud = build_cloud(tracked, folder.fps)
    found = (*ended, *counted(gatherer.findings))
    if not cloud.positions.shape[1]:
        hint = "; ".join(map(sentence, found)) or "Check that the markers are retro-reflective and lit."
        raise NoMarkers("No sensor saw a marker in any frame.", where=str(folder.path), hint=hint)
    missing = [diagnostic("sensor_failed", reason="missing", cameras=[name]) for name in folder.missing]
    return SensorTake(cloud, dict(frames), (*missing, *found))


def capture_of(
    folder: SensorFolder, take: SensorTake | None = None, name: str = "", *, progress: Progress = silent
) -> Capture:
    """Return the capture of a folder: unnamed points, cameras and problems. ``cloud_of`` makes a missing take."""
    take, name = take or cloud_of(folder, progress=progress), name or folder.path.name
    source = (str(folder.path),)
    return Capture(name, cameras=folder.cameras, markers=take.cloud, sources=source, problems=take.findings)


def counted(findings: Sequence[Finding]) -> list[Diagnostic]:
    """Return each finding once, with its first time and its count."""
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
    """Return each sensor's mask of constant lights from a recording of the empty scene."""
    return {d.name: learned_mask(frame.infrared for frame in d.frames()) for d in empty.devices if d.count()}


def _moments(
    folder: SensorFolder, gatherer: Gatherer, finders: list[Acquisition], frames: Counter[str], ended: list[Diagnostic]
) -> Iterator[list[SensorSightings]]:
    for name in folder.missing:
        gatherer.ended(folder.cameras.names.index(name))
    going = {finder: iter(device.frames()) for finder, device in zip(finders, folder.devices, strict=True)}
    clock = dict.fromkeys(going, -np.inf)
    while going:
        # Ask the sensor that is farthest behind, so that few frames wait.
        finder = min(going, key=lambda f: clock[f])
        frame = None
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
        yield from gatherer.moments()


INTERLEAVE_S = 160e-6
"""Exposure delay between successive time-of-flight sensors, so that the light of one does not reach another
(thesis 5.3.2, after the Azure Kinect's documentation)."""
LARGEST_INTERLEAVE_S = 0.02  # Largest exposure delay between two sensors, in seconds. Chosen by hand.


def triggered(names: tuple[str, ...], interleave_s: float = 0.0) -> Clocks:
    """Return the clocks of sensors on one trigger. At stamp t, sensor c shows what happened at ``t + c · interleave``.

    Raises:
        CommandLineInvalid: the interleave is negative or too long.
    """
    if not 0.0 <= interleave_s <= LARGEST_INTERLEAVE_S:
        hint = f"160 for time-of-flight sensors, 0 for others, at most {1e6 * LARGEST_INTERLEAVE_S:.0f}."
        raise CommandLineInvalid(f"An interleave of {1e6 * interleave_s:.0f} microseconds is not possible.", hint=hint)
    late = interleave_s * np.arange(len(names))
    return replace(Clocks.alike(names), offset_s=-late, method="trigger")
