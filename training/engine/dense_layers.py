"""Dense layer stacks in torch, and their arrays in the format of the weight files."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import nn

from solver_backend.exchange.errors import TrainingMismatch
from solver_backend.priors.autoencoder import DenseStack

_ACTIVATIONS = {"silu": nn.SiLU, "elu": nn.ELU, "leaky_relu": nn.LeakyReLU}


def dense_stack(widths: tuple[int, ...], activation: str) -> nn.Sequential:
    """Return linear layers of the given widths, with activations between them."""
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
    """Copy weights from a weight file into a stack of layers.

    Raises:
        TrainingMismatch: the layers in the file have other widths.
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
    """Return the arrays of a dense stack: weights in half precision and biases in float32."""
    arrays: dict[str, np.ndarray] = {}
    for number, layer in enumerate(linear_layers(stack)):
        arrays[f"{part}_w{number}"] = layer.weight.detach().numpy().astype(np.float16)
        arrays[f"{part}_b{number}"] = layer.bias.detach().numpy().astype(np.float32)
    return arrays


class AttentionLayer(nn.Module):
    """Attention with an optional bias, followed by two dense layers. Both parts start with layer normalisation."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.first, self.second = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.up, self.down = nn.Linear(width, 2 * width), nn.Linear(2 * width, width)

    def forward(self, x: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
        """Map (B, N, d) to (B, N, d). The bias is added to the scores (B, heads, N, N)."""
        q, k, v = (split_heads(part, self.heads) for part in self.qkv(self.first(x)).chunk(3, -1))
        x = x + self.out(attention(q, k, v, bias))
        return x + self.down(self.up(self.second(x)).relu())


def split_heads(x: torch.Tensor, heads: int) -> torch.Tensor:
    """Split features (B, N, d) into attention heads (B, heads, N, d / heads)."""
    return x.unflatten(-1, (heads, -1)).transpose(1, 2)


def attention(q: torch.Tensor, k: torch.Tensor, v: torch.Tensor, bias: torch.Tensor | None = None) -> torch.Tensor:
    """Return attention values (B, N, d) for queries, keys and values (B, heads, N, d / heads)."""
    if bias is None:
        return nn.functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(-2)
    scores = q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5 + bias
    return (scores.softmax(-1) @ v).transpose(1, 2).flatten(-2)
