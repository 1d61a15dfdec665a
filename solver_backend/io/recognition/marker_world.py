"""Do markers that are stored in metres with Z up make sense so? What readers of marker files ask of theirs."""

from __future__ import annotations

import numpy as np

from solver_backend.io.recognition.marker_unit import find_unit, spread
from solver_backend.io.recognition.marker_up_axis import find_up_axis
from solver_backend.types import MarkerCloud


def marker_problems(cloud: MarkerCloud) -> tuple[str, ...]:
    """Return a sentence each on markers of another size than a person's, and on a body that does not stand along Z."""
    if not np.isfinite(cloud.positions).any():
        return ()
    found: list[str] = []
    unit = find_unit(cloud.positions, "m", None, "m")
    if unit.problem:
        hint = f" They look like {unit.name}." if unit.name != "m" else ""
        found.append(f"The markers spread over {spread(cloud.positions):.3g} m, which is no person.{hint}")
    axis = find_up_axis(cloud.positions * unit.metres, cloud.labels or ("",) * cloud.positions.shape[1], "z", None, "z")
    if axis.problem:
        stands = axis.problem.partition("the body stands along ")[2][:2].strip(",;. ")
        found.append(f"The markers' body stands along {stands}, not along Z: is Z up in the capture?")
    return tuple(found)
