"""Changes of files that keep so much of their structure that readers go on into their depths."""

from __future__ import annotations

import io
import json
import re
import zipfile
from functools import lru_cache
from typing import Any

import numpy as np

from tests.fuzz.archives import Member, archive_bytes, member
from tests.fuzz.binary_mutations import change_numbers, change_pickle, change_png

_TOKEN = re.compile(r"[\w.+\-]+|\s+|.", re.DOTALL)
_WORDS = (
    "0", "-1", "1", "1e400", "-1e308", "nan", "inf", "9" * 23, "9" * 400, "0.1", "''", '""', "[", "]", "{", "}", ",",
    ":", "=", "\n", " " * 200, "\t", "null", "true", "${PORT}", "&a", "*a", "|", "<", ">", "\0", "\u0661", "a.b.c",
    "[" * 1200, '{"a":' * 1200,
)  # fmt: skip
_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 1e308, 10**23, 10**400, float("nan"), float("inf"), "", "1", "x" * 100, [], {}, [[]],
    [1, [2]], {"a": None}, 100, 0.5,
)  # fmt: skip
_HOLE = "what is nested goes here"
_LONGEST = 2**20
"""Characters to which what is repeated grows: the limit of memory is the reader's, not the mutation's."""
_KINDS = ("<f8", "<f4", "<i4", "<u8", "|b1", "<U3", "|S2", "<c16", "<f2", ">f8", "|O", "<M8[s]", "|V4", "f8,f8")


def mutated(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return changed bytes of a file of this kind: 'text', 'table', 'json', 'npz', 'png', 'pickle' or 'binary'."""
    for _ in range(1 + _drawn(rng, 0.7, 0.9)):
        structured = rng.random() < 0.8
        data = _BY_KIND[kind](data, rng) if structured else change_bytes(data, rng)
    return data


def _drawn(rng: np.random.Generator, *limits: float) -> int:
    """Return between which limits a number of [0, 1) falls."""
    drawn = rng.random()
    return sum(drawn >= limit for limit in limits)


def change_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut, flip, insert, repeat or remove bytes."""
    at, length = (int(rng.integers(0, len(data) + 1)) for _ in range(2))
    what = int(rng.integers(5))
    if what == 0:
        return data[:at]
    if what == 1:
        changed = bytearray(data)
        for i in rng.integers(0, max(1, len(data)), int(rng.integers(1, 9))):
            if len(data):
                changed[int(i)] = int(rng.integers(256))
        return bytes(changed)
    if what == 2:
        return data[:at] + rng.bytes(int(rng.integers(1, 20))) + data[at:]
    if what == 3:
        return data[:at] + data[at : at + length % 200] * int(rng.integers(2, 50)) + data[at:]
    return data[:at] + data[at + length % 300 :]


def change_text(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace, remove, repeat or exchange words of a text."""
    tokens = list(_tokens(data))
    if not tokens:
        return data
    i, j = (int(rng.integers(len(tokens))) for _ in range(2))
    what = int(rng.integers(6))
    if what <= 1:
        tokens[i] = _WORDS[int(rng.integers(len(_WORDS)))]
    elif what == 2:
        del tokens[i : i + int(rng.integers(1, 30))]
    elif what == 3:
        tokens[i:i] = _repeated(tokens[i : i + 30], int(rng.integers(1, 40)))
    elif what == 4:
        tokens[i], tokens[j] = tokens[j], tokens[i]
    else:
        word = _WORDS[int(rng.integers(len(_WORDS)))]
        tokens[i:i] = _repeated([word], int(rng.integers(1, 300)))
    return "".join(tokens).encode("utf-8", "replace")


@lru_cache(maxsize=256)
def _tokens(data: bytes) -> tuple[str, ...]:
    return tuple(_TOKEN.findall(data.decode("latin-1")))


def _repeated(words: list[str], times: int) -> list[str]:
    return words * min(times, 1 + _LONGEST // (1 + sum(map(len, words))))


def change_table(data: bytes, rng: np.random.Generator) -> bytes:
    """Change rows, columns or a cell of a table; every other time a word as in any text."""
    lines = data.decode("latin-1").splitlines()
    delimiters = [mark for mark in "\t,; " if any(mark in line for line in lines)]
    if not delimiters or rng.random() < 0.5:
        return change_text(data, rng)
    delimiter = max(delimiters, key=data.decode("latin-1").count)
    rows = [line.split(delimiter) for line in lines]
    i, j = (int(rng.integers(len(rows))) for _ in range(2))
    column = int(rng.integers(max(map(len, rows))))
    what = int(rng.integers(7))
    if what == 0:
        rows[i], rows[j] = rows[j], rows[i]
    elif what == 1:
        del rows[i : i + int(rng.integers(1, 4))]
    elif what == 2:
        times = int(rng.integers(1, 40))
        rows[i:i] = rows[i : i + 3] * min(times, 1 + _LONGEST // (1 + sum(map(len, lines[i : i + 3]))))
    elif what == 3:
        rows = [row[:column] + row[column + 1 :] for row in rows]
    elif what == 4:
        rows = [row[:column] + row[column : column + 1] * 2 + row[column + 1 :] for row in rows]
    elif what == 5:
        word = _WORDS[int(rng.integers(len(_WORDS)))]
        rows = [row if k < i else [*row[:column], word, *row[column + 1 :]] for k, row in enumerate(rows)]
    else:
        delimiter = ("\t", ",", ";", " ", "|")[int(rng.integers(5))]
    return "\n".join([delimiter.join(row) for row in rows] + [""]).encode("utf-8", "replace")


def change_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Change one node of a tree; what is no JSON is changed as a text."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return change_text(data, rng)
    places = places_in(tree) if isinstance(tree, dict | list) else []
    if not places or rng.random() < 0.05:
        return json.dumps(_VALUES[int(rng.integers(len(_VALUES)))]).encode()
    holder, key = places[int(rng.integers(len(places)))]
    what = int(rng.integers(5))
    if what == 4 and rng.random() < 0.2:
        holder[key] = _HOLE
        depth = int(rng.choice([50, 1200, 100_000]))
        return json.dumps(tree).replace(f'"{_HOLE}"', "[" * depth + "]" * depth, 1).encode()
    if what == 0:
        del holder[key]
    elif what == 1 and isinstance(holder, list):
        holder.extend(holder[:20] * int(rng.integers(1, 20)))
    elif what == 2 and isinstance(holder, dict):
        holder[str(key) + "x"] = holder.pop(key)
    else:
        holder[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    return json.dumps(tree).encode()


def places_in(tree: Any) -> list[tuple[Any, Any]]:
    """Return container and key of every node."""
    found, open_ones = [], [tree]
    while open_ones:
        inner = open_ones.pop()
        for key, value in inner.items() if isinstance(inner, dict) else enumerate(inner):
            found.append((inner, key))
            if isinstance(value, dict | list):
                open_ones.append(value)
    return found


def change_npz(data: bytes, rng: np.random.Generator) -> bytes:
    """Change one array of an archive, its header, or how it is packed."""
    try:
        whole = _members(data)
        names = list(whole)
        name = names[int(rng.integers(len(names)))]
        changed = _changed_member(name, whole[name], rng)
        packing = _drawn(rng, 0.6, 0.95)
        kept = [one for key, (one, _) in whole.items() if key not in changed]
        kept += [member(key, content, packing == 1) for key, content in changed.items() if content is not None]
        return _by_lzma(kept, name) if packing == 2 else archive_bytes(kept)
    except Exception:  # an archive that earlier changes have broken
        return change_bytes(data, rng)


@lru_cache(maxsize=256)
def _members(data: bytes) -> dict[str, tuple[Member, bytes]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    return {name: (member(name, content), content) for name, content in contents.items()}


def _by_lzma(members: list[Member], name: str) -> bytes:
    """Return an archive of members that are as they are, one of them packed by LZMA."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for one in members:
            archive.writestr(one.name, one.content, zipfile.ZIP_LZMA if one.name.endswith(name) else None)
    return out.getvalue()


def _changed_member(name: str, whole: tuple[Member, bytes], rng: np.random.Generator) -> dict[str, bytes | None]:
    what, content = int(rng.integers(6)), whole[1]
    if what == 0:
        return {name: None}
    if what == 1:
        return {name: None, f"x{name}": content}
    if what == 2:
        return {name: change_bytes(content, rng)}
    if what == 3:
        return {name: _with_header(content, rng)}
    out = io.BytesIO()
    np.save(out, _changed_array(np.load(io.BytesIO(content), allow_pickle=False), rng))
    return {name: out.getvalue()}


def _with_header(member: bytes, rng: np.random.Generator) -> bytes:
    """Return the member with another type or shape in its header."""
    lengths = [0, 1, 3, -1, 2**31, 2**62, 10**30, 7]
    shape = tuple(lengths[int(i)] for i in rng.integers(0, len(lengths), int(rng.integers(0, 5))))
    header = {"descr": _KINDS[int(rng.integers(len(_KINDS)))], "fortran_order": bool(rng.integers(2)), "shape": shape}
    text = (repr(header) + "\n").encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + member[128:]


def _changed_array(value: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    if value.dtype.kind == "U" and not value.ndim and str(value)[:1] in ("{", "[") and rng.random() < 0.8:
        return np.array(change_json(str(value).encode(), rng).decode())
    what = int(rng.integers(8))
    if what == 0:
        return value[..., :-1] if value.ndim else np.repeat(value, 2)
    if what == 1:
        return value[:1] if value.ndim else value.reshape(1, 1)
    if what == 2:
        return value[None]
    if what == 3:
        return value[:0] if value.ndim else np.zeros((0, 3))
    if value.dtype.kind not in "fiub" or what == 4:
        odd = (np.array("x" * 50), np.array(["a", "a"]), np.array(-1.0), np.array(b"\xff"), np.array(2**63, np.uint64))
        return odd[int(rng.integers(len(odd)))]
    if what == 5:
        with np.errstate(all="ignore"):
            return value.astype(_KINDS[int(rng.integers(9))])
    changed = np.array(value, dtype=np.float64)
    odd_values = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e12, 0.0, -1.0, 1e-320, 85.0)
    with np.errstate(all="ignore"):
        if what == 6:
            return changed * odd_values[int(rng.integers(len(odd_values)))]
        if changed.size:
            changed.reshape(-1)[rng.integers(0, changed.size, 3)] = odd_values[int(rng.integers(len(odd_values)))]
    return changed


_BY_KIND = {
    "text": change_text, "table": change_table, "json": change_json, "npz": change_npz, "pickle": change_pickle,
    "binary": change_numbers, "png": change_png,
}  # fmt: skip
