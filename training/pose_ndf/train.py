"""Train Pose-NDF, from the corpus to the weights."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import numpy as np
import torch

from solver_backend.body.joint_limits import excess_deg
from solver_backend.exchange.errors import JobInvalid
from solver_backend.geometry.rotations import matrix_from_quat
from solver_backend.metrics.positions import spearman
from solver_backend.priors.pose_ndf import PoseNDF, load_pose_ndf
from training.data.corpus import Corpus, mirrored
from training.engine.loop import run_training
from training.engine.publish import Card, Figures, Finished, TrainingJob, publish
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
    unit_quats,
)
from training.pose_ndf.network import PoseFieldNet, PoseNdfSettings, PoseNdfTask, as_prior, field_arrays

FAR_DEG, NEAR_DEG, ALL_DEG = (15.0, 90.0), (0.5, 40.0), (1.0, 60.0)
"""Ranges of the rotations' standard deviations in degrees per axis, for the first stage, the second, and validation."""


def manifold_of(training: Corpus, device: str = "cpu") -> PoseManifold:
    """Return the distinct poses in a corpus that are within the joint limits, and their mirror images.

    Raises:
        JobInvalid: all poses are from one person, so distances to other people are undefined.
    """
    frames = possible_frames(training)
    rotations, people = torch.as_tensor(training.rotations[frames]), torch.as_tensor(training.people[frames])
    if len(people.unique()) < 2:
        raise JobInvalid("Pose-NDF learns from the recordings of several people, and these are of one.", where="data")
    quats = torch.cat((unit_quats(rotations), unit_quats(mirrored(rotations))))
    return PoseManifold.of(quats, people.repeat(2), device)


def possible_frames(corpus: Corpus) -> np.ndarray:
    """Return the distinct frames within the joint limits. In other frames, a limb or the head was tracked wrongly."""
    distinct = np.unique(corpus.distinct)
    return distinct[(excess_deg(corpus.rotations[distinct].astype(np.float64)) == 0).all(axis=1)]


def perturbed_validation(validation: Corpus, manifold: PoseManifold, count: int, *, even: bool = True) -> Labelled:
    """Return poses of unseen subjects, rotated by 1 to 60 degrees, and their distances to the training poses.

    The standard deviation of the rotations is drawn uniformly or, without ``even``, uniformly in its logarithm. Without
    ``even``, half of the poses are rotated by less than 8 degrees, and their distances mostly show how subjects differ.
    """
    poses = unit_quats(torch.as_tensor(validation.rotations[possible_frames(validation)]))
    generator = torch.Generator().manual_seed(1)
    chosen = poses[torch.randint(len(poses), (count,), generator=generator)]
    unseen = Poses(chosen, torch.full((count,), NOBODY))
    return labelled(rotated(unseen, spread(count, ALL_DEG, generator, even=even), generator), manifold)


class Stages:
    """Makes the poses of every training stage, and makes earlier poses again if a later stage needs them."""

    def __init__(self, manifold: PoseManifold, settings: PoseNdfSettings, seed: int) -> None:
        self._manifold, self._settings, self._seed = manifold, settings, seed
        self._pools: dict[int, Labelled] = {}

    def poses(self, stage: int, before: list[PoseFieldNet]) -> Labelled:
        """Return the poses of a stage together with the poses of all earlier stages.

        Args:
            stage: stage number, counted from 0.
            before: final networks of the earlier stages.
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
    """Train all stages. Each starts from the previous stage's network and has its own folder for checkpoints."""
    torch.manual_seed(job.settings.seed)
    model = PoseFieldNet(settings)
    validation = perturbed_validation(job.validation, manifold, settings.validation)
    stages, ended = Stages(manifold, settings, job.settings.seed), []
    for number, share in enumerate(settings.stages):
        task = PoseNdfTask(model, lambda n=number: stages.poses(n, ended), validation, settings, job.settings.batch)
        rate = job.settings.learning_rate * (1.0 if number < 2 else 0.5)
        steps = max(1, round(share * job.settings.steps))
        chosen = replace(job.settings, steps=steps, learning_rate=rate, workers=0)
        trained = run_training(task, chosen, job.work / f"stage{number + 1}", job.progress)
        ended.append(cast(PoseFieldNet, trained))
        model = PoseFieldNet(settings)
        model.load_state_dict(trained.state_dict())
    return ended[-1]


_CARD = Card(
    "Pose-NDF",
    """Pose-NDF (Tiwari et al. 2022) estimates a pose's distance to the manifold of plausible poses. It is a neural
field over the 21 body joints' quaternions with features along the kinematic tree and softplus layers. It is trained on
the mean distance (2) to the 5 nearest recorded poses and on the eikonal equation. Training has three stages: poses far
from the manifold and on it, then also poses near it, then also poses along projections. The manifold consists of the
distinct training poses within the joint limits (`body/joint_limits.py`) and their mirror images.

In contrast to the paper, q and -q are the same input by construction, the gradient uses the metric of the distance, and
features have 8 numbers. In addition, **distances are to the poses of other people**, even for recorded poses. The
median distance to all other people's poses is 0.4 rad, for recorded and unseen people. If recorded poses had distance
zero and negatives were labelled by their own neighbours, the field would be 0.0 at an unseen person's pose with a true
distance of 0.4. Negatives that are nearer make this worse.""",
    """Measured with the shipped weights on poses of the validation subjects within the joint limits, rotated by 1° to
60° about every axis at one sigma (half of them in some joints only). In `near`, half of the poses are rotated by less
than 8°. The true distance is the mean over the 5 nearest training poses. `lowered` counts poses with a distance,
predicted or true, that a projection (eq. 6) lowers. A projection moves no pose further than 0.9 of its first distance.
Samples start with independent joints, each with 1.75 times its recorded spread and within its range. `outside` counts
samples with any joint more than 15° beyond its range of motion.
""",
    augmented=False,
)


def train_pose_ndf(job: TrainingJob, settings: PoseNdfSettings = PoseNdfSettings()) -> Finished:
    """Train Pose-NDF, export its weights, measure them and write the model card."""
    manifold = manifold_of(job.training, job.settings.device)
    model = train_stages(job, settings, manifold)
    spread = manifold.spread
    arrays = field_arrays(model) | {
        "joint_mean": spread.mean.astype(np.float32),
        "joint_factor": spread.factor.astype(np.float32),
    }
    size = {name: getattr(settings, name) for name in ("features", "encoder_hidden", "field_hidden")}
    asked = asdict(settings) | asdict(job.settings)

    def measured(path: Path) -> Figures:
        return {"metrics": measure(load_pose_ndf(path), job.validation, manifold, settings)}

    return publish(job, "pose_ndf", arrays, {"field_size": size}, asked, measured, _CARD)


def measure(prior: PoseNDF, validation: Corpus, manifold: PoseManifold, settings: PoseNdfSettings) -> dict[str, float]:
    """Measure a field: its ranking of poses, its distances, projections and samples."""
    perturbed = perturbed_validation(validation, manifold, settings.validation)
    truth = perturbed.distance.numpy().astype(np.float64)
    start = matrix_from_quat(perturbed.quats.numpy().astype(np.float64))
    found = prior.energy(start)
    projected = prior.project(start)
    truth_after = manifold.nearest.mean_distance(unit_quats(torch.as_tensor(projected))).numpy()
    near = perturbed_validation(validation, manifold, settings.validation, even=False)
    near_found = prior.energy(matrix_from_quat(near.quats.numpy().astype(np.float64)))
    sampled = prior.sample(settings.samples, seed=0)
    outside = (excess_deg(sampled) > 0).any(axis=1)
    return {
        "spearman": spearman(found, truth),
        "spearman_near": spearman(near_found, near.distance.numpy()),
        "mean_error_rad": float(np.abs(found - truth).mean()),
        "predicted_lowered_percent": 100 * float((prior.energy(projected) < found).mean()),
        "true_lowered_percent": 100 * float((truth_after < truth).mean()),
        "true_before_rad": float(truth.mean()),
        "true_after_rad": float(truth_after.mean()),
        "samples_outside_percent": 100 * float(outside.mean()),
        "samples_true_rad": float(manifold.nearest.mean_distance(unit_quats(torch.as_tensor(sampled))).mean()),
    }
