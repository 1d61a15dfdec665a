"""Takes whose points nobody named get their labels first, and are solved as any other then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver_backend.body.marker_names import LEAST_MARKERS, is_unnamed, name_markers
from solver_backend.exchange.errors import FileMissing, NoDetections
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.recipes.live import fit_average_person
from solver_backend.labelling.label_take import LabelledTake, label_take
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network
from solver_backend.types import Capture, MarkerCloud

Told = Mapping[tuple[int, int], str]
"""Marker's name by (column, frame), from a person."""


def needs_labels(cloud: MarkerCloud) -> bool:
    """Return whether too few markers are named for a solve, or as many points without names are seen as with."""
    if cloud.labels is None:
        return True
    names = name_markers([label for label in cloud.labels if not is_unnamed(label)])
    if len(names.unknown) >= LEAST_MARKERS:
        return False  # somebody named them, in words of their own: the solve finds their bones
    if len(names.known) < LEAST_MARKERS:
        return True
    seen = np.isfinite(cloud.positions).all(-1).sum(0)
    nameless = [is_unnamed(label) for label in cloud.labels]
    return int(seen[nameless].sum()) >= int(seen[~np.array(nameless)].sum())


def told_by(cloud: MarkerCloud) -> dict[tuple[int, int], str]:
    """Return what a half-labelled take's own names tell of every stretch of theirs: they bind."""
    if cloud.labels is None:
        return {}
    known = name_markers([label for label in cloud.labels if not is_unnamed(label)]).known
    seen = np.isfinite(cloud.positions).all(-1)
    begins = seen & ~np.roll(seen, 1, axis=0)
    begins[0] = seen[0]
    return {
        (column, int(frame)): known[label]
        for column, label in enumerate(cloud.labels)
        if known.get(label) in MARKERS
        for frame in np.flatnonzero(begins[:, column])
    }


def labelled_capture(
    capture: Capture, progress: Progress = silent, *, told: Told | None = None, network: PointNetwork | None = None,
    always: bool = False,
) -> tuple[Capture, LabelledTake | None]:  # fmt: skip
    """Return a capture whose points have names, and how they came by them; the same capture where it needs none.

    Args:
        capture: with or without markers.
        progress: called as frames are read.
        told: names from a person, by column and frame; they bind the whole stretch.
        network: the one that ships if None.
        always: label it even if it has names (which bind, see ``told_by``).
    """
    cloud = capture.markers
    if cloud is None or capture.keypoints is not None or not (always or needs_labels(cloud)):
        return capture, None
    try:
        take = label_take(
            cloud, network or load_network(), fit_average_person, progress, {**told_by(cloud), **(told or {})}
        )
    except (FileMissing, NoDetections):
        if always:
            raise
        return capture, None
    return replace(
        capture, markers=take.cloud(cloud), notes=(*capture.notes, *said_of(take)),
        problems=(*(p for p in capture.problems if "markers are known" not in p), *doubts_of(take)),
    ), take  # fmt: skip


def said_of(take: LabelledTake) -> list[str]:
    """Return sentences on what was named."""
    labels = take.labels[np.isfinite(take.confidence)]
    named = labels[(labels >= 0) & (labels < GHOST)]
    shares = [100.0 * float(np.mean(group)) if len(labels) else 0.0 for group in (
        (labels >= 0) & (labels < GHOST), labels == GHOST, labels < 0,
    )]  # fmt: skip
    return [
        f"The points had no names: a network named {shares[0]:.1f} % of them, as {len(set(named.tolist()))} markers; "
        f"{shares[1]:.1f} % are none of a person's, {shares[2]:.1f} % stay unknown."
    ]


def doubts_of(take: LabelledTake) -> list[str]:
    """Return a sentence if many points stay unknown."""
    there = np.isfinite(take.confidence)
    unknown = float((take.labels[there] < 0).mean()) if there.any() else 1.0
    if unknown < 0.05:
        return []
    return [f"{100 * unknown:.0f} % of the points could not be named surely; they are left out of the solve."]
