"""A network of positions alone names points and gives landmarks, and files that are none are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

from dataclasses import replace  # noqa: E402

from solver_backend.cli.main import main  # noqa: E402
from solver_backend.exchange.errors import FileMissing, JobInvalid, WeightsInvalid  # noqa: E402
from solver_backend.exchange.progress import silent  # noqa: E402
from solver_backend.exchange.solve_settings import SolveSettings  # noqa: E402
from solver_backend.fitters.pipeline import prepare  # noqa: E402
from solver_backend.io.markers.read import read_markers, write_markers  # noqa: E402
from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS  # noqa: E402
from solver_backend.labelling.point_network import frame_landmarks  # noqa: E402
from solver_backend.labelling.position_network import GHOST_M, SIGMA_M, chosen_network  # noqa: E402
from solver_backend.priors.weights import ASSETS  # noqa: E402
from solver_backend.synthesis.embedded.demo import record_markers  # noqa: E402
from solver_backend.types import Capture, MarkerCloud  # noqa: E402
from training.landmarks.models import Published  # noqa: E402
from training.landmarks.onnx_export import export_row  # noqa: E402


class Fixed:
    """A session whose network knows where the markers are."""

    def __init__(self, markers: np.ndarray, centre: np.ndarray) -> None:
        self.markers, self.centre = markers, centre

    def run(self, _names, values):
        return [np.tile(self.markers - self.centre, (len(values["points"]), 1, 1)).astype(np.float32)]


def test_points_get_the_label_of_the_nearest_marker_and_far_ones_none() -> None:
    from solver_backend.labelling.position_network import PositionNetwork

    rng = np.random.default_rng(0)
    markers = 0.4 * rng.normal(size=(len(MARKERS), 3)) + [5.0, -2.0, 1.0]
    order = rng.permutation(len(MARKERS))
    stray = markers.max(0) + 3 * GHOST_M
    cloud = np.concatenate([markers[order] + 0.002 * rng.normal(size=markers.shape), stray[None]])
    centre = np.sort(cloud, axis=0)[(len(cloud) - 1) // 2]
    reading = PositionNetwork(Fixed(markers, centre), "0")(cloud[None])
    assert (reading.log_probability[0, :-1].argmax(-1) == order).all()
    assert reading.log_probability[0, -1].argmax() == GHOST
    np.testing.assert_allclose(reading.positions[0, : len(MARKERS)], markers, atol=1e-5)
    assert np.isnan(reading.positions[0, len(MARKERS) :]).all()
    np.testing.assert_allclose(reading.covariance[0, 0], SIGMA_M**2 * np.eye(3), rtol=1e-6)


@pytest.fixture(scope="module")
def row(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a row as training writes it, with random weights."""
    torch.manual_seed(0)
    return str(export_row(Published(2, size=32), tmp_path_factory.mktemp("row") / "row.onnx"))


def test_a_trained_row_is_read_from_its_file(row: str) -> None:
    network = chosen_network(row)
    assert len(network.sha256) == 64
    points = 0.3 * np.random.default_rng(1).normal(size=(3, 53, 3)) + [1.0, 2.0, 1.0]
    found = frame_landmarks(points, network)
    assert found.shape == (3, len(LANDMARKS), 3)
    assert np.isfinite(found[:, : len(MARKERS)]).all()
    assert np.abs(found[:, : len(MARKERS)] - points.mean(1, keepdims=True)).max() < 3.0


def test_the_noise_aware_solver_takes_the_landmarks_of_the_file(row: str) -> None:
    cloud = MarkerCloud(0.3 * np.random.default_rng(1).normal(size=(4, 53, 3)) + [0.0, 0.0, 1.0], 30.0)
    settings = SolveSettings(method="noise-aware", landmarks="network", network=row)
    measured = prepare(Capture("take", markers=cloud), settings, silent).measurements
    assert measured.provenance["landmark_network"] == chosen_network(row).sha256
    assert measured.located.all() and len(measured.landmarks.names) == len(MARKERS)
    with pytest.raises(JobInvalid, match="does not estimate all joints"):
        prepare(Capture("take", markers=cloud), replace(settings, landmarks="network-joints"), silent)


@pytest.mark.slow
def test_a_take_is_labelled_by_the_network_of_a_file(tmp_path: Path) -> None:
    take = record_markers(20, 30.0, layout="MANIFOLD_53").cloud
    cloud = MarkerCloud(take.positions[:, :53], take.fps)
    write_markers(tmp_path / "take.c3d", cloud)
    out = [tmp_path / f"{name}.c3d" for name in ("shipped", "given")]
    verb = ["markers label", str(tmp_path / "take.c3d"), "--out"]
    assert main([*verb, str(out[0])]) == 0
    assert main([*verb, str(out[1]), "--network", str(ASSETS / "landmarks.npz")]) == 0
    assert read_markers(out[0]).cloud.labels == read_markers(out[1]).cloud.labels


def test_the_verb_refuses_a_network_that_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_markers(tmp_path / "take.c3d", record_markers(8, 30.0, layout="MANIFOLD_53").cloud)
    verb = ["markers label", str(tmp_path / "take.c3d"), "--out", str(tmp_path / "out.c3d")]
    assert main([*verb, "--network", str(tmp_path / "none.onnx")]) != 0
    assert "The landmark network is missing" in capsys.readouterr().err
    assert not (tmp_path / "out.c3d").exists()


def test_files_that_are_no_network_are_refused(tmp_path: Path) -> None:
    assert chosen_network() is chosen_network()
    with pytest.raises(FileMissing):
        chosen_network(str(tmp_path / "none.onnx"))
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(WeightsInvalid, match="not a landmark network"):
        chosen_network(str(tmp_path / "text.onnx"))


@pytest.mark.parametrize("shape", [(1, 159), (1, 53, 2), (1, 53, 4), (1, 52, 3), (2, 53, 3)])
def test_networks_of_another_output_are_refused(
    shape: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import onnxruntime

    class Other:
        def __init__(self, *_values, **_options) -> None:
            pass

        def run(self, _names, _values):
            return [np.zeros(shape, np.float32)]

    monkeypatch.setattr(onnxruntime, "InferenceSession", Other)
    path = tmp_path / f"other_{'_'.join(map(str, shape))}.onnx"
    path.write_bytes(b"network")
    with pytest.raises(WeightsInvalid, match="does not estimate the 53 markers") as found:
        chosen_network(str(path))
    assert found.value.hint
