"""What all labels of a recording together show: shared affixes, sides glued to the end, the system they are of."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from solver_backend.body.label_words import Affixes, Letters, bare_label, prefixes, spelt, suffixes
from solver_backend.body.marker_layouts import Family, LayoutFile, keys_of, label_key

_AXES = ("OALP", "OXYZ", "OAPL")
_NUMBERED = re.compile(r"(?P<stem>[A-Za-z]*[ ._-]?)(?P<number>\d{1,3})")
MOST_READ = 10_000
"""Names whose places are kept, about a megabyte: recordings of a session have the same."""
COUNTED, LAST_VERTEBRA = 8, 12
"""Names of one stem with a number that show somebody counted, where one is beyond the last vertebra of any kind."""


@dataclass(frozen=True)
class LabelContext:
    """How the labels of one recording are to be read."""

    file: LayoutFile
    affixes: Affixes
    """What nearly all of them begin and end with."""
    letters: Letters
    """Side by the letter that stands for it."""
    glued: dict[str, tuple[str, str]]
    """Side and name by each label whose last letter is a side."""
    families: tuple[Family, ...]
    computed: frozenset[str]
    """Names of axes that stand beside their origin: ``PELVISA`` beside ``PELVISO``."""

    numbered: frozenset[str]
    """Names that a program counted through, ``T1`` to ``T41``: none of them is a vertebra."""

    def places_of(self, label: str) -> tuple[str, ...]:
        """Return the places that a label names; several where it may be either, none where it names none."""
        bare = self.affixes.bare(label)
        if bare in self.numbered:
            return ()
        for key in keys_of(bare):
            found = next((family.names[key] for family in self.families if key in family.names), None)
            if found or (found := self.file.names.get(key)):
                return (found,)
        if bare in self.glued:
            side, stem = self.glued[bare]
            bare = f"{'LEFT' if side == 'L' else 'RIGHT'} {stem}"
        return _by_side(self.file, bare, self.letters)

    def is_exact(self, label: str) -> bool:
        """Return whether a label is one of the names that the layouts list."""
        return any(key in self.file.names for key in keys_of(self.affixes.bare(label)))

    def is_virtual(self, label: str) -> bool:
        """Return whether a label is that of a computed point."""
        bare = self.affixes.bare(label)
        keys = set(keys_of(bare))
        if any(keys & family.virtual for family in self.families):
            return True
        return not self.places_of(label) and (label_key(bare) in self.computed or self.file.is_virtual(bare))


def context_of(labels: Sequence[str], file: LayoutFile, least: int) -> LabelContext:
    """Return how a recording's labels are to be read.

    Args:
        labels: of the points that somebody named.
        file: of the layouts.
        least: labels that a prefix or suffix must make known before it is taken for one.
    """
    bare = tuple(dict.fromkeys(map(bare_label, labels)))
    best = _context(bare, file, Affixes())
    known = _count(best, bare)
    most = max(2 * known, known + least - 1, least - 1)
    for affixes in (*prefixes(bare), *suffixes(bare)):
        context = _context(bare, file, affixes)
        if (count := _count(context, bare)) > most:
            best, most = context, count
    return best


def _context(bare: Sequence[str], file: LayoutFile, affixes: Affixes) -> LabelContext:
    names = [affixes.bare(label) for label in bare]
    keys = frozenset(key for name in names for key in keys_of(name))
    letters = max(file.words.sides.letters, key=lambda pair: _sided(file, names, pair))  # the first of equals
    families = tuple(family for family in file.families.values() if family.fits(keys))
    return LabelContext(
        file, affixes, letters, file.words.sides.glued(names, letters), families, _axes_of(keys),
        _counted_through(names),
    )  # fmt: skip


def _sided(file: LayoutFile, names: Iterable[str], letters: Letters) -> int:
    """Return how many names are known with these letters for sides, 0 unless both sides are among them."""
    sides = Counter(place[0] for name in names for place in _by_side(file, name, letters)[:1])
    return min(sides["L"], sides["R"]) and sides["L"] + sides["R"]


def _by_side(file: LayoutFile, name: str, letters: Letters) -> tuple[str, ...]:
    """Return the places of a name by its words, or by a listed name beside a side that stands apart."""
    known = file.places_read
    if (name, letters) not in known:
        if len(known) >= MOST_READ:
            known.clear()
        known[name, letters] = _read(file, name, letters)
    return known[name, letters]


def _read(file: LayoutFile, name: str, letters: Letters) -> tuple[str, ...]:
    if parted := file.words.sides.apart(spelt(name), letters):
        side, stem = parted
        if found := file.names.get(side + label_key(stem)):
            return (found,)
    return file.words.places_of(name, letters)


def _count(context: LabelContext, labels: Iterable[str]) -> int:
    found = [context.places_of(label) for label in labels]
    return len({places[0] for places in found if len(places) == 1})


def _counted_through(names: Iterable[str]) -> frozenset[str]:
    """Return the names that differ in a number alone which goes beyond what a body counts."""
    numbers: dict[str, dict[str, int]] = {}
    for name in names:
        if found := _NUMBERED.fullmatch(name):
            numbers.setdefault(found["stem"], {})[name] = int(found["number"])
    series = (named for named in numbers.values() if len(named) >= COUNTED and max(named.values()) > LAST_VERTEBRA)
    return frozenset(name for named in series for name in named)


def _axes_of(keys: frozenset[str]) -> frozenset[str]:
    """Return the names of origins and axes that stand together: four names that differ in their last letter."""
    stems = {key[:-1] for key in keys if key.endswith("O")}
    return frozenset(
        stem + letter
        for stem in stems
        for axes in _AXES
        if all(stem + axis in keys for axis in axes)
        for letter in axes
    )
