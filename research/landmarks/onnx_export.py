"""The point network as an ONNX file, for programs that read such."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn

from solver_backend.exchange.errors import BackendMissing
from solver_backend.exchange.outputs import atomic_output
from solver_backend.labelling.point_network import PointNetwork
from solver_backend.training.landmarks.point_net import PointNet, PointNetWidths

OPSET = 17
"""Version of ONNX's operators (of June 2022); chosen by hand."""
OUTPUTS = ("scores", "missing", "positions", "spread")


def export_onnx(network: PointNetwork, path: Path, *, overwrite: bool = False) -> Path:
    """Write a network: inputs ``points`` (B, N, 3) float32, medians at the origin, and ``seen`` (B, N) bool.

    Raises:
        BackendMissing: the package onnx is not installed.
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    model = torch_network(network).eval()
    example = (torch.zeros(1, 8, 3), torch.ones(1, 8, dtype=torch.bool))
    axes = {"points": {0: "clouds", 1: "n"}, "seen": {0: "clouds", 1: "n"}}
    axes |= {"scores": {0: "clouds", 1: "n"}, "positions": {0: "clouds"}, "spread": {0: "clouds"}}
    with atomic_output(path, overwrite=overwrite) as temporary:
        try:
            torch.onnx.export(
                _Plain(model), example, str(temporary), input_names=["points", "seen"], output_names=list(OUTPUTS),
                dynamic_axes=axes, opset_version=OPSET, dynamo=False,
            )  # fmt: skip
        except ModuleNotFoundError as error:
            raise BackendMissing(
                f"ONNX files need the package {error.name}.", hint="pip install manifold-mocap[onnx]"
            ) from error
    return path


def torch_network(network: PointNetwork) -> PointNet:
    """Return the network that its NumPy reading is of."""
    arrays = network.arrays
    model = PointNet(PointNetWidths(arrays["queries"].shape[1], network.layers, network.heads))
    model.load_state_dict({name: torch.as_tensor(value) for name, value in arrays.items()})
    return model


class _Plain(nn.Module):
    """Returns tensors, not a reading."""

    def __init__(self, model: PointNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, ...]:
        reading = self.model(points, seen)
        return reading.scores, reading.missing, reading.positions, reading.spread
