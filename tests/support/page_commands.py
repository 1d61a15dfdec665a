"""Commands of the two programs as a page prints them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator

COMMAND = re.compile(
    r"(?:(?<![\w/-])\S*python[\d.]*(?:\.exe)? -m (?:solver_backend|(blender_addon))"
    r"|(?:(?<=`)|^|(?<=\n    ))manifold(?: (blender))?) ([a-z][^`|\n]*)",
    flags=re.MULTILINE,
)


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield program and words of each command of a page."""
    for match in COMMAND.finditer(re.sub(r"\\\n\s*", " ", text)):
        line = match[3].split("\n")[0].split(" #")[0].split(" && ")[0].split(" > ")[0]
        program = "blender_addon" if match[1] or match[2] else "solver_backend"
        yield program, shlex.split(line.rstrip(" .,;:)"), comments=True)
