"""Pose-NDF from corpus to weights."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from solver_backend.body.joint_limits import excess_deg
from solver_backend.geometry.quaternions import matrix_from_quat
from solver_backend.metrics.rank_correlation import spearman
from solver_backend.priors.pose_ndf.pose_ndf import PoseNDF, load_pose_ndf
from training.data.corpus import Corpus
from training.engine.model_card import Card
from training.engine.publish import Figures, publish
from training.engine.recipe import Finished, TrainingJob
from training.pose_ndf.nearest_poses import unit_quats
from training.pose_ndf.negatives import PoseManifold
from training.pose_ndf.network import PoseNdfSettings, field_arrays
from training.pose_ndf.stages import manifold_of, perturbed_validation, train_stages

_CARD = Card(
    "Pose-NDF",
    """Pose-NDF (Tiwari et al. 2022): the distance of a pose to the manifold of plausible poses, a neural field
over the 21 body joints' quaternions with features down the kinematic tree; softplus layers, trained in three stages on
the mean of distances (2) to the 5 nearest recorded poses and on the eikonal equation: on poses far from the manifold
and on it, then also near it, then also on those that projections meet. Manifold: distinct training poses within the
limits of joints (`body/joint_limits.py`), mirrored too. Unlike the paper, q and -q are one input by construction, the
gradient is taken in the metric of the distance, features have 8 numbers, and **distances are to the poses of other
people than the one a pose came from**, recorded poses included: these lie 0.4 rad (median) from everybody else's, and
so do those of somebody unseen. With zero for recorded poses, and negatives labelled by their own neighbours, a field
is 0.0 where the true distance of an unseen person's pose is 0.4, and negatives nearer and nearer make that worse.""",
    """Measured with the weights as they ship, on poses of the validation subjects within the limits of joints,
turned by 1° to 60° about every axis at one sigma (half of them in some joints only). `near`: half of the poses turned
by less than 8°. True distance: mean over the 5 nearest training poses. `lowered`: poses whose distance, predicted or
true, a projection (eq. 6) lowers; it moves no pose farther than 0.9 of the distance it began at. Samples begin with
every joint drawn on its own as it turns in the recordings, 1.75 times as wide and within its range; `outside`: any
joint beyond its range of motion and 15°.
""",
    augmented=False,
)


def train_pose_ndf(job: TrainingJob, settings: PoseNdfSettings = PoseNdfSettings()) -> Finished:
    """Train, export, measure the exported weights and write the model card."""
    manifold = manifold_of(job.training, job.settings.device)
    model = train_stages(job, settings, manifold)
    spread = manifold.spread
    arrays = field_arrays(model) | {
        "joint_mean": spread.mean.astype(np.float32), "joint_factor": spread.factor.astype(np.float32),
    }  # fmt: skip
    size = {name: getattr(settings, name) for name in ("features", "encoder_hidden", "field_hidden")}
    asked = asdict(settings) | asdict(job.settings)

    def measured(path: Path) -> Figures:
        return {"metrics": measure(load_pose_ndf(path), job.validation, manifold, settings)}

    return publish(job, "pose_ndf", arrays, {"field_size": size}, asked, measured, _CARD)


def measure(prior: PoseNDF, validation: Corpus, manifold: PoseManifold, settings: PoseNdfSettings) -> dict[str, float]:
    """Return how well the field ranks, measures and projects perturbed poses, and what it samples."""
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
