"""The network read in NumPy is the one that was trained, whatever the order and the place of the points."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.labelling.outputs import GHOST, LANDMARKS
from solver_backend.labelling.point_network import PointNetwork, lower_median, network_of

torch = pytest.importorskip("torch")


@pytest.fixture(scope="module")
def trained():
    from training.landmarks.models import PointNet, PointNetWidths

    torch.manual_seed(3)
    return PointNet(PointNetWidths(width=32, layers=2, heads=4))


@pytest.fixture(scope="module")
def network(trained) -> PointNetwork:
    return network_of({name: value.numpy() for name, value in trained.state_dict().items()})


@pytest.fixture
def clouds() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return 0.5 * rng.normal(size=(3, 20, 3)), rng.random((3, 20)) < 0.8


def test_numpy_says_what_torch_says(trained, network, clouds):
    points, seen = clouds
    centre = lower_median(points, seen)
    local = torch.as_tensor(np.where(seen[..., None], points - centre, 0.0), dtype=torch.float32)
    with torch.no_grad():
        told = trained(local, torch.as_tensor(seen))
    reading = network(points, seen)
    assert np.abs(reading.scores - told.scores.numpy())[seen].max() < 1e-4
    assert np.abs(reading.positions - centre - told.positions.numpy()).max() < 1e-4
    assert np.abs(reading.spread - told.spread.numpy()).max() < 1e-4


def test_order_and_place_do_not_matter(network, clouds):
    points, seen = clouds
    order = np.random.default_rng(1).permutation(20)
    here, there = network(points, seen), network(points[:, order] + (3.0, -2.0, 1.0), seen[:, order])
    assert np.abs(here.scores[:, order] - there.scores)[seen[:, order]].max() < 1e-4
    assert np.abs(here.positions + (3.0, -2.0, 1.0) - there.positions).max() < 1e-4


def test_points_that_are_not_there_say_nothing(network, clouds):
    points, seen = clouds
    moved = np.where(seen[..., None], points, 99.0)
    assert np.array_equal(network(points, seen).positions, network(moved, seen).positions)
    one = network(points[:1, seen[0]])
    assert np.abs(one.scores[0] - network(points, seen).scores[0, seen[0]]).max() < 1e-4


def test_covariances_are_positive_definite_and_follow_the_factor(network, clouds):
    reading = network(*clouds)
    covariance = reading.covariance
    assert covariance.shape == (3, len(LANDMARKS), 3, 3)
    assert np.linalg.eigvalsh(covariance).min() > 0
    wide = np.exp(-2.0 * np.clip(reading.spread[..., :3], -4, 5).sum(-1)) * 2.0**3 * 0.1**6
    assert np.allclose(np.linalg.det(covariance), wide, rtol=1e-4)


def test_probabilities_sum_to_one(network, clouds):
    reading = network(*clouds)
    assert reading.scores.shape[-1] == GHOST + 1
    assert np.allclose(np.exp(reading.log_probability).sum(-1), 1.0, atol=1e-5)


def test_other_weights_are_refused(trained):
    arrays = {name: value.numpy() for name, value in trained.state_dict().items()}
    with pytest.raises(WeightsInvalid):
        network_of({"embed.weight": np.zeros((3, 3))})
    with pytest.raises(WeightsInvalid):
        network_of({**arrays, "missing": np.full_like(arrays["missing"], np.nan)})
