"""People of random shape with recorded motion: true markers and joints, and the inputs of a solver."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from research.simulation.marker_noise import DataNoise
from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks, pose_landmarks
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters.measurements.markers import measure_landmarks
from solver_backend.fitters.problem import Measurements
from solver_backend.labelling.point_network import frame_landmarks, load_network
from solver_backend.synthesis.simulation.cast import Take, cast_person
from solver_backend.types import SMPL_JOINTS, JointSet

LAYOUT = "MANIFOLD_53"
NOISES = ("data", "inference", "both")
"""Columns n_d and n_m of table 5.2: corrupted markers, and the network's output for clean and for corrupted markers."""


@dataclass(frozen=True, eq=False)
class LandmarkTake:
    """F frames of a person with known markers and joints."""

    name: str
    body: Body
    landmarks: Landmarks
    """Landmarks of the 53 markers, then of the 24 joints."""
    points: np.ndarray
    """(F, 77, 3) true positions in metres."""
    local: np.ndarray
    """(F, 21, 3, 3) rotations of joints 1..21."""
    fps: float

    @classmethod
    def of(cls, take: Take, seed: int) -> LandmarkTake:
        """Perform a take with a random person."""
        person = cast_person(take, np.random.default_rng(seed))
        markers = marker_landmarks(person.body, marker_layout(LAYOUT))
        landmarks = Landmarks.joined((markers, keypoint_landmarks(person.body, JointSet.SMPL_24)))
        posed = pose_landmarks(person.body, landmarks, person.betas, person.orient, person.local, person.transl)
        return cls(take.name, person.body, landmarks, posed.points, person.local, take.fps)

    @property
    def joints(self) -> np.ndarray:
        """(F, 24, 3) joint positions in metres."""
        return self.points[:, -len(SMPL_JOINTS) :]

    def measured(self, noise: str, *, joints: bool, seed: int) -> Measurements:
        """Return the inputs of a solver: markers, optionally with joints, with one of the ``NOISES``."""
        keep = len(self.landmarks) - (0 if joints else len(SMPL_JOINTS))
        points = self.estimated(noise, seed)[:, :keep]
        return measure_landmarks(self.landmarks.part(slice(0, keep)), points, self.fps, np.zeros(1))

    def estimated(self, noise: str, seed: int) -> np.ndarray:
        """Return (F, 77, 3) landmarks, NaN if missing: corrupted, or the shipped network's output for a cloud."""
        return _estimated(self, noise, seed)


@lru_cache(maxsize=2)
def _estimated(take: LandmarkTake, noise: str, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if noise == "data":
        found = DataNoise()(take.points, rng)
    else:
        markers = take.points[:, : -len(SMPL_JOINTS)]
        found = frame_landmarks(DataNoise().cloud(markers, rng) if noise == "both" else markers, load_network())
    found.setflags(write=False)  # every method gets the same
    return found
