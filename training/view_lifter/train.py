"""The view lifter from recordings to shipped weights."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import TrainingMismatch
from solver_backend.priors.lifter import POINTS
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import read_weights
from training.engine.loop import run_training
from training.engine.model_card import Card
from training.engine.publish import publish
from training.engine.recipe import Finished, TrainingJob
from training.view_lifter.task import ViewLifterSettings, ViewLifterTask

NAME = "view_lifter"
CARD = Card(
    "View lifter",
    """The view lifter: pose code, root, direction up and errors of a person from one camera's 2D keypoints. Attention
among 27 frames of 19 points, turned and scaled so that neither place in the picture nor distance matter. Neither the
person's size nor their distance comes out: one camera holds neither. Trained on synthetic windows alone.""",
    """On windows about the distinct poses of unseen subjects, cameras and faults drawn as in training. Distances are
on a skeleton of 1.70 m about the joints' middle, in the camera's axes; `pa_joints_mm`: after the best similarity;
`pa_inverted_mm`: of those upside down; `along_mm`: along the line of sight; `inside_95_percent`: joints within the 95 %
ellipsoid that the network gives. SPoser, whose codes it gives, was trained on subjects 49 and 135.
""",
    augmented=False,
)


def train_view_lifter(job: TrainingJob, settings: ViewLifterSettings = ViewLifterSettings()) -> Finished:
    """Train, export and write the model card.

    Raises:
        TrainingMismatch: the weights to start from are of another network.
    """
    task = ViewLifterTask(
        job.training, job.validation, load_body(), load_sposer(), settings, job.settings.batch, job.settings.seed,
        job.settings.device,
    )  # fmt: skip
    if job.start is not None:
        _take_over(task.model, read_weights(job.start, NAME).arrays)
    loop = job.settings if job.settings.device == "cpu" else replace(job.settings, workers=0)
    network = run_training(task, loop, job.work, job.progress)
    header: dict[str, Any] = {
        "heads": settings.heads, "points": POINTS, "sposer_sha256": load_sposer().metadata["sha256"],
    }  # fmt: skip
    arrays = {name: value.numpy().astype(np.float16) for name, value in network.state_dict().items()}
    figures = {"metrics": task.evaluate(network)}
    return publish(job, NAME, arrays, header, asdict(settings) | asdict(job.settings), lambda path: figures, CARD)


def _take_over(network: nn.Module, arrays: dict[str, np.ndarray]) -> None:
    """Give a network the weights of a file."""
    try:
        network.load_state_dict({name: torch.as_tensor(array.astype(np.float32)) for name, array in arrays.items()})
    except RuntimeError as error:
        raise TrainingMismatch(
            "The weights to start from are of another network.", hint="Train with the same sizes, or without --from."
        ) from error
