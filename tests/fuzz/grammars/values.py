"""What stands in documents: numbers, words, trees and arrays, as hypothesis makes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

ODDLY = 24  # One of so many values is another than the sound file's.
_SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=8),
    st.sampled_from([0, -1, 1, 2**31, 2**63, 1e308, 1e-308, 1e30, -1e9, "", "nan", "1", "\u0661", "\0", "a/../b", "é"]),
)  # fmt: skip
_TREES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
_NUMBERS = st.one_of(
    st.floats().map(repr),
    st.integers(-(10**25), 10**25).map(str),
    st.sampled_from(
        ["", "-", "+1", "1,5", "1.5e3", "1E400", "-.5", "5.", "0x10", "1_000", "NaN", "inf", "#N/A", '"1"']
    ),
)
_SHAPES = arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)


def _arrays(*kinds: str) -> st.SearchStrategy[Any]:
    return arrays.arrays(st.sampled_from(kinds).map(np.dtype), _SHAPES)


STRATEGIES: dict[str, st.SearchStrategy[Any]] = {
    "scalar": _SCALARS,
    "tree": _TREES,
    "number": _NUMBERS,
    "float": st.floats(),
    "text": st.text(max_size=12),
    "array": _arrays("<f8", "<f4", "<i4", "<i8", "|b1", "<U5", "|S3", "<f2", ">f8", "<u2"),
    "plain array": _arrays("<f8", "<f4", "<i4", "<i8"),
}
"""By name. Numbers are as tables and texts write them, in several countries' ways."""
