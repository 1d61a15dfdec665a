"""Define the view lifter's task: poses in the camera's axes, with errors across and along the line of sight."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import nn

from solver_backend.body.body import Body, load_body
from solver_backend.exchange.errors import TrainingMismatch
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.priors.autoencoder import decoded_rotations
from solver_backend.priors.lifter import POINTS
from solver_backend.priors.sposer import SPoser, load_sposer
from solver_backend.priors.view_lifter import MIDDLE, OUTPUTS, TOKEN, WINDOW, LiftedView, features, interpreted, look_at
from solver_backend.priors.weights import read_weights
from training.data.corpus import Corpus
from training.data.points import rotation_points
from training.engine.dense_layers import AttentionLayer
from training.engine.loop import device_of, run_training
from training.engine.publish import Card, Finished, TrainingJob, publish
from training.view_lifter.filming import INVERTED_COSINE, FilmedWindows, Recordings, film


class ViewNet(nn.Module):
    """Network that maps features (N, 27, 62) to outputs (N, 89)."""

    def __init__(self, width: int, layers: int, heads: int) -> None:
        super().__init__()
        self.embed = nn.Linear(TOKEN, width)
        self.place = nn.Parameter(0.1 * torch.randn(WINDOW, width))
        self.layers = nn.ModuleList(AttentionLayer(width, heads) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.out = nn.Linear(width, OUTPUTS)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """Map features (N, 27, 62) to outputs (N, 89) for the middle frame of each window."""
        x = self.embed(tokens) + self.place
        for layer in self.layers:
            x = layer(x)
        return self.out(self.norm(x[:, MIDDLE]))


_VALIDATION_WINDOWS = 2000  # Number of windows in each validation. Chosen by hand.
_JOINTS = NUM_JOINTS  # Number of body joints. They precede the other points.


@dataclass(frozen=True)
class ViewLifterSettings:
    """Settings of the network and of the people who are simulated."""

    width: int = 192  # Features per frame.
    layers: int = 6  # Number of layers of attention between frames.
    heads: int = 6  # Number of heads in each attention layer.
    exchanged: int = 3  # Number of copies of the recordings in which limbs are exchanged between clips.
    tips: float = 0.3  # Weight of points on the joints' axes, relative to the joints.
    up: float = 0.1  # Weight of the up direction, in metres per unit.
    error: float = 0.01  # Weight of the logarithmic density of the errors, in metres.


class ViewLifterTask:
    """Draws batches of windows, computes the loss, and reports figures on unseen subjects."""

    def __init__(
        self, training: Corpus, validation: Corpus, body: Body, prior: SPoser, settings: ViewLifterSettings,
        batch: int, seed: int, device: str = "cpu",
    ) -> None:  # fmt: skip
        torch.manual_seed(seed)
        self._network = ViewNet(settings.width, settings.layers, settings.heads)
        self._settings, self._prior, self._batch = settings, prior, batch
        self._device = torch.device(device)
        self._recordings = Recordings.of(training, body, settings.exchanged, seed, self._device)
        unseen = Recordings.of(validation, body, 0, seed)
        chosen = unseen.centres[:: max(1, len(unseen.centres) // _VALIDATION_WINDOWS)]
        self._unseen = film(unseen, chosen, torch.Generator().manual_seed(seed + 1))

    @property
    def model(self) -> nn.Module:
        """Network that maps 27 frames of 62 numbers to 89 numbers."""
        return self._network

    def draw(self, generator: torch.Generator) -> FilmedWindows:
        """Draw windows on the training device, because a CPU cannot draw as fast as a GPU learns."""
        centres = self._recordings.centres
        if self._device.type != "cpu":
            generator = torch.Generator(self._device).manual_seed(generator.initial_seed())
        chosen = centres[torch.randint(len(centres), (self._batch,), generator=generator, device=self._device)]
        return film(self._recordings, chosen, generator)

    def loss(self, batch: FilmedWindows, generator: torch.Generator) -> torch.Tensor:
        """Return the mean error of points in metres and of the up direction, plus the errors' negative log density."""
        footage, chosen = batch.to(device_of(self._network)), self._settings
        lifted = _lifted(self._network, footage)
        poses = self._poses(lifted, footage)
        length = torch.linalg.vector_norm(poses.off, dim=-1)
        up = (lifted.up - footage.true_up).square().sum(-1).mean()
        density = _density(poses.off[:, :_JOINTS].detach(), lifted).mean()
        points = (length[:, :_JOINTS].mean() + chosen.tips * length[:, _JOINTS:].mean()) / (1.0 + chosen.tips)
        return points + chosen.up * up + chosen.error * density

    @torch.no_grad()
    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return figures on unseen subjects."""
        footage = self._unseen
        lifted = _lifted(model, footage)
        poses = self._poses(lifted, footage)
        off = poses.off[:, 1:_JOINTS]
        cosine = (lifted.up * footage.true_up).sum(-1).clamp(-1.0, 1.0)
        known = footage.up.square().sum(-1) > 0
        inverted = (footage.root[:, :, 1] * footage.true_up).sum(-1) < INVERTED_COSINE
        sigma = lifted.sigma_m[:, 1:]
        along = (off * lifted.sight[:, None, 2]).sum(-1)
        across = (off.square().sum(-1) - along.square()).clamp_min(0.0)
        deviation = across / sigma[..., 0].square() + (along / sigma[..., 1]).square()
        found, truth = (joints[:, :_JOINTS].numpy() for joints in (poses.found, poses.truth))
        return {
            "joints_mm": 1000 * float(torch.linalg.vector_norm(off, dim=-1).mean()),
            "pa_joints_mm": pa_mpjpe_mm(found, truth),
            "pa_inverted_mm": pa_mpjpe_mm(found[inverted], truth[inverted]),
            "along_mm": 1000 * float(along.abs().mean()),
            "up_unknown_deg": float(torch.rad2deg(torch.arccos(cosine[~known])).mean()),
            "inside_95_percent": 100 * float((deviation < 7.815).float().mean()),
        }

    def _poses(self, lifted: LiftedView, footage: FilmedWindows) -> _Poses:
        decoded = decoded_rotations(self._prior.decoder_like(lifted.z), lifted.z)
        points = rotation_points(torch.cat([decoded, footage.local]))
        found, truth = torch.matmul(points, torch.cat([lifted.root, footage.root]).mT).chunk(2)
        off = found - truth
        return _Poses(found, truth, off - off[:, :_JOINTS].mean(dim=1, keepdim=True))


@dataclass(frozen=True)
class _Poses:
    found: torch.Tensor  # (B, 90, 3) points relative to the pelvis in metres.
    truth: torch.Tensor  # (B, 90, 3) points relative to the pelvis in metres.
    off: torch.Tensor  # (B, 90, 3) errors relative to their mean over the joints, in metres.


def _lifted(network: nn.Module, footage: FilmedWindows) -> LiftedView:
    view = look_at(footage.points, footage.confidence)
    tokens = features(footage.points, footage.confidence, footage.up, view)
    with torch.autocast(tokens.device.type, torch.bfloat16, enabled=tokens.device.type == "cuda"):
        output = network(tokens)
    return interpreted(output.float(), view)


def _density(off: torch.Tensor, lifted: LiftedView) -> torch.Tensor:
    """Return the negative logarithms (B, 24) of the normal densities of errors (B, 24, 3)."""
    seen = torch.matmul(off, lifted.sight.mT)
    sigma = lifted.sigma_m[..., (0, 0, 1)]
    return (0.5 * (seen / sigma).square() + torch.log(sigma)).sum(-1)


NAME = "view_lifter"
CARD = Card(
    "View lifter",
    """The view lifter estimates a person's pose code, root, up direction and errors from one camera's 2D keypoints. It
uses attention among 27 frames of 19 points, rotated and scaled to remove position and distance. It does not estimate
the person's size or distance, which one camera cannot measure. It is trained on synthetic windows alone.""",
    """Measured on windows around the distinct poses of unseen subjects, with cameras and faults sampled as in training.
Distances are on a skeleton of 1.70 m relative to the joints' centre, in the camera's axes. `pa_joints_mm` is the error
after the best similarity, `pa_inverted_mm` the same for upside-down poses, and `along_mm` the error along the line of
sight. `inside_95_percent` counts joints within the network's 95 % ellipsoid. The network predicts SPoser's codes, and
SPoser was trained on subjects 49 and 135.
""",
    augmented=False,
)


def train_view_lifter(job: TrainingJob, settings: ViewLifterSettings = ViewLifterSettings()) -> Finished:
    """Train the view lifter, export its weights and write the model card.

    Raises:
        TrainingMismatch: the weights to start from belong to another network.
    """
    task = ViewLifterTask(
        job.training,
        job.validation,
        load_body(),
        load_sposer(),
        settings,
        job.settings.batch,
        job.settings.seed,
        job.settings.device,
    )
    if job.start is not None:
        _take_over(task.model, read_weights(job.start, NAME).arrays)
    loop = job.settings if job.settings.device == "cpu" else replace(job.settings, workers=0)
    network = run_training(task, loop, job.work, job.progress)
    header: dict[str, Any] = {
        "heads": settings.heads,
        "points": POINTS,
        "sposer_sha256": load_sposer().metadata["sha256"],
    }
    arrays = {name: value.numpy().astype(np.float16) for name, value in network.state_dict().items()}
    figures = {"metrics": task.evaluate(network)}
    return publish(job, NAME, arrays, header, asdict(settings) | asdict(job.settings), lambda path: figures, CARD)


def _take_over(network: nn.Module, arrays: dict[str, np.ndarray]) -> None:
    try:
        network.load_state_dict({name: torch.as_tensor(array.astype(np.float32)) for name, array in arrays.items()})
    except RuntimeError as error:
        raise TrainingMismatch(
            "The weights to start from are of another network.", hint="Train with the same sizes, or without --from."
        ) from error
