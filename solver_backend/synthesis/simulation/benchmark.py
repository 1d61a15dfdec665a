"""Benchmark captures: recorded motion on our body, seen by tripod cameras and a detector that errs like a real one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.errors import TakeTooShort
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.synthesis.simulation.filming import FilmSettings, Person, around, film, miscalibrated
from solver_backend.synthesis.simulation.keypoint_detector import DetectorModel
from solver_backend.types import NUM_BETAS, NUM_BODY_JOINTS, NUM_JOINTS, SMPL_JOINTS, Capture, JointSet, Keypoints2D

JOINT_SET = JointSet.BODY_25
BETAS_SIGMA = 0.8
"""Spread of the drawn shapes, within the range of most people."""
FLOOR_S = 1.0
"""Within this time some sole stands on the floor."""
UPRIGHT = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
"""Y up to Z up."""


@dataclass(frozen=True)
class Take:
    """Recorded motion of F frames, Y up."""

    name: str
    rotations: np.ndarray
    """(F, 22, 3, 3) local rotations of the pelvis and joints 1..21 relative to the T-pose."""
    root: np.ndarray
    """(F, 3) metres, pelvis."""
    fps: float


@dataclass(frozen=True)
class BenchmarkSettings:
    """How a take is filmed."""

    num_views: int = 4
    """Cameras."""
    seed: int = 0
    """Of shape, bias and noise."""
    sync_offset_frames: float = 0.0
    """Largest delay of a camera; each but the first draws its own, uniformly in ±."""
    largest_delay_frames: float = 0.0
    """Largest lateness of a camera; each but the first draws its own, uniformly from 0, beside the one above."""
    anatomy_mm: float = 8.0
    """Standard deviation per axis of what a detector means by a joint against what the body means: a solve of the
    recording assigns its landmarks 9.6 mm, of which a part is common to all people and in the landmarks' definition."""
    calibration_mm: float = 8.0
    """Standard deviation per axis of how far the calibration misplaces the person in a view. The recording shows 22 mm
    (its views disagree by 27 mm as calibrated and by 10 mm with refined cameras), which is a poor calibration; chosen
    is one that people accept (Pagnon et al. 2021 ask for less than 10 mm)."""
    detector: DetectorModel = field(default_factory=DetectorModel)
    """The detector."""


def benchmark_capture(
    take: Take, settings: BenchmarkSettings = BenchmarkSettings(), body: Body | None = None
) -> Capture:
    """Film a take; the truth goes along.

    Truth: SMPL parameters, joints, keypoints3d, and ``meant3d``, the points that the detector means; ``swapped`` and
    ``outlier`` (C, F, K), ``swaps`` (N, 4: view, limb, first frame, one past the last), ``delay_frames`` (C,), and the
    cameras as they stood, ``R`` and ``t``.

    Args:
        take: recorded motion.
        settings: how it is filmed.
        body: whose shapes the person's is drawn from; the one that ships if left out.

    Raises:
        TakeTooShort: fewer than four frames.
    """
    if len(take.rotations) < 4:
        raise TakeTooShort(f"A benchmark take needs 4 frames, this one has {len(take.rotations)}.", where=take.name)
    rng = np.random.default_rng(settings.seed)
    person = cast_person(take, rng, body)
    true = person.landmarks(JOINT_SET)
    pelvis = true.skeleton.joints[:, 0]
    cameras = around(pelvis, settings.num_views)
    share = rng.uniform(-1, 1, len(cameras) - 1)
    late = settings.sync_offset_frames * share + settings.largest_delay_frames * 0.5 * (share + 1.0)
    delays = np.r_[0.0, late]
    offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(JOINT_SET.num_keypoints, 3))
    found = film(person, cameras, FilmSettings(JOINT_SET, take.fps, settings.detector, offsets, delays), rng)
    body_pose = np.zeros((len(person.local), 3 * (NUM_JOINTS - 1)))
    body_pose[:, : 3 * NUM_BODY_JOINTS] = log_so3(person.local).reshape(len(person.local), -1)
    truth = {
        "betas": person.betas, "global_orient": log_so3(person.orient), "body_pose": body_pose,
        "transl": person.transl, "joints": true.skeleton.joints, "keypoints3d": true.points,
        "meant3d": person.landmarks(JOINT_SET, offsets).points,
        "swapped": found.swapped, "outlier": found.outlier, "swaps": found.swaps, "delay_frames": delays,
        "R": cameras.R, "t": cameras.t,
    }  # fmt: skip
    return Capture(
        name=f"{take.name}_{settings.num_views}views_seed{settings.seed}",
        cameras=miscalibrated(cameras, pelvis.mean(axis=0), settings.calibration_mm, rng),
        keypoints=Keypoints2D(found.xy, found.confidence, JOINT_SET, take.fps),
        footage=(None,) * len(cameras),
        sources=(take.name,),
        notes=("Synthetic capture: recorded motion, simulated cameras and detector; the truth is known.",),
        truth=truth,
    )


def cast_person(take: Take, rng: np.random.Generator, body: Body | None = None) -> Person:
    """Return somebody of random shape who does what was recorded, on the floor."""
    body = body or load_body()
    betas = np.clip(BETAS_SIGMA * rng.normal(size=NUM_BETAS), -2.0, 2.0)
    orient, transl = _on_the_floor(body, betas, take)
    return Person(body, betas, orient, take.rotations[:, 1:], transl)


def _on_the_floor(body: Body, betas: np.ndarray, take: Take) -> tuple[np.ndarray, np.ndarray]:
    """Return root rotations and translations, Z up: steps scaled to the legs, the standing sole on the floor.

    The height is corrected by a slow curve, the running minimum of the soles over ``FLOOR_S`` smoothed over as long;
    ramps and stairs become flat, jumps shorter than that stay.
    """
    orient = UPRIGHT @ take.rotations[:, 0]
    rest = body.rest_joints(betas)
    legs = rest[0, 1] - rest[SMPL_JOINTS.index("left_ankle"), 1]
    recorded = float(np.percentile(take.root[:, 1], 90))
    path = (take.root - take.root[:1] * [1, 0, 1]) * (legs + 0.08) / max(recorded, 0.5)
    transl = path @ UPRIGHT.T - rest[0]
    soles = keypoint_landmarks(body, JointSet.BODY_25)
    points = pose_landmarks(body, soles, betas, orient, take.rotations[:, 1:], transl).points
    feet = [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("_toe", "_heel"))]
    transl[:, 2] -= running_floor(points[:, feet, 2].min(axis=1), max(1, round(FLOOR_S * take.fps))) - 0.01
    return orient, transl


def running_floor(height: np.ndarray, frames: int) -> np.ndarray:
    """Return (F,) the least height within ``frames`` around each frame, smoothed by a Gaussian of half that length."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(height, frames // 2, mode="edge"), 2 * (frames // 2) + 1)
    lowest = np.pad(near.min(axis=1), 2 * frames, mode="edge")
    kernel = np.exp(-0.5 * (np.arange(-2 * frames, 2 * frames + 1) / (0.5 * frames)) ** 2)
    return np.convolve(lowest, kernel / kernel.sum(), mode="valid")
