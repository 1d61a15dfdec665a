"""What nearly all labels of a recording begin or end with, which is no part of their names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

SHARED = 0.8
"""Share of labels that a prefix without a separator begins, at least: some points are a stick's or a box's."""
LONGEST = 30
"""Characters of such a prefix or suffix, at most."""


@dataclass(frozen=True)
class Affixes:
    """What stands before and after the names: ``p`` of ``pRightASI``, ``_study`` of ``r.ASIS_study``."""

    prefix: str = ""
    suffix: str = ""

    def bare(self, label: str) -> str:
        """Return a label without its subject, prefix and suffix."""
        return bare_label(label).removeprefix(self.prefix).removesuffix(self.suffix)


def bare_label(label: str) -> str:
    """Return a label without its subject."""
    return label.rpartition(":")[2].strip()


def prefixes(bare: Sequence[str]) -> Iterator[Affixes]:
    """Yield what may be a prefix that nearly all labels share, the shortest first."""
    yield from map(Affixes, _shared(bare))


def suffixes(bare: Sequence[str]) -> Iterator[Affixes]:
    """Yield what may be a suffix that nearly all labels share, the shortest first."""
    for reverse in _shared([label[::-1] for label in bare]):
        yield Affixes(suffix=reverse[::-1])


def _shared(labels: Sequence[str]) -> list[str]:
    counts = Counter(label[:length] for label in labels for length in range(1, min(len(label) - 1, LONGEST) + 1))
    least = max(2.0, SHARED * len(labels))
    return sorted((prefix for prefix, count in counts.items() if count >= least), key=len)
