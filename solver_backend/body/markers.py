"""Marker layouts: where optical markers sit on the skin, defined by anatomical rule on any body."""

from __future__ import annotations

from solver_backend.body.anatomy import LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks

MARKER_OFFSET_M = 0.0095
"""Distance of a marker's centre from the skin: the radius of a common 14 mm marker and its base."""


def _skin(
    joint: str,
    direction: tuple[float, float, float],
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    towards: str = "",
    along: float = 0.0,
) -> OnSurface:
    return OnSurface(joint, direction, start, -MARKER_OFFSET_M, towards, along)


_MIDLINE: dict[str, Rule] = {
    "C7": _skin("neck", (0, 0.25, -1), (0, -0.01, 0)),
    "T4": _skin("spine3", (0, 0.2, -1), (0, 0.06, 0)),
    "T10": _skin("spine2", (0, 0, -1), (0, 0.03, 0)),
    "CLAV": _skin("neck", (0, -0.25, 1), (0, -0.05, 0)),
    "STRN": _skin("spine3", (0, 0, 1), (0, -0.02, 0)),
    "SACR": _skin("pelvis", (0, 0, -1), (0, 0.055, 0)),
    "ARIEL": _skin("head", (0, 1, 0), (0, 0.05, 0)),
}
_LEFT: dict[str, Rule] = {
    "FHD": _skin("head", (0.6, 0, 1), (0, 0.12, 0)),
    "BHD": _skin("head", (0.6, 0, -1), (0, 0.12, 0)),
    "BAC": _skin("collar", (0, 0, -1), (0.05, -0.1, 0)),
    "SHO": _skin("shoulder", (0, 1, 0), (-0.02, 0, 0)),
    "UPA": _skin("shoulder", (0, 1, -0.6), towards="elbow", along=0.55),
    "ELB": _skin("elbow", (0, 1, -0.3)),
    "ELM": _skin("elbow", (0, -1, -0.3)),
    "FRM": _skin("elbow", (0, 1, 0), towards="wrist", along=0.5),
    "WRA": _skin("wrist", (0, 0.25, 1)),
    "WRB": _skin("wrist", (0, 0.25, -1)),
    "FIN": _skin("hand", (0, 1, 0)),
    "FWT": _skin("hip", (0.3, 0, 1), (0.03, 0.09, 0)),
    "BWT": _skin("pelvis", (0, 0, -1), (0.045, 0.04, 0)),
    "THI": _skin("hip", (1, 0, 0.2), towards="knee", along=0.5),
    "KNE": _skin("knee", (1, 0, 0)),
    "KNM": _skin("knee", (-1, 0, 0)),
    "SHN": _skin("knee", (1, 0, 0.3), towards="ankle", along=0.5),
    "ANK": _skin("ankle", (1, 0, 0)),
    "ANM": _skin("ankle", (-1, 0, 0)),
    "HEE": _skin("ankle", (0, 0, -1), (0, -0.045, 0)),
    "MT1": _skin("foot", (-1, 0.4, 0)),
    "MT5": _skin("foot", (1, 0.2, 0)),
    "TOE": _skin("foot", (0, 1, 0.2)),
}

ALIASES: dict[str, str] = {
    "LASI": "LFWT", "RASI": "RFWT", "LPSI": "LBWT", "RPSI": "RBWT", "RBAK": "RBAC", "LTIB": "LSHN", "RTIB": "RSHN",
    "LIWR": "LWRA", "RIWR": "RWRA", "LOWR": "LWRB", "ROWR": "RWRB",
}  # fmt: skip
"""Other names of the same places."""


def _pairs(*parts: str) -> tuple[str, ...]:
    return tuple(side + part for part in parts for side in "LR")


_CMU_41 = (
    *_pairs("FHD", "BHD"), "C7", "T10", "CLAV", "STRN", "RBAC",
    *_pairs("SHO", "UPA", "ELB", "FRM", "WRA", "WRB", "FIN", "FWT", "BWT"),
    *_pairs("THI", "KNE", "SHN", "ANK", "HEE", "MT5", "TOE"),
)  # fmt: skip
MARKER_LAYOUTS: dict[str, tuple[str, ...]] = {
    "CMU_41": _CMU_41,
    "PLUGIN_GAIT_39": (
        *_pairs("FHD", "BHD"), "C7", "T10", "CLAV", "STRN", "RBAK",
        *_pairs("SHO", "UPA", "ELB", "FRM", "WRA", "WRB", "FIN", "ASI", "PSI"),
        *_pairs("THI", "KNE", "TIB", "ANK", "HEE", "TOE"),
    ),
    "MANIFOLD_53": (*_CMU_41, "LBAC", "T4", "SACR", "ARIEL", *_pairs("ELM", "KNM", "ANM", "MT1")),
}  # fmt: skip
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


def _sided_rules() -> dict[str, tuple[str, Rule]]:
    rules: dict[str, tuple[str, Rule]] = {name: ("", rule) for name, rule in _MIDLINE.items()}
    for part, rule in _LEFT.items():
        for letter, side in (("L", "left"), ("R", "right")):
            rules[letter + part] = (side, rule)
    return rules | {alias: rules[name] for alias, name in ALIASES.items()}


_RULES = _sided_rules()
