"""People in front of cameras, listed in any order, with the truth of who is who."""

from __future__ import annotations

import numpy as np

from solver_backend.types import Cameras, Detections, JointSet
from tests.support.scenes import detected, walker

COCO = JointSet.COCO_17


class Scene:
    """People in front of cameras, and which detection is whom."""

    def __init__(self, cameras: Cameras, seed: int = 0) -> None:
        self.cameras, self.rng = cameras, np.random.default_rng(seed)
        self.people: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, points: np.ndarray, seen: np.ndarray, *, certainty: float = 0.6, missing: float = 0.1) -> None:
        """Add a person at points (F, K, 3) whom views see where ``seen`` (C, F) says so."""
        xy, confidence = detected(self.cameras, points, self.rng)
        confidence = np.where(confidence > 0, certainty, 0.0) * (self.rng.uniform(size=confidence.shape) > missing)
        self.people.append((xy, confidence * seen[..., None], seen))

    def detections(self, *, shuffle: bool = True) -> tuple[Detections, np.ndarray]:
        """Return the files' content, people in any order, and who (C, F, P) each detection is."""
        views, frames = self.people[0][2].shape
        shape = (views, frames, len(self.people), self.people[0][0].shape[2])
        xy, confidence = np.full((*shape, 2), np.nan, np.float32), np.zeros(shape, np.float32)
        who = np.full(shape[:3], -1)
        for c, f in np.ndindex(views, frames):
            here = [i for i, person in enumerate(self.people) if person[2][c, f]]
            order = self.rng.permutation(here) if shuffle else sorted(here, reverse=True)
            for slot, i in enumerate(order):
                xy[c, f, slot], confidence[c, f, slot] = self.people[i][0][c, f], self.people[i][1][c, f]
                who[c, f, slot] = i
        xy[confidence == 0] = np.nan
        return Detections(self.cameras.names, xy, confidence, COCO), who


def everywhere(frames: int, views: tuple[int, ...] = (0, 1, 2, 3)) -> np.ndarray:
    seen = np.zeros((4, frames), bool)
    seen[list(views)] = True
    return seen


def add_strangers(scene: Scene, frames: int, count: int) -> None:
    """Add people who walk in the background of single cameras, some for each camera."""
    for view, centre in enumerate(scene.cameras.centres):
        away = -centre[:2] / np.linalg.norm(centre[:2])
        across = np.array([-away[1], away[0]])
        for _ in range(count):
            start = scene.rng.uniform(0.5, 3.0) * away + scene.rng.uniform(-2.0, 2.0) * across
            velocity = scene.rng.choice([-1.0, 1.0]) * scene.rng.uniform(0.2, 0.9) * across
            points = walker(COCO, frames, tuple(start), tuple(velocity), phase=scene.rng.uniform(0.0, 6.0))
            scene.add(scene.rng.normal(1.0, 0.055) * points, everywhere(frames, (view,)))
