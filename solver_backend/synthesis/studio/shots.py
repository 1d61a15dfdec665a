"""Shots: every combination of motion, person, array and look, each seeded by its own name."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.synthesis.simulation.cast import strange_body
from solver_backend.synthesis.studio.camera_arrays import CameraRing
from solver_backend.synthesis.studio.motions import MotionSource, find_motions
from solver_backend.synthesis.studio.spec import Spec, StudioLook
from solver_backend.types import NUM_BETAS

_MOST_BETA = 2.5  # Standard deviations of a shape coefficient at most; chosen by hand.


@dataclass(frozen=True)
class Shot:
    """One take of one person before one array."""

    name: str  # Unique in its data set, and a folder's name.
    motion: MotionSource
    person: int
    array: CameraRing
    look: StudioLook

    def rng(self, spec: Spec, stream: str) -> np.random.Generator:
        """Return the source of randomness of one thing in this shot; it depends on seed and names alone."""
        return seeded(spec.seed, self.name, stream)


def seeded(seed: int, *names: str) -> np.random.Generator:
    """Return a source of randomness of a seed and names (SHA-256)."""
    digest = hashlib.sha256("\0".join([str(seed), *names]).encode()).digest()
    return np.random.default_rng(np.frombuffer(digest, np.uint32))


def list_shots(spec: Spec) -> tuple[Shot, ...]:
    """Return all shots of a description, in its order.

    Raises:
        FileMissing: a motion is not there.
    """
    return tuple(_shots(spec, find_motions(list(spec.motions), spec.folder)))


def _shots(spec: Spec, motions: tuple[MotionSource, ...]) -> Iterator[Shot]:
    for motion in motions:
        for person in range(spec.people.count):
            for array in spec.arrays:
                for look in spec.looks:
                    parts = (motion.name, f"person{person:03d}", array.name, look.name)
                    yield Shot("-".join(re.sub(r"[^\w.~+]", "_", part) for part in parts), motion, person, array, look)


def cast(spec: Spec, person: int) -> tuple[Body, np.ndarray]:
    """Return body and (10,) shape of a person, who is the same in every shot.

    Raises:
        BodyInvalid: the body that ships cannot be read.
    """
    rng = seeded(spec.seed, "person", str(person))
    betas = np.clip(spec.people.sigma * rng.normal(size=NUM_BETAS), -_MOST_BETA, _MOST_BETA)
    body = load_body()
    return (strange_body(int(rng.integers(2**31)), body=body) if spec.people.strange else body), betas
