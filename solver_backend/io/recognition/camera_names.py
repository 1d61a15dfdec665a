"""Match the names of recorded cameras with those of a calibration."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_FILLERS = {"cam", "camera", "c", "json", "int", "ext", "img", "view", "video", "pose", "keypoints", "openpose", "kpts"}
_CAMERA = re.compile(r"cam(?:era)?[\s_\-.]*\d+", re.IGNORECASE)


def name_key(name: str) -> tuple[str, ...]:
    """Return what tells a camera's name from another's: its words and numbers without fillers and leading zeros.

    ``cam01_json``, ``Cam_1``, ``camera-001`` and ``int_cam01_img`` all give ``('1',)``; ``left_json`` ``('left',)``.
    """
    parts = re.findall(r"[^\W\d_]+|\d+", name.lower())
    kept = [part.lstrip("0") or "0" if part.isdigit() else part for part in parts if part not in _FILLERS]
    return tuple(kept) or tuple(parts)


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Return a sorting key that puts cam2 before cam10."""
    return [(0, int(p)) if p.isdigit() else (1, p) for p in re.findall(r"\d+|\D+", name.lower())]


def match_names(recorded: Sequence[str], calibrated: Sequence[str]) -> list[int] | None:
    """Return for each recorded camera the index of its calibration, or None where any has none or several.

    Names are compared by ``name_key``; where that fails, by the part of the recorded name that reads like a camera
    (``Static_cam_01`` -> ``cam_01``).
    """
    keys = [name_key(name) for name in calibrated]
    for read in (name_key, _camera_part):
        wanted = [read(name) for name in recorded]
        if len(set(wanted)) == len(wanted) and all(keys.count(key) == 1 for key in wanted):
            return [keys.index(key) for key in wanted]
    return None


def _camera_part(name: str) -> tuple[str, ...]:
    found = _CAMERA.findall(name)
    return name_key(found[-1]) if found else name_key(name)


def listing(names: Iterable[str]) -> str:
    """Return names for a message."""
    return ", ".join(names) or "none"
