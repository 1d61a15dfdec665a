"""Labels as words: a side and what of the body they name, in English, German and French, glued or apart."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from typing import Any

# A vertebra, the capitals before a capitalised word, a word, capitals, a number; and with capitals before small letters
# apart: ``KneeMed`` is of two words in the first way, ``KNEin`` in the second.
_TOKENS = tuple(
    re.compile(rf"[CTL]1?\d(?!\d)|{capitals}|[A-Z]?[a-z]+|[A-Z]+|\d+")
    for capitals in ("[A-Z]+(?=[A-Z][a-z])", "[A-Z]{2,}(?=[a-z])")
)
_SPELT = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "AE", "Ö": "OE", "Ü": "UE", "ß": "ss"})


@dataclass(frozen=True)
class LabelWords:
    """What the file of layouts states of words."""

    vocabulary: dict[str, str]
    """Word by each way to write it, in capitals; empty for words without meaning."""
    sides: dict[str, str]
    """L or R by each word for a side."""
    phrases: dict[tuple[str, ...], tuple[str, ...]]
    """Places by the sorted words that name them, a sided place without its side; several where they may name either."""

    def of(self, label: str, letters: tuple[tuple[str, str], ...] = (("L", "L"), ("R", "R"))) -> tuple[str, list[str]]:
        """Return the side, empty where none is named, and the words of a label; no words where some are not known.

        Args:
            label: without its prefix.
            letters: the side that each single letter stands for.
        """
        for pattern in _TOKENS:
            side, words = self._of_tokens([token.upper() for token in pattern.findall(_spelt(label))], dict(letters))
            if words:
                return side, words
        return "", []

    def _of_tokens(self, tokens: list[str], letters: dict[str, str]) -> tuple[str, list[str]]:
        side_of = self.sides | letters
        found = [side_of[token] for token in tokens if token in side_of]
        rest = [token for token in tokens if token not in side_of]
        parts = [self._split(token) for token in rest]
        if rest and not found and parts[0] is None and rest[0][0] in letters:
            found, parts[0] = [letters[rest[0][0]]], self._split(rest[0][1:])
        known = [part for part in parts if part is not None]
        words = [word for part in known for word in part]
        found += [side for word in words if (side := self.sides.get(word))]
        if len(known) < len(parts) or len(set(found)) > 1:
            return "", []
        return found[0] if found else "", [word for form in words if (word := self.vocabulary.get(form, ""))]

    def of_glued(self, label: str) -> tuple[str, list[str]]:
        """Return the same of a label whose last letter is a side's: ``ForearmL``."""
        return self.of(f"{label[-1:]} {label[:-1]}") if label[-1:] in ("L", "R") else ("", [])

    def places_of(self, label: str, letters: tuple[tuple[str, str], ...] = (("L", "L"), ("R", "R"))) -> tuple[str, ...]:
        """Return the places that a label's words name, none where no phrase fits all of them."""
        side, words = self.of(label, letters)
        parts = self.phrases.get(tuple(sorted(set(words))), ()) if words else ()
        return tuple(part[1:] if part[0] == "-" else side + part for part in parts if (part[0] == "-") == (not side))

    def _split(self, token: str) -> list[str] | None:
        """Return the known words that a token is made of, the longest first; None where it is not made of any."""
        if token in self.vocabulary or token in self.sides:
            return [token]
        for end in range(len(token) - 2, 1, -1):
            head = token[:end]
            if (head in self.vocabulary or head in self.sides) and (rest := self._split(token[end:])) is not None:
                return [head, *rest]
        return None


def words_of_file(values: dict[str, Any], midline: frozenset[str]) -> LabelWords:
    """Return the words of a file's sections ``words``, ``sides`` and ``phrases``; the midline's begin with ``-``.

    Raises:
        KeyError: a phrase holds a word that is not in the vocabulary.
    """
    vocabulary = {form: word for word, forms in values["words"].items() for form in (word, *forms)}
    sides = {form: side for side, forms in values["sides"].items() for form in forms}
    phrases: dict[tuple[str, ...], tuple[str, ...]] = {}
    for place, texts in values["phrases"].items():
        for text in texts:
            key = tuple(sorted({vocabulary[word.upper()] for word in text.split()}))
            phrases[key] = (*phrases.get(key, ()), "-" + place if place in midline else place)
    return LabelWords(vocabulary, sides, phrases)


def _spelt(label: str) -> str:
    """Return a label in letters without accents."""
    plain = unicodedata.normalize("NFKD", label.translate(_SPELT))
    return "".join(letter for letter in plain if not unicodedata.combining(letter))
