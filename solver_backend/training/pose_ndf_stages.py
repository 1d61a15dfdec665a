"""Pose-NDF trained in stages: from negatives far from the manifold to those that projections meet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import torch

from solver_backend.body.joint_limits import excess_deg
from solver_backend.training.augmentation import mirrored
from solver_backend.training.corpus import Corpus
from solver_backend.training.loop import run_training
from solver_backend.training.nearest_poses import NearestPoses, unit_quats
from solver_backend.training.pose_ndf import PoseFieldNet, PoseNdfSettings, PoseNdfTask, as_prior
from solver_backend.training.pose_negatives import (
    Labelled,
    blended_poses,
    joined,
    labelled,
    projected_poses,
    spread,
    turned_poses,
)
from solver_backend.training.recipe import Job

FAR_DEG, NEAR_DEG, ALL_DEG = (15.0, 90.0), (2.0, 40.0), (1.0, 60.0)
"""Spread of the turns about each axis: of the first stage, the second, and the validation."""


@dataclass(frozen=True)
class Manifold:
    """The recorded poses that a distance is measured to."""

    quats: torch.Tensor
    """(M, 21, 4): distinct training poses within the limits of joints, and their mirror images."""
    nearest: NearestPoses

    @classmethod
    def of(cls, training: Corpus) -> Manifold:
        """Take the distinct poses of a corpus that lie within the joints' limits."""
        rotations = torch.as_tensor(possible_poses(training))
        quats = torch.cat((unit_quats(rotations), unit_quats(mirrored(rotations))))
        return cls(quats, NearestPoses(quats))


def possible_poses(corpus: Corpus) -> np.ndarray:
    """Return the distinct poses without those that no body can take: there a head, hand or foot was tracked wrongly."""
    poses = corpus.rotations[np.unique(corpus.distinct)]
    return poses[(excess_deg(poses.astype(np.float64)) == 0).all(axis=1)]


def perturbed_validation(validation: Corpus, manifold: Manifold, count: int, *, even: bool = True) -> Labelled:
    """Return poses of unseen subjects with their distance to the training poses, turned by 1 to 60 degrees.

    The spread of the turns is drawn evenly, or evenly in its logarithm: then half of the poses are turned by less than
    8 degrees, and what tells them apart is mostly how the subjects differ.
    """
    poses = unit_quats(torch.as_tensor(possible_poses(validation)))
    generator = torch.Generator().manual_seed(1)
    turned = turned_poses(poses, spread(count, ALL_DEG, generator, even=even), generator)
    return labelled(turned, manifold.nearest)


class Stages:
    """The negatives of every stage; those of a finished stage are made again only if a later one mixes them in."""

    def __init__(self, manifold: Manifold, settings: PoseNdfSettings, seed: int) -> None:
        self._manifold, self._settings, self._seed = manifold, settings, seed
        self._pools: dict[int, Labelled] = {}

    def negatives(self, stage: int, before: list[PoseFieldNet]) -> Labelled:
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
        poses, count = self._manifold.quats, self._settings.pool
        if stage == 0:
            quats = turned_poses(poses, spread(count, FAR_DEG, generator), generator)
        elif stage == 1:
            third = count // 3
            turned = turned_poses(poses, spread(count - third, NEAR_DEG, generator), generator)
            quats = torch.cat((turned, blended_poses(poses, third, generator)))
        else:
            quats = projected_poses(as_prior(before[stage - 1]), poses, count, generator)
        return labelled(quats, self._manifold.nearest)


def train_stages(job: Job, settings: PoseNdfSettings, manifold: Manifold) -> PoseFieldNet:
    """Train stage after stage, each from where the last one ended, each with checkpoints in a folder of its own."""
    torch.manual_seed(job.settings.seed)
    model = PoseFieldNet(settings)
    validation = perturbed_validation(job.validation, manifold, settings.validation)
    stages, ended = Stages(manifold, settings, job.settings.seed), []
    for number, share in enumerate(settings.stages):
        task = PoseNdfTask(
            model, manifold.quats, lambda n=number: stages.negatives(n, ended), validation, settings, job.settings.batch
        )
        rate = job.settings.learning_rate * (1.0 if number < 2 else 0.5)
        chosen = replace(job.settings, steps=max(1, round(share * job.settings.steps)), learning_rate=rate)
        trained = run_training(task, chosen, job.work / f"stage{number + 1}", job.progress)
        ended.append(cast(PoseFieldNet, trained))
        model = PoseFieldNet(settings)
        model.load_state_dict(trained.state_dict())
    return ended[-1]
