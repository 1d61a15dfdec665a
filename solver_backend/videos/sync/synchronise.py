"""Synchronise the cameras of a take by keypoints, claps, sound or light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import Cameras
from solver_backend.videos.files.video import VideoWithoutSound, probe, read_sound
from solver_backend.videos.sync.clap import (
    PIECE_S,
    SOUND_FLOOR_S,
    WRISTS,
    brightness_signal,
    claps,
    clocks_by_claps,
    onsets,
)
from solver_backend.videos.sync.clocks import Clocks, clocks_of_pairs
from solver_backend.videos.sync.geometry import FilmedTracks, clocks_by_geometry
from solver_backend.videos.sync.signals import Signal, SyncUnknown, pair_lag
from solver_backend.videos.sync.speeds import clocks_by_speeds
from solver_backend.videos.video_detections import VideoDetections

WAYS = ("auto", "keypoints", "clap", "sound", "flash", "none")
"""Methods. ``auto`` uses keypoints, or sound if those show nothing."""
REACH_S = 6.5  # Largest offset.
IN_STEP_FRAMES, IN_STEP_SIGMAS = 1.0, 3.0
"""Largest offset of cameras in step, and in deviations. Nobody starts four cameras by hand within a frame. The solve
corrects the rest."""
ROLLING_SHUTTER = diagnostic("rolling_shutter")


def synchronise(
    found: Sequence[VideoDetections], cameras: Cameras | None, way: str = "auto", progress: Progress = silent
) -> Clocks:
    """Return the clocks of the cameras of a take.

    Args:
        found: what was found in each camera's video.
        cameras: calibrated cameras in the same order. None where there is no calibration yet.
        way: one of ``WAYS``.
        progress: called as stages advance.

    Raises:
        CommandLineInvalid: the way is unknown.
        SyncUnknown: nothing shows the clocks by it.
        VideoWithoutSound: by sound, and a video has none.
    """
    names = tuple(item.name for item in found)
    if way not in WAYS:
        raise CommandLineInvalid(f"'{way}' is not a way to synchronise.", hint=f"One of {', '.join(WAYS)}.")
    if way == "none" or len(found) == 1:
        return Clocks.alike(names)
    progress("Synchronising", 0, 1)
    alone = {"sound": by_sound, "flash": by_flash, "clap": by_claps}
    if way in alone:
        clocks = alone[way](found)
    else:
        clocks = by_keypoints(found, cameras) if way == "keypoints" else _by_what_tells(found, cameras)
    progress("Synchronising", 1, 1)
    return in_step(clocks, float(np.median([item.fps for item in found])))


def _by_what_tells(found: Sequence[VideoDetections], cameras: Cameras | None) -> Clocks:
    """Return the clocks by keypoints, else by sound, else as filmed with a warning."""
    try:
        return by_keypoints(found, cameras)
    except SyncUnknown as why:
        try:
            return by_sound(found)
        except (SyncUnknown, VideoWithoutSound):
            names = tuple(item.name for item in found)
            return replace(Clocks.alike(names), findings=(diagnostic("clocks_assumed", reason=why.message),))


def by_keypoints(found: Sequence[VideoDetections], cameras: Cameras | None) -> Clocks:
    """Return the clocks by the main person: by rays of calibrated cameras, else by speeds.

    Raises:
        SyncUnknown: nobody moves enough, or the views do not agree.
    """
    names = tuple(item.name for item in found)
    tracks = [item.of_track(item.main_track())[0] for item in found]
    times = [item.times_s - item.times_s[0] for item in found]
    if any(len(when) < 2 for when in times):
        raise SyncUnknown("A video of a single picture has no clock.", where=", ".join(names))
    if cameras is None:
        return clocks_by_speeds(names, tracks, times, found[0].joint_set, REACH_S)
    fps = float(np.median([item.fps for item in found]))
    filmed = FilmedTracks(replace(cameras, names=names), tracks, times, found[0].joint_set, fps)
    try:
        start = clocks_by_speeds(names, tracks, times, found[0].joint_set, REACH_S)
    except SyncUnknown:
        start = None
    return clocks_by_geometry(filmed, start, REACH_S)


def by_sound(found: Sequence[VideoDetections]) -> Clocks:
    """Return the clocks by sound.

    Raises:
        VideoWithoutSound: a video has no sound.
        SyncUnknown: they heard nothing in common.
    """
    signals = []
    for item in found:
        heard = read_sound(item.video)
        signals.append(onsets(replace(heard, start_s=heard.start_s - float(item.times_s[0]))))
    return _of_signals(found, signals, PIECE_S, SOUND_FLOOR_S, "sound")


def by_claps(found: Sequence[VideoDetections]) -> Clocks:
    """Return the clocks by claps of the person.

    Raises:
        SyncUnknown: no clap is seen by all, or the detector finds no wrists.
    """
    if not set(WRISTS) <= set(found[0].joint_set.keypoints):
        raise SyncUnknown("The detector finds no wrists, so no clap.", hint="Use sound: --sync sound.")
    if any(item.num_frames < 2 for item in found):
        raise SyncUnknown("A video of a single picture has no clock.", where=", ".join(i.name for i in found))
    tracks = [item.of_track(item.main_track())[0] for item in found]
    signals = [claps(t, item.times_s - item.times_s[0], item.joint_set) for t, item in zip(tracks, found, strict=True)]
    return clocks_by_claps(tuple(item.name for item in found), signals, REACH_S)


def by_flash(found: Sequence[VideoDetections]) -> Clocks:
    """Return the clocks by changes of the light.

    Raises:
        SyncUnknown: nothing flashed.
    """
    signals = [brightness_signal(probe(item.video)) for item in found]
    floor_s = float(np.median([1.0 / max(item.fps, 1.0) for item in found])) / np.sqrt(12.0)
    return _of_signals(found, signals, 10.0, floor_s, "light")


def _of_signals(
    found: Sequence[VideoDetections], signals: list[Signal], piece_s: float, floor_s: float, method: str
) -> Clocks:
    pairs = {}
    for i, j in combinations(range(len(found)), 2):
        lag = pair_lag(signals[i], signals[j], reach_s=REACH_S, piece_s=piece_s, floor_s=floor_s)
        if lag is not None:
            pairs[i, j] = lag
    return clocks_of_pairs(tuple(item.name for item in found), pairs, method)


def in_step(clocks: Clocks, fps: float) -> Clocks:
    """Return the clocks, or equal ones if their differences are no more than their uncertainty.

    Detections of cameras in step are then not resampled at all.
    """
    sigma = np.sqrt(clocks.covariance[:, 0, 0])
    allowed = np.minimum(np.maximum(IN_STEP_SIGMAS * sigma, IN_STEP_FRAMES / fps), 2.0 * IN_STEP_FRAMES / fps)
    # A rate that cannot be distinguished from none within the take counts as none.
    sure = np.abs(clocks.rate) > IN_STEP_SIGMAS * np.sqrt(clocks.covariance[:, 1, 1])
    if (np.abs(clocks.offset_s) <= allowed).all() and not sure.any():
        method = f"{clocks.method}, in step" if clocks.method != "as filmed" else clocks.method
        return replace(Clocks.alike(clocks.names), method=method, findings=clocks.findings)
    return replace(clocks, findings=(*clocks.findings, ROLLING_SHUTTER))
