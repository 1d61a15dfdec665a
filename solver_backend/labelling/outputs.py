"""Define the landmark network's outputs: the markers in the superset, and the joints."""

from __future__ import annotations

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_layout
from solver_backend.exchange.joint_sets import SMPL_JOINTS

MARKERS: tuple[str, ...] = marker_layout("MANIFOLD_53")
"""Markers that a point can be, in the order of the network's labels. All layouts are subsets of these markers."""
GHOST = len(MARKERS)  # Label of a point that is not a marker.
JOINTS: tuple[str, ...] = SMPL_JOINTS
LANDMARKS: tuple[str, ...] = (*MARKERS, *JOINTS)  # Markers, then joints, in the order of the estimated positions.
OTHER_PLACES: tuple[str, ...] = tuple(
    place for place in dict.fromkeys(load_layouts().names.values()) if place not in MARKERS
)
"""Landmarks that occur only in other layouts. A point there is not one of the markers."""


def other_side(name: str) -> str:
    """Return the marker or joint on the other side of the body, or the same name on the midline."""
    if name in JOINTS:
        swapped = name.replace("left_", "right_") if "left_" in name else name.replace("right_", "left_")
        return swapped if swapped in JOINTS else name
    swapped = {"L": "R", "R": "L"}.get(name[0], "") + name[1:]
    return swapped if swapped in (*MARKERS, *OTHER_PLACES) else name
