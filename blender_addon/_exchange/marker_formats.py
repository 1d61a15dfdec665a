"""The formats that markers are written in; ``io/markers/write.py`` has a writer for each."""

from __future__ import annotations

MARKER_FORMATS = {
    "c3d": ("C3D", "Labels and positions, millimetres, Z up: what optical systems and biomechanics read"),
    "trc": ("TRC", "Labels and positions as a text, millimetres, Y up: for OpenSim"),
}
"""Name and tooltip, by the ending of the files."""
