"""Marker layouts: where optical markers sit on the skin, defined by anatomical rule on any body."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from solver_backend.body.anatomy import LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_layouts import LayoutFile, load_layouts

MARKER_OFFSET_M = 0.0095
"""Distance of a marker's centre from the skin: the radius of a common 14 mm marker and its base."""


_FILE = load_layouts()
ALIASES = _FILE.aliases
"""Other names of the same places."""
MARKER_LAYOUTS = _FILE.layouts
"""Marker names of each layout."""


def marker_landmarks(body: Body, names: tuple[str, ...]) -> Landmarks:
    """Return markers by name (of any layout or alias), 9.5 mm off the skin, moving with its correctives.

    Raises:
        BodyInvalid: a ray misses the mesh.
        KeyError: a name belongs to no layout; see ``known_markers``.
    """
    return LandmarkBuilder(body, _RULES, correctives=True).build(names)


def known_markers() -> frozenset[str]:
    """Return every marker name and alias."""
    return frozenset(_RULES)


def _rule(values: Mapping[str, Any]) -> OnSurface:
    """Return the rule of one place from the data file's values."""
    return OnSurface(
        values["joint"],
        tuple(values["direction"]),
        tuple(values.get("start", (0.0, 0.0, 0.0))),
        -MARKER_OFFSET_M,
        values.get("towards", ""),
        values.get("along", 0.0),
    )


def _sided_rules(file: LayoutFile) -> dict[str, tuple[str, Rule]]:
    rules: dict[str, tuple[str, Rule]] = {name: ("", _rule(values)) for name, values in file.midline.items()}
    for part, values in file.sided.items():
        for letter, side in (("L", "left"), ("R", "right")):
            rules[letter + part] = (side, _rule(values))
    return rules | {alias: rules[name] for alias, name in file.aliases.items()}


_RULES = _sided_rules(_FILE)
