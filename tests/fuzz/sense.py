"""Changes that leave a file readable and break what it means, so that the fault lies behind the reader.

Frames, views, joints or markers are left out, repeated or exchanged in every array that counts them; columns become
NaN, zero or astronomical; rates, words and flags become others of their kind.
"""

from __future__ import annotations

import io
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.markers.read import read_markers
from tests.fuzz.archives import archive_bytes, member, npy_bytes
from tests.fuzz.mutations import mutated, places_in
from tests.support.c3d_bytes import C3dBytes

_ODD = (np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0, 0.5, 1e4, 1e30, -1e30, 1e300, 1e-30)
_FACTORS = (-1.0, 0.0, 1e-3, 0.5, 2.0, 1e3, 1e12)
_RATES = (0.0, -30.0, 1e-3, 1e-300, 0.5, 1.0, 1e6, 1e300, np.nan, np.inf)
_WORDS = (
    "", "x", "COCO_17", "BODY_25", "SMPL", "SMPL_HANDS", "neutral", "none", "left", "{}", "[]", "null", "\0", "é" * 300,
    "mm", "1", "../x",
)  # fmt: skip
_AXES = 3
"""Lengths up to this are coordinates as likely as counts of something."""
_LONGEST_LABEL = 60  # Letters of a label; C3D counts its bytes in one byte.
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
_TEXT_NUMBERS = ("0", "-1", "nan", "inf", "1e30", "-1e30", "1e-30", "1e300", "0.5", "100000")
Arrays = dict[str, np.ndarray]


def broken_sense(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Return a file of other content, well-formed as the sound one is; ``kind`` is that of ``mutations.mutated``."""
    if kind == "npz":
        return _npz(data, rng)
    if kind == "binary" and (arrays := _take(data)) is not None:
        return _c3d(_changed(arrays, rng), rng)
    if kind == "json":
        return _json(data, rng)
    if kind in ("text", "table"):
        return _numbers(data, rng)
    return mutated(data, kind, rng)


def _npz(data: bytes, rng: np.random.Generator) -> bytes:
    arrays = _changed(_arrays(data), rng)
    if rng.random() < 0.05 and len(arrays) > 1:
        del arrays[_one_of(list(arrays), rng)]
    return archive_bytes(member(f"{name}.npy", npy_bytes(array)) for name, array in arrays.items())


@lru_cache(maxsize=64)
def _arrays(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


@lru_cache(maxsize=64)
def _take(data: bytes) -> Arrays | None:
    """Return the points of a C3D file in millimetres, their labels and rate; None where it is none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.c3d"
        path.write_bytes(data)
        try:
            cloud = read_markers(path).cloud
        except Exception:  # an odd file
            return None
    labels = cloud.labels or tuple(f"*{k}" for k in range(cloud.positions.shape[1]))
    return {"points": 1e3 * cloud.positions, "labels": np.array(labels), "rate": np.array(cloud.fps)}


def _c3d(arrays: Arrays, rng: np.random.Generator) -> bytes:
    points, labels, rate = (arrays[name] for name in ("points", "labels", "rate"))
    seen = np.isfinite(points).all(-1)
    fourth = np.where(seen, 0.0, -1.0)
    if rng.random() < 0.2:
        seen[...] = True  # not finite, and said to be seen
    with np.errstate(all="ignore"):
        points = np.where(seen[..., None], points, 0.0).astype(np.float32).astype(np.float64)
    names = [str(label)[:_LONGEST_LABEL] for label in labels][: points.shape[1]]
    units = "mm" if rng.random() < 0.9 else str(_one_of(("m", "cm", "inch", "", None), rng) or "")
    return C3dBytes(points, names, rate=float(np.float32(rate)), fourth=fourth, units=units or None).to_bytes()


def _changed(arrays: Arrays, rng: np.random.Generator) -> Arrays:
    arrays = dict(arrays)
    for _ in range(1 + int(rng.geometric(0.6)) // 2):
        _CHANGES[int(rng.choice(len(_CHANGES), p=_SHARES))](arrays, rng)
    return arrays


def _count(arrays: Arrays, rng: np.random.Generator) -> None:
    """Choose other frames, views, joints or markers, in every array that has so many."""
    lengths = Counter(n for array in arrays.values() for n in set(array.shape) if n > _AXES)
    if not lengths:
        return
    n, distinct = _one_of(sorted(lengths), rng), rng.random() < 0.8
    whole = np.arange(n)
    chosen = _one_of(
        (
            whole[:0], whole[:1], whole[-1:], whole[:2], np.delete(whole, rng.integers(n)), np.repeat(whole, 2),
            whole[::-1], rng.permutation(n), np.zeros(n, int), np.where(whole == rng.integers(n), 0, whole),
            np.tile(whole, 5),
        ),
        rng,
    )  # fmt: skip
    for name, array in arrays.items():
        for axis, length in enumerate(array.shape):
            if length == n and array.size < 1e6:
                array = np.take(array, chosen, axis=axis)
        arrays[name] = _with_own_names(array) if distinct else array


def _with_own_names(array: np.ndarray) -> np.ndarray:
    """Return words of which none comes twice, so that a camera or a marker that does is not refused by its name."""
    words = [str(word) for word in array] if array.dtype.kind == "U" and array.ndim == 1 else []
    if len(set(words)) == len(words):
        return array
    return np.array([f"{word}_{k}" if word in words[:k] else word for k, word in enumerate(words)])


def _values(arrays: Arrays, rng: np.random.Generator) -> None:
    """Let a column, a row, a third or all of an array's numbers be others."""
    names = [name for name, array in arrays.items() if array.dtype.kind == "f" and array.ndim and array.size]
    if not names:
        return
    name = _one_of(names, rng)
    array = arrays[name].copy()
    place = _place(array.shape, rng)
    what = rng.integers(4)
    with np.errstate(all="ignore"):
        if what <= 1:
            array[place] = _one_of(_ODD, rng)
        elif what == 2:
            array[place] = array[place] * _one_of(_FACTORS, rng)
        else:
            array[place] = array[place] + _one_of((-1e6, -10.0, 0.3, 10.0, 1e6), rng)
    arrays[name] = array


def _place(shape: tuple[int, ...], rng: np.random.Generator) -> Any:
    what = int(rng.integers(4))
    if what == 0:
        return ...
    if what == 1:
        return rng.random(shape) < 0.3
    axes = [slice(None)] * len(shape)
    for axis in rng.permutation(len(shape))[: what - 1]:
        at = int(rng.integers(shape[axis]))
        axes[axis] = slice(at, at + 1 + int(rng.integers(2)))
    return tuple(axes)


def _rate(arrays: Arrays, rng: np.random.Generator) -> None:
    names = [name for name, array in arrays.items() if array.dtype.kind == "f" and array.size == 1]
    if names:
        name = _one_of(names, rng)
        with np.errstate(all="ignore"):
            arrays[name] = np.full_like(arrays[name], _one_of(_RATES, rng))


def _flags(arrays: Arrays, rng: np.random.Generator) -> None:
    names = [name for name, array in arrays.items() if array.dtype.kind in "iub" and array.size]
    if not names:
        return
    name = _one_of(names, rng)
    array = arrays[name]
    others = (
        np.zeros_like(array), np.ones_like(array), np.roll(array, 1), (~array), array[::-1] if array.ndim else array,
        (array.astype(np.int64) + 1).astype(array.dtype),
    )  # fmt: skip
    arrays[name] = _one_of(others, rng)


def _words(arrays: Arrays, rng: np.random.Generator) -> None:
    names = [name for name, array in arrays.items() if array.dtype.kind == "U" and array.size]
    if not names:
        return
    name = _one_of(names, rng)
    array = arrays[name]
    if not array.ndim:
        text = str(array)
        is_tree = text[:1] in ("{", "[") and rng.random() < 0.8
        arrays[name] = np.array(
            _json(text.encode(), rng).decode("utf-8", "replace") if is_tree else _one_of(_WORDS, rng)
        )
        return
    words = array.ravel().tolist()
    i, j = (int(rng.integers(len(words))) for _ in range(2))
    what = int(rng.integers(4))
    if what == 0:
        words[i], words[j] = words[j], words[i]
    elif what == 1:
        words[i] = words[j]
    elif what == 2:
        words[i] = _one_of(_WORDS, rng)
    else:
        words = [words[i]] * len(words)
    arrays[name] = np.array(words).reshape(array.shape)


def _exchange(arrays: Arrays, rng: np.random.Generator) -> None:
    """Give an array the content of another one of its shape and kind."""
    name = _one_of(list(arrays), rng)
    alike = [n for n, a in arrays.items() if (a.shape, a.dtype.kind) == (arrays[name].shape, arrays[name].dtype.kind)]
    arrays[name] = arrays[_one_of(alike, rng)]


_CHANGES: tuple[Callable[[Arrays, np.random.Generator], None], ...] = (
    _count, _values, _rate, _flags, _words, _exchange,
)  # fmt: skip
_SHARES = (0.25, 0.4, 0.1, 0.1, 0.1, 0.05)


def _json(data: bytes, rng: np.random.Generator) -> bytes:
    """Change numbers of a tree to odd ones, or how many things a list of it has."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return mutated(data, "json", rng)
    places = places_in(tree) if isinstance(tree, dict | list) else []
    numbers = [place for place in places if isinstance(place[0][place[1]], int | float)]
    lists = [place for place in places if isinstance(place[0][place[1]], list)]
    if not numbers and not lists:
        return mutated(data, "json", rng)
    if lists and (not numbers or rng.random() < 0.3):
        holder, key = _one_of(lists, rng)
        items = holder[key]
        holder[key] = _one_of((items[:1], items[1:], items * 2, items[::-1], [*items[:1]] * len(items)), rng)
    else:
        for holder, key in [_one_of(numbers, rng)] if rng.random() < 0.8 else numbers[:: int(rng.integers(1, 4))]:
            holder[key] = _number_like(holder[key], rng)
    return json.dumps(tree).encode()


def _number_like(value: float, rng: np.random.Generator) -> float:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return _one_of((0, 1, -1, value + 1, value - 1, 2 * value, 1000, 2**31), rng)
    return float(_one_of((*_ODD, -value, 2 * value, 1000 * value), rng))


def _numbers(data: bytes, rng: np.random.Generator) -> bytes:
    """Change one number of a text, those of a row or of a column, or every few of all."""
    text = data.decode("latin-1")
    found = _found(text)
    if not found:
        return mutated(data, "text", rng)
    step = int(_one_of((1, 2, 3, 5, 17, len(found)), rng))
    first = int(rng.integers(len(found)))
    last = first + int(_one_of((1, 1, step + 1, 40, len(found)), rng))
    word, factor = _one_of(_TEXT_NUMBERS, rng), _one_of((*_FACTORS, None, None), rng)
    parts, at = list[str](), 0
    for begin, end in found[first:last:step]:
        new = word if factor is None else repr(float(text[begin:end]) * factor)
        parts += [text[at:begin], new]
        at = end
    return "".join([*parts, text[at:]]).encode("latin-1")


@lru_cache(maxsize=256)
def _found(text: str) -> list[tuple[int, int]]:
    return [match.span() for match in _NUMBER.finditer(text)]


def _one_of(choices: Any, rng: np.random.Generator) -> Any:
    return choices[int(rng.integers(len(choices)))]
