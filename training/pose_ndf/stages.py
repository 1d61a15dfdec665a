"""Pose-NDF trained in stages: from poses far from the manifold to those near it and those that projections meet."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import torch

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import JobInvalid
from training.data.augmentation import mirrored
from training.data.corpus import Corpus
from training.engine.loop import run_training
from training.engine.recipe import TrainingJob
from training.pose_ndf.nearest_poses import unit_quats
from training.pose_ndf.negatives import (
    NOBODY,
    Labelled,
    PoseManifold,
    Poses,
    blended,
    joined,
    labelled,
    projected,
    rotated,
    spread,
)
from training.pose_ndf.network import PoseFieldNet, PoseNdfSettings, PoseNdfTask, as_prior

FAR_DEG, NEAR_DEG, ALL_DEG = (15.0, 90.0), (0.5, 40.0), (1.0, 60.0)
"""Spread of the turns about each axis: of the first stage, the second, and the validation."""


def manifold_of(training: Corpus, device: str = "cpu") -> PoseManifold:
    """Return the distinct poses of a corpus that lie within the joints' limits, and their mirror images.

    Raises:
        JobInvalid: all are of one person, so that there is nobody else to measure a distance to.
    """
    frames = possible_frames(training)
    rotations, people = torch.as_tensor(training.rotations[frames]), torch.as_tensor(training.people[frames])
    if len(people.unique()) < 2:
        raise JobInvalid("Pose-NDF learns from the recordings of several people, and these are of one.", where="data")
    quats = torch.cat((unit_quats(rotations), unit_quats(mirrored(rotations))))
    return PoseManifold.of(quats, people.repeat(2), device)


def possible_frames(corpus: Corpus) -> np.ndarray:
    """Return the distinct frames without those that no body can take: there a limb or the head was tracked wrongly."""
    distinct = np.unique(corpus.distinct)
    return distinct[(excess_deg(corpus.rotations[distinct].astype(np.float64)) == 0).all(axis=1)]


def perturbed_validation(validation: Corpus, manifold: PoseManifold, count: int, *, even: bool = True) -> Labelled:
    """Return poses of unseen subjects with their distance to the training poses, turned by 1 to 60 degrees.

    The spread of the turns is drawn evenly, or evenly in its logarithm: then half of the poses are turned by less than
    8 degrees, and what distinguishes them is mostly how the subjects differ.
    """
    poses = unit_quats(torch.as_tensor(validation.rotations[possible_frames(validation)]))
    generator = torch.Generator().manual_seed(1)
    chosen = poses[torch.randint(len(poses), (count,), generator=generator)]
    unseen = Poses(chosen, torch.full((count,), NOBODY))
    return labelled(rotated(unseen, spread(count, ALL_DEG, generator, even=even), generator), manifold)


class Stages:
    """The poses of every stage; those of a finished stage are made again only if a later one mixes them in."""

    def __init__(self, manifold: PoseManifold, settings: PoseNdfSettings, seed: int) -> None:
        self._manifold, self._settings, self._seed = manifold, settings, seed
        self._pools: dict[int, Labelled] = {}

    def poses(self, stage: int, before: list[PoseFieldNet]) -> Labelled:
        """Return the poses of a stage: its own and all earlier ones, so that near ones join far ones.

        Args:
            stage: number from 0.
            before: networks that the earlier stages ended with.
        """
        for number in range(stage + 1):
            if number not in self._pools:
                self._pools[number] = self._own(number, before)
        return joined([self._pools[number] for number in range(stage + 1)])

    def _own(self, stage: int, before: list[PoseFieldNet]) -> Labelled:
        generator = torch.Generator().manual_seed(1000 * self._seed + stage)
        manifold, count, noise = self._manifold, self._settings.pool, self._settings.noise
        if stage == 0:
            far = rotated(manifold.drawn(count, generator), spread(count, FAR_DEG, generator), generator, noise)
            parts = [far, manifold.drawn(count // 2, generator)]
        elif stage == 1:
            sigma = spread(2 * count, NEAR_DEG, generator)
            near = rotated(manifold.drawn(2 * count, generator), sigma, generator, noise)
            parts = [near, blended(manifold, count // 4, generator)]
        else:
            parts = [projected(as_prior(before[stage - 1], manifold.spread), manifold, count, generator)]
        return joined([labelled(part, manifold) for part in parts])


def train_stages(job: TrainingJob, settings: PoseNdfSettings, manifold: PoseManifold) -> PoseFieldNet:
    """Train stage after stage, each from where the last one ended, each with checkpoints in a folder of its own."""
    torch.manual_seed(job.settings.seed)
    model = PoseFieldNet(settings)
    validation = perturbed_validation(job.validation, manifold, settings.validation)
    stages, ended = Stages(manifold, settings, job.settings.seed), []
    for number, share in enumerate(settings.stages):
        task = PoseNdfTask(
            model, lambda n=number: stages.poses(n, ended), validation, settings, job.settings.batch
        )  # fmt: skip
        rate = job.settings.learning_rate * (1.0 if number < 2 else 0.5)
        steps = max(1, round(share * job.settings.steps))
        chosen = replace(job.settings, steps=steps, learning_rate=rate, workers=0)
        trained = run_training(task, chosen, job.work / f"stage{number + 1}", job.progress)
        ended.append(cast(PoseFieldNet, trained))
        model = PoseFieldNet(settings)
        model.load_state_dict(trained.state_dict())
    return ended[-1]
