"""Stacks of dense layers in torch, and their arrays as the weight files hold them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import nn

from solver_backend.exchange.errors import TrainingMismatch
from solver_backend.priors.networks.dense import DenseStack

_ACTIVATIONS = {"silu": nn.SiLU, "elu": nn.ELU, "leaky_relu": nn.LeakyReLU}


def dense_stack(widths: tuple[int, ...], activation: str) -> nn.Sequential:
    """Return linear layers with the activation between them."""
    layers: list[nn.Module] = []
    for number, (before, after) in enumerate(pairwise(widths)):
        layers.append(nn.Linear(before, after))
        if number < len(widths) - 2:
            layers.append(_ACTIVATIONS[activation]())
    return nn.Sequential(*layers)


def linear_layers(stack: nn.Sequential) -> list[nn.Linear]:
    """Return the linear layers of a stack."""
    return [layer for layer in stack if isinstance(layer, nn.Linear)]


def take_over(stack: nn.Sequential, weights: DenseStack) -> None:
    """Give a stack the weights of a file.

    Raises:
        TrainingMismatch: the file's layers have other widths.
    """
    layers = linear_layers(stack)
    widths = (layers[0].in_features, *(layer.out_features for layer in layers))
    if widths != weights.widths:
        raise TrainingMismatch(
            f"The weights to start from have layers of {weights.widths}, the network has {widths}.",
            hint="Train with the same widths (--hidden), or without --from.",
        )
    with torch.no_grad():
        for layer, weight, bias in zip(layers, weights.weights, weights.biases, strict=True):
            layer.weight.copy_(torch.as_tensor(np.asarray(weight, dtype=np.float32)))
            layer.bias.copy_(torch.as_tensor(np.asarray(bias, dtype=np.float32)))


def stack_arrays(stack: nn.Sequential, part: str) -> dict[str, np.ndarray]:
    """Return the arrays of a stack of dense layers: weights in half precision, biases in float32."""
    arrays: dict[str, np.ndarray] = {}
    for number, layer in enumerate(linear_layers(stack)):
        arrays[f"{part}_w{number}"] = layer.weight.detach().numpy().astype(np.float16)
        arrays[f"{part}_b{number}"] = layer.bias.detach().numpy().astype(np.float32)
    return arrays
