"""What a detector's process sends: a line of JSON, and the arrays that it announces; checked before it is believed."""

from __future__ import annotations

import json
import math
from typing import IO, Any

import numpy as np

_LARGEST_HEAD, _LARGEST_ANSWER = 1 << 20, 1 << 24
_MOST_ARRAYS = 32
"""Arrays that a detector's answer may hold; chosen by hand."""


def read_head(stream: IO[bytes]) -> dict[str, Any]:
    """Return the object of the next line.

    Raises:
        ValueError: the line is longer than a MiB, cut off, or no JSON object.
    """
    line = stream.readline(_LARGEST_HEAD)
    try:
        head = json.loads(line)
    except RecursionError as error:
        raise ValueError("the line is nested too deeply") from error
    if not isinstance(head, dict):
        raise ValueError("the line is not an object")
    return head


def read_arrays(head: dict[str, Any], stream: IO[bytes]) -> dict[str, np.ndarray]:
    """Return the arrays that a line announces in ``arrays``: their shapes by name; the bytes are little-endian float32.

    Raises:
        ValueError: it announces none, too many or too large ones, or their bytes are cut off.
    """
    shapes = head.get("arrays")
    if not isinstance(shapes, dict) or len(shapes) > _MOST_ARRAYS:
        raise ValueError("the line announces no arrays")
    return {name: _array(shape, stream) for name, shape in shapes.items()}


def _array(shape: Any, stream: IO[bytes]) -> np.ndarray:
    if not isinstance(shape, list) or not all(type(n) is int and 0 <= n < 1 << 24 for n in shape) or len(shape) > 8:
        raise ValueError(f"{str(shape)[:60]} is not a shape")
    size = 4 * math.prod(shape)
    if size > _LARGEST_ANSWER or len(data := stream.read(size)) < size:
        raise ValueError("an array is too large or cut off")
    return np.frombuffer(data, "<f4").reshape(shape).astype(np.float64)
