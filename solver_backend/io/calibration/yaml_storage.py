"""Parse the subset of YAML that OpenCV's FileStorage writes.

The run time is linear in the length. Anchors, aliases and block scalars, which FileStorage never writes, are errors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.files import LARGEST_TEXT, read_text

_NO_KEY_BEGINS_WITH = frozenset("-:\"'[{")
_UNWRITTEN = {"&": "an anchor", "*": "an alias", "|": "a block text", ">": "a folded text"}
_CLOSING = {"[": "]", "{": "}"}
_TAG = re.compile(r"^!![\w\-]+\s*")
_SPECIAL = {".nan": float("nan"), ".inf": float("inf"), "-.inf": float("-inf"), "+.inf": float("inf")}
_SPECIAL |= {"true": True, "false": False, "null": None, "~": None, "": None}


@dataclass(frozen=True)
class _Line:
    number: int
    indent: int
    text: str


def read_yaml(path: Path) -> Any:
    """Read an OpenCV YAML file as nested dicts, lists and scalars."""
    try:
        return parse_yaml(read_text(path, LARGEST_TEXT))
    except (ValueError, RecursionError) as error:
        what = f"The file is truncated or is not OpenCV's YAML ({error})."
        raise FileDamaged(what, where=str(path), hint="Write it with cv2.FileStorage.") from error


def parse_yaml(text: str) -> Any:
    """Parse YAML text. Raise ValueError with the line number if a line cannot be parsed."""
    lines = _logical_lines(text)
    value, end = _block(lines, 0, lines[0].indent) if lines else ({}, 0)
    if end < len(lines):
        raise ValueError(f"line {lines[end].number}: unexpected indentation")
    return value


def _logical_lines(text: str) -> list[_Line]:
    lines: list[_Line] = []
    parts: list[str] = []
    first, indent, depth = 0, 0, 0
    for number, raw in enumerate(text.splitlines(), 1):
        bare = _without_comment(raw.expandtabs(8)).rstrip()
        if not bare or (depth == 0 and (bare.startswith(("%", "---", "...")))):
            continue
        if not depth:
            first, indent = number, len(bare) - len(bare.lstrip())
        parts.append(bare.lstrip())
        brackets = re.sub(r"\"[^\"]*\"|'[^']*'", "", bare)
        depth = max(0, depth + sum(map(brackets.count, "[{")) - sum(map(brackets.count, "]}")))
        if not depth:
            lines.append(_Line(first, indent, " ".join(parts)))
            parts = []
    if depth:
        raise ValueError(f"line {first}: a bracket is not closed")
    return lines


def _key_and_rest(text: str) -> tuple[str, str] | None:
    """Split a line at its colon into key and text. Return None if the line is not ``key: value``."""
    if text[0] in "\"'":
        key, quote, rest = text[1:].partition(text[0])
        rest = rest.lstrip() if quote else ""
        if not rest.startswith(":"):
            return None
        rest = rest[1:]
    elif text[0] in _NO_KEY_BEGINS_WITH or ":" not in text:
        return None
    else:
        key, _, rest = text.partition(":")
    return (key.rstrip(), rest.strip()) if not rest or rest[0].isspace() else None


def _without_comment(line: str) -> str:
    quote = ""
    for i, char in enumerate(line):
        if quote:
            quote = "" if char == quote else quote
        elif char in "\"'":
            quote = char
        elif char == "#" and (i == 0 or line[i - 1].isspace()):
            return line[:i]
    return line


def _block(lines: list[_Line], i: int, indent: int) -> tuple[Any, int]:
    if lines[i].text == "-" or lines[i].text.startswith("- "):
        return _sequence(lines, i, indent)
    return _mapping(lines, i, indent)


def _sequence(lines: list[_Line], i: int, indent: int) -> tuple[list[Any], int]:
    items: list[Any] = []
    while i < len(lines) and lines[i].indent == indent and (lines[i].text == "-" or lines[i].text.startswith("- ")):
        rest = lines[i].text[1:].lstrip()
        if rest and _key_and_rest(rest):
            inner = indent + len(lines[i].text) - len(rest)
            lines[i] = _Line(lines[i].number, inner, rest)
            value, i = _mapping(lines, i, inner)
        else:
            value, i = _value(rest, lines, i, indent)
        items.append(value)
    return items, i


def _mapping(lines: list[_Line], i: int, indent: int) -> tuple[dict[str, Any], int]:
    items: dict[str, Any] = {}
    while i < len(lines) and lines[i].indent == indent:
        found = _key_and_rest(lines[i].text)
        if found is None:
            raise ValueError(f"line {lines[i].number}: 'key: value' is expected, not '{lines[i].text[:40]}'")
        items[found[0]], i = _value(found[1], lines, i, indent)
    return items, i


def _value(rest: str, lines: list[_Line], i: int, indent: int) -> tuple[Any, int]:
    """Parse the value that starts with ``rest`` in line ``i``. Also return the index of the next line."""
    rest = _TAG.sub("", rest)
    if rest:
        return _flow(rest, lines[i].number), i + 1
    following = lines[i + 1] if i + 1 < len(lines) else None
    if following is None or following.indent < indent:
        return None, i + 1
    # List items may have the same indentation as their key.
    if following.indent == indent and (not following.text.startswith("-") or lines[i].text.startswith("-")):
        return None, i + 1
    return _block(lines, i + 1, following.indent)


def _flow(text: str, number: int) -> Any:
    if text[0] in _UNWRITTEN:
        raise ValueError(f"line {number}: '{text[:40]}' is {_UNWRITTEN[text[0]]}, which FileStorage never writes")
    try:
        value, end = _flow_value(text, 0)
    except (IndexError, ValueError) as error:
        why = "a bracket is not closed" if isinstance(error, IndexError) else error
        raise ValueError(f"line {number}: {why}") from error
    if text[end:].strip():
        raise ValueError(f"line {number}: '{text[end:].strip()[:40]}' is not expected")
    return value


def _flow_value(text: str, i: int) -> tuple[Any, int]:
    i = _after_blanks(text, i)
    if text[i] in _CLOSING:
        return _flow_items(text, i + 1, _CLOSING[text[i]])
    if text[i] in "\"'":
        end = text.find(text[i], i + 1)
        if end < 0:
            raise ValueError("a quote is not closed")
        return text[i + 1 : end], end + 1
    end = i
    while end < len(text) and text[end] not in ",]}":
        end += 1
    if end == i:
        raise ValueError(f"a value is missing before '{text[i : i + 40]}'")
    return _scalar(text[i:end].strip()), end


def _flow_items(text: str, i: int, closing: str) -> tuple[Any, int]:
    """Parse the list or map that starts at index ``i``. Also return the index after it."""
    items: list[tuple[str, Any]] = []
    i, key = _after_blanks(text, i), ""
    while text[i] != closing:
        if closing == "}":
            colon = text.find(":", i)
            if colon < 0:
                raise ValueError("a ':' is missing in a map")
            key, i = text[i:colon].strip().strip("\"'"), colon + 1
        value, i = _flow_value(text, i)
        items.append((key, value))
        i = _after_blanks(text, i)
        if text[i] == ",":
            i = _after_blanks(text, i + 1)
        elif text[i] != closing:
            raise ValueError(f"'{text[i : i + 40]}' is found, but ',' or '{closing}' is expected")
    return (dict(items) if closing == "}" else [value for _, value in items]), i + 1


def _after_blanks(text: str, i: int) -> int:
    while text[i].isspace():
        i += 1
    return i


def _scalar(text: str) -> Any:
    if text.lower() in _SPECIAL:
        return _SPECIAL[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
