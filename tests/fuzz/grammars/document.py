"""One document by the grammar of its format, drawn from bytes, so that an input's number names it."""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Protocol
from xml.etree import ElementTree

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.fuzz.grammars import binaries, texts

_BYTES = 8192
"""Of randomness for one document; what it does not need is left."""

_LARGE = 20_000
"""Characters from which a tree is drawn by its lines and words: node by node takes half a second."""


class _Fuzzed(Protocol):
    fuzz_one_input: Callable[[bytes], bytes | None]


def document(sound: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return a document by the grammar of the sound file's format; the sound file itself where the draw came to none.

    Args:
        sound: what is read without an error.
        kind: as of ``mutations.mutated``.
        rng: randomness.
    """
    found: list[bytes] = []
    _drawer(sound, kind, found.append)(rng.bytes(_BYTES))
    return found[0] if found else sound


def _drawer(sound: bytes, kind: str, take: Callable[[bytes], None]) -> Callable[[bytes], bytes | None]:
    @settings(database=None, suppress_health_check=list(HealthCheck), deadline=None)
    @given(strategy_of(sound, kind))
    def draw(content: bytes) -> None:
        take(content)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        inner: _Fuzzed = draw.hypothesis  # type: ignore[attr-defined]
        return inner.fuzz_one_input


@lru_cache(maxsize=512)
def strategy_of(sound: bytes, kind: str) -> st.SearchStrategy[bytes]:
    """Return what draws documents of a sound file's format."""
    made: dict[str, Any] = {"pickle": binaries.pickle_bytes, "png": binaries.png_bytes}
    if kind in made:
        return made[kind](sound)
    if kind == "npz" and binaries.is_archive(sound):
        return binaries.npz_bytes(sound)
    if kind in ("npz", "binary"):
        return binaries.box_bytes(sound) if sound[4:8] in (b"ftyp", b"moov", b"mdat") else binaries.word_bytes(sound)
    text = sound.decode("utf-8", "replace")
    return _text_grammar(text, kind)(text).map(lambda drawn: drawn.encode("utf-8", "surrogatepass"))


def _text_grammar(text: str, kind: str) -> Callable[[str], st.SearchStrategy[str]]:
    if text.lstrip()[:1] in ("{", "[") and len(text) < _LARGE and _parses(_json, text):
        return texts.json_text
    if kind == "table":
        return texts.table_text
    if text.lstrip()[:1] == "<" and _parses(ElementTree.fromstring, text):
        return texts.xml_text
    return texts.toml_text if "=" in text and _parses(tomllib.loads, text) else texts.lines_text


def _json(text: str) -> None:
    try:
        json.loads(text)
    except ValueError:
        for line in text.splitlines():
            json.loads(line)


def _parses(parse: Callable[[str], object], text: str) -> bool:
    try:
        parse(text)
    except (ValueError, RecursionError, ElementTree.ParseError):
        return False
    return True
