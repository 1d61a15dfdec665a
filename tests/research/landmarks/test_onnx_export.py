"""The ONNX file says what NumPy says."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

torch = pytest.importorskip("torch")
runtime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from research.landmarks.onnx_export import export_onnx, torch_network  # noqa: E402
from solver_backend.labelling.point_network import lower_median, network_of  # noqa: E402
from solver_backend.training.landmarks.point_net import PointNet, PointNetWidths  # noqa: E402


def test_onnx_is_numpy_to_a_ten_thousandth(tmp_path):
    torch.manual_seed(0)
    module = PointNet(PointNetWidths(32, 2, 4))
    network = network_of({name: value.numpy() for name, value in module.state_dict().items()})
    assert all(torch.equal(a, b) for a, b in zip(torch_network(network).parameters(), module.parameters(), strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = export_onnx(network, tmp_path / "landmarks.onnx")
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    for clouds, points in ((1, 53), (3, 20)):
        cloud, seen = rng.normal(0, 0.5, (clouds, points, 3)), rng.random((clouds, points)) < 0.9
        centre = lower_median(cloud, seen)
        local = np.where(seen[..., None], cloud - centre, 0.0).astype(np.float32)
        scores, _, positions, spread = session.run(None, {"points": local, "seen": seen})
        reading = network(cloud, seen)
        assert np.abs(scores - reading.scores)[seen].max() < 1e-4
        assert np.abs(positions + centre - reading.positions).max() < 1e-4
        assert np.abs(spread - reading.spread).max() < 1e-4
