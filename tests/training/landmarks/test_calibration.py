"""Label scores are brought to what recordings show by the weights alone, and nothing else is touched."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from solver_backend.labelling.point_network import network_of  # noqa: E402
from training.landmarks.models import PointNet, PointNetWidths  # noqa: E402
from training.landmarks.train import GHOST_LOGIT, TEMPERATURE, calibrated  # noqa: E402


def test_scores_are_divided_and_ghosts_lowered() -> None:
    torch.manual_seed(0)
    net = PointNet(PointNetWidths(width=32, layers=2, heads=4))
    torch.nn.init.normal_(net.missing)
    arrays = {name: value.detach().numpy().copy() for name, value in net.state_dict().items()}
    points = np.random.default_rng(0).normal(size=(2, 9, 3))
    before, after = (network_of(a, "")(points) for a in (arrays, calibrated(arrays)))
    wanted = before.scores / TEMPERATURE
    wanted[..., -1] -= GHOST_LOGIT
    np.testing.assert_allclose(after.scores, wanted, atol=1e-4)
    np.testing.assert_allclose(after.missing, before.missing / TEMPERATURE, atol=1e-6)
    np.testing.assert_array_equal(after.positions, before.positions)
