"""Faults of a recording or its calibration, one or two at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras

METRES_PER_INCH = 0.0254
OWN_UNITS = 3.3
"""Units per metre of a calibration that counts squares of a board."""
TILT = np.radians(35.0)
LATEST_FRAMES = 600
"""Maximum delay between the cameras' starts: 10 s at 60 frames per second."""


@dataclass(frozen=True)
class Recording:
    """Contents of a folder: pixels of C cameras, their calibration, and how they are written."""

    xy: np.ndarray  # (C, F, K, 2) pixels, NaN if unseen.
    confidence: np.ndarray  # (C, F, K) confidences.
    cameras: Cameras  # Written cameras, with K and image size of the calibration.
    names: tuple[str, ...]  # Names of the folders.
    transposed_K: bool = False  # Write transposed intrinsics.
    starts: np.ndarray | None = None  # (C,) delays of the cameras' starts in frames, None for none.


def half_size(recording: Recording, chosen: np.ndarray | slice = slice(None)) -> Recording:
    """Return the recording detected in pictures of half the size: ``u' + 0.5 = (u + 0.5) / 2`` px."""
    xy = recording.xy.copy()
    xy[chosen] = (xy[chosen] + 0.5) / 2 - 0.5
    return replace(recording, xy=xy)


def quarter_turn(recording: Recording, chosen: np.ndarray, clockwise: bool) -> Recording:
    """Return the recording detected in pictures rotated by 90°, with the original calibration."""
    xy = recording.xy.copy()
    for c in chosen:
        width, height = recording.cameras.image_size[c]
        u, v = xy[c, ..., 0].copy(), xy[c, ..., 1].copy()
        xy[c] = np.stack([height - 1 - v, u] if clockwise else [v, width - 1 - u], axis=-1)
    return replace(recording, xy=xy)


def in_unit(recording: Recording, units_per_metre: float) -> Recording:
    """Return the recording with its calibration in another unit."""
    return replace(recording, cameras=replace(recording.cameras, t=recording.cameras.t * units_per_metre))


def camera_to_world(recording: Recording) -> Recording:
    """Return the recording with the cameras' axes and positions in its calibration."""
    cameras = recording.cameras
    return replace(recording, cameras=replace(cameras, R=cameras.R.swapaxes(1, 2), t=cameras.centres))


def tilted(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording in a world tilted by ``TILT``, with its floor at another height."""
    heading = rng.uniform(0, 2 * np.pi)
    turn = exp_so3(TILT * np.array([np.cos(heading), np.sin(heading), 0.0]))
    R = recording.cameras.R @ turn.T
    t = recording.cameras.t + R @ np.array([0.0, 0.0, rng.uniform(-1.0, 1.0)])
    return replace(recording, cameras=replace(recording.cameras, R=R, t=t))


def started_apart(recording: Recording, rng: np.random.Generator) -> Recording:
    """Return the recording with cameras that were started by hand within ``LATEST_FRAMES``."""
    starts = np.round(rng.uniform(0, LATEST_FRAMES, len(recording.cameras))).astype(int)
    return replace(recording, starts=starts - starts.min())


_PREFIXED = (
    ("trial1_cam{n}", "cam{n}"), ("Walk_01_Miqus_{n}_2898{n}", "2898{n}"), ("2024-05-01_take2_{word}", "{word}"),
    ("take{n0}_{letter}", "{letter}"), ("P01_S2_{letter}_4k", "cam{letter}"), ("GoPro{n}-squat 03", "GoPro{n}"),
    ("squat_left{n}_synced", "left{n}"), ("jump_3_cam_{n}", "int_cam_{n}_img"), ("{word}_trial03", "{word}"),
    ("S12.T4.{n}", "{n}"),
)  # fmt: skip
_WORDS = "front", "back", "left", "right", "top", "door", "window", "wall"


def prefixed(recording: Recording, seed: int) -> Recording:
    """Return the recording with folders named by take and camera, and a calibration named by camera alone."""
    recorded, calibrated = _PREFIXED[seed % len(_PREFIXED)]

    def named(pattern: str) -> tuple[str, ...]:
        return tuple(
            pattern.format(n=c + 1, n0=7, word=_WORDS[c], letter="ABCDEFGH"[c]) for c in range(len(recording.cameras))
        )

    return replace(recording, names=named(recorded), cameras=replace(recording.cameras, names=named(calibrated)))


def _some(rng: np.random.Generator, cameras: Cameras, count: int) -> np.ndarray:
    return rng.permutation(len(cameras))[:count]


KINDS: dict[str, Callable[[Recording, np.random.Generator, int], Recording]] = {
    "as it should be": lambda r, g, seed: r,
    "half size": lambda r, g, seed: half_size(r),
    "one half size": lambda r, g, seed: half_size(r, _some(g, r.cameras, 1)),
    "turned": lambda r, g, seed: quarter_turn(r, np.arange(len(r.cameras)), seed % 2 == 0),
    "two turned": lambda r, g, seed: quarter_turn(r, _some(g, r.cameras, 2), seed % 2 == 0),
    "cm": lambda r, g, seed: in_unit(r, 100.0),
    "inch": lambda r, g, seed: in_unit(r, 1 / METRES_PER_INCH),
    "own unit": lambda r, g, seed: in_unit(r, OWN_UNITS),
    "camera to world": lambda r, g, seed: camera_to_world(r),
    "transposed K": lambda r, g, seed: replace(r, transposed_K=True),
    "tilt": lambda r, g, seed: tilted(r, g),
    "starts apart": lambda r, g, seed: started_apart(r, g),
    "names": lambda r, g, seed: prefixed(r, seed),
    "turned, half size": lambda r, g, seed: half_size(quarter_turn(r, np.arange(len(r.cameras)), seed % 2 == 0)),
    "half size, apart": lambda r, g, seed: started_apart(half_size(r), g),
    "cm, camera to world": lambda r, g, seed: in_unit(camera_to_world(r), 100.0),
    "tilt, inch": lambda r, g, seed: in_unit(tilted(r, g), 1 / METRES_PER_INCH),
}
"""Faults by name. Each function gets a random generator and the seed."""
