"""Takes of people who move their fingers before four cameras, with the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import DEMO_BETAS, author_motion, demo_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.person_hands import (
    HandFaults,
    MovingHands,
    detect_hands,
    hidden_points,
    move_hands,
)
from solver_backend.types import Capture


@dataclass(frozen=True)
class HandedTake:
    """The embedded demo with hands."""

    capture: Capture
    person: Person
    hands: MovingHands
    hidden: np.ndarray
    """(C, F, 2, 21) whether something stands before a point."""


@lru_cache(maxsize=4)
def handed_take(frames: int = 90, fps: float = 30.0, seed: int = 0, faults: HandFaults | None = None) -> HandedTake:
    """Return the demo's person, cameras and detections of the body, with hands that a detector finds; shared."""
    body = load_body()
    motion = author_motion(body, DEMO_BETAS, frames, fps)
    orient, local = exp_so3(motion.global_orient), exp_so3(motion.body_pose)
    person = Person(body, DEMO_BETAS, orient, local, motion.transl)
    capture, rng = demo_capture(frames, fps, seed=seed + 7), np.random.default_rng(seed)
    hands = move_hands(person, fps, rng)
    assert capture.cameras is not None and capture.keypoints is not None
    hidden = hidden_points(person, capture.cameras, hands.points)
    found = detect_hands(capture.cameras, hands.points, hidden, fps, faults or HandFaults(), rng)
    return HandedTake(replace(capture, keypoints=replace(capture.keypoints, hands=found)), person, hands, hidden)
