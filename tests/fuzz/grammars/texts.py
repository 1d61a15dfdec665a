"""Grammars of texts: JSON, TOML, XML, tables, and lines of words and numbers."""

from __future__ import annotations

import json
import re
import tomllib
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

from hypothesis import strategies as st

from tests.fuzz.grammars.values import NUMBERS, oddly, tree_like

_WORD = re.compile(r"[-+]?\.?\d[\w.+-]*|[A-Za-z_][\w-]*|\s+|.", re.DOTALL)


@st.composite
def json_text(draw: st.DrawFn, sound: str) -> str:
    """Draw a document, or lines of documents where the sound file has those, laid out in one way or another."""
    try:
        trees = [json.loads(sound)]
    except ValueError:
        trees = [json.loads(line) for line in sound.splitlines() if line.strip()]
    drawn = [draw(tree_like(tree)) for tree in trees]
    indent, ascii_only = draw(oddly(None, st.integers(0, 3))), draw(st.booleans())
    return "\n".join(json.dumps(tree, indent=indent, ensure_ascii=ascii_only) for tree in drawn)


@st.composite
def toml_text(draw: st.DrawFn, sound: str) -> str:
    """Draw a document of tables, arrays and values, in the several ways in which TOML lets them be written."""
    lines: list[str] = []
    _toml_table(draw, draw(tree_like(tomllib.loads(sound))), "", lines)
    return draw(st.sampled_from(["\n", "\r\n"])).join(lines) + "\n"


def _toml_table(draw: st.DrawFn, tree: Any, name: str, lines: list[str]) -> None:
    if not isinstance(tree, dict):
        lines.append(f"value = {_toml_value(draw, tree)}")
        return
    tables = {key: value for key, value in tree.items() if isinstance(value, dict)}
    for key, value in tree.items():
        if key not in tables:
            comment = draw(oddly("", st.sampled_from([" # noted", "\t", "  #"])))
            lines.append(f"{_toml_key(str(key))} = {_toml_value(draw, value)}{comment}")
    for key, value in tables.items():
        inner = f"{name}.{_toml_key(str(key))}" if name else _toml_key(str(key))
        lines.append(f"[{inner}]")
        _toml_table(draw, value, inner, lines)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key)


def _toml_value(draw: st.DrawFn, value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        between = draw(st.sampled_from([", ", ",\n  ", ","]))
        return "[" + between.join(_toml_value(draw, item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml_key(str(k))} = {_toml_value(draw, v)}" for k, v in value.items()) + "}"
    if isinstance(value, int | float):
        return draw(oddly(repr(value), NUMBERS))
    return draw(st.sampled_from([json.dumps(value), "'" + str(value).replace("'", "") + "'"]))


@st.composite
def xml_text(draw: st.DrawFn, sound: str) -> str:
    """Draw elements and attributes of the same names, left out, repeated, in another order or with other values."""
    head = draw(oddly('<?xml version="1.0"?>\n', st.sampled_from(["", "<!-- said -->", "<!DOCTYPE a>"])))
    return head + _xml_element(draw, ElementTree.fromstring(sound))


def _xml_element(draw: st.DrawFn, element: ElementTree.Element) -> str:
    given = "".join(
        f" {name}={quoteattr(draw(oddly(value, NUMBERS)))}"
        for name, value in element.attrib.items()
        if draw(st.integers(0, 40))
    )
    children = list(element)
    if children and draw(st.integers(0, 30)) == 0:
        children = draw(st.lists(st.sampled_from(children), max_size=2 * len(children)))
    inner = escape(element.text or "") + "".join(_xml_element(draw, child) + (child.tail or "") for child in children)
    tag = draw(oddly(element.tag, st.sampled_from(["a", "camera", "transform"])))
    return f"<{tag}{given}>{inner}</{tag}>"


@st.composite
def table_text(draw: st.DrawFn, sound: str) -> str:
    """Draw a table: rows more or fewer, other numbers in cells, other marks between them and other ends of lines."""
    lines = sound.splitlines()
    mark = max("\t,; ", key=sound.count)
    rows = [line.split(mark) for line in lines[:60]]
    rows = [[draw(oddly(cell, NUMBERS)) if _is_number(cell) else draw(oddly(cell, st.text(max_size=6))) for cell in row]
            for row in rows]  # fmt: skip
    if rows and draw(st.integers(0, 9)) == 0:
        at = draw(st.integers(0, len(rows) - 1))
        rows[at] = rows[at][: draw(st.integers(0, len(rows[at])))]
    if draw(st.integers(0, 9)) == 0:
        rows = rows[: draw(st.integers(0, len(rows)))]
    mark = draw(oddly(mark, st.sampled_from(["\t", ",", ";", "|"])))
    head = draw(oddly("", st.just("\ufeff")))
    return head + draw(st.sampled_from(["\n", "\r\n", "\r"])).join(mark.join(row) for row in rows) + "\n"


def _is_number(cell: str) -> bool:
    return any(character.isdigit() for character in cell)


@st.composite
def lines_text(draw: st.DrawFn, sound: str) -> str:
    """Draw lines of the same words: numbers and a word now and then another, lines repeated, left out or exchanged."""
    lines = sound.splitlines()
    if lines and draw(st.integers(0, 9)) == 0:
        a, b = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        lines[a], lines[b] = lines[b], lines[a]
    if lines and draw(st.integers(0, 9)) == 0:
        del lines[draw(st.integers(0, len(lines) - 1))]
    if lines and draw(st.integers(0, 9)) == 0:
        lines.insert(draw(st.integers(0, len(lines))), draw(st.sampled_from(lines)))
    words = [_WORD.findall(line) for line in lines]
    for _ in range(draw(st.integers(0, 3))):
        row = draw(st.integers(0, max(len(words) - 1, 0)))
        if words and words[row]:
            at = draw(st.integers(0, len(words[row]) - 1))
            words[row][at] = draw(NUMBERS | st.text(max_size=5))
    return draw(st.sampled_from(["\n", "\r\n"])).join("".join(row) for row in words) + "\n"
