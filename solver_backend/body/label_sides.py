"""The side that a label names: by a word or letter of several languages, in front, at the end, apart or glued."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

Letters = tuple[tuple[str, str], tuple[str, str]]
"""The letters of one language for left and right, each with the side: ``(("G", "L"), ("D", "R"))``."""
ENGLISH: Letters = (("L", "L"), ("R", "R"))
LEAST_GLUED = 3
"""Pairs by which an ending shows that it is a side's; then a label without its other side has it too."""
_APART = tuple(
    re.compile(pattern)
    for pattern in (
        r"(?P<side>[A-Za-z]+)[ ._-]+(?P<rest>.+)",
        r"(?P<rest>.+?)[ ._-]+(?P<side>[A-Za-z]+)\.?",
        r"(?P<side>[A-Z]?[a-z]{1,})(?P<rest>[A-Z0-9].*)",
        r"(?P<rest>.*[a-z0-9])(?P<side>[A-Z][a-z]+)",
    )
)


@dataclass(frozen=True)
class Sides:
    """What the file of layouts states of sides."""

    words: dict[str, str]
    """L or R by each word for a side, in capitals, wherever it stands."""
    short: tuple[tuple[str, str], ...]
    """Pairs of short words for left and right, which are sides only where they stand apart or last: li and re."""
    letters: tuple[Letters, ...]
    """Pairs of letters, one language each, English first."""

    def by_token(self, letters: Letters = ENGLISH) -> dict[str, str]:
        """Return the side by each word that is one where it stands apart."""
        short = {word: side for pair in self.short for word, side in zip(pair, "LR", strict=True)}
        return short | self.words | dict(letters)

    def apart(self, label: str, letters: Letters) -> tuple[str, str] | None:
        """Return the side that stands apart before or after a name, and the name: ``M5_G``, ``liM5``; None without."""
        by_token = self.by_token(letters)
        for pattern in _APART:
            found = pattern.fullmatch(label)
            side = by_token.get(found["side"].upper(), "") if found else ""
            if found and side:
                return side, found["rest"]
        return None

    def glued(self, names: Sequence[str], letters: Letters) -> dict[str, tuple[str, str]]:
        """Return side and name of the labels that end in a side: ``ASISr``, ``KNIEli``.

        One ending alone is not enough (``HEEL``, ``ARMl`` for the lateral marker beside ARMm): the other side's label
        has to be there, and none that ends in m instead; or ``LEAST_GLUED`` pairs show what the ending is.
        """
        there, found = set(names), dict[str, tuple[str, str]]()
        shown: Counter[str] = Counter()
        single: list[tuple[str, str, str, str]] = []
        for name, (ending, other, side) in product(names, self._endings(letters)):
            stem = name[: -len(ending)]
            if not name.endswith(ending) or len(stem) < 2 or stem + ("m" if ending.islower() else "M") in there:
                continue
            if stem + other in there:
                found[name] = (side, stem.rstrip(" _.-"))
                shown[ending] += 1
            else:
                single.append((name, ending, side, stem.rstrip(" _.-")))
        for name, ending, side, stem in single:
            if shown[ending] >= LEAST_GLUED and name not in found:
                found[name] = (side, stem)
        return found

    def _endings(self, letters: Letters) -> Iterator[tuple[str, str, str]]:
        """Yield each ending with the other side's and its own side, short words before letters."""
        for left, right in (*self.short, (letters[0][0], letters[1][0])):
            for one, other, side in ((left, right, "L"), (right, left, "R")):
                for spell in (str.upper, str.lower):
                    yield spell(one), spell(other), side


def sides_of_file(values: dict[str, Any]) -> Sides:
    """Return the sides of a file's sections ``sides``, ``short_sides`` and ``side_letters``."""
    return Sides(
        {word: side for side, words in values["sides"].items() for word in words},
        tuple((left, right) for left, right in values["short_sides"]),
        tuple(((left, "L"), (right, "R")) for left, right in values["side_letters"]),
    )
