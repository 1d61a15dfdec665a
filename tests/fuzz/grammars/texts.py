"""Grammars of texts: JSON, TOML, XML, tables, and lines of words and numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

from tests.fuzz.grammars.draws import Draw
from tests.fuzz.grammars.values import ODDLY

_WORD = re.compile(r"[-+]?\.?\d[\w.+-]*|[A-Za-z_][\w-]*|\s+|.", re.DOTALL)
_ROWS = 60
"""Of a table, from which one is drawn."""


def tree_like(draw: Draw, sound: Any) -> Any:
    """Draw a tree of the same grammar: keys left out or added, lists shorter or longer, values of other kinds."""
    if draw.seldom(4 * ODDLY):
        return draw.value("tree")
    if isinstance(sound, dict):
        found = {draw.oddly(key, "text"): tree_like(draw, value) for key, value in sound.items()}
        return {key: value for key, value in found.items() if not draw.seldom(2 * ODDLY)}
    if isinstance(sound, list):
        return _list_like(draw, sound)
    return draw.value("float" if isinstance(sound, float) and draw.seldom(2) else "scalar") if draw.seldom() else sound


def _list_like(draw: Draw, sound: list[Any]) -> list[Any]:
    if len(sound) > 40:  # numbers of a long list are alike: one of them changes
        at = draw.integer(0, len(sound) - 1)
        return [*sound[:at], tree_like(draw, sound[at]), *sound[at + 1 :]]
    found = [tree_like(draw, value) for value in sound]
    if not draw.seldom():
        return found
    return (found * 2 + [draw.value("scalar"), draw.value("scalar")])[: draw.integer(0, 2 * len(found) + 2)]


def json_text(draw: Draw, trees: Sequence[object]) -> str:
    """Draw a document, or lines of documents where the sound file has those, laid out in one way or another."""
    indent, ascii_only = (draw.integer(0, 3) if draw.seldom() else None), draw.seldom(2)
    return "\n".join(json.dumps(tree_like(draw, tree), indent=indent, ensure_ascii=ascii_only) for tree in trees)


def toml_text(draw: Draw, tree: dict[str, Any]) -> str:
    """Draw a document of tables, arrays and values, in the several ways in which TOML lets them be written."""
    lines: list[str] = []
    _toml_table(draw, tree_like(draw, tree), "", lines)
    return draw.one_of(["\n", "\r\n"]).join(lines) + "\n"


def _toml_table(draw: Draw, tree: Any, name: str, lines: list[str]) -> None:
    if not isinstance(tree, dict):
        lines.append(f"value = {_toml_value(draw, tree)}")
        return
    tables = {key: value for key, value in tree.items() if isinstance(value, dict)}
    for key, value in tree.items():
        if key not in tables:
            comment = draw.oddly("", [" # noted", "\t", "  #"])
            lines.append(f"{_toml_key(str(key))} = {_toml_value(draw, value)}{comment}")
    for key, value in tables.items():
        inner = f"{name}.{_toml_key(str(key))}" if name else _toml_key(str(key))
        lines.append(f"[{inner}]")
        _toml_table(draw, value, inner, lines)


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key)


def _toml_value(draw: Draw, value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + draw.one_of([", ", ",\n  ", ","]).join(_toml_value(draw, item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml_key(str(k))} = {_toml_value(draw, v)}" for k, v in value.items()) + "}"
    if isinstance(value, int | float):
        return draw.oddly(repr(value), "number")
    return json.dumps(value) if draw.seldom(2) else "'" + str(value).replace("'", "") + "'"


def xml_text(draw: Draw, root: ElementTree.Element) -> str:
    """Draw elements and attributes of the same names, left out, repeated, in another order or with other values."""
    head = draw.oddly('<?xml version="1.0"?>\n', ["", "<!-- said -->", "<!DOCTYPE a>"])
    return head + _xml_element(draw, root)


def _xml_element(draw: Draw, element: ElementTree.Element) -> str:
    given = "".join(
        f" {name}={quoteattr(draw.oddly(value, 'number'))}"
        for name, value in element.attrib.items()
        if not draw.seldom(40)
    )
    children = list(element)
    if children and draw.seldom(30):
        children = [draw.one_of(children) for _ in range(draw.integer(0, 2 * len(children)))]
    inner = escape(element.text or "") + "".join(_xml_element(draw, child) + (child.tail or "") for child in children)
    tag = draw.oddly(element.tag, ["a", "camera", "transform"])
    return f"<{tag}{given}>{inner}</{tag}>"


def table_text(draw: Draw, sound: str) -> str:
    """Draw a table: rows more or fewer, other numbers in cells, other marks between them and other ends of lines."""
    mark = max("\t,; ", key=sound.count)
    rows = [line.split(mark) for line in sound.splitlines()[:_ROWS]]
    cells = sum(map(len, rows))
    for _ in range(draw.integer(0, 2 * cells // ODDLY) if draw.seldom(2) else draw.integer(0, 3)):
        row = draw.one_of(rows) if rows else []
        if row:
            at = draw.integer(0, len(row) - 1)
            row[at] = draw.value("number" if any(c.isdigit() for c in row[at]) else "text")
    if rows and draw.seldom(10):
        at = draw.integer(0, len(rows) - 1)
        rows[at] = rows[at][: draw.integer(0, len(rows[at]))]
    if draw.seldom(10):
        rows = rows[: draw.integer(0, len(rows))]
    mark = draw.oddly(mark, ["\t", ",", ";", "|"])
    head = draw.oddly("", ["\ufeff"])
    return head + draw.one_of(["\n", "\r\n", "\r"]).join(mark.join(row) for row in rows) + "\n"


def words_of(text: str) -> list[list[str]]:
    """Return the words, numbers and blanks of each line."""
    return [_WORD.findall(line) for line in text.splitlines()]


def lines_text(draw: Draw, sound: list[list[str]]) -> str:
    """Draw lines of the same words: numbers and a word now and then another, lines repeated, left out or exchanged."""
    lines = list(sound)
    if lines and draw.seldom(10):
        a, b = (draw.integer(0, len(lines) - 1) for _ in range(2))
        lines[a], lines[b] = lines[b], lines[a]
    if lines and draw.seldom(10):
        del lines[draw.integer(0, len(lines) - 1)]
    if lines and draw.seldom(10):
        lines.insert(draw.integer(0, len(lines)), draw.one_of(lines))
    for _ in range(draw.integer(0, 3)):
        row = draw.integer(0, max(len(lines) - 1, 0))
        if lines and lines[row]:
            at = draw.integer(0, len(lines[row]) - 1)
            word = draw.value("number" if draw.seldom(2) else "text")
            lines[row] = [*lines[row][:at], word, *lines[row][at + 1 :]]
    return draw.one_of(["\n", "\r\n"]).join("".join(row) for row in lines) + "\n"
