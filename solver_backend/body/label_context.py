"""What all labels of a recording together show: shared affixes, sides glued to the end, the system they are of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

from solver_backend.body.label_affixes import Affixes, bare_label, prefixes, suffixes
from solver_backend.body.marker_layouts import Family, LayoutFile, keys_of, label_key

_ENGLISH, _FRENCH = (("L", "L"), ("R", "R")), (("G", "L"), ("D", "R"))
_AXES = ("OALP", "OXYZ", "OAPL")


@dataclass(frozen=True)
class LabelContext:
    """How the labels of one recording are to be read."""

    file: LayoutFile
    affixes: Affixes
    """What nearly all of them begin and end with."""
    letters: tuple[tuple[str, str], ...]
    """Side by the letter that stands for it."""
    glued: dict[str, tuple[str, str]]
    """Side and name by each label whose last letter is a side."""
    families: tuple[Family, ...]
    computed: frozenset[str]
    """Names of axes that stand beside their origin: ``PELVISA`` beside ``PELVISO``."""

    def places_of(self, label: str) -> tuple[str, ...]:
        """Return the places that a label names; several where it may be either, none where it names none."""
        bare = self.affixes.bare(label)
        for key in keys_of(bare):
            found = next((family.names[key] for family in self.families if key in family.names), None)
            if found or (found := self.file.names.get(key)):
                return (found,)
        if bare in self.glued:
            side, stem = self.glued[bare]
            found = self.file.names.get(side + label_key(stem))
            return (found,) if found else self.file.words.places_of(f"{side} {stem}")
        return self.file.words.places_of(bare, self.letters)

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
    letters = _ENGLISH if _sided(file, names, _ENGLISH) >= _sided(file, names, _FRENCH) else _FRENCH
    families = tuple(family for family in file.families.values() if family.fits(keys))
    return LabelContext(file, affixes, letters, _glued(names, letters), families, _axes_of(keys))


def _sided(file: LayoutFile, names: Iterable[str], letters: tuple[tuple[str, str], ...]) -> int:
    """Return how many names are known with these letters for sides, 0 unless both sides are among them."""
    sides = Counter(place[0] for name in names for place in file.words.places_of(name, letters)[:1])
    return min(sides["L"], sides["R"]) and sides["L"] + sides["R"]


def _count(context: LabelContext, labels: Iterable[str]) -> int:
    found = [context.places_of(label) for label in labels]
    return len({places[0] for places in found if len(places) == 1})


def _glued(names: Sequence[str], letters: tuple[tuple[str, str], ...]) -> dict[str, tuple[str, str]]:
    """Return side and name of the labels that end in a side's letter.

    One letter alone is not enough (``HEEL``, ``ARMl`` for the lateral marker beside ``ARMm``): the other side's label
    has to be there, and none that ends in m instead.
    """
    there = set(names)
    found: dict[str, tuple[str, str]] = {}
    for name, ((left, _), (right, _)) in product(names, (letters, letters[::-1])):
        last, stem = name[-1:], name[:-1]
        lower = last.islower()
        other = right.lower() if lower else right
        middle = "m" if lower else "M"
        if last.upper() == left and len(stem) > 1 and stem + other in there and stem + middle not in there:
            found[name] = (dict(letters)[left], stem.rstrip(" _.-"))
    return found


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
