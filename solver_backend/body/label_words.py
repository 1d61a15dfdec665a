"""Split marker labels in several languages into a side and words for a body part."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

Letters = tuple[tuple[str, str], tuple[str, str]]  # Left and right letter, with sides: ``(("G", "L"), ("D", "R"))``.
ENGLISH: Letters = (("L", "L"), ("R", "R"))
LEAST_GLUED = 3  # Label pairs that prove that an ending means a side, even for a label without its counterpart.
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
    """Words and letters that mean left or right, from the layouts file."""

    words: dict[str, str]  # L or R for each word that means a side at any position, in capitals.
    short: tuple[tuple[str, str], ...]  # Pairs of short words that mean sides only if separate or last: li and re.
    letters: tuple[Letters, ...]  # Pairs of letters, one pair per language, English first.

    def by_token(self, letters: Letters = ENGLISH) -> dict[str, str]:
        """Map the words and letters for a side, which are separate from the name in a label, to L or R."""
        short = {word: side for pair in self.short for word, side in zip(pair, "LR", strict=True)}
        return short | self.words | dict(letters)

    def apart(self, label: str, letters: Letters) -> tuple[str, str] | None:
        """Split a label such as ``M5_G`` or ``liM5`` into its side (L or R) and its name without the side.

        Return None if the label has no side that is separate from the name.
        """
        by_token = self.by_token(letters)
        for pattern in _APART:
            found = pattern.fullmatch(label)
            side = by_token.get(found["side"].upper(), "") if found else ""
            if found and side:
                return side, found["rest"]
        return None

    def glued(self, names: Sequence[str], letters: Letters) -> dict[str, tuple[str, str]]:
        """Split labels that end in a side, as in ``ASISr`` or ``KNIEli``, into side and name.

        A last letter alone does not prove a side, as in ``HEEL``. A label is split if the label for the other side also
        exists, or if at least ``LEAST_GLUED`` other labels with the same ending have a label for the other side. It is
        never split if there is a label for the medial marker (``ARMl`` next to ``ARMm`` is lateral).
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
        """Yield each ending that means a side, the other side's ending, and the side (L or R). Words come first."""
        for left, right in (*self.short, (letters[0][0], letters[1][0])):
            for one, other, side in ((left, right, "L"), (right, left, "R")):
                for spell in (str.upper, str.lower):
                    yield spell(one), spell(other), side


def sides_of_file(values: dict[str, Any]) -> Sides:
    """Read the words for sides from the contents of a layouts file."""
    return Sides(
        {word: side for side, words in values["sides"].items() for word in words},
        tuple((left, right) for left, right in values["short_sides"]),
        tuple(((left, "L"), (right, "R")) for left, right in values["side_letters"]),
    )


# C7, TH10, HWK7. 1ST and 5th are not vertebrae although an L may precede them.
_VERTEBRA = r"(?:(?:[CTL]|TH)1?\d|[BHL]W[KS]1?\d)(?!\d|st|nd|rd|th|ST|ND|RD|TH)"
# A vertebra, the capitals before a capitalised word, a word, capitals, or a number. The first pattern splits ``KNEin``
# into ``KN`` and ``Ein``, the second into ``KNE`` and ``in``.
_TOKENS = tuple(
    re.compile(rf"{_VERTEBRA}|{capitals}|[A-Z]?[a-z]+|[A-Z]+|\d+")
    for capitals in ("[A-Z]+(?=[A-Z][a-z])", "[A-Z]{2,}(?=[a-z])")
)
# Vertebrae in words: SpineThoracic10, 7. Halswirbel, Tenth Thoracic Vertebra.
_LEVELS = {
    "C": r"CERVICAL[A-Z]*|HALSWIRBEL[A-Z]*",
    "T": r"THORA[CK][A-Z]*|TORACI[A-Z]*|BRUSTWIRBEL[A-Z]*",
    "L": r"LUMBA[A-Z]*|LOMBAIRE|LENDENWIRBEL[A-Z]*",
}
_NUMBERS = "first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth"
_ORDINALS = [str(word) for word in _NUMBERS.split()]
_IN_WORDS = tuple(
    (letter, re.compile(pattern, re.IGNORECASE))
    for letter, word in _LEVELS.items()
    for pattern in (
        rf"(?:SPINE[ ._-]*)?(?:{word})[ ._-]*(?:VERTEBRA[A-Z]*|WIRBEL)?[ ._-]*(?P<number>1?\d)",
        rf"(?P<number>1?\d|{'|'.join(_ORDINALS)})(?:ST|ND|RD|TH|\.)?[ ._-]*(?:{word})",
    )
)
LONGEST_LABEL = 256  # Longest label that is read. Formats allow 127 or 255 letters.
ARTICLE = 2  # Words without meaning and with up to this many letters count only if separate.
_SPELT = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "AE", "Ö": "OE", "Ü": "UE", "ß": "ss"})


@dataclass(frozen=True)
class LabelWords:
    """Vocabulary for labels: body parts and sides in several languages, from a layouts file."""

    vocabulary: dict[str, str]  # Word for each spelling, in capitals. Empty for words without meaning.
    alone: dict[str, str]  # Words that mean something else when alone: a single "front" is a forehead.
    sides: Sides
    phrases: dict[tuple[str, ...], tuple[str, ...]]  # Locations by the sorted words that name them, without side.

    def of(self, label: str, letters: Letters = ENGLISH) -> tuple[str, list[str]]:
        """Split a label into a side ("" for none) and known words. The list is empty if a word is unknown."""
        for pattern in _TOKENS:
            side, words = self._of_tokens([token.upper() for token in pattern.findall(spelt(label))], letters)
            if words:
                return side, words
        return "", []

    def _of_tokens(self, tokens: list[str], letters: Letters) -> tuple[str, list[str]]:
        side_of, tokens = self.sides.by_token(letters), self._joined(tokens)
        found = [side_of[token] for token in tokens if token in side_of]
        rest = [token for token in tokens if token not in side_of]
        parts = [self._split(token) for token in rest]
        if found and len(rest) == 1 and rest[0] in self.alone:
            return (found[0], [self.alone[rest[0]]]) if len(set(found)) == 1 else ("", [])
        if rest and not found and parts[0] is None and rest[0][0] in dict(letters):
            found, parts[0] = [dict(letters)[rest[0][0]]], self._split(rest[0][1:])
        known = [part for part in parts if part is not None]
        words = [word for part in known for word in part]
        found += [side for word in words if (side := self.sides.words.get(word))]
        if len(known) < len(parts) or len(set(found)) > 1:
            return "", []
        return found[0] if found else "", [word for form in words if (word := self.vocabulary.get(form, ""))]

    def known_in(self, text: str) -> tuple[str, frozenset[str]]:
        """Return the side that a text names ("" for none or both sides), and the known words in the text.

        A single unknown letter may change the meaning of the words. If the text contains one, the side and the words
        are empty.
        """
        by_token = self.sides.by_token(ENGLISH)
        tokens = self._joined([token.upper() for token in _TOKENS[0].findall(spelt(text))])
        sides, words = set[str](), set[str]()
        for token in tokens:
            ends = ((token, ""), (token[1:], token[:1]), (token[:-1], token[-1:]))
            for stem, letter in ends if token not in by_token else ():
                if (letter in dict(ENGLISH) or not letter) and (parts := self._split(stem)) is not None:
                    words |= {self.vocabulary.get(part, "") for part in parts}
                    sides |= {side for part in (*parts, letter) if (side := by_token.get(part))}
                    break
            else:
                if token not in by_token and len(token) == 1 and token.isalpha():
                    return "", frozenset()
            sides |= {by_token[token]} if token in by_token else set()
        return sides.pop() if len(sides) == 1 else "", frozenset(words - {""})

    def _joined(self, tokens: list[str]) -> list[str]:
        """Join two adjacent tokens that form one known word, such as avant-bras or upper arm."""
        joined: list[str] = []
        for token in tokens:
            if joined and min(len(token), len(joined[-1])) > 1 and joined[-1] + token in self.vocabulary:
                token = joined.pop() + token
            joined.append(token)
        return joined

    def of_glued(self, label: str) -> tuple[str, list[str]]:
        """Split a label that ends in a side letter, such as ``ForearmL``, into side and words."""
        return self.of(f"{label[-1:]} {label[:-1]}") if label[-1:] in ("L", "R") else ("", [])

    def places_of(self, label: str, letters: Letters = ENGLISH) -> tuple[str, ...]:
        """Return the locations that are described by exactly the words in a label, in any order."""
        side, words = self.of(label, letters)
        parts = self.phrases.get(tuple(sorted(set(words))), ()) if words else ()
        return tuple(part[1:] if part[0] == "-" else side + part for part in parts if (part[0] == "-") == (not side))

    def lacks_side(self, label: str) -> bool:
        """Return whether a label, such as ``KNEE``, lacks the side of a location that exists on both sides."""
        return bool(self.without_side(label))

    def without_side(self, label: str) -> tuple[str, ...]:
        """Return the locations (without side) of a label that should state a side but does not. Otherwise return ()."""
        side, words = self.of(label)
        parts = self.phrases.get(tuple(sorted(set(words))), ()) if words and not side else ()
        return () if any(part[0] == "-" for part in parts) else parts

    def _split(self, token: str) -> list[str] | None:
        """Split a token into known words, or return None if that is impossible."""
        if token in self.vocabulary or token in self.sides.words:
            return [token]
        whole = len(token)
        found: list[list[str] | None] = [None] * whole + [[]]
        for start in reversed(range(whole)):
            for end in (whole, *range(min(whole - 2, start + self._longest), start + 1, -1)):
                rest = found[end]
                if rest is not None and end - start <= self._longest and self._is_part(token[start:end]):
                    found[start] = [token[start:end], *rest]
                    break
        return found[0]

    @cached_property
    def _longest(self) -> int:
        return max(map(len, (*self.vocabulary, *self.sides.words)))

    def _is_part(self, text: str) -> bool:
        """Return whether part of a token is a word. Articles do not count, so ``HANDLE`` is not ``HAND`` and ``LE``."""
        long = text in self.vocabulary and len(text) > ARTICLE
        return bool(self.vocabulary.get(text)) or long or text in self.sides.words


def words_of_file(values: dict[str, Any], midline: frozenset[str]) -> LabelWords:
    """Read a layouts file's vocabulary. Raise ``KeyError`` if a phrase has an unknown word."""
    vocabulary = {form: word for word, forms in values["words"].items() for form in (word, *forms)}
    phrases: dict[tuple[str, ...], tuple[str, ...]] = {}
    for place, texts in values["phrases"].items():
        for text in texts:
            key = tuple(sorted({vocabulary[word.upper()] for word in text.split()}))
            named = "-" + place if place in midline else place
            phrases[key] = tuple(dict.fromkeys((*phrases.get(key, ()), named)))
    return LabelWords(vocabulary, values["alone"], sides_of_file(values), phrases)


def spelt(label: str) -> str:
    """Remove accents from a label, and write its vertebrae in the form ``C7``. Return "" if the label is too long."""
    if len(label) > LONGEST_LABEL:
        return ""
    decomposed = unicodedata.normalize("NFKD", label.translate(_SPELT))
    plain = "".join(letter for letter in decomposed if not unicodedata.combining(letter))
    for level, pattern in _IN_WORDS:
        if found := pattern.search(plain):
            number = found["number"].lower()
            digits = number if number.isdigit() else str(1 + _ORDINALS.index(number))
            return f"{plain[: found.start()]} {level}{digits} {plain[found.end() :]}"
    return plain


SHARED = 0.8  # Smallest share of labels with a common prefix. The other points may belong to a stick.
LONGEST = 30  # Largest number of characters in such a prefix or suffix.


@dataclass(frozen=True)
class Affixes:
    """Prefix and suffix that a recording's labels share: ``p`` in ``pRightASI``, ``_study`` in ``r.ASIS_study``."""

    prefix: str = ""
    suffix: str = ""

    def bare(self, label: str) -> str:
        """Remove the subject name, prefix and suffix from a label."""
        return bare_label(label).removeprefix(self.prefix).removesuffix(self.suffix)


def bare_label(label: str) -> str:
    """Remove the subject name, which ends in a colon, from a label."""
    return label.rpartition(":")[2].strip()


def prefixes(bare: Sequence[str]) -> Iterator[Affixes]:
    """Yield prefixes that nearly all labels share, shortest first."""
    yield from map(Affixes, _shared(bare))


def suffixes(bare: Sequence[str]) -> Iterator[Affixes]:
    """Yield suffixes that nearly all labels share, shortest first."""
    for reverse in _shared([label[::-1] for label in bare]):
        yield Affixes(suffix=reverse[::-1])


def _shared(labels: Sequence[str]) -> list[str]:
    counts = Counter(label[:length] for label in labels for length in range(1, min(len(label) - 1, LONGEST) + 1))
    least = max(2.0, SHARED * len(labels))
    return sorted((prefix for prefix, count in counts.items() if count >= least), key=len)
