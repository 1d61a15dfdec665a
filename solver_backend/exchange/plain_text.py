"""Make text safe to show: remove characters that control a terminal or change the reading direction."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

_JOINERS = frozenset("\u200c\u200d")  # Invisible, but part of how Persian, Indic scripts and emoji are written.
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Control characters, invisible ones that format or turn the direction, halves of pairs, breaks."""
_SHOWN = "\ufffd"
_PLAIN = re.compile(r"[ -~]*")


def plain(text: str, *, keep: str = "") -> str:
    """Return the text on one line, with a sign for each control character except those to keep."""
    if _PLAIN.fullmatch(text):
        return text
    return "".join(c if c in keep or not _steers(c) else _SHOWN for c in text)


def _steers(character: str) -> bool:
    return character not in _JOINERS and unicodedata.category(character) in _STEERING


def pairs(text: str) -> dict[str, str]:
    """Return every second word of a text by the word before it."""
    words = text.split()
    return dict(zip(words[::2], words[1::2], strict=True))


def either(names: Iterable[str]) -> str:
    """Return names as a list of alternatives, such as "a, b or c"."""
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last
