"""From a capture to a problem: its views, its single camera or its markers, measured and made ready for a method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.repeated_frames import without_views
from solver_backend.body.body import Body
from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.label_places import places_given
from solver_backend.exchange.errors import BackendMissing, TakeTooShort
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.layers import Layer, Measurements
from solver_backend.fitters.methods import METHODS, require_curves, require_network, require_one_view, require_start
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.geometry.arrays import Array, constant
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture, MarkerCloud, MarkerSubject, Motion


def prepare(
    capture: Capture,
    settings: SolveSettings,
    progress: Progress,
    prior: AutoencodingPrior | None = None,
    person: MarkerSubject | None = None,
    start: Motion | None = None,
) -> Problem:
    """Prepare a capture for a solver: its views, or its markers if it has no keypoints; errors are as in ``solve``."""
    markers = capture.markers if capture.keypoints is None else None
    if markers is None:
        capture.require_views()
    require_curves(settings, capture.name)
    if not METHODS[settings.method].per_frame and capture.num_frames < 4:
        raise TakeTooShort(
            f"The bundle needs 4 frames, the take has {capture.num_frames}.",
            where=capture.name,
            hint="Use the method 'frame' for single images.",
        )
    if start is not None:
        require_start(settings, capture)
    body, like = load_chosen_body(settings.body), make_origin(settings.backend)
    prior = load_sposer() if prior is None else prior
    if settings.noise:
        from solver_backend.fitters.measurements.views import with_meant_confidence

        capture = with_meant_confidence(capture, settings.noise)
    if settings.is_direct:
        from solver_backend.fitters.measurements.markers import measure_directly

        require_network(settings, capture.name)
        return Problem.of(body, prior, measure_directly(capture, body, like, settings, person, progress))
    if markers is not None:
        return _prepare_markers(markers, capture.others, body, prior, like, settings, progress, person)
    return Problem.of(body, prior, _measure_views(capture, body, prior, like, settings, progress, start))


def _measure_views(
    capture: Capture,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    start: Motion | None,
) -> Measurements:
    from solver_backend.fitters.measurements.views import begin_at, measure_views

    seen = without_views(capture, settings.leave_out)
    fitting = prior_on_body(prior, body.layout)
    if seen.is_one_view:
        from solver_backend.fitters.one_view.measure import measure_one_view

        require_one_view(settings, capture.name)
        return measure_one_view(seen, body, fitting, like, settings.betas, progress)
    views = measure_views(seen, body, like, progress, estimate_sync=settings.estimate_sync, sync=settings.sync)
    if start is None:
        return views
    from solver_backend.fitters.hands.wide_motion import without_fingers

    return begin_at(views, without_fingers(start), body, fitting, like)


def _prepare_markers(
    cloud: MarkerCloud,
    others: MarkerCloud | None,
    body: Body,
    prior: AutoencodingPrior,
    like: Array,
    settings: SolveSettings,
    progress: Progress,
    person: MarkerSubject | None,
) -> Problem:
    from solver_backend.fitters.hands.layer import Hands
    from solver_backend.fitters.hands.shown_hands import split_hands
    from solver_backend.fitters.marker_calibration.marker_problem import marker_problem
    from solver_backend.fitters.measurements.markers import known_markers_of, measure_markers
    from solver_backend.fitters.measurements.sources import LocatedPoints
    from solver_backend.fitters.props.solve_props import Props

    markers, hands = split_hands(cloud, places_given(settings.layout))
    if METHODS[settings.method].finds_shape and person is None:
        problem = Problem.of(body, prior, measure_markers(known_markers_of(markers), body, like))
    else:
        problem = marker_problem(markers, body, prior, like, settings, progress, person)
    source = problem.measurements.source
    assert isinstance(source, LocatedPoints)
    layers: list[Layer] = [] if hands is None else [Hands(hands)]
    layers.append(Props.of(markers, source.labels, settings.layout, others))
    return replace(problem, measurements=replace(problem.measurements, layers=tuple(layers)))


def first_subject(problem: Problem, settings: SolveSettings) -> Subject:
    """Return the known person, else the average one without bias, with the settings' shape if given."""
    if known := problem.measurements.known_person:
        return known
    subject = Subject.average(problem.body, problem.measurements.landmarks, make_origin(settings.backend))
    return subject if settings.betas is None else replace(subject, betas=constant(settings.betas, subject.betas))


def make_origin(backend: str) -> Array:
    """Return an array of the backend's kind, for new arrays to follow."""
    if backend == "numpy":
        return np.zeros(1)
    try:
        import torch
    except ImportError as error:
        raise BackendMissing(
            f"The backend {backend!r} was asked for, and torch is not installed.",
            hint="Install torch in this Python, or use the backend 'numpy'.",
        ) from error
    if backend == "cuda" and not torch.cuda.is_available():
        raise BackendMissing(
            "The backend 'cuda' was asked for, and torch finds no CUDA device.",
            hint="Use the backend 'torch' or 'numpy', or install a driver and a torch build for CUDA.",
        )
    return torch.zeros(1, dtype=torch.float64, device="cuda" if backend == "cuda" else None)
