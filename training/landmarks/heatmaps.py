"""Heatmaps of landmarks: drawn, read by their centre of mass, fused by the shared axis, and compared (4.14, 4.15)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch

SIGMA_PX = 2.0
"""Spread of a drawn heatmap."""
SKIPPED = 2
"""Centres of maps so smooth are the same to 0.8 mm from every second pixel along each axis."""
REACH_SIGMAS = 4.5
"""Beyond so many spreads a Gaussian holds nothing."""
WELSCH_NU = 0.05
"""Scale of Welsch's loss, in normalised positions; chosen by hand."""
HEAT_SHARE, WELSCH_SHARE = 1.0, 1.0


def _profile(where: torch.Tensor, size: int) -> torch.Tensor:
    """Return the (..., size) profiles along one axis, which sum to 1."""
    pixels = torch.linspace(-1.0, 1.0, size, device=where.device)
    sigma = 2.0 * SIGMA_PX / (size - 1)
    return torch.softmax(-0.5 * ((pixels - where.clamp(-1.0, 1.0)[..., None]) / sigma).square(), -1)


@dataclass(frozen=True)
class MapReading:
    """What is read of maps without making them: they are the softmax of (..., S, S) logits."""

    across: torch.Tensor
    """(...) centre of mass along columns, in -1..1."""
    down: torch.Tensor
    """(...) along rows."""
    log_total: torch.Tensor
    """(...) logarithm of the sum of exponentials: logits less this are the maps' logarithms."""
    log_near: torch.Tensor
    """(..., n) logarithms of the maps at the pixels that were asked for."""


def read_maps(logits: torch.Tensor, pixels: torch.Tensor | None = None, line: torch.Tensor | None = None) -> MapReading:
    """Return the reading of maps whose logits are (..., S, S), and their logarithms at (..., n) numbers of pixels.

    Args:
        logits: of the maps.
        pixels: counted along rows.
        line: (S,) where rows and columns lie; evenly over -1..1 if None.
    """
    side, shape = logits.shape[-1], logits.shape[:-2]
    flat = logits.reshape(-1, side * side)
    index = flat.new_empty((len(flat), 0), dtype=torch.long) if pixels is None else pixels.reshape(len(flat), -1)
    line = torch.linspace(-1.0, 1.0, side, device=logits.device) if line is None else line
    v, u = torch.meshgrid(line, line, indexing="ij")
    basis = torch.stack((torch.ones_like(u), u, v), -1).flatten(0, 1)
    log_total, centre, near = _SoftmaxReading.apply(flat, index, basis)
    across, down = centre.unflatten(0, shape).unbind(-1)
    return MapReading(across, down, log_total.view(shape), (near - log_total[:, None]).unflatten(0, shape))


class _SoftmaxReading(torch.autograd.Function):
    """Total, centre and some values of a softmax, by one pass over it; its derivative by another.

    With ``h = softmax(l)``: ``d log_total / dl = h``, ``d c / dl = h (x - c)``.
    """

    @staticmethod
    def forward(
        ctx: Any, logits: torch.Tensor, index: torch.Tensor, basis: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        with torch.autocast(logits.device.type, enabled=False):
            logits = logits.float()
            highest = logits.amax(-1, keepdim=True)
            mass = (logits - highest).exp_()
            sums = mass @ basis
            total, centre = sums[:, :1], sums[:, 1:] / sums[:, :1]
            ctx.save_for_backward(mass, total, centre, index, basis)
            return (highest + total.log())[:, 0], centre, logits.gather(-1, index)

    @staticmethod
    def symbolic(graph: Any, logits: Any, index: Any, basis: Any) -> tuple[Any, Any, Any]:
        """Return the same reading as operators of an ONNX file (opset 18)."""
        last, of_places = (graph.op("Constant", value_t=torch.tensor(which)) for which in ([-1], [1, 2]))
        sums = graph.op("MatMul", graph.op("Softmax", logits, axis_i=-1), basis)
        return (
            graph.op("ReduceLogSumExp", logits, last, keepdims_i=0),
            graph.op("Gather", sums, of_places, axis_i=1),
            graph.op("GatherElements", logits, index, axis_i=1),
        )

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        by_total, by_centre, by_near = gradients
        mass, total, centre, index, basis = ctx.saved_tensors
        constant = by_total[:, None] - (by_centre * centre).sum(-1, keepdim=True)
        by_logits = torch.cat((constant, by_centre), -1).div_(total) @ basis.T
        return by_logits.mul_(mass).scatter_add_(-1, index, by_near), None, None


def fused(reading: MapReading) -> torch.Tensor:
    """Return (B, L, 3) normalised positions of the (B, 2, L) maps of the xy and yz views; y is the mean of both."""
    across, down = reading.across, reading.down
    return torch.stack((across[:, 0], 0.5 * (down[:, 0] + down[:, 1]), across[:, 1]), -1)


def gaussians_near(u: torch.Tensor, v: torch.Tensor, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return Gaussians about (...) coordinates where they hold anything, and which pixels those are, (..., n)."""
    side = min(size, 2 * math.ceil(REACH_SIGMAS * SIGMA_PX) + 1)
    around = torch.arange(side, device=u.device)
    columns, rows = (
        ((c.clamp(-1.0, 1.0) + 1.0) * 0.5 * (size - 1) - side // 2).round().long().clamp(0, size - side)[..., None]
        + around for c in (u, v)
    )  # fmt: skip
    down, across = _profile(v, size).gather(-1, rows), _profile(u, size).gather(-1, columns)
    a = (down[..., :, None] * across[..., None, :]).flatten(-2)
    return a, (size * rows[..., :, None] + columns[..., None, :]).flatten(-2)


def divergence_from_gaussians(gaussians: torch.Tensor, log_near: torch.Tensor) -> torch.Tensor:
    """Return Jensen and Shannon's divergence of maps from Gaussians, both looked at where the latter are, (..., n).

    The same as ``jensen_shannon`` of the whole maps but for what Gaussians hold beyond ``REACH_SIGMAS``: where one map
    is 0, the other one's mass counts ``log(2) / 2``.
    """
    a, b = gaussians, log_near.exp()
    log_middle = (0.5 * (a + b) + 1e-12).log()
    near = a * ((a + 1e-12).log() - log_middle) + b * ((b + 1e-12).log() - log_middle)
    return 0.5 * (near.sum(-1) + math.log(2.0) * (2.0 - a.sum(-1) - b.sum(-1)))


def relative_entropy(gaussians: torch.Tensor, log_near: torch.Tensor) -> torch.Tensor:
    """Return ``KL(G || H) = sum G (log G - log H)`` of Gaussians and maps, looked at where the former are, (..., n).

    Its gradient by a logit is ``H - G``, that of Jensen and Shannon's ``H (log(H / M) - JS) / 2``: nothing wherever a
    map is surely wrong.
    """
    return (gaussians * ((gaussians + 1e-12).log() - log_near)).sum(-1)


def welsch(truth: torch.Tensor, estimate: torch.Tensor) -> torch.Tensor:
    """Return ``1 - exp(-|e|² / 2 ν²)`` of (..., 3) normalised positions (thesis eq. 4.15)."""
    return 1.0 - torch.exp(-(truth - estimate).square().sum(-1) / (2.0 * WELSCH_NU**2))
