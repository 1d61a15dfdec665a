"""Find the line that makes a BVH file unreadable."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np


def torn_line(path: Path | str, text: str) -> str:
    """Return the path of a BVH file for an error message, followed by its first damaged MOTION line, if any.

    The damaged line is omitted if more than half of the lines are damaged.
    """
    lines = text.splitlines()
    channels = sum(int(count) for count in re.findall(r"(?i)\bCHANNELS\s+(\d{1,4})\b", text))
    first = next((n for n, line in enumerate(lines) if line.strip().startswith("Frame Time")), len(lines)) + 1
    rows, odd, torn = 0, 0, (0, 0)
    for number in range(first, len(lines)):
        if row := lines[number].split():
            rows += 1
            if len(row) != channels or not _are_numbers(row):
                torn = torn if odd else (number + 1, len(row))
                odd += 1
    if not odd or 2 * odd > rows:
        return str(path)
    return f"{path}, line {torn[0]}, which has {torn[1]} words instead of {channels} numbers"


def _are_numbers(words: list[str]) -> bool:
    try:
        return bool(np.array(words, np.float64).size)
    except ValueError:
        return False
