"""Train the limb slants from recordings to shipped weights. Windows are drawn once and read by the view lifter."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import nn

from solver_backend.body.body import Body, load_body
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.view_lifter import (
    BONES,
    CLASSES,
    bone_slants,
    features,
    flip_chances,
    interpreted,
    load_view_lifter,
    look_at,
    slant_classes,
)
from training.data.corpus import Corpus
from training.data.points import rotation_points
from training.engine.loop import run_training
from training.engine.publish import Card, Finished, TrainingJob, publish
from training.view_lifter.filming import Recordings, film

NAME = "limb_slants"
_BLOCK = 1000
"""Number of windows per draw, which limits memory. Chosen by hand."""
FLAGGED_PERCENT = 20.0  # Percentage of limbs that the card reports as flagged: those with the highest probability.
CARD = Card(
    "Limb slants",
    """This network estimates the probabilities that the bones of arms and legs point towards the camera, across or away
from it. Its input is the view lifter's output before the last layer. A large probability of the opposite class marks
a limb that may be lifted wrongly. The view lifter's weights do not change.""",
    """Measured on windows of unseen subjects, with cameras and faults sampled as in training. `cross_entropy` is over
the three classes. `flips_percent` counts limbs with a bone that the view lifter points the wrong way.
`flips_flagged_percent` is the share of them among the 20 % of limbs with the highest probability of it.
""",
    augmented=False,
)


@dataclass(frozen=True)
class LimbSlantSettings:
    """Settings of the network and of the windows that it learns from."""

    hidden: int = 64  # Width of the only layer.
    dropout: float = 0.2  # Dropout rate of that layer during training.
    windows: int = 16_000  # Total number of windows. On a CPU, the view lifter reads 200 per second.
    unseen: int = 3_000  # Number of windows from unseen subjects.
    exchanged: int = 1  # Number of copies of the recordings in which limbs are exchanged between clips.


@dataclass(frozen=True)
class SlantWindows:
    """Features of B windows from the view lifter, and the lifted and the true slants of the limbs."""

    hidden: torch.Tensor  # (B, d) features.
    classes: torch.Tensor  # (B, 8) classes of the true limb slants.
    lifted: np.ndarray  # (B, 8) slants that were lifted.
    true: np.ndarray  # (B, 8) true slants.


class LimbSlantTask:
    """Draws batches from fixed windows, computes the loss, and reports figures on unseen subjects."""

    def __init__(
        self, training: Corpus, validation: Corpus, body: Body, settings: LimbSlantSettings, batch: int, seed: int
    ) -> None:
        torch.manual_seed(seed)
        width = load_view_lifter().width
        self._network = nn.Sequential(
            nn.Linear(width, settings.hidden),
            nn.SiLU(),
            nn.Dropout(settings.dropout),
            nn.Linear(settings.hidden, len(BONES) * CLASSES),
        )
        self._batch = batch
        self._seen = read_windows(Recordings.of(training, body, settings.exchanged, seed), settings.windows, seed)
        self._unseen = read_windows(Recordings.of(validation, body, 0, seed), settings.unseen, seed + 1)

    @property
    def model(self) -> nn.Module:
        """Network that maps the lifter's features to 24 logits."""
        return self._network

    def draw(self, generator: torch.Generator) -> torch.Tensor:
        """Return the indices (B,) of the windows in a batch."""
        return torch.randint(len(self._seen.hidden), (self._batch,), generator=generator)

    def loss(self, batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Return the cross-entropy of the classes of all eight bones."""
        return _entropy(self._network(self._seen.hidden[batch]), self._seen.classes[batch])

    @torch.no_grad()
    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return figures on unseen subjects."""
        seen = self._unseen
        logits = model(seen.hidden)
        chances = torch.softmax(logits.unflatten(1, (len(BONES), CLASSES)), dim=-1).numpy()
        wrong = flip_chances(np.eye(CLASSES)[slant_classes(seen.true)], seen.lifted) > 0
        order = np.argsort(-flip_chances(chances, seen.lifted), axis=None)
        most = order[: round(0.01 * FLAGGED_PERCENT * len(order))]
        return {
            "cross_entropy": float(_entropy(logits, seen.classes)),
            "flips_percent": 100.0 * float(wrong.mean()),
            "flips_flagged_percent": 100.0 * float(wrong.ravel()[most].sum() / max(wrong.sum(), 1)),
        }


def read_windows(recordings: Recordings, count: int, seed: int) -> SlantWindows:
    """Film windows around random frames with random cameras, and apply the view lifter to them."""
    generator, lifter, prior = torch.Generator().manual_seed(seed), load_view_lifter(), load_sposer()
    parts = list[SlantWindows]()
    for first in range(0, count, _BLOCK):
        number = min(_BLOCK, count - first)
        footage = film(
            recordings,
            recordings.centres[torch.randint(len(recordings.centres), (number,), generator=generator)],
            generator,
        )
        points, confidence, up = (t.numpy().astype(float) for t in (footage.points, footage.confidence, footage.up))
        view = look_at(points, confidence)
        hidden = lifter.hidden(features(points, confidence, up, view))
        lifted = interpreted(lifter.output(hidden), view)
        posed = [(footage.local.numpy(), footage.root.numpy()), (np.asarray(prior.decode(lifted.z)), lifted.root)]
        true, found = (
            bone_slants((rotation_points(local) @ np.swapaxes(root, 1, 2))[:, :NUM_JOINTS], lifted.sight[:, 2])
            for local, root in posed
        )
        classes = torch.as_tensor(slant_classes(true))
        parts.append(SlantWindows(torch.as_tensor(hidden), classes, found, true))
    return SlantWindows(
        torch.cat([part.hidden for part in parts]),
        torch.cat([part.classes for part in parts]),
        np.concatenate([part.lifted for part in parts]),
        np.concatenate([part.true for part in parts]),
    )


def train_limb_slants(job: TrainingJob, settings: LimbSlantSettings = LimbSlantSettings()) -> Finished:
    """Train the limb-slant network, export its weights and write the model card."""
    task = LimbSlantTask(job.training, job.validation, load_body(), settings, job.settings.batch, job.settings.seed)
    network = run_training(task, job.settings, job.work, job.progress)
    header = {
        "network_hidden": [settings.hidden],
        "activation": "silu",
        "view_lifter_sha256": load_view_lifter().metadata["sha256"],
    }
    layers = [module for module in network.modules() if isinstance(module, nn.Linear)]
    arrays = {
        f"network_{kind}{number}": value.detach().numpy().astype(np.float16)
        for number, module in enumerate(layers)
        for kind, value in (("w", module.weight), ("b", module.bias))
    }
    figures = {"metrics": task.evaluate(network)}
    return publish(job, NAME, arrays, header, asdict(settings) | asdict(job.settings), lambda path: figures, CARD)


def _entropy(logits: torch.Tensor, classes: torch.Tensor) -> torch.Tensor:
    flat = logits.unflatten(1, (len(BONES), CLASSES)).flatten(0, 1)
    return nn.functional.cross_entropy(flat, classes.flatten())
