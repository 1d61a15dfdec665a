"""Draws for grammars: places and lengths from randomness, values from what hypothesis made in advance.

A draw inside a strategy of hypothesis takes 20 microseconds, and a document has hundreds of places that stay as they
are. So hypothesis makes values by the hundred, and a grammar decides where they go.
"""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any, Protocol, TypeVar

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.grammars.values import ODDLY, STRATEGIES

T = TypeVar("T")
_VALUES = 256
"""Of each kind in a stock."""
_AT_ONCE, _BYTES = 16, 8192  # Values that hypothesis makes in one go, and the bytes of randomness it has for them.
_GOES = 200  # After so many goes a stock that is not full stays as it is.


class _Fuzzed(Protocol):
    fuzz_one_input: Callable[[bytes], bytes | None]


@lru_cache(maxsize=64)
def stock(kind: str, number: int) -> tuple[Any, ...]:
    """Return values of a kind that hypothesis made; the same for a number.

    Args:
        kind: of ``STRATEGIES``.
        number: of the stock.
    """
    rng, found = np.random.default_rng([number, *kind.encode()]), []
    draw = _drawer(kind)
    for _ in range(_GOES):
        if len(found) >= _VALUES:
            break
        draw(rng.bytes(_BYTES), found.extend)
    return tuple(found)


@cache
def _drawer(kind: str) -> Callable[[bytes, Callable[[list[Any]], None]], None]:
    takers: list[Callable[[list[Any]], None]] = []

    @settings(database=None, suppress_health_check=list(HealthCheck), deadline=None)
    @given(st.lists(STRATEGIES[kind], min_size=_AT_ONCE, max_size=_AT_ONCE))
    def make(values: list[Any]) -> None:
        takers[-1](values)

    inner: _Fuzzed = make.hypothesis  # type: ignore[attr-defined]

    def draw(content: bytes, take: Callable[[list[Any]], None]) -> None:
        takers[:] = [take]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            inner.fuzz_one_input(content)

    return draw


class Draw:
    """What a grammar asks: how many, which, and what else."""

    def __init__(self, rng: np.random.Generator, number: int = 0) -> None:
        """Draw from the generator's next bytes and from the stocks of this number."""
        self._random, self._number = random.Random(rng.bytes(8)), number

    def integer(self, low: int, high: int) -> int:
        """Return an integer of a range, both ends included."""
        return self._random.randint(low, high)

    def seldom(self, times: int = ODDLY) -> bool:
        """Return true once in so many times."""
        return self._random.random() * times < 1.0

    def one_of(self, choices: Sequence[T]) -> T:
        """Return one of them."""
        return self._random.choice(choices)

    def value(self, kind: str) -> Any:
        """Return a value that hypothesis made, by a name of ``STRATEGIES``."""
        return self._random.choice(stock(kind, self._number))

    def oddly(self, usual: Any, other: str | Sequence[Any]) -> Any:
        """Return the usual value, seldom one of a kind or one of others."""
        if not self.seldom():
            return usual
        return self.value(other) if isinstance(other, str) else self.one_of(other)

    def content(self, length: int) -> bytes:
        """Return so many bytes."""
        return self._random.randbytes(length)
