"""Markers of a recording that are no known places of the person."""

from __future__ import annotations

from collections.abc import Sequence

from solver_backend.body.label_places import places_given
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.types import MarkerCloud


def loose_markers(cloud: MarkerCloud, worn: Sequence[str], layout: str = "") -> MarkerCloud | None:
    """Return the markers that a person does not wear and no program computed; None where there are none.

    Args:
        cloud: all markers.
        worn: labels of the person's.
        layout: path of a file that states how labels are read, see ``read_label_places``; empty for none.
    """
    labels = cloud.labels or ()
    names = name_markers([label for label in labels if not is_unnamed(label)], places_given(layout))
    used = {*worn, *names.virtual, *names.doubled}
    kept = [i for i, label in enumerate(labels) if label not in used]
    return cloud.columns(kept, tuple(labels[i] for i in kept)) if kept else None
