"""One document by the grammar of its format, so that an input's number names it."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from functools import lru_cache
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np

from tests.fuzz.grammars import binaries, texts
from tests.fuzz.grammars.draws import Draw

T = TypeVar("T")
_LARGE = 20_000
"""Characters from which a tree is drawn by its lines and words, node by node being slow."""
_BINARY = {"pickle": binaries.pickle_bytes, "png": binaries.png_bytes}


def document(sound: bytes, kind: str, rng: np.random.Generator, number: int = 0) -> bytes:
    """Return a document by the grammar of the sound file's format.

    Args:
        sound: what is read without an error.
        kind: as of ``mutations.mutated``.
        rng: randomness.
        number: of the stock of values that hypothesis made.
    """
    return _grammar_of(sound, kind)(Draw(rng, number))


@lru_cache(maxsize=1024)
def _grammar_of(sound: bytes, kind: str) -> Callable[[Draw], bytes]:
    """Return what draws documents of a sound file's format."""
    if kind in _BINARY:
        return _BINARY[kind]
    if kind == "npz" and (members := binaries.members_of(sound)):
        return lambda draw: binaries.npz_bytes(draw, members)
    if kind in ("npz", "binary"):
        boxes = sound[4:8] in (b"ftyp", b"moov", b"mdat")
        return lambda draw: (binaries.box_bytes if boxes else binaries.word_bytes)(draw, sound)
    grammar = _text_grammar(sound.decode("utf-8", "replace"), kind)
    return lambda draw: grammar(draw).encode("utf-8", "surrogatepass")


def _text_grammar(text: str, kind: str) -> Callable[[Draw], str]:
    if text.lstrip()[:1] in ("{", "[") and len(text) < _LARGE and (trees := _parsed(_json, text)) is not None:
        return lambda draw: texts.json_text(draw, trees)
    if kind == "table":
        return lambda draw: texts.table_text(draw, text)
    if text.lstrip()[:1] == "<" and (root := _parsed(ElementTree.fromstring, text)) is not None:
        return lambda draw: texts.xml_text(draw, root)
    if "=" in text and (tree := _parsed(tomllib.loads, text)) is not None:
        return lambda draw: texts.toml_text(draw, tree)
    rows = texts.words_of(text)
    return lambda draw: texts.lines_text(draw, rows)


def _json(text: str) -> list[object]:
    try:
        return [json.loads(text)]
    except ValueError:
        return [json.loads(line) for line in text.splitlines() if line.strip()]


def _parsed(parse: Callable[[str], T], text: str) -> T | None:
    try:
        return parse(text)
    except (ValueError, RecursionError, ElementTree.ParseError):
        return None
