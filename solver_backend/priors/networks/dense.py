"""Stacks of dense layers with a smooth activation, forward and with their derivative."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.geometry.arrays import Array, array_namespace, constant, times_transposed

ACTIVATIONS = ("silu", "elu", "leaky_relu")
"""Names of the activations: ``x sigmoid(x)``; ``x`` or ``exp(x) - 1``; ``x`` or ``0.01 x``."""
LEAK = 0.01  # Slope of LeakyReLU below zero, torch's default, which training uses.


@dataclass(frozen=True)
class DenseStack:
    """``x -> W_n a(... a(W_1 x + b_1) ...) + b_n``; an activation after the last layer only if asked for."""

    weights: tuple[Array, ...]  # (out, in) each.
    biases: tuple[Array, ...]  # (out,) each.
    activation: str
    activate_last: bool = False

    def __post_init__(self) -> None:
        if self.activation not in ACTIVATIONS:
            raise WeightsInvalid(f"Unknown activation {self.activation!r} (known: {', '.join(ACTIVATIONS)}).")

    @property
    def widths(self) -> tuple[int, ...]:
        """Sizes of the input, the hidden layers and the output."""
        return (int(self.weights[0].shape[1]), *(int(w.shape[0]) for w in self.weights))

    def like(self, x: Array) -> DenseStack:
        """Return the stack in the kind, type and device of ``x``."""
        weights = tuple(constant(np.asarray(w), x) for w in self.weights)
        biases = tuple(constant(np.asarray(b), x) for b in self.biases)
        return DenseStack(weights, biases, self.activation, self.activate_last)

    def _is_active(self, number: int) -> bool:
        return self.activate_last or number < len(self.weights) - 1

    def __call__(self, x: Array) -> Array:
        """(N, in) -> (N, out)."""
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = times_transposed(x, weight) + bias
            if self._is_active(number):
                x = activate(x, self.activation)[0]
        return x

    def with_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Return the output (N, out) and its derivative, transposed: (N, in, out).

        Forward mode: ``J_1 = a'(h_1) W_1`` and ``J_k = a'(h_k) (W_k J_{k-1})``, each one product of an
        (N in, width) matrix with the layer's weights.
        """
        xp = array_namespace(x)
        count, width = x.shape
        jacobian = self.weights[0].T
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = times_transposed(x, weight) + bias
            if number > 0:
                flat = xp.reshape(jacobian, (count * width, weight.shape[1]))
                jacobian = xp.reshape(times_transposed(flat, weight), (count, width, weight.shape[0]))
            if self._is_active(number):
                x, slope = activate(x, self.activation)
                jacobian = jacobian * slope[:, None, :]
        return x, jacobian

    def with_vjp(self, x: Array) -> tuple[Array, Callable[[Array], Array]]:
        """Return the output (N, out) and the map of its cotangents (N, out) to those of the input (N, in).

        Reverse mode, ``v -> W_1ᵀ a'(h_1) ... W_nᵀ a'(h_n) v``: one pass costs as much as the forward pass.
        """
        xp = array_namespace(x)
        slopes: list[Array | None] = []
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x, slope = times_transposed(x, weight) + bias, None
            if self._is_active(number):
                x, slope = activate(x, self.activation)
            slopes.append(slope)

        def vjp(cotangent: Array) -> Array:
            for weight, slope in zip(reversed(self.weights), reversed(slopes), strict=True):
                cotangent = xp.matmul(cotangent if slope is None else cotangent * slope, weight)
            return cotangent

        return x, vjp


def activate(x: Array, activation: str) -> tuple[Array, Array]:
    """Return the activation of ``x`` and its derivative."""
    xp = array_namespace(x)
    if activation == "silu":
        gate = 0.5 * (1.0 + xp.tanh(0.5 * x))
        return x * gate, gate * (1.0 + x * (1.0 - gate))
    one = xp.ones_like(x)
    if activation == "elu":
        below = xp.exp(xp.where(x > 0, xp.zeros_like(x), x))
        return xp.where(x > 0, x, below - 1.0), below
    return xp.where(x > 0, x, LEAK * x), xp.where(x > 0, one, LEAK * one)
