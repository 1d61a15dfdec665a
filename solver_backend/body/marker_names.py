"""Match the marker labels in a recording to locations on the body."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from solver_backend.body.joint_names import joint_centre_places
from solver_backend.body.label_words import Affixes, LabelWords, Letters, bare_label, prefixes, spelt, suffixes
from solver_backend.body.marker_layouts import Family, LayoutFile, keys_of, label_key, load_layouts
from solver_backend.geometry.arrays import quantile
from solver_backend.types import MarkerCloud

_ARM, _LEG = ("elbow", "wrist", "hand"), ("knee", "ankle", "foot")
_LIMBS = dict.fromkeys(_ARM, "arm") | dict.fromkeys(_LEG, "leg")
_WAIST = ("FWT", "MWT")  # Pelvis locations where the skin moves with the hips.


def chosen_places(ambiguous: Mapping[str, tuple[str, ...]], known: Collection[str], file: LayoutFile) -> dict[str, str]:
    """Choose the location of each ambiguous label, and omit labels without a clear choice.

    Locations that another label has are excluded. If several remain, the location must be on an arm or leg that also
    has other labels. ``LateralEpicondyleL`` belongs to the elbow if only arms have markers, or if the knee has another
    label.
    """
    limbs = {limb for place in known if (limb := limb_of(place, file))}
    found: dict[str, str] = {}
    for label, places in ambiguous.items():
        free = [place for place in places if place not in known]
        left = [place for place in free if limb_of(place, file) in limbs] if len(free) > 1 else free
        if len(left) == 1:
            found[label] = left[0]
    return found


def of_one_limb(places: Collection[str], file: LayoutFile) -> bool:
    """Return whether all locations are on one arm including its shoulder, or on one leg."""
    rules = [file.sided.get(place[1:]) for place in places]
    joints = {
        "" if rule is None or place[1:] in _WAIST else str(rule["joint"])
        for place, rule in zip(places, rules, strict=True)
    }
    one_side = len({place[:1] for place in places}) == 1
    return one_side and any(joints and joints <= limb for limb in ({*_ARM, "shoulder"}, {*_LEG, "hip"}))


def limb_of(place: str, file: LayoutFile) -> str:
    """Return arm or leg for a sided location below the shoulder or hip, otherwise empty text."""
    rule = file.sided.get(place[1:]) if place[:1] in ("L", "R") else None
    return "" if rule is None else _LIMBS.get(rule["joint"], "")


_AXES = ("OALP", "OXYZ", "OAPL")
_NUMBERED = re.compile(r"(?P<stem>[A-Za-z]*[ ._-]?)(?P<number>\d{1,3})")
MOST_READ = 10_000  # Number of cached names, about a megabyte. Recordings from the same session share names.
COUNTED, LAST_VERTEBRA = 8, 12  # Smallest number of numbered names with one stem, and a number beyond any vertebra.


@dataclass(frozen=True)
class LabelContext:
    """Rules for reading the labels of one recording: side letters, affixes and naming systems."""

    file: LayoutFile
    affixes: Affixes  # Prefix and suffix shared by nearly all labels.
    letters: Letters  # Letters that mean sides.
    glued: dict[str, tuple[str, str]]  # Side and name of each label whose last letter is a side.
    families: tuple[Family, ...]
    computed: frozenset[str]  # Names of axes with their origin: ``PELVISA`` with ``PELVISO``.

    numbered: frozenset[str]  # Names that a program numbered consecutively, ``T1`` to ``T41``. None is a vertebra.

    def places_of(self, label: str) -> tuple[str, ...]:
        """Return the locations that a label may name. There are several if the label is ambiguous."""
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
        """Return whether a label is itself a name in the layouts."""
        return any(key in self.file.names for key in keys_of(self.affixes.bare(label)))

    def is_virtual(self, label: str) -> bool:
        """Return whether a label names a point that a program computed, such as a joint centre."""
        bare = self.affixes.bare(label)
        keys = set(keys_of(bare))
        if any(keys & family.virtual for family in self.families):
            return True
        return not self.places_of(label) and (label_key(bare) in self.computed or self.file.is_virtual(bare))


def context_of(labels: Sequence[str], file: LayoutFile, least: int) -> LabelContext:
    """Find the rules for reading a recording's labels.

    A prefix or suffix is removed if this more than doubles the number of recognised labels, and recognises at least
    ``least`` more.
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
    letters = max(file.words.sides.letters, key=lambda pair: _sided(file, names, pair))  # of equals, the first wins
    families = tuple(family for family in file.families.values() if family.fits(keys))
    glued, numbered = file.words.sides.glued(names, letters), _counted_through(names)
    return LabelContext(file, affixes, letters, glued, families, _axes_of(keys), numbered)


def _sided(file: LayoutFile, names: Iterable[str], letters: Letters) -> int:
    """Count the names that are recognised with the given side letters. Return 0 if only one side occurs."""
    sides = Counter(place[0] for name in names for place in _by_side(file, name, letters)[:1])
    return min(sides["L"], sides["R"]) and sides["L"] + sides["R"]


def _by_side(file: LayoutFile, name: str, letters: Letters) -> tuple[str, ...]:
    """Return the locations of a name, read with the given side letters. Results are cached."""
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
    """Return the names in numbered series with more numbers than there are vertebrae, such as ``T1`` to ``T41``."""
    numbers: dict[str, dict[str, int]] = {}
    for name in names:
        if found := _NUMBERED.fullmatch(name):
            numbers.setdefault(found["stem"], {})[name] = int(found["number"])
    series = (named for named in numbers.values() if len(named) >= COUNTED and max(named.values()) > LAST_VERTEBRA)
    return frozenset(name for named in series for name in named)


def _axes_of(keys: frozenset[str]) -> frozenset[str]:
    """Return the names of computed axes and their origins: groups of four names that differ in their last letter."""
    stems = {key[:-1] for key in keys if key.endswith("O")}
    found = [(stem, axes) for stem in stems for axes in _AXES if keys.issuperset(stem + axis for axis in axes)]
    return frozenset(stem + axis for stem, axes in found for axis in axes)


# Vicon writes *0, *1, ...; Motive 'Unlabeled 1189', 'Unlabeled:2012' or 'Unlabeled_7'; Cortex U_1; Qualisys unnames;
# other programs number their points.
_WORDS = r"(unlabell?ed|unnamed|unidentified|unlabel|uname|unbenannt|sans ?nom)"
_UNNAMED = re.compile(
    rf"(\*\d*|#\d*|u_?\d+|new ?\d{{4}}|[*#]?{_WORDS}[\s:_*#.-]*((marker|point|trajectory)[\s:_*#.-]*)?\d*)( \(\d+\))?",
    re.IGNORECASE,
)
LEAST_MARKERS = 8  # Fewer do not determine a person: a body needs six, and some may be hidden.
LEAST_LIMB_MARKERS = 6  # The same for a single arm or leg. A leg in Plug-in Gait has six markers.
LEAST_NETWORK_PLACES = 20  # Fewest markers that the labelling network must name. Otherwise it labels none.


@dataclass(frozen=True)
class MarkerNames:
    """Body locations of a recording's labels, and the labels without a location."""

    known: dict[str, str]  # Location on the body by label.
    unknown: tuple[str, ...]
    virtual: tuple[str, ...]  # Labels of computed points (joint centres, segment axes), or excluded by the user.
    doubled: tuple[str, ...]  # Labels whose location another label already has.
    ambiguous: dict[str, tuple[str, ...]] = field(default_factory=dict)  # Possible locations of ambiguous labels.
    affixes: Affixes = field(default_factory=Affixes)  # Prefix and suffix shared by nearly all labels.


def least_markers(places: Collection[str]) -> int:
    """Return the number of markers that a solve needs, fewer for a single arm or leg."""
    return LEAST_LIMB_MARKERS if of_one_limb(places, load_layouts()) else LEAST_MARKERS


def is_unnamed(label: str) -> bool:
    """Return whether a label is only a number or word that a program gives to unnamed points."""
    name = label.rpartition(":")[2].strip()
    return not name or any(_UNNAMED.fullmatch(text) is not None for text in (name, label.strip()))


def name_markers(labels: Sequence[str], own: Mapping[str, str] = MappingProxyType({})) -> MarkerNames:
    """Find the body locations of a recording's labels.

    If several labels name the same location, one that the layouts list is preferred. The labels of a skeleton's joint
    centres are recognised together (see ``joint_centre_places``).

    Args:
        own: maps labels to user-defined locations, which always win: a name in the layouts, ``@`` and a bone's joint
          (several labels may share it), or empty text to exclude the label.
    """
    found = _named(tuple(labels), tuple(own.items()))
    return replace(found, known=dict(found.known), ambiguous=dict(found.ambiguous))


@lru_cache(maxsize=64)
def _named(labels: tuple[str, ...], given: tuple[tuple[str, str], ...]) -> MarkerNames:
    """Return the cached result of ``name_markers``. Callers must not modify it."""
    own = {**joint_centre_places(labels), **dict(given)}
    file = load_layouts()
    context = context_of(labels, file, LEAST_MARKERS)
    meant = {label: () if label in own else context.places_of(label) for label in labels}
    several = {label: found for label, found in meant.items() if len(found) > 1}
    sure = {*own.values(), *(found[0] for found in meant.values() if len(found) == 1)}
    meant |= {label: (place,) for label, place in chosen_places(several, sure, file).items()}
    virtual = {
        label: own.get(label) == "" or (label not in own and context.is_virtual(label))
        for label in dict.fromkeys(labels)
    }
    places = {
        label: own[label] or None if label in own else found[0] if len(found) == 1 and not virtual[label] else None
        for label, found in meant.items()
    }
    # In order of reliability: user-defined, names in the layouts, words.
    order = sorted(places, key=lambda label: 0 if label in own else 2 - context.is_exact(label))
    first = {place: label for label in reversed(order) if (place := places[label]) is not None and place[0] != "@"}
    known = {label: place for label, place in places.items() if place is not None and first.get(place, label) == label}
    return MarkerNames(
        known=known,
        unknown=tuple(label for label, place in places.items() if place is None and not virtual[label]),
        virtual=tuple(label for label in places if virtual[label]),
        doubled=tuple(label for label, place in places.items() if place is not None and label not in known),
        ambiguous={label: found for label, found in meant.items() if len(found) > 1},
        affixes=context.affixes,
    )


# First joint of the bone that a word names, without side.
_SEGMENT_LIMBS = dict.fromkeys(("ARM", "UPPERARM", "HUMERUS"), "shoulder") | {"FOREARM": "elbow", "HAND": "wrist"}
_SEGMENT_LIMBS |= {"THIGH": "hip", "FEMUR": "hip", "SHANK": "knee", "TIBIA": "knee", "FOOT": "ankle"}
_MIDLINE = {"HEAD": "head", "PELVIS": "pelvis", "SACRUM": "pelvis"}
_PLACES = frozenset({"KNEE", "ANKLE", "MALLEOLUS", "ELBOW", "WRIST", "EPICONDYLE", "STYLOID", "ACROMION", "SHOULDER"})
"""Words for joints. A label that contains one of them does not name a bone, even with a word for a bone."""


def named_bone(label: str) -> str | None:
    """Return the joint where a bone starts, such as ``left_knee``. The label or its subject name describes the bone.

    Return None if neither describes a bone.
    """
    words = load_layouts().words
    prefix = label.rpartition(":")[0]
    return _bone(bare_label(label), words) or (_bone(prefix, words) if prefix else None)


def _bone(text: str, words: LabelWords) -> str | None:
    side, found = words.known_in(text)
    if found & _PLACES:
        return None
    limbs = {joint for word in found if (joint := _SEGMENT_LIMBS.get(word))}
    middle = {joint for word in found if (joint := _MIDLINE.get(word))}
    if len(limbs) + len(middle) != 1 or (limbs and not side):
        return None
    return f"{'left' if side == 'L' else 'right'}_{limbs.pop()}" if limbs else middle.pop()


LEAST_LABELS = 2  # Smallest number of labels without a side that name a limb.
BESIDE_M = 0.05  # Distance in metres between the limb's markers and the median plane. An acromion is at 0.17.
_TWINS = {("l", "m"): ("lat", "med"), ("r", "u"): ("radius", "ulna")}  # Endings as in ``EPICl`` and ``EPICm``.


def places_by_side(cloud: MarkerCloud, own: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Find the side of arm and leg labels that do not state a side, and map them to locations.

    Left and right markers with known locations, such as both ASIS, define the median plane. The result is empty if
    there is no such pair, if the markers are not all clearly on one side of the plane, or if fewer than
    ``LEAST_LABELS`` labels lack a side. Labels of arms are ignored if another arm label states its side. The same
    applies to legs.

    Args:
        own: maps labels to user-defined locations, which always win.
    """
    labels = [label for label in cloud.labels or () if not is_unnamed(label)]
    names = name_markers(labels, own)
    bare = {label: names.affixes.bare(label) for label in (*names.unknown, *names.doubled)}
    parts = _parts(bare)
    label_of = {place: label for label, place in reversed(names.known.items()) if place[0] in "LR"}
    lefts = [(label, place) for label, place in names.known.items() if place[0] == "L"]
    pairs = [(label, label_of[other]) for label, place in lefts if (other := "R" + place[1:]) in label_of]
    sided = {limb_of(place, load_layouts()) for place in names.known.values()}
    parts = {label: part for label, part in parts.items() if limb_of("L" + part, load_layouts()) not in sided - {""}}
    if len(parts) < LEAST_LABELS or not pairs:
        return {}
    off = _to_the_left(cloud, pairs, list(parts))
    if not np.isfinite(off).all() or (abs(off) < BESIDE_M).any() or len(set(np.sign(off))) > 1:
        return {}
    side = "L" if off[0] > 0 else "R"
    taken = set(names.known.values())
    return {label: side + part for label, part in parts.items() if side + part not in taken}


def _parts(bare: Mapping[str, str]) -> dict[str, str]:
    """Return the location, without side, of each label that has only one possible location.

    If a label has several possible locations, only those on an arm or leg with an unambiguous label count.
    """
    words, there = load_layouts().words, set(bare.values())
    several: dict[str, tuple[str, ...]] = {}
    for label, name in bare.items():
        found = words.without_side(name)
        for endings, meant in _TWINS.items():
            if name[-1:] in endings and {name[:-1] + ending for ending in endings} <= there:
                found = words.without_side(f"{name[:-1]} {meant[endings.index(name[-1])]}")
        if found:
            several[label] = found
    limbs = {limb_of("L" + parts[0], load_layouts()) for parts in several.values() if len(parts) == 1} - {""}
    chosen: dict[str, str] = {}
    for label, parts in several.items():
        left = parts if len(parts) == 1 else [part for part in parts if limb_of("L" + part, load_layouts()) in limbs]
        if len(left) == 1 and left[0] not in chosen.values():
            chosen[label] = left[0]
    return chosen


def _to_the_left(cloud: MarkerCloud, pairs: Sequence[tuple[str, str]], labels: Sequence[str]) -> np.ndarray:
    """Return the median distance in metres of each label to the left of the plane midway between the ``pairs``."""
    column = {label: i for i, label in enumerate(cloud.labels or ())}
    left, right = (cloud.positions[:, [column[pair[side]] for pair in pairs]].mean(axis=1) for side in (0, 1))
    across = (left - right) / np.maximum(np.linalg.norm(left - right, axis=-1, keepdims=True), 1e-9)
    away = cloud.positions[:, [column[label] for label in labels]] - 0.5 * (left + right)[:, None]
    return quantile(np.einsum("fli,fi->fl", away, across), 0.5, axis=0)
