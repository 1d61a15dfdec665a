"""Takes of recorded motions, seen by cameras with a detector's noise: eleven to fit constants, eleven held out.

Keypoints are the joints of the recorded skeletons, not of the project's body. Errors of a detector are simulated. They
last several frames, differ by keypoint and view, and are sometimes large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras, JointSet
from tests.benchmarks.metric import BenchmarkSkipped
from tests.benchmarks.spoiled_views.kinds import Recording
from tests.support.recordings import recordings_folder

FPS = 60.0
SIZE = (1920, 1080)
NOISE, OFFSET, OUTLIERS = 0.012, 0.008, 0.02
"""Standard deviations of a detector's errors and of its constant offsets, relative to the person's height in the
picture, and the share of errors that are ten times as large."""
CORRELATION = 0.8  # Correlation of a detector's errors between successive frames.
_JOINTS = {
    "right_shoulder": "rhumerus", "right_elbow": "rradius", "right_wrist": "rhand", "left_shoulder": "lhumerus",
    "left_elbow": "lradius", "left_wrist": "lhand", "right_hip": "rfemur", "right_knee": "rtibia",
    "right_ankle": "rfoot", "left_hip": "lfemur", "left_knee": "ltibia", "left_ankle": "lfoot",
    "left_big_toe": "ltoes_end", "right_big_toe": "rtoes_end", "neck": "lowerneck", "mid_hip": "root",
}  # fmt: skip
_FACE = {"nose": (0.0, 0.10), "right_eye": (-0.03, 0.08), "left_eye": (0.03, 0.08), "right_ear": (-0.07, 0.0),
         "left_ear": (0.07, 0.0)}  # fmt: skip
"""Metres to the left and forward of the head's centre."""


@dataclass(frozen=True)
class MotionTake:
    """One take of a recorded motion."""

    clip: str
    """File of ``motion_cmu/asfamc``."""
    layout: str = "ring 4"
    """A layout of ``cameras_of``."""
    noise: float = 1.0
    """Factor on the detector's usual noise."""
    frames: int = 240
    size: float = 1.0
    """Factor on the person's size. Children are smaller."""
    missing: float = 0.0
    """Share of keypoints that are not detected."""
    start: int = 60
    """First frame of the clip at 60 Hz."""
    standing: bool = False
    """True if the person holds the first pose and sways."""
    company: str = ""
    """Clip of a second person, 1.3 m to the side."""


FITTED = (
    MotionTake("49_02"), MotionTake("gsimchoni_charleston1", noise=2.0, start=0), MotionTake("16_15"),
    MotionTake("35_01", "side 3"), MotionTake("14_02", "ring 8"), MotionTake("135_02", noise=0.0),
    MotionTake("17_03", standing=True), MotionTake("01_01", "overhead"), MotionTake("127_03", "two"),
    MotionTake("02_05", "ring 4", missing=0.2), MotionTake("16_21", company="02_01"),
)  # fmt: skip
HELD_OUT = (
    MotionTake("gsimchoni_lambada", start=0), MotionTake("49_17", noise=2.0), MotionTake("16_30", "side 3"),
    MotionTake("02_07", missing=0.2), MotionTake("09_01", "ring 8", start=0), MotionTake("29_09", size=0.65),
    MotionTake("135_05", "overhead"), MotionTake("127_20", "two"), MotionTake("14_24", noise=0.0),
    MotionTake("16_31"), MotionTake("16_32", company="29_03"),
)  # fmt: skip


@dataclass(frozen=True)
class Filmed:
    """A simulated recording of a take."""

    recording: Recording  # (C, F, 25 or 50, 2) pixels, with a second person's keypoints last.
    truth: np.ndarray  # (F, 25, 3) metres of the first person, NaN for keypoints that skeletons lack.


def film(take: MotionTake, seed: int) -> Filmed:
    """Return the simulated recording of a take.

    Raises:
        BenchmarkSkipped: the motions are missing.
    """
    rng = np.random.default_rng(seed)
    truth = take.size * keypoints_of(take.clip, take.start, take.frames)
    if take.standing:
        sway = 0.006 * np.cumsum(rng.normal(size=(take.frames, 1, 3)), axis=0) * np.array([1.0, 1.0, 0.1]) / 3
        truth = truth[:1] + sway
    truth = truth - np.r_[np.nanmean(truth[..., :2], axis=(0, 1)), np.nanmin(truth[..., 2])]
    cameras = cameras_of(take.layout)
    xy, confidence = detect(cameras, truth, take, rng)
    if take.company:
        other = keypoints_of(take.company, take.start, take.frames)
        other = other - np.r_[np.nanmean(other[..., :2], axis=(0, 1)), np.nanmin(other[..., 2])] + [0.9, -0.9, 0.0]
        beside = detect(cameras, other, take, rng)
        xy, confidence = np.concatenate([xy, beside[0]], 2), np.concatenate([confidence, beside[1]], 2)
    return Filmed(Recording(xy, confidence, cameras, cameras.names), truth)


def detect(
    cameras: Cameras, points: np.ndarray, take: MotionTake, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return noisy (C, F, 25, 2) pixels and (C, F, 25) confidences of (F, 25, 3) points."""
    xy = project(cameras, points)
    xy = np.asarray(xy).reshape(len(cameras), *points.shape[:2], 2)
    seen = np.isfinite(xy).all(-1) & ((xy >= 0) & (xy < SIZE)).all(-1)
    height = np.minimum(np.nanmax(xy[..., 1], axis=-1) - np.nanmin(xy[..., 1], axis=-1), SIZE[1])
    step = rng.normal(size=xy.shape)
    error = np.empty_like(step)
    error[:, 0] = step[:, 0]
    for f in range(1, xy.shape[1]):
        error[:, f] = CORRELATION * error[:, f - 1] + np.sqrt(1 - CORRELATION**2) * step[:, f]
    error *= NOISE
    error += OFFSET * rng.normal(size=(len(cameras), 1, xy.shape[2], 2))
    far = rng.uniform(size=xy.shape[:3]) < OUTLIERS
    error[far] += 0.1 * rng.normal(size=(int(far.sum()), 2))
    xy = xy + take.noise * error * height[..., None, None]
    seen &= rng.uniform(size=seen.shape) >= take.missing
    confidence = np.where(seen, np.clip(rng.normal(0.75, 0.1, seen.shape), 0.2, 1.0), 0.0)
    return np.where(seen[..., None], xy, np.nan), confidence


def cameras_of(layout: str) -> Cameras:
    """Return the cameras of a layout. They look at a point 0.95 m above the floor's centre.

    ``random N`` has 2 to 16 cameras that look near this point, with other focal lengths and lenses.
    """
    name, _, seed = layout.partition(" ")
    if name == "random":
        return _random_cameras(np.random.default_rng([int(seed), 1]))
    place = {
        "ring 4": [(90 * k + 20, 4.2, 1.6 + 0.2 * k) for k in range(4)],
        "ring 8": [(45 * k + 10, 4.5, 1.4 + 0.1 * k) for k in range(8)],
        "two": [(0, 4.0, 1.5), (60, 4.2, 1.7)],
        "side 3": [(-50, 4.5, 1.4), (5, 4.0, 1.6), (55, 4.4, 1.9)],
        "overhead": [(0, 4.2, 1.5), (120, 4.4, 1.7), (240, 4.0, 1.6), (45, 1.0, 4.3)],
    }[layout]
    count = np.arange(len(place))
    aims = np.tile([0.0, 0.0, 0.95], (len(place), 1))
    distortion = np.tile([0.03, -0.02, 0.0005, -0.0003, 0.0, 0.0, 0.0, 0.0], (len(place), 1))
    return _cameras(place, aims, 1150.0 + 30 * count, distortion, np.stack([955.0 + 4 * count, 545.0 - 3 * count], 1))


def _random_cameras(rng: np.random.Generator) -> Cameras:
    """Return 2 to 16 cameras on an arc, 2.4 to 7.2 m away, with focal lengths of 0.43 to 0.84 image widths."""
    count = int(rng.choice([2, 3, 3, 4, 4, 5, 6, 8, 10, 12, 16]))
    arc = 120.0 if count == 2 else float(rng.choice([360, 360, 200, 120]))
    angles = (np.arange(count) + rng.uniform(-0.2, 0.2, count)) * arc / (count if arc == 360.0 else count - 1)
    away = rng.uniform(2.8, 6.0) * rng.uniform(0.85, 1.2, count)
    place = np.stack([angles + rng.uniform(0, 360), away, rng.uniform(0.6, 2.8, count)], axis=1)
    aims = rng.normal(size=(count, 3)) * [0.15, 0.15, 0.1] + [0.0, 0.0, 0.95]
    focal = SIZE[0] * rng.uniform(0.45, 0.8) * rng.uniform(0.95, 1.05, count)
    distortion = np.zeros((count, 8))
    distortion[:, :2] = rng.uniform(-0.1, 0.05), rng.uniform(-0.03, 0.03)
    return _cameras(place.tolist(), aims, focal, distortion, np.array(SIZE) / 2 + 12 * rng.normal(size=(count, 2)))


def _cameras(
    place: Sequence[Sequence[float]], aims: np.ndarray, focal: np.ndarray, distortion: np.ndarray, middle: np.ndarray
) -> Cameras:
    """Return level cameras at angles in degrees, distances and heights in m, which look at ``aims``."""
    count = len(place)
    R, t, K = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for c, (degrees, away, height) in enumerate(place):
        angle = np.radians(degrees)
        centre = np.array([away * np.cos(angle), away * np.sin(angle), height])
        z = aims[c] - centre
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R[c] = np.stack([x, np.cross(z, x), z])
        t[c] = -R[c] @ centre
        K[c] = [[focal[c], 0.0, middle[c, 0]], [0.0, focal[c], middle[c, 1]], [0.0, 0.0, 1.0]]
    return Cameras(tuple(f"cam{c + 1}" for c in range(count)), K, distortion, R, t, np.tile(SIZE, (count, 1)))


def keypoints_of(clip: str, start: int, frames: int) -> np.ndarray:
    """Return (F, 25, 3) BODY_25 keypoints of a clip at 60 Hz in metres, Z up, repeated backwards if it is short."""
    path = recordings_folder() / "motion_cmu" / "asfamc" / f"{clip}.npz"
    if not path.is_file():
        raise BenchmarkSkipped("The recorded motions are not here.", hint="Set MOCAP_SHARED_DATA to their folder.")
    with np.load(path, allow_pickle=False) as stored:
        names, parents = [str(name) for name in stored["names"]], stored["parents"]
        turns = exp_so3(np.asarray(stored["rotvec"], np.float64))
        turns[:, 0] = exp_so3(np.asarray(stored["root_rotvec"], np.float64))
        root, offsets = np.asarray(stored["root"], np.float64), np.asarray(stored["offsets"], np.float64)
    G, p = np.empty_like(turns), np.empty((*turns.shape[:2], 3))
    for j, parent in enumerate(parents):
        G[:, j] = turns[:, j] if parent < 0 else G[:, parent] @ turns[:, j]
        p[:, j] = root if parent < 0 else p[:, parent] + G[:, parent] @ offsets[j]
    found = np.full((len(p), len(JointSet.BODY_25.keypoints), 3), np.nan)
    for k, name in enumerate(JointSet.BODY_25.keypoints):
        if name in _JOINTS:
            found[:, k] = p[:, names.index(_JOINTS[name])]
    head = (p[:, names.index("head")] + p[:, names.index("head_end")]) / 2
    up = p[:, names.index("head_end")] - p[:, names.index("lowerneck")]
    left = p[:, names.index("lhumerus")] - p[:, names.index("rhumerus")]
    forward = np.cross(left, up)
    left, forward = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (left, forward))
    for name, (sideways, ahead) in _FACE.items():
        found[:, JointSet.BODY_25.keypoints.index(name)] = head + sideways * left + ahead * forward
    found = found[..., [2, 0, 1]]  # Y up to Z up
    order = np.r_[np.arange(len(found)), np.arange(len(found) - 2, 0, -1)]
    at = (start + np.arange(frames)) / 2
    low = np.floor(at).astype(int)
    share = (at - low)[:, None, None]
    one, other = (found[order[(low + k) % len(order)]] for k in (0, 1))
    return (1 - share) * one + share * other
