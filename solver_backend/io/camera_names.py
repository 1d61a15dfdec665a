"""Match the names of recorded cameras with those in a calibration."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_FILLERS = {"cam", "camera", "c", "json", "int", "ext", "img", "view", "video", "pose", "keypoints", "openpose", "kpts"}
_COUNTING_DIGITS = 3  # Largest number of digits in a camera number. A longer number is a serial number.
_COUNTED = re.compile(rf"(?<!\d)\d{{1,{_COUNTING_DIGITS}}}$")
_CAMERA = re.compile(r"cam(?:era)?[\s_\-.]*\d+", re.IGNORECASE)


def name_key(name: str) -> tuple[str, ...]:
    """Return the words and numbers that distinguish a camera name from others.

    ``cam01_json``, ``Cam_1``, ``camera-001`` and ``int_cam01_img`` give ``('1',)``. ``left_json`` gives ``('left',)``.
    """
    parts = _words(name)
    return tuple(_plain(part) for part in parts if part not in _FILLERS) or tuple(parts)


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W\d_]+|\d+", name.lower())


def _plain(word: str) -> str:
    return word.lstrip("0") or "0" if word.isdigit() else word


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that places cam2 before cam10."""
    parts = re.findall(r"([0-9]+)|([^0-9]+)", name.lower())
    return [(1, 0, word) if word else (0, len(n), n) for n, word in ((n.lstrip("0"), word) for n, word in parts)]


def match_names(recorded: Sequence[str], calibrated: Sequence[str]) -> list[int] | None:
    """Find each recorded camera in a calibration by name. Return indices, or None if names are ambiguous.

    Comparisons are tried until one assigns all cameras. They use ``name_key``, the part that looks like a camera name
    (``Static_cam_01`` -> ``cam_01``), or the part without the common prefix and suffix of all recorded names
    (``trial1_A``, ``trial1_B`` -> ``A``, ``B``) or of all calibrated names. Finally, calibrated names are searched for
    among the words of recorded names (``Walk_Miqus_1_28984`` -> ``28984``), or recorded names in calibrated names.
    """
    for read_recorded, read_calibrated in _WAYS:
        wanted, keys = read_recorded(recorded), read_calibrated(calibrated)
        if len(set(wanted)) == len(wanted) and all(keys.count(key) == 1 for key in wanted):
            return [keys.index(key) for key in wanted]
    inside = _by_contained_names(recorded, calibrated)
    if inside is not None or len(calibrated) != len(recorded) or any(map(_counts, _name_keys(recorded))):
        return inside
    found = _by_contained_names(calibrated, recorded)
    return None if found is None else [found.index(i) for i in range(len(recorded))]


def takes_in_names(recorded: Sequence[str], calibrated: Sequence[str]) -> tuple[str, ...]:
    """Return the take names if the recorded names contain several takes of the same cameras, else ().

    ``walk_cam01``, ``walk_cam02``, ``run_cam01`` and ``run_cam02`` give ``walk`` and ``run``.
    """
    keys = _name_keys(calibrated)
    cameras_of: dict[str, set[int]] = {}
    for name in recorded:
        words = _words(name)
        plain = list(map(_plain, words))
        found = [(i, k) for i, key in enumerate(keys) for k in range(len(words)) if (*plain[k : k + len(key)],) == key]
        if len(found) > 1:  # in walk1_cam01, use the number that follows a word for camera
            found = [(i, k) for i, k in found if k > 0 and words[k - 1] in _FILLERS]
        if len(found) != 1:
            return ()
        camera, k = found[0]
        rest = [*words[:k], *words[k + len(keys[camera]) :]]
        cameras_of.setdefault("_".join(word for word in rest if word not in _FILLERS), set()).add(camera)
    alike = len({frozenset(cameras) for cameras in cameras_of.values()}) == 1
    complete = sum(map(len, cameras_of.values())) == len(recorded)
    return tuple(cameras_of) if len(cameras_of) > 1 and "" not in cameras_of and alike and complete else ()


def counted_order(recorded: Sequence[str], calibrated: Sequence[str]) -> list[int] | None:
    """Assign numbered cameras in ascending order, such as ``cam0`` to ``cam01``.

    Return None if a name contains no number, or if the numbers of cameras differ.
    """
    if len(recorded) != len(calibrated) or not all(_COUNTED.search(name) for name in (*recorded, *calibrated)):
        return None
    first, second = (sorted(range(len(names)), key=lambda i: natural_key(names[i])) for names in (recorded, calibrated))
    order = [0] * len(recorded)
    for i, j in zip(first, second, strict=True):
        order[i] = j
    return order


def _name_keys(names: Sequence[str]) -> list[tuple[str, ...]]:
    return [name_key(name) for name in names]


def _camera_parts(names: Sequence[str]) -> list[tuple[str, ...]]:
    return [name_key((_CAMERA.findall(name) or [name])[-1]) for name in names]


def _distinct_parts(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return name keys without the common prefix and suffix of the names."""
    if len(names) < 2:
        return _name_keys(names)
    start = _shared_start(names)
    end = _shared_start([name[start:][::-1] for name in names])
    # A number is one word: cam10 and cam11 differ in 10 and 11, not in 0 and 1.
    while start and names[0][start - 1].isdigit():
        start -= 1
    while end and names[0][len(names[0]) - end].isdigit():
        end -= 1
    return [name_key(name[start : len(name) - end]) for name in names]


def _own_parts(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the distinguishing parts of calibrated names, or the whole names if only numbers remain."""
    parts = _distinct_parts(names)
    return _name_keys(names) if any(map(_counts, parts)) else parts


def _counts(key: tuple[str, ...]) -> bool:
    return len(key) == 1 and key[0].isdigit() and len(key[0]) <= _COUNTING_DIGITS


def _shared_start(names: Sequence[str]) -> int:
    different = (i for i, letters in enumerate(zip(*names, strict=False)) if len(set(letters)) > 1)
    return next(different, min(map(len, names)))


def _by_contained_names(recorded: Sequence[str], calibrated: Sequence[str]) -> list[int] | None:
    """Find the only calibrated name that each recorded name contains. Return indices, or None if this is ambiguous."""
    keys = _name_keys(calibrated)
    found = []
    for name in recorded:
        words = tuple(map(_plain, _words(name)))
        inside = [i for i, key in enumerate(keys) if any(words[k : k + len(key)] == key for k in range(len(words)))]
        if len(inside) != 1:
            return None
        found += inside
    return found if len(set(found)) == len(found) else None


_WAYS = (
    (_name_keys, _name_keys),
    (_camera_parts, _name_keys),
    (_distinct_parts, _name_keys),
    (_camera_parts, _camera_parts),
    (_name_keys, _own_parts),
    (_distinct_parts, _own_parts),
)
"""Pairs of functions that extract the compared parts of recorded and calibrated names, from strict to tolerant."""


def listing(names: Iterable[str]) -> str:
    """Join names with commas for a message."""
    return ", ".join(names) or "none"
