"""Marker layouts: where optical markers sit on the skin, defined by anatomical rule on any body."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

import numpy as np

from solver_backend.body.anatomy import AtJoints, LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.marker_layouts import load_layouts

ON_BONE = "@"
"""A place that begins so is the bone of the joint named after it: for markers of which nothing else is known."""
ON_BONE_SPREAD_M = 0.2
"""How far such a marker may be from the joint."""
MARKER_OFFSET_M = 0.0095
"""Distance of a marker's centre from the skin: the radius of a common 14 mm marker and its base."""


def marker_layout(name: str) -> tuple[str, ...]:
    """Return the marker names of a layout.

    Raises:
        KeyError: there is no such layout.
    """
    return load_layouts().layouts[name]


@lru_cache(maxsize=16)
def marker_landmarks(body: Body, names: tuple[str, ...]) -> Landmarks:
    """Return markers by name (of any layout or alias), 9.5 mm off the skin, moving with its correctives.

    A name such as ``@left_knee`` is the joint itself, which moves with the bone below it.

    Raises:
        BodyInvalid: a ray misses the mesh.
        KeyError: a name belongs to no layout; see ``known_markers``.
    """
    return LandmarkBuilder(body, _rules_of(names, MARKER_OFFSET_M), correctives=True).build(names)


def known_markers() -> frozenset[str]:
    """Return every marker name and alias."""
    return frozenset(_rules(MARKER_OFFSET_M))


def placement_precision(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return how sure a place is of its rule, (L, 3, 3) in 1/m² of the rest frame: ``n nᵀ / s² + (I - n nᵀ) / t²``.

    n is the skin's normal; s and t, off the skin and along it, go with the kind of place: bone under thin skin is found
    by hand within a centimetre, the middle of a thigh is anywhere.

    Raises:
        BodyInvalid, KeyError: as in ``marker_landmarks``.
    """
    normal = skin_normals(body, names)
    off, along = np.array([_spread(name) for name in names]).T
    outer = normal[:, :, None] * normal[:, None]
    return outer * (off**-2 - along**-2)[:, None, None] + np.eye(3) * (along**-2)[:, None, None]


def skin_normals(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return the skin's outward unit normal at each place of the rest body, (L, 3); 0 at bones."""
    on, off = (
        LandmarkBuilder(body, _rules_of(names, distance)).build(names).anchors.sum(axis=1) for distance in (0.0, 1.0)
    )
    return off - on


def _spread(name: str) -> tuple[float, float]:
    return (ON_BONE_SPREAD_M, ON_BONE_SPREAD_M) if name.startswith(ON_BONE) else load_layouts().spread_of(name)


def _rules_of(names: tuple[str, ...], distance_m: float) -> dict[str, tuple[str, Rule]]:
    bones = {name: ("", AtJoints({name[len(ON_BONE) :]: 1.0})) for name in names if name.startswith(ON_BONE)}
    return {**_rules(distance_m), **bones}


@cache
def _rules(distance_m: float) -> dict[str, tuple[str, OnSurface]]:
    """Return side and rule of every name, this far from the skin."""
    file = load_layouts()
    rules = {name: ("", _rule(values, distance_m)) for name, values in file.midline.items()}
    for part, values in file.sided.items():
        for letter, side in (("L", "left"), ("R", "right")):
            rules[letter + part] = (side, _rule(values, distance_m))
    return rules | {alias: rules[name] for alias, name in file.aliases.items()}


def _rule(values: Mapping[str, Any], distance_m: float) -> OnSurface:
    """Return the rule of one place from the data file's values."""
    return OnSurface(
        values["joint"],
        tuple(values["direction"]),
        tuple(values.get("start", (0.0, 0.0, 0.0))),
        -distance_m,
        values.get("towards", ""),
        values.get("along", 0.0),
    )
