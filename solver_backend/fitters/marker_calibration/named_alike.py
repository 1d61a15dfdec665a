"""Takes of one person under the same names, before they are calibrated together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from solver_backend.fitters.marker_calibration.exchanged_wrists import with_wrists_named
from solver_backend.fitters.marker_calibration.person_doubts import over_takes
from solver_backend.labelling.names_over_takes import names_over_takes
from solver_backend.types import MarkerCloud


def named_alike(
    clouds: Sequence[MarkerCloud], own: Mapping[str, str]
) -> tuple[tuple[MarkerCloud, ...], dict[str, Any]]:
    """Return takes whose names agree, and what the person's provenance records of it.

    Args:
        clouds: labelled takes.
        own: the user's place by label, which is not changed.
    """
    wrists = with_wrists_named(clouds, own)
    named = names_over_takes(wrists.clouds, own)
    return named.clouds, over_takes((*wrists.changes, *named.changes))
