"""The person of a live run: the network that names points, and the fit that starts from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import name_markers
from solver_backend.fitters.recipes.live import LiveFit, fit_average_person
from solver_backend.io.native.motion_file import read_subject
from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.point_network import PointNetwork, load_network


def person_fit(subject: Path | None) -> tuple[PointNetwork, LiveFit]:
    """Return the network and a fit of a calibrated person, or of one whose shape is learned as they move.

    Raises:
        FileMissing, SubjectInvalid: the subject cannot be read.
    """
    network = load_network()
    if subject is None:
        return network, fit_average_person()
    person = read_subject(subject)
    offsets = np.zeros((len(MARKERS), 3))
    places = name_markers(person.places).known
    for place, offset in zip(person.places, person.offsets, strict=True):
        if places.get(place) in MARKERS:
            offsets[MARKERS.index(places[place])] = offset
    return network, LiveFit(load_body(), offsets=offsets, betas=person.betas)
