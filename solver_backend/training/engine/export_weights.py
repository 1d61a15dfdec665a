"""From trained networks to the weight files that ship."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from solver_backend.priors.weights import PriorWeights, write_weights
from solver_backend.training.sposer.network import linear_layers


def stack_arrays(stack: nn.Sequential, part: str, dtype: type = np.float16) -> dict[str, np.ndarray]:
    """Return the arrays of a stack of dense layers: weights in ``dtype``, biases in float32."""
    arrays: dict[str, np.ndarray] = {}
    for number, layer in enumerate(linear_layers(stack)):
        arrays[f"{part}_w{number}"] = layer.weight.detach().numpy().astype(dtype)
        arrays[f"{part}_b{number}"] = layer.bias.detach().numpy().astype(np.float32)
    return arrays


def export_prior(path: Path, prior: str, arrays: dict[str, np.ndarray], metadata: dict[str, Any]) -> str:
    """Write a weight file and return the hash of its arrays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_weights(path, PriorWeights(prior, arrays, metadata))
