"""Takes of one camera with truth or a solve of all cameras for comparison, and the errors of a result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.fitters.pipeline import solve
from solver_backend.io.load import load_capture
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.priors.lifted_take import lift_take
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.simulation.cast import Take
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import read_take
from tests.benchmarks.metric import BenchmarkSkipped
from tests.support.limb_errors import LIMBS
from tests.support.recordings import ABSENT, BALANCING_TRIAL, recordings_folder

HELD_OUT = (
    ("03", "asfamc/03_02", 20), ("03", "asfamc/03_04", 60), ("13", "mb2/13_29", 600), ("13", "mb2/13_29", 1500),
    ("49", "asfamc/49_02", 60), ("49", "asfamc/49_06", 60), ("49", "asfamc/49_11", 60), ("135", "asfamc/135_02", 200),
    ("135", "asfamc/135_04", 150), ("135", "asfamc/135_07", 100),
)  # fmt: skip
"""Subject, file under ``motion_cmu`` and first frame: walks over obstacles, exercises, dance and cartwheels, fights.
The lifter is not trained on these subjects."""
JUMPS = ("asfamc/49_02", "asfamc/49_06", "asfamc/49_11")  # Takes that leave the floor for a part of the time.
ON_LEVEL_FLOOR = (
    ("49", "asfamc/49_01", 0), ("49", "asfamc/49_01", 40),
    *(clip for clip in HELD_OUT if clip[0] != "03" and clip[1] not in JUMPS),
)  # fmt: skip
"""Held-out takes on a level floor, in the same form. Subject 03 walks over obstacles and slides on a level floor."""
UNSEEN_CLASS = (
    ("indian", "far/indian_07", 60), ("indian", "far/indian_08", 100), ("indian", "far/indian_13", 60),
    ("indian", "far/indian_15", 60),
)  # fmt: skip
"""Takes of a class of motion that no network is trained on, in the same form."""
TUNING = (("60", "daz/salsa_07", 20), ("60", "daz/salsa_11", 270), ("08", "mb2/08_01", 10), ("08", "mb2/08_03", 10))
"""Takes for choosing constants, in the same form."""
TUNING_DANCES = (("indian", "far/indian_04", 60), ("indian", "far/indian_06", 60), ("indian", "far/indian_14", 60))
"""Other dances of the unseen class, for choosing deviations."""
FRAMES = 120


@dataclass(frozen=True)
class OneViewTake:
    """A take of one camera."""

    name: str
    capture: Capture
    joints: np.ndarray
    """(F, 24, 3) true joints, or joints of a solve of all cameras, in metres."""
    together: np.ndarray
    """(F, 24, 3) joints of a solve of all cameras in metres."""


def real_takes() -> Iterator[OneViewTake]:
    """Yield each camera of the balancing trial, with the solve of all four.

    Raises:
        BenchmarkSkipped: the recording is missing.
    """
    folder = recordings_folder() / BALANCING_TRIAL
    if not folder.is_dir():
        raise BenchmarkSkipped("The recording is not here.", hint=ABSENT)
    capture = load_capture(folder)
    joints = solve(capture).motion.joints
    assert capture.cameras is not None
    for view, name in enumerate(capture.cameras.names):
        yield OneViewTake(name, capture.views([view]), joints, joints)


def filmed_takes(which: tuple[tuple[str, str, int], ...] = HELD_OUT, views: int = 2) -> Iterator[OneViewTake]:
    """Yield takes of recorded motion with a simulated detector, for each camera in turn.

    Raises:
        BenchmarkSkipped: the motions are missing.
    """
    for number, (subject, file, start) in enumerate(which):
        take = short_take(file, start)
        settings = BenchmarkSettings(num_views=3, seed=number, touches_floor=file not in JUMPS)
        capture = benchmark_capture(take, settings)
        together = solve(capture).motion.joints
        for view in range(views):
            yield OneViewTake(subject, capture.views([view]), capture.truth["joints"], together)


def short_take(file: str, start: int) -> Take:
    """Return ``FRAMES`` frames of a clip at about 30 Hz. Raise ``BenchmarkSkipped`` if it is missing."""
    path = recordings_folder() / "motion_cmu" / f"{file}.npz"
    if not path.is_file():
        raise BenchmarkSkipped("The motions are not here.", hint=ABSENT)
    whole = read_take(path, None, start)
    step = max(1, round(whole.fps / 30.0))
    rotations, root = whole.rotations[::step][:FRAMES], whole.root[::step][:FRAMES]
    return replace(whole, rotations=rotations, root=root, fps=whole.fps / step)


def lifted_pa_mm(take: OneViewTake) -> float:
    """Return the error in mm of the lifter alone, after the best similarity of each frame."""
    cameras, keypoints = take.capture.require_views()
    body = load_body()
    lifted = lift_take(cameras, keypoints, body, prior_on_body(load_sposer(), body.layout), cameras.R[0, :, 2])
    posed = forward_kinematics(body, np.zeros(10), lifted.view.root, lifted.local, np.zeros((len(lifted.local), 3)))
    return pa_mpjpe_mm(np.asarray(posed.joints)[:, LIMBS], take.joints[:, LIMBS])
