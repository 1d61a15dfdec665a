"""Takes without labels of a calibrated person: named by the person's labels, markers outside the network's too."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.marker_names import is_unnamed
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.label_like import UNSURE_SHARE
from solver_backend.fitters.marker_calibration.extra_names import named_extras, with_extras
from solver_backend.fitters.settings import SolveSettings
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerSubject


def labelled_as_person(
    capture: Capture, person: MarkerSubject, settings: SolveSettings = SolveSettings(), progress: Progress = silent, *,
    kept: Collection[str] = (),
) -> Capture:  # fmt: skip
    """Return a capture that the network labelled, under the labels of the person, and what that named.

    Args:
        capture: as the network left it: points outside its places have no names.
        person: who wears the markers.
        settings: whose body is the person's.
        progress: called as stages advance.
        kept: names that the user or the file gave, which stay.

    Raises:
        SubjectInvalid: the person is of another body or wears other markers.
    """
    if capture.markers is None:
        return capture
    body = load_chosen_body(settings.body)
    named = named_extras(capture.markers, person, body, load_sposer(), np.zeros(1), progress, kept)
    notes = [diagnostic("points_named_of_person", count=len(named.named), markers=named.named)] if named.named else []
    doubts = [diagnostic("points_doubted_of_person", count=named.doubtful)] if named.doubtful else []
    problems = [item for item in capture.problems if item.code != "points_not_named" or not named.named]
    if len(problems) < len(capture.problems):
        seen = np.isfinite(named.cloud.positions).all(-1).sum(0)
        nameless = float(seen[[is_unnamed(label) for label in named.cloud.labels or ()]].sum() / seen.sum())
        doubts += [diagnostic("points_not_named", percent=100.0 * nameless)] if nameless >= UNSURE_SHARE else []
    return replace(capture, markers=named.cloud, notes=(*capture.notes, *notes), problems=(*problems, *doubts))


def person_of_nameless(
    person: MarkerSubject, captures: Sequence[Capture], settings: SolveSettings = SolveSettings(),
    progress: Progress = silent,
) -> MarkerSubject:  # fmt: skip
    """Return the person with the markers outside the network's places that its labelled takes show on bones.

    Args:
        person: calibrated from these takes.
        captures: takes whose points had no names, as the network left them.
        settings: whose body is the person's.
        progress: called as stages advance.
    """
    clouds = [capture.markers for capture in captures if capture.markers is not None]
    if not clouds:
        return person
    return with_extras(person, clouds, load_chosen_body(settings.body), load_sposer(), np.zeros(1), progress)
