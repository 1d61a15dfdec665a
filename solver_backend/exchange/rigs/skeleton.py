"""A skeleton as recognition sees it: a tree of places, whatever its bones are called."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np


class Skeleton:
    """Bones with heads at rest, in any unit and axes.

    Args:
        heads: (3,) place of each bone's head.
        parents: name of each bone's parent; roots have none.
    """

    def __init__(self, heads: Mapping[str, Sequence[float] | np.ndarray], parents: Mapping[str, str]) -> None:
        self.names = tuple(heads)
        self.heads = np.array([heads[name] for name in self.names], np.float64).reshape(-1, 3)
        index = {name: i for i, name in enumerate(self.names)}
        self.parents = [index.get(parents[name], -1) if name in parents else -1 for name in self.names]
        self.children: list[list[int]] = [[] for _ in self.names]
        for bone, parent in enumerate(self.parents):
            if parent >= 0:
                self.children[parent].append(bone)
        self.size = float(np.ptp(self.heads, axis=0).max()) if len(self.names) else 0.0
        self.reach = np.zeros(len(self.names))
        """(N,) length of the longest way down from each bone."""
        self.counts = np.ones(len(self.names), dtype=int)
        """(N,) bones at and below each bone."""
        for bone in reversed(self._from_roots()):
            below = self.children[bone]
            self.counts[bone] += sum(self.counts[child] for child in below)
            self.reach[bone] = max((self.reach[child] + self.distance(bone, child) for child in below), default=0.0)

    def distance(self, a: int, b: int) -> float:
        """Return the distance of two heads."""
        return math.dist(self.heads[a], self.heads[b])

    def main_path(self, bone: int) -> list[int]:
        """Return the longest way down, from a bone on."""
        path = [bone]
        while self.children[path[-1]]:
            path.append(max(self.children[path[-1]], key=lambda c: self.reach[c] + self.distance(path[-1], c)))
        return path

    def above(self, bone: int) -> list[int]:
        """Return a bone and all that it hangs on, the root last."""
        line = [bone]
        while self.parents[line[-1]] >= 0:
            line.append(self.parents[line[-1]])
        return line

    def below(self, bone: int) -> list[int]:
        """Return a bone and all that hang on it."""
        found = [bone]
        for one in found:
            found.extend(self.children[one])
        return found

    def pairs(self) -> list[tuple[int, int]]:
        """Return the branches that are alike: of one parent, equally long and as rich, at places apart."""
        found = []
        for children in self.children:
            for i, a in enumerate(children):
                for b in children[i + 1 :]:
                    reach = max(self.reach[a], self.reach[b])
                    alike = abs(self.reach[a] - self.reach[b]) < _ALIKE * reach and self._equally_far(a, b)
                    if alike and abs(self.counts[a] - self.counts[b]) <= _ALIKE_COUNT * max(self.counts[a], 4):
                        found.append((a, b))
        return found

    def _equally_far(self, a: int, b: int) -> bool:
        parent = self.parents[a]
        return abs(self.distance(a, parent) - self.distance(b, parent)) < _ALIKE * self.size

    def _from_roots(self) -> list[int]:
        order = [bone for bone, parent in enumerate(self.parents) if parent < 0]
        for bone in order:
            order.extend(self.children[bone])
        return order


_ALIKE = 0.06
"""Relative difference of the two sides of a figure: captured skeletons differ by 2 to 3 %."""
_ALIKE_COUNT = 0.25
"""The same of the numbers of their bones: one hand may hold a prop."""
