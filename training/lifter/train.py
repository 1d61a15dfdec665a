"""Train the lifter, from the corpus to the shipped weights."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifter import OUTPUTS, POINTS, TRUNK, Lifted, features, interpreted, trunk_frame
from solver_backend.priors.sposer import SPoser, load_sposer
from solver_backend.priors.weights import read_stack, read_weights
from solver_backend.types import NUM_BETAS, JointSet
from training.data.corpus import Corpus, exchanged_limbs, maybe_mirrored, varied_joints
from training.data.points import rotation_points
from training.engine.dense_layers import dense_stack, stack_arrays, take_over
from training.engine.loop import device_of, run_training
from training.engine.publish import Card, Finished, TrainingJob, publish

_JOINT_SET = JointSet.BODY_25B
_VALIDATION_POSES = 2000
"""Number of poses in each validation. Chosen by hand."""


@dataclass(frozen=True)
class LifterSettings:
    """Settings of the lifter's network and of the simulated people."""

    hidden: tuple[int, ...] = (384, 384)  # Widths of the hidden layers.
    people: int = 8  # Number of shapes per batch.
    betas_sigma: float = 1.0  # Standard deviation of the shape coefficients.
    offset_m: float = 0.012  # Standard deviation of a point's bias, for each axis and person.
    noise_m: tuple[float, float] = (0.003, 0.03)
    """Smallest and largest noise of a triangulated point in metres per axis. One draw per pose."""
    missing: float = 0.5  # Largest fraction of points outside the trunk that are missing. Most poses lack few.
    exchanged: float = 0.3  # Fraction of poses with limbs from other poses.


@dataclass(frozen=True)
class LifterPeople:
    """Poses and shapes of simulated people, and their noisy points."""

    points: torch.Tensor  # (N, 19, 3) points in metres.
    seen: torch.Tensor  # (N, 19) mask of seen points.
    local: torch.Tensor  # (N, 21, 3, 3) local rotations.
    root: torch.Tensor  # (N, 3, 3) rotations of the root.
    pelvis: torch.Tensor  # (N, 3) pelvis positions in metres.
    betas: torch.Tensor  # (N, 10) shapes.

    def to(self, device: torch.device) -> LifterPeople:
        """Copy the people to a device."""
        return LifterPeople(*(getattr(self, part.name).to(device) for part in fields(self)))


class LifterTask:
    """Draws batches of people, computes the loss, and reports figures on unseen subjects."""

    def __init__(
        self,
        training: Corpus,
        validation: Corpus,
        body: Body,
        prior: SPoser,
        settings: LifterSettings,
        batch: int,
        seed: int,
    ) -> None:
        torch.manual_seed(seed)
        self._network = dense_stack((4 * len(POINTS), *settings.hidden, OUTPUTS), "silu")
        self._settings, self._body, self._prior, self._batch = settings, body, prior, batch
        landmarks = keypoint_landmarks(body, _JOINT_SET)
        self._landmarks, self._columns = landmarks, [landmarks.names.index(name) for name in POINTS]
        self._poses = torch.from_numpy(training.rotations)
        self._distinct = torch.from_numpy(training.distinct)
        unseen = torch.from_numpy(validation.some_distinct(_VALIDATION_POSES))
        self._unseen = self._people(unseen, torch.Generator().manual_seed(seed + 1))

    @property
    def model(self) -> nn.Module:
        """The lifter's network, which maps 76 inputs to 51 outputs."""
        return self._network

    def draw(self, generator: torch.Generator) -> LifterPeople:
        """Draw a batch of simulated people."""
        chosen = self._distinct[torch.randint(len(self._distinct), (self._batch,), generator=generator)]
        windows = exchanged_limbs(self._poses[chosen][:, None], generator, self._settings.exchanged)
        windows = varied_joints(maybe_mirrored(windows, generator), generator)
        return self._people(windows[:, 0], generator)

    def loss(self, batch: LifterPeople, generator: torch.Generator) -> torch.Tensor:
        """Return the mean point distance in metres plus weighted errors of rotation, position and shape."""
        people = batch.to(device_of(self._network))
        lifted = self._lifted(self._network, people)
        off = self._points_off(lifted, people)
        turn = (lifted.root - people.root).square().sum((-1, -2)).mean()
        place = (lifted.pelvis - people.pelvis).abs().sum(-1).mean()
        shape = (lifted.betas - people.betas).square().mean()
        return off.mean() + 0.2 * turn + 0.5 * place + 0.01 * shape

    @torch.no_grad()
    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return errors on unseen subjects: points (with a fixed pelvis), root, pelvis and shape."""
        lifted, people = self._lifted(model, self._unseen), self._unseen
        cosine = ((lifted.root * people.root).sum((-1, -2)) - 1.0) / 2.0
        angle = torch.rad2deg(torch.arccos(cosine.clamp(-1.0, 1.0)))
        return {
            "points_mm": 1000 * float(self._points_off(lifted, people)[:, 1:NUM_JOINTS].mean()),
            "root_deg": float(angle.mean()),
            "pelvis_mm": 1000 * float((lifted.pelvis - people.pelvis).norm(dim=-1).mean()),
            "betas_explained": 1.0
            - float((lifted.betas - people.betas)[:, :2].square().mean()) / float(people.betas[:, :2].square().mean()),
        }

    def _points_off(self, lifted: Lifted, people: LifterPeople) -> torch.Tensor:
        decoded = rotation_points(self._prior.decode(lifted.z))
        return torch.linalg.vector_norm(decoded - rotation_points(people.local), dim=-1)

    def _lifted(self, network: nn.Module, people: LifterPeople) -> Lifted:
        trunk = trunk_frame(people.points, people.seen)
        return interpreted(network(features(people.points, people.seen, trunk)), trunk)

    def _people(self, local: torch.Tensor, generator: torch.Generator) -> LifterPeople:
        """Return people in these poses, of random shape and orientation, and their noisy points."""
        chosen, count = self._settings, len(local)
        root = exp_so3(_directions(count, generator) * np.pi * torch.rand(count, 1, generator=generator))
        parts = [
            self._person(part, turn, generator)
            for part, turn in zip(local.chunk(chosen.people), root.chunk(chosen.people), strict=True)
        ]
        points, pelvis, betas = (torch.cat(column) for column in zip(*parts, strict=True))
        low, high = chosen.noise_m
        noise = low * (high / low) ** torch.rand(count, 1, 1, generator=generator)
        points = points + noise * torch.randn(points.shape, generator=generator)
        share = chosen.missing * torch.rand(count, 1, generator=generator) ** 2
        seen = torch.rand(count, len(POINTS), generator=generator) > share
        seen[:, : len(TRUNK)] = True
        return LifterPeople(points, seen, local, root, pelvis, betas)

    def _person(
        self, local: torch.Tensor, root: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the points, pelvis and shape of one person in several poses."""
        betas = self._settings.betas_sigma * torch.randn(NUM_BETAS, generator=generator)
        bias = self._settings.offset_m * torch.randn(len(self._landmarks), 3, generator=generator)
        posed = pose_landmarks(
            self._body, self._landmarks, betas, root, local, torch.zeros(len(local), 3), offsets=bias
        )
        return posed.points[:, self._columns], posed.skeleton.joints[:, 0], betas.expand(len(local), -1)


def _directions(count: int, generator: torch.Generator) -> torch.Tensor:
    return nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


NAME = "lifter"
CARD = Card(
    "Lifter",
    """The lifter estimates the start of a fit to a frame's 3D keypoints. From 19 points in the trunk's frame it
estimates SPoser's code, the root's rotation and position, and the shape. It is trained on synthetic people alone:
random shapes in the corpus's poses, with a detector's bias, 3 to 30 mm of noise per axis and up to half of the points
missing.""",
    """Measured on the distinct poses of unseen subjects, with people and noise sampled as in training. `points_mm` is
the mean distance of joints 1 to 23 on a skeleton of 1.70 m with the pelvis fixed. `betas_explained` is the fraction of
the first two shape parameters' variance that a single frame explains.
""",
)


def train_lifter(job: TrainingJob, settings: LifterSettings = LifterSettings()) -> Finished:
    """Train the lifter, export its weights, measure them and write the model card."""
    task = LifterTask(
        job.training, job.validation, load_body(), load_sposer(), settings, job.settings.batch, job.settings.seed
    )
    if job.start is not None:
        start = read_weights(job.start, NAME)
        take_over(cast(nn.Sequential, task.model), read_stack(start, "network", 4 * len(POINTS), OUTPUTS))
    network = cast(nn.Sequential, run_training(task, job.settings, job.work, job.progress))
    header = {
        "network_hidden": settings.hidden,
        "activation": "silu",
        "points": POINTS,
        "sposer_sha256": load_sposer().metadata["sha256"],
    }
    arrays, figures = stack_arrays(network, "network"), {"metrics": task.evaluate(network)}
    return publish(job, NAME, arrays, header, asdict(settings) | asdict(job.settings), lambda path: figures, CARD)
