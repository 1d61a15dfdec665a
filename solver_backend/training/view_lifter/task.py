"""What the view lifter learns: poses in the camera's axes, and how far it is off across and along the line of sight."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from solver_backend.body.body import Body
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.priors.sposer import SPoser
from solver_backend.priors.view_lifter import INPUTS, OUTPUTS, LiftedView, features, interpreted, look_at
from solver_backend.training.data.corpus import Corpus
from solver_backend.training.data.points import rotation_points
from solver_backend.training.engine.dense_layers import dense_stack
from solver_backend.training.engine.devices import device_of
from solver_backend.training.view_lifter.filming import FilmedWindows, film
from solver_backend.training.view_lifter.recordings import Recordings

_VALIDATION_WINDOWS = 2000
"""Windows that each validation looks at; chosen by hand."""
_JOINTS = NUM_JOINTS
"""Joints of the body, before the points that are no joints."""


@dataclass(frozen=True)
class ViewLifterSettings:
    """The network and the people it is shown."""

    hidden: tuple[int, ...] = (640, 512, 512, 512)
    """Widths of the hidden layers."""
    exchanged: int = 3
    """Copies of the recordings whose clips have limbs of one another."""
    tips: float = 0.3
    """Weight of points along the joints' axes against the joints."""
    up: float = 0.1
    """Weight of the direction up, metres a unit."""
    error: float = 0.01
    """Weight of the logarithmic density of the errors, metres."""


class ViewLifterTask:
    """Batches of windows, the loss, and figures on unseen subjects."""

    def __init__(
        self, training: Corpus, validation: Corpus, body: Body, prior: SPoser, settings: ViewLifterSettings,
        batch: int, seed: int, device: str = "cpu",
    ) -> None:  # fmt: skip
        torch.manual_seed(seed)
        self._network = dense_stack((INPUTS, *settings.hidden, OUTPUTS), "silu")
        self._settings, self._prior, self._batch = settings, prior, batch
        self._device = torch.device(device)
        self._recordings = Recordings.of(training, body, settings.exchanged, seed, self._device)
        unseen = Recordings.of(validation, body, 0, seed)
        chosen = unseen.centres[:: max(1, len(unseen.centres) // _VALIDATION_WINDOWS)]
        self._unseen = film(unseen, chosen, torch.Generator().manual_seed(seed + 1))

    @property
    def model(self) -> nn.Module:
        """1544 to 89."""
        return self._network

    def draw(self, generator: torch.Generator) -> FilmedWindows:
        """Draw windows where the network trains: a processor could not draw as fast as a GPU learns."""
        centres = self._recordings.centres
        if self._device.type != "cpu":
            generator = torch.Generator(self._device).manual_seed(generator.initial_seed())
        chosen = centres[torch.randint(len(centres), (self._batch,), generator=generator, device=self._device)]
        return film(self._recordings, chosen, generator)

    def loss(self, batch: FilmedWindows, generator: torch.Generator) -> torch.Tensor:
        """Return metres of misplaced points, of the direction up, and the errors' density."""
        footage, chosen = batch.to(device_of(self._network)), self._settings
        lifted = _lifted(self._network, footage)
        off = self._off(lifted, footage)
        length = torch.linalg.vector_norm(off, dim=-1)
        up = (lifted.up - footage.true_up).square().sum(-1).mean()
        density = _density(off[:, :_JOINTS].detach(), lifted).mean()
        points = (length[:, :_JOINTS].mean() + chosen.tips * length[:, _JOINTS:].mean()) / (1.0 + chosen.tips)
        return points + chosen.up * up + chosen.error * density

    @torch.no_grad()
    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return figures on unseen subjects."""
        footage = self._unseen
        lifted = _lifted(model, footage)
        off = self._off(lifted, footage)[:, 1:_JOINTS]
        found, truth = self._joints(lifted.z, lifted.root), _posed(footage)
        cosine = (lifted.up * footage.true_up).sum(-1).clamp(-1.0, 1.0)
        known = footage.up.square().sum(-1) > 0
        sigma = lifted.sigma_m[:, 1:]
        along = (off * lifted.sight[:, None, 2]).sum(-1)
        across = (off.square().sum(-1) - along.square()).clamp_min(0.0)
        deviation = across / sigma[..., 0].square() + (along / sigma[..., 1]).square()
        return {
            "joints_mm": 1000 * float(torch.linalg.vector_norm(off, dim=-1).mean()),
            "pa_joints_mm": pa_mpjpe_mm(found[:, :_JOINTS].numpy(), truth[:, :_JOINTS].numpy()),
            "along_mm": 1000 * float(along.abs().mean()),
            "up_unknown_deg": float(torch.rad2deg(torch.arccos(cosine[~known])).mean()),
            "inside_95_percent": 100 * float((deviation < 7.815).float().mean()),
        }

    def _joints(self, z: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
        return torch.matmul(rotation_points(self._prior.decode(z)), root.mT)

    def _off(self, lifted: LiftedView, footage: FilmedWindows) -> torch.Tensor:
        """Return (B, 90, 3) errors of points about the middle of the joints, in the camera's axes."""
        off = self._joints(lifted.z, lifted.root) - _posed(footage)
        return off - off[:, :_JOINTS].mean(dim=1, keepdim=True)


def _posed(footage: FilmedWindows) -> torch.Tensor:
    return torch.matmul(rotation_points(footage.local), footage.root.mT)


def _lifted(network: nn.Module, footage: FilmedWindows) -> LiftedView:
    view = look_at(footage.points, footage.confidence)
    return interpreted(network(features(footage.points, footage.confidence, footage.up, view)), view)


def _density(off: torch.Tensor, lifted: LiftedView) -> torch.Tensor:
    """Return (B, 24) negative logarithms of the normal densities of (B, 24, 3) errors."""
    seen = torch.matmul(off, lifted.sight.mT)
    sigma = lifted.sigma_m[..., (0, 0, 1)]
    return (0.5 * (seen / sigma).square() + torch.log(sigma)).sum(-1)
