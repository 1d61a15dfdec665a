"""ONNX files give what NumPy and torch give, for any number of clouds and points."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")
runtime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from solver_backend.cli.main import main  # noqa: E402
from solver_backend.labelling.outputs import MARKERS  # noqa: E402
from solver_backend.labelling.point_network import lower_median, network_of  # noqa: E402
from training.landmarks.cloud_stream import Clouds  # noqa: E402
from training.landmarks.models import DemocapLike, FromCoordinates, LandmarkModel, PointNet, PointNetWidths, Published  # noqa: E402  # noqa: E402
from training.landmarks.onnx_export import export_point_network, export_row, torch_network  # noqa: E402
from training.landmarks.rows import Row  # noqa: E402


def test_onnx_is_numpy_to_a_ten_thousandth(tmp_path):
    torch.manual_seed(0)
    module = PointNet(PointNetWidths(32, 2, 4))
    network = network_of({name: value.numpy() for name, value in module.state_dict().items()})
    assert all(torch.equal(a, b) for a, b in zip(torch_network(network).parameters(), module.parameters(), strict=True))
    path = export_point_network(network, tmp_path / "landmarks.onnx")
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


def bodies(clouds: int, points: int):
    generator = torch.Generator().manual_seed(clouds)
    cloud = torch.randn(clouds, points, 3, generator=generator) * torch.tensor([0.4, 0.2, 0.6]) + 0.3
    return cloud, torch.rand(clouds, points, generator=generator) < 0.9


@pytest.mark.parametrize("model", [Published(2, size=32), DemocapLike(2, size=32), FromCoordinates(8)])
def test_a_row_is_written_with_its_drawing_and_decoding(tmp_path, model: LandmarkModel):
    torch.manual_seed(1)
    for name, parameter in model.named_parameters():
        torch.nn.init.normal_(parameter, std=20.0 if "predict" in name else 0.2)  # sharp maps: centres differ
    session = runtime.InferenceSession(
        str(export_row(model, tmp_path / "row.onnx")), providers=["CPUExecutionProvider"]
    )
    for clouds, points in ((1, 53), (3, 20)):
        cloud, seen = bodies(clouds, points)
        (found,) = session.run(None, {"points": cloud.numpy(), "seen": seen.numpy()})
        with torch.no_grad():
            expected = model.positions(Clouds(cloud, seen, seen, cloud, seen)).numpy()
        assert found.shape == (clouds, len(model.columns), 3) and np.ptp(expected, axis=1).max() > 0.01
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_the_verb_writes_a_trained_row_and_names_its_landmarks(tmp_path, capsys):
    folder, out = tmp_path / "run", tmp_path / "row.onnx"
    assert main(["train export", str(folder), "--out", str(out), "--json"]) != 0
    assert "no trained landmark network" in capsys.readouterr().out
    model = Row("published", 2, resolution=32).model()
    folder.mkdir()
    np.savez(folder / "weights.npz", **{name: value.numpy() for name, value in model.state_dict().items()})
    for width, code in ((4, 3), (2, 0)):
        row = {"network": "published", "width": width, "resolution": 32}
        (folder / "figures.json").write_text(json.dumps({"row": row}))
        assert main(["train export", str(folder), "--out", str(out), "--json"]) == code
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert len(answer["landmarks"]) == 71 and answer["landmarks"][:2] == list(MARKERS[:2])
    session = runtime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    cloud, seen = bodies(2, 53)
    assert session.run(None, {"points": cloud.numpy(), "seen": seen.numpy()})[0].shape == (2, 71, 3)
