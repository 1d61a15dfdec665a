"""Make benchmark captures: recorded motion on our body, cameras on tripods and a realistic detector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from research.simulation.filming import FilmSettings, around, film
from solver_backend.body.body import Body
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import TakeTooShort
from solver_backend.geometry.rotations import log_so3
from solver_backend.synthesis.faults import MEASURED_DETECTOR, DetectorFaults
from solver_backend.synthesis.simulation.cast import Person, Take, cast_person
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.types import NUM_BODY_JOINTS, NUM_JOINTS, Capture, JointSet, Keypoints2D

JOINT_SET = JointSet.BODY_25


@dataclass(frozen=True)
class BenchmarkSettings:
    """Settings for filming a motion with simulated cameras."""

    num_views: int = 4  # Number of cameras.
    seed: int = 0  # Seed of the shape, the bias and the noise.
    sync_offset_frames: float = 0.0  # Largest delay of a camera. All except the first are drawn uniformly from ± this.
    largest_delay_frames: float = 0.0
    """Largest additional delay of a camera in frames. All except the first are drawn uniformly from 0 to this."""
    anatomy_mm: float = 8.0
    """Standard deviation in millimetres per axis between the detector's and the body's definition of a joint. In a
    solve of the recording, it is 9.6 mm. The landmarks already include the part that is common to all people."""
    calibration_mm: float = 8.0
    """Standard deviation in millimetres per axis of the calibration error, at the person in a view. The recording's
    poor calibration has 22 mm (its views disagree by 27 mm, and by 10 mm with refined cameras). Pagnon et al. 2021 ask
    for less than 10 mm."""
    detector: DetectorFaults = MEASURED_DETECTOR  # The simulated detector and its errors.
    touches_floor: bool = False  # Put the lowest skin point on the floor in every frame. Recorded feet may float.


def benchmark_capture(
    take: Take, settings: BenchmarkSettings = BenchmarkSettings(), body: Body | None = None
) -> Capture:
    """Film a recorded motion with simulated cameras, and add the ground truth.

    The truth contains SMPL parameters, joints, keypoints3d, and ``meant3d``, the points as the detector defines them.
    It also contains ``swapped`` and ``outlier`` (C, F, K), ``swaps`` (N, 4: view, limb, first frame, one past the
    last), ``delay_frames`` (C,), and the true cameras, ``R`` and ``t``.

    Args:
        take: recorded motion.
        settings: settings for filming the take.
        body: body for the random shape, by default the included body.

    Raises:
        TakeTooShort: there are fewer than four frames.
    """
    if len(take.rotations) < 4:
        raise TakeTooShort(f"A benchmark take needs 4 frames, this one has {len(take.rotations)}.", where=take.name)
    rng = np.random.default_rng(settings.seed)
    person = cast_person(take, rng, body)
    if settings.touches_floor:
        person = person.touching_the_floor(take.fps)
    return film_benchmark(person, take.fps, take.name, settings, rng)


def film_benchmark(
    person: Person, fps: float, name: str, settings: BenchmarkSettings, rng: np.random.Generator
) -> Capture:
    """Film a person with simulated cameras, and add the ground truth (see ``benchmark_capture``)."""
    true = person.landmarks(JOINT_SET)
    pelvis = true.skeleton.joints[:, 0]
    cameras = around(pelvis, settings.num_views)
    share = rng.uniform(-1, 1, len(cameras) - 1)
    late = settings.sync_offset_frames * share + settings.largest_delay_frames * 0.5 * (share + 1.0)
    delays = np.r_[0.0, late]
    offsets = 1e-3 * settings.anatomy_mm * rng.normal(size=(JOINT_SET.num_keypoints, 3))
    found = film(person, cameras, FilmSettings(JOINT_SET, fps, settings.detector, offsets, delays), rng)
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
        name=f"{name}_{settings.num_views}views_seed{settings.seed}",
        cameras=miscalibrated(cameras, pelvis.mean(axis=0), settings.calibration_mm, rng),
        keypoints=Keypoints2D(found.xy, found.confidence, JOINT_SET, fps),
        footage=(None,) * len(cameras),
        sources=(name,),
        notes=(diagnostic("synthetic", origin="recorded motion, simulated cameras and detector"),),
        truth=truth,
    )
