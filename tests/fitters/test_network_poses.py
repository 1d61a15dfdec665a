"""A network's result joins the detections of its camera, weighted by what the take shows, or is refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import JobInvalid, MotionInvalid
from solver_backend.exchange.progress import silent
from solver_backend.fitters.network_poses import NetworkPoses, with_network_results
from solver_backend.fitters.one_view.depth import OneCamera
from solver_backend.fitters.one_view.measure import measure_one_view
from solver_backend.fitters.problem import Measurements
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.types import Capture
from solver_backend.types.network_result import NetworkResult, StartingResult
from tests.support.simulated_network import simulate_network

LIKE = np.zeros(1)


class Filmed:
    """A capture of one camera, its measurements, and a network's result."""

    def __init__(self) -> None:
        whole = demo_capture(120, 30.0)
        assert whole.truth is not None and whole.cameras is not None
        self.body, truth = load_body(), whole.truth
        local = np.asarray(exp_so3(np.asarray(truth["body_pose"]).reshape(120, -1, 3)[:, :21]))
        orient = np.asarray(exp_so3(truth["global_orient"]))
        self.person = Person(self.body, truth["betas"], orient, local, truth["transl"])
        self.whole, self.capture = whole, whole.views([0])
        self.prior = prior_on_body(load_sposer(), self.body.layout)
        self.measured = measure_one_view(self.capture, self.body, self.prior, LIKE, None, silent)
        rng = np.random.default_rng(3)
        self.simulated = simulate_network(self.body, self.person, whole.cameras, 0, 30.0, rng)

    def joined(self, *people: NetworkResult, camera: str = "", capture: Capture | None = None) -> Measurements:
        """Return the measurements with a result."""
        result = StartingResult(people, "result.pt", camera)
        return with_network_results(self.measured, capture or self.capture, self.body, self.prior, [result], LIKE)


@pytest.fixture(scope="module")
def filmed() -> Filmed:
    return Filmed()


def _note(measured: Measurements) -> dict[str, object]:
    return measured.provenance["diagnostics"][-1]["values"]


def test_the_covariance_comes_from_the_take(filmed: Filmed) -> None:
    good, noisy = filmed.simulated.result, filmed.simulated.result
    shaken = noisy.local.copy()
    shaken[:, 1:] = shaken[:, 1:] @ exp_so3(0.12 * np.random.default_rng(1).standard_normal((120, 21, 3)))
    sigmas = []
    for person in (good, replace(noisy, local=shaken)):
        layer = filmed.joined(person).layers[0]
        assert isinstance(layer, NetworkPoses)
        sigmas.append(np.median(layer.sigma_m, axis=0))
    assert 0.01 < sigmas[0][0] < 0.06 and (sigmas[1] > 1.2 * sigmas[0]).all()


def test_frames_are_matched_by_number_rate_and_shift(filmed: Filmed) -> None:
    person = filmed.simulated.result
    assert _note(filmed.joined(person))["reason"] == ""
    later = replace(person.of_frames(np.arange(20, 120)), frames=np.arange(100))
    assert "its frame -20 is the take's first" in _note(filmed.joined(later))["reason"]
    slow = replace(person.of_frames(np.arange(0, 120, 2)), frames=np.arange(60))
    assert "its 60 frames cover the take's 120" in _note(filmed.joined(slow))["reason"]


def test_the_person_who_fits_is_chosen(filmed: Filmed) -> None:
    person = filmed.simulated.result
    other = replace(person, person="other", local=person.local[::-1].copy())
    joined = filmed.joined(other, replace(person, person="right"))
    assert "person right of 2 fits best" in _note(joined)["reason"]


def test_wrong_results_are_refused_by_name(filmed: Filmed) -> None:
    person, rng = filmed.simulated.result, np.random.default_rng(2)
    turned = np.asarray(exp_so3(0.8 * rng.standard_normal((120, 22, 3))))
    with pytest.raises(MotionInvalid, match="from the camera's keypoints in every alignment"):
        filmed.joined(replace(person, local=person.local @ turned))
    left, right = (
        np.array([k for k, name in enumerate(filmed.body.layout.joints[:22]) if name.startswith(side)])
        for side in ("left", "right")
    )
    mirrored = np.diag([-1.0, 1.0, 1.0]) @ person.local @ np.diag([-1.0, 1.0, 1.0])
    mirrored[:, np.concatenate([left, right])] = mirrored[:, np.concatenate([right, left])]
    with pytest.raises(MotionInvalid, match="mirrored"):
        filmed.joined(replace(person, local=mirrored))
    with pytest.raises(MotionInvalid, match="too few frames"):
        filmed.joined(person.of_frames(np.arange(3)))
    with pytest.raises(JobInvalid, match="no camera 'cam9'"):
        filmed.joined(person, camera="cam9")
    with pytest.raises(JobInvalid, match="Several cameras see the person"):
        filmed.joined(person, capture=filmed.whole)


def test_the_size_follows_from_both_poses(filmed: Filmed) -> None:
    assert filmed.whole.cameras is not None
    root = filmed.whole.cameras.R[0] @ filmed.person.orient
    exact = replace(filmed.simulated.result, local=np.concatenate([root[:, None], filmed.person.local], axis=1))
    true, off = filmed.body.stature_of(filmed.person.betas), list[float]()
    for measured in (filmed.measured, filmed.joined(exact)):
        assert measured.known_person is not None
        off.append(abs(filmed.body.stature_of(np.asarray(measured.known_person.betas)) / true - 1.0))
    assert off[1] < 0.7 * off[0]


def test_another_size_keeps_the_result(filmed: Filmed) -> None:
    joined = filmed.joined(filmed.simulated.result)
    assert isinstance(joined.source, OneCamera) and filmed.whole.cameras is not None
    root = filmed.whole.cameras.R[0] @ filmed.person.orient
    true = replace(joined.source.take, view=replace(joined.source.take.view, root=root), local=filmed.person.local)
    again = joined.source.sized_by(true)
    assert isinstance(again.layers[0], NetworkPoses) and _note(again).keys() == _note(joined).keys()
    assert again.known_person is not None
    stature = filmed.body.stature_of(np.asarray(again.known_person.betas))
    assert abs(stature / filmed.body.stature_of(filmed.person.betas) - 1.0) < 0.01  # The true poses give the true size.
