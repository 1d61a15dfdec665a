"""Export landmark networks to ONNX files that map points to positions in metres."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from torch import nn

from solver_backend.exchange.errors import BackendMissing, FileDamaged, FileMissing
from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.outputs import atomic_output
from solver_backend.labelling.point_network import PointNetwork
from training.landmarks.cloud_stream import Clouds
from training.landmarks.models import LandmarkModel, PointNet, PointNetWidths
from training.landmarks.rows import Row

OPSET = 18  # Version of ONNX's operators (December 2022). It is the first with the maximum of scattered values.
INPUTS = ("points", "seen")
OUTPUTS = ("scores", "missing", "positions", "spread")
"""Names of the point network's outputs."""
_AXES = {0: "clouds", 1: "n"}


def export_point_network(network: PointNetwork, path: Path, *, overwrite: bool = False) -> Path:
    """Write the labelling network to an ONNX file.

    Inputs are ``points`` (B, N, 3) float32 with their median at the origin, and ``seen`` (B, N) bool.

    Raises:
        BackendMissing: the package onnx is not installed.
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    axes = {"scores": _AXES, "positions": {0: "clouds"}, "spread": {0: "clouds"}}
    return _export(_Reading(torch_network(network)), path, OUTPUTS, axes, overwrite)


def export_row(model: LandmarkModel, path: Path, *, overwrite: bool = False) -> Path:
    """Write the network of a table row to an ONNX file, with its pre-processing and post-processing.

    The inputs are ``points`` (B, N, 3) float32 in metres, Z up, and ``seen`` (B, N) bool, with at least one point per
    cloud. The output is ``positions`` (B, L, 3) in metres of the landmarks ``model.columns``. For rows with attention
    over points, each cloud's median must be at the origin.

    Raises:
        BackendMissing: the package onnx is not installed.
        OutputExists, OutputNotWritable: see ``atomic_output``.
    """
    return _export(_Positions(model), path, ("positions",), {"positions": {0: "clouds"}}, overwrite)


def torch_network(network: PointNetwork) -> PointNet:
    """Convert the solver's NumPy network to torch."""
    arrays = network.arrays
    model = PointNet(PointNetWidths(arrays["queries"].shape[1], network.layers, network.heads))
    model.load_state_dict({name: torch.as_tensor(value) for name, value in arrays.items()})
    return model


def _export(
    module: nn.Module, path: Path, outputs: tuple[str, ...], axes: dict[str, dict[int, str]], overwrite: bool
) -> Path:
    rng = torch.Generator().manual_seed(0)
    example = (torch.randn(1, 8, 3, generator=rng), torch.ones(1, 8, dtype=torch.bool))  # size 1 would broadcast
    axes = dict.fromkeys(INPUTS, _AXES) | axes
    with atomic_output(path, overwrite=overwrite) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about deprecations in the exporter and about sizes that it makes constant
        try:
            torch.onnx.export(
                module.eval(),
                example,
                str(temporary),
                input_names=list(INPUTS),
                output_names=list(outputs),
                dynamic_axes=axes,
                opset_version=OPSET,
                dynamo=False,
            )
        except ModuleNotFoundError as error:
            raise BackendMissing(
                f"ONNX files need the package {error.name}.", hint="Install it with: pip install onnx."
            ) from error
    return path


class _Reading(nn.Module):
    """Module that returns the tensors of a ``LabelReading`` separately, as ONNX needs them."""

    def __init__(self, model: PointNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, ...]:
        reading = self.model(points, seen)
        return reading.scores, reading.missing, reading.positions, reading.spread


class _Positions(nn.Module):
    """Module that maps points to positions, without labels or targets."""

    def __init__(self, model: LandmarkModel) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        nothing = torch.zeros_like(seen)
        return self.model.positions(Clouds(points, seen, nothing, points, nothing))


def read_trained(folder: Path) -> LandmarkModel:
    """Read the trained network from the ``--work`` folder of a training.

    Raises:
        FileMissing, FileDamaged: the folder contains no trained row, or is damaged.
    """
    try:
        figures = json.loads((folder / "figures.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise FileMissing(
            "The folder contains no trained landmark network.",
            where=str(folder),
            hint="Give the folder of train landmarks --work. It contains figures.json and weights.npz.",
        ) from error
    except ValueError as error:
        raise FileDamaged("The figures of the training cannot be read.", where=str(folder / "figures.json")) from error
    return trained_model(figures, folder / "weights.npz")


def trained_model(figures: Mapping[str, Any], weights: Path) -> LandmarkModel:
    """Return the trained network of a row, ready to read clouds.

    Args:
        figures: figures that were written by the training.
        weights: weights from the same training.

    Raises:
        FileMissing, FileDamaged: the weights are missing, or belong to another network.
    """
    known = {field.name for field in fields(Row)} - {"balance", "variety"}
    try:
        model = Row(**{name: value for name, value in figures["row"].items() if name in known}).model()
        arrays = {name: torch.as_tensor(array).float() for name, array in read_npz(weights).items()}
        lost, foreign = model.load_state_dict(arrays, strict=False)
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise FileDamaged("The weights and the figures belong to different networks.", where=str(weights)) from error
    if foreign or any(name in dict(model.named_parameters()) for name in lost):
        raise FileDamaged("The weights and the figures belong to different networks.", where=str(weights))
    return model.eval()
