"""Names of numbered files, counted nouns, and the looks of a body."""

from __future__ import annotations

import re
from glob import escape
from pathlib import Path


def next_number(folder: Path, stem: str) -> int:
    """Return the next unused number N for a file with the name ``stem_N`` in a folder."""
    found = [re.match(rf"{re.escape(stem)}_(\d+)", path.name) for path in folder.glob(f"{escape(stem)}_*")]
    return 1 + max((int(match[1]) for match in found if match), default=0)


def next_path(folder: Path, stem: str, suffix: str = "") -> Path:
    """Return the next unused path in the series ``stem_01``, ``stem_02`` and so on."""
    return folder / f"{stem}_{next_number(folder, stem):02d}{suffix}"


CLIP = "clip_of"
"""Custom property of an edited clip: the name of the original take. The clip's frames are not the capture's."""


ROOT_MOTION = "root_motion"
"""Custom property of a take with its travel on the root control. Its other channels are relative to the root."""


def counted(count: int, thing: str) -> str:
    """Return a number with a noun in the singular or plural: 1 camera, 4 cameras, 0 frames."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


MARKERS: tuple[str, ...] = (
    "LFHD", "RFHD", "LBHD", "RBHD", "C7", "T10", "CLAV", "STRN", "RBAC", "LSHO", "RSHO", "LUPA", "RUPA", "LELB",
    "RELB", "LFRM", "RFRM", "LWRA", "RWRA", "LWRB", "RWRB", "LFIN", "RFIN", "LFWT", "RFWT", "LBWT", "RBWT", "LTHI",
    "RTHI", "LKNE", "RKNE", "LSHN", "RSHN", "LANK", "RANK", "LHEE", "RHEE", "LMT5", "RMT5", "LTOE", "RTOE", "LBAC",
    "T4", "SACR", "ARIEL", "LELM", "RELM", "LKNM", "RKNM", "LANM", "RANM", "LMT1", "RMT1",
)  # fmt: skip


PERSON_LOOK, SHAVEN_LOOK, SUIT_LOOK, MANNEQUIN, SEGMENTS_LOOK = "person", "shaven", "suit", "mannequin", "segments"
LOOKS = (PERSON_LOOK, SHAVEN_LOOK, SUIT_LOOK, MANNEQUIN, SEGMENTS_LOOK)
_SIDED = ("Arm", "Forearm", "Hand", "Thigh", "Shank", "Foot", "Toes")
SEGMENTS = (
    "Head",
    "Neck",
    "Chest",
    "Abdomen",
    "Pelvis",
    *(f"{s} {name}" for s in ("Left", "Right") for name in _SIDED),
)
"""Body segments in the order of their materials."""
