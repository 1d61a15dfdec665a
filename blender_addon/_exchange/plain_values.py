"""Values in the types that JSON has."""

from __future__ import annotations

import math
from typing import Any


def as_plain(value: Any) -> Any:
    """Return the value in JSON's types: arrays as lists, numbers that are not finite as null, the rest as text."""
    if isinstance(value, dict):
        return {str(key): as_plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # of NumPy or PyTorch, without importing either
        return as_plain(value.tolist())
    if isinstance(value, list | tuple):
        return [as_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
