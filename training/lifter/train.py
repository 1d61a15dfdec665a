"""The lifter from corpus to shipped weights."""

from __future__ import annotations

from dataclasses import asdict
from typing import cast

from torch import nn

from solver_backend.body.body import load_body
from solver_backend.priors.lifter import OUTPUTS, POINTS
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import read_stack, read_weights
from training.engine.dense_layers import stack_arrays, take_over
from training.engine.loop import run_training
from training.engine.model_card import Card
from training.engine.publish import publish
from training.engine.recipe import Finished, TrainingJob
from training.lifter.task import LifterSettings, LifterTask

NAME = "lifter"
CARD = Card(
    "Lifter",
    """The lifter: where a fit to a frame's 3D keypoints starts. A network from 19 points, seen from the trunk, to
SPoser's code, the root's rotation and place, and the shape. Trained on synthetic people alone: random shapes in the
corpus's poses, with a detector's bias, located with 3 to 30 mm of noise per axis, up to half of the points missing.""",
    """On the distinct poses of unseen subjects, people and noise drawn as in training. `points_mm`: mean distance
of joints 1 to 23 on a skeleton of 1.70 m, pelvis fixed. `betas_explained`: share of the first two shape parameters'
variance that a single frame explains.
""",
)


def train_lifter(job: TrainingJob, settings: LifterSettings = LifterSettings()) -> Finished:
    """Train, export and write the model card."""
    task = LifterTask(
        job.training, job.validation, load_body(), load_sposer(), settings, job.settings.batch, job.settings.seed
    )  # fmt: skip
    if job.start is not None:
        start = read_weights(job.start, NAME)
        take_over(cast(nn.Sequential, task.model), read_stack(start, "network", 4 * len(POINTS), OUTPUTS))
    network = cast(nn.Sequential, run_training(task, job.settings, job.work, job.progress))
    header = {
        "network_hidden": settings.hidden, "activation": "silu", "points": POINTS,
        "sposer_sha256": load_sposer().metadata["sha256"],
    }  # fmt: skip
    arrays, figures = stack_arrays(network, "network"), {"metrics": task.evaluate(network)}
    return publish(job, NAME, arrays, header, asdict(settings) | asdict(job.settings), lambda path: figures, CARD)
