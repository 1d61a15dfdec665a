"""The view lifter from recordings to shipped weights."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.body.body import load_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import INPUTS, OUTPUTS
from solver_backend.training.engine.model_card import Card
from solver_backend.training.engine.recipe import Finished, TrainingJob
from solver_backend.training.lifter.train import train_network
from solver_backend.training.view_lifter.task import ViewLifterSettings, ViewLifterTask

CARD = Card(
    "View lifter",
    """The view lifter: pose code, root, direction up and errors of a person from one camera's 2D keypoints. A network
from 27 frames of 19 points, turned and scaled so that neither place in the picture nor distance matter. Neither the
person's size nor their distance comes out: one camera holds neither. Trained on synthetic windows alone.""",
    """On windows about the distinct poses of unseen subjects, cameras and faults drawn as in training. Distances are
on a skeleton of 1.70 m about the joints' middle, in the camera's axes; `pa_joints_mm`: after the best similarity;
`along_mm`: along the line of sight; `inside_95_percent`: joints within the 95 % ellipsoid that the network gives.
SPoser, whose codes it gives, was trained on subjects 49 and 135.
""",
    augmented=False,
)


def train_view_lifter(job: TrainingJob, settings: ViewLifterSettings = ViewLifterSettings()) -> Finished:
    """Train, export and write the model card."""
    task = ViewLifterTask(
        job.training, job.validation, load_body(), load_sposer(), settings, job.settings.batch, job.settings.seed,
        job.settings.device,
    )  # fmt: skip
    loop = job.settings if job.settings.device == "cpu" else replace(job.settings, workers=0)
    return train_network(job, task, settings, ("view_lifter", INPUTS, OUTPUTS), CARD, loop)
