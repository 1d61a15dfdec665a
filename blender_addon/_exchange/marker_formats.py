"""The formats that markers are written in; ``io/markers/write.py`` has a writer for each.

Command lines, panels, menus and their texts follow this table.
"""

from __future__ import annotations

MARKER_FORMATS = {
    "c3d": ("C3D", "Labels and positions, millimetres, Z up: what optical systems and biomechanics read"),
    "trc": ("TRC", "Labels and positions as a text, millimetres, Y up: for OpenSim"),
}
"""Name and tooltip, by the ending of the files."""


def _listed(*names: str) -> str:
    """Return names as a sentence lists them: ``A, B or C``."""
    *first, end = names
    return f"{', '.join(first)} or {end}" if first else end


FORMAT_NAMES = _listed(*(name for name, _ in MARKER_FORMATS.values()))
"""Names of all formats, for sentences."""


def file_names(stem: str, *others: str) -> str:
    """Return what stands for a file of markers in help texts.

    Args:
        stem: such as TAKE, of ``TAKE.c3d|TAKE.trc``.
        others: further names of files.
    """
    return "|".join([*(f"{stem}.{ending}" for ending in MARKER_FORMATS), *others])
