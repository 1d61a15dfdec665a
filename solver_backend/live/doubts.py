"""When a pose is unsure although most markers fit: points that nothing explains, or a limb that is off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from solver_backend.labelling.outputs import MARKERS

UNEXPLAINED = 10
"""Points without a name from which a pose is unsure: a second person, a prop of many markers, or a body that the fit
has not found."""
OFF_M = 0.08
"""Distance in the median of a limb's markers from which a pose is unsure."""
_FEWEST = 3
"""Markers of a limb without which nothing is known of it."""
_PARTS = {
    "arm": ("UPA", "ELB", "ELM", "FRM", "WRA", "WRB", "FIN"),
    "leg": ("THI", "KNE", "KNM", "SHN", "ANK", "ANM", "HEE", "MT5", "MT1", "TOE"),
}
_LIMBS = {
    f"{side} {part}": [MARKERS.index(f"{side[0].upper()}{name}") for name in names]
    for part, names in _PARTS.items() for side in ("left", "right")
}  # fmt: skip


def doubts_of(off_m: np.ndarray, unexplained: int, limbs: Mapping[str, list[int]] = _LIMBS) -> str:
    """Return why a pose is unsure, with the numbers; an empty text where it is not.

    Args:
        off_m: (L,) metres between each seen marker or keypoint and the body, NaN where it is not seen.
        unexplained: points near the person that have no name.
        limbs: rows of each limb; those of the 53 markers if left out.
    """
    far = {limb: off for limb, off in limbs_off(off_m, limbs).items() if off > OFF_M}
    found = [f"the {limb} is {1e3 * off:.0f} mm off" for limb, off in far.items()]
    if unexplained >= UNEXPLAINED:
        found.append(f"{unexplained} points are unexplained")
    return "; ".join(found)


def limbs_off(off_m: np.ndarray, limbs: Mapping[str, list[int]] = _LIMBS) -> dict[str, float]:
    """Return the median distance of each limb's points in metres, of limbs with enough of them."""
    seen = {limb: off_m[rows][np.isfinite(off_m[rows])] for limb, rows in limbs.items()}
    return {limb: float(np.median(off)) for limb, off in seen.items() if len(off) >= _FEWEST}


def keypoint_limbs(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the rows of each limb among a detector's keypoints."""
    parts = {"arm": ("shoulder", "elbow", "wrist"), "leg": ("hip", "knee", "ankle", "heel", "big_toe")}
    return {
        f"{side} {part}": [row for row, name in enumerate(names) if name in {f"{side}_{joint}" for joint in joints}]
        for part, joints in parts.items() for side in ("left", "right")
    }  # fmt: skip
