"""Remove characters that control a terminal or change the reading direction."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

_JOINERS = frozenset("\u200c\u200d")  # Invisible characters that Persian, Indic scripts and emoji require.
_STEERING = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories to replace: control and format characters, surrogates, and line and paragraph separators."""
_SHOWN = "\ufffd"
_PLAIN = re.compile(r"[ -~]*")


def plain(text: str, *, keep: str = "") -> str:
    """Replace the control characters in a text, except those in ``keep``, with a visible sign."""
    if _PLAIN.fullmatch(text):
        return text
    return "".join(c if c in keep or not _steers(c) else _SHOWN for c in text)


def _steers(character: str) -> bool:
    return character not in _JOINERS and unicodedata.category(character) in _STEERING


def pairs(text: str) -> dict[str, str]:
    """Convert alternating keys and values, such as "a 1 b 2", to a dictionary."""
    words = text.split()
    return dict(zip(words[::2], words[1::2], strict=True))


def either(names: Iterable[str]) -> str:
    """Join names as alternatives, such as "a, b or c"."""
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last
