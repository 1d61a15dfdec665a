"""Attention layers read in NumPy, float32, by the names of the trained modules' parameters (``attention_layers``)."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.arrays import times_transposed

Arrays = dict[str, np.ndarray]  # Parameters by name.
_EPSILON = np.float32(1e-5)  # Keeps a root mean square from zero, as the training has it.


def layer(arrays: Arrays, x: np.ndarray, name: str, heads: int, bias: np.ndarray | None = None) -> np.ndarray:
    """Return (B, N, d) features after attention among them and two dense layers, normalised before each.

    ``x + W_o softmax(Q Kᵀ / √d_h + B) V``, then ``x + W_2 relu(W_1 x)`` (Vaswani et al. 2017, with the norm first).

    Args:
        arrays: parameters.
        x: (B, N, d).
        name: prefix of the layer's parameters.
        heads: d_h = d / heads.
        bias: (B, heads, N, N) added to the scores; none if None.
    """
    qkv = dense(arrays, layer_norm(arrays, x, name + "first"), name + "qkv")
    q, k, v = (split_heads(part, heads) for part in np.split(qkv, 3, axis=-1))
    x = x + dense(arrays, attention(q, k, v, bias), name + "out")
    inner = dense(arrays, layer_norm(arrays, x, name + "second"), name + "up")
    np.maximum(inner, 0.0, out=inner)
    return x + dense(arrays, inner, name + "down")


def dense(arrays: Arrays, x: np.ndarray, name: str) -> np.ndarray:
    """Return ``W x + b`` of the last axis; without b where there is none."""
    product = times_transposed(x.reshape(-1, x.shape[-1]), arrays[name + ".weight"])
    bias = arrays.get(name + ".bias")
    if bias is not None:
        product += bias
    return product.reshape(*x.shape[:-1], -1)


def layer_norm(arrays: Arrays, x: np.ndarray, name: str) -> np.ndarray:
    """Return the last axis without its mean, by its deviation, scaled and shifted."""
    x = x - x.mean(-1, keepdims=True)
    scale = np.sqrt(np.einsum("...d,...d->...", x, x)[..., None] / x.shape[-1] + _EPSILON)
    x /= scale
    x *= arrays[name + ".weight"]
    x += arrays[name + ".bias"]
    return x


def attention(q: np.ndarray, k: np.ndarray, v: np.ndarray, bias: np.ndarray | None = None) -> np.ndarray:
    """Return the (B, N, d) values that each of N queries attends to; all are (B, heads, N, d_h)."""
    scores = q @ np.swapaxes(k, -1, -2)
    scores *= np.float32(q.shape[-1] ** -0.5)
    if bias is not None:
        scores += bias
    out = softmax(scores) @ v
    return np.swapaxes(out, 1, 2).reshape(len(out), out.shape[2], -1)


def split_heads(x: np.ndarray, heads: int) -> np.ndarray:
    """Return (B, heads, N, d_h) of (B, N, d)."""
    return np.swapaxes(x.reshape(*x.shape[:2], heads, -1), 1, 2)


def softmax(x: np.ndarray) -> np.ndarray:
    """Return the softmax of the last axis; overwrites what it is given."""
    x -= x.max(-1, keepdims=True)
    np.exp(x, out=x)
    x /= x.sum(-1, keepdims=True)
    return x
