"""Stacks of dense layers with softplus between them, and their derivative in reverse mode."""

from __future__ import annotations

from dataclasses import dataclass

from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, constant

SHARPNESS = 20.0
"""The factor β of ``softplus(x) = log(1 + exp(β x)) / β``."""


@dataclass(frozen=True)
class SoftplusStack:
    """``x -> W_n s(... s(W_1 x + b_1) ...) + b_n``, with a softplus after the last layer too if it must be positive."""

    weights: tuple[Array, ...]
    """(out, in) each."""
    biases: tuple[Array, ...]
    """(out,) each."""
    last_is_positive: bool = False

    def like(self, x: Array) -> SoftplusStack:
        """Return the stack in the kind, type and device of ``x``."""
        weights = tuple(constant(w, x) for w in self.weights)
        return SoftplusStack(weights, tuple(constant(b, x) for b in self.biases), self.last_is_positive)

    def forward(self, x: Array) -> tuple[Array, list[Array]]:
        """Return the output (N, out) and, for ``backward``, the slope of the softplus at every layer that has one."""
        slopes: list[Array] = []
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = array_namespace(x).matmul(x, weight.T) + bias
            if number < len(self.weights) - 1 or self.last_is_positive:
                x, slope = softplus(x)
                slopes.append(slope)
        return x, slopes

    def backward(self, slopes: list[Array], by_output: Array) -> Array:
        """Return the derivative by the input (N, in) from that by the output (N, out)."""
        xp = array_namespace(by_output)
        for number in range(len(self.weights) - 1, -1, -1):
            if number < len(slopes):
                by_output = by_output * slopes[number]
            by_output = xp.matmul(by_output, self.weights[number])
        return by_output


def softplus(x: Array) -> tuple[Array, Array]:
    """Return ``log(1 + exp(β x)) / β`` and its derivative, the sigmoid of ``β x``, without overflow."""
    xp = array_namespace(x)
    scaled = SHARPNESS * x
    magnitude = xp.abs(scaled)
    value = 0.5 * (scaled + magnitude) + xp.log1p(xp.exp(-magnitude))
    return value / SHARPNESS, 0.5 * (1.0 + xp.tanh(0.5 * scaled))
