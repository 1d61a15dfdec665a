from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.filming import around
from solver_backend.cameras.noise_map import NoiseMap, read_noise_map
from solver_backend.cameras.projection import project
from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileDamaged, NoDetections, TooFewViews
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Capture, JointSet, Keypoints2D
from solver_backend.videos.detect.measure_noise_map import measure_noise_map


def capture(views: int = 5, frames: int = 250, scatter: float = 1.0) -> Capture:
    """Return a capture whose keypoints scatter by 24 mm at confidence 0.2, falling to 6 mm at 1."""
    rng = np.random.default_rng(4)
    cameras = around(np.array([[0.0, 0.0, 1.0]] * 2), views)
    drift = np.cumsum(rng.normal(0, 0.01, (frames, 1, 3)), axis=0)
    points = rng.uniform([-0.4, -0.4, 0.1], [0.4, 0.4, 1.7], (17, 3)) + drift
    px = project(cameras, points)
    confidence = rng.uniform(0.2, 1.0, px.shape[:-1])
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    sigma_px = true_mm(confidence) / (1000.0 * depth / cameras.K[:, 0, 0, None, None])
    xy = px + scatter * sigma_px[..., None] * rng.normal(size=px.shape)
    return Capture("known", cameras, Keypoints2D(xy, confidence, JointSet.COCO_17, 60.0), detector="toy 1")


def true_mm(confidence: np.ndarray) -> np.ndarray:
    return 6.0 + 18.0 * (1.0 - confidence) / 0.8


@pytest.mark.slow
def test_the_spread_at_each_confidence_is_recovered() -> None:
    found = measure_noise_map([capture()], "toy")
    assert found.detections > 15_000 and (np.diff(found.sigma_mm) <= 0).all()
    np.testing.assert_allclose(found.sigma_mm, true_mm(found.confidence), rtol=0.15)
    weight = found.weight(np.array([0.0, 0.25, 0.95]))
    assert weight[0] == 0.0 and weight[2] / weight[1] == pytest.approx((22.9**2 + 64.0) / (7.1**2 + 64.0), rel=0.3)


def test_detections_of_one_place_tell_no_spread() -> None:
    known = capture(frames=20)
    assert known.keypoints is not None
    still = replace(known, keypoints=replace(known.keypoints, xy=np.full_like(known.keypoints.xy, 300.0)))
    with pytest.raises(NoDetections, match="No detection can be compared"):
        measure_noise_map([still], "toy")


def test_two_views_tell_no_spread() -> None:
    with pytest.raises(TooFewViews, match="3 cameras"):
        measure_noise_map([capture(views=2)], "toy")


@pytest.mark.slow
def test_the_verb_writes_what_is_read_and_names_the_detector(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_capture(tmp_path / "c.npz", capture(frames=60))
    out = tmp_path / "noise.json"
    assert main(["cameras noise", str(tmp_path / "c.npz"), "--out", str(out), "--json"]) == 0
    found = read_noise_map(out)
    assert found.detector == "toy 1" == json.loads(capsys.readouterr().out.splitlines()[-1])["detector"]
    keypoints, note = found.applied(capture(frames=4).keypoints, "other 2")
    assert note.values["detector"] == "other 2" and keypoints.confidence.max() > 1.0 > keypoints.confidence.min()


@pytest.mark.parametrize("text", ["", "[]", '{"format": "manifold_mocap_detector_noise"}', "\x00"])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "n.json").write_text(text, encoding="utf-8")
    with pytest.raises(FileDamaged, match="not a detector noise map|is not JSON"):
        read_noise_map(tmp_path / "n.json")


def test_values_that_cannot_be_are_refused(tmp_path: Path) -> None:
    good = NoiseMap("d", np.array([0.2, 0.9]), np.array([20.0, 5.0])).as_dict()
    for change, why in (
        ({"sigma_mm": [5.0, -1.0]}, "must be above 0"),
        ({"sigma_mm": [20.0, 1e9]}, "at most 10000"),
        ({"sigma_mm": [5.0, 20.0]}, "rises with the confidence"),
        ({"confidence": [0.9, 0.2]}, "not in ascending order"),
        ({"sigma_mm": [1.0]}, "2 confidences and 1 values"),
        ({"sigma_mm": [], "confidence": []}, "has 0 steps"),
        ({"sigma_mm": "none"}, "sigma_mm is not a list of finite numbers"),
        ({"confidence": [True, 1.0]}, "confidence is not a list"),
        ({"captures": [3]}, "captures is not a list of names"),
        ({"detections": -1}, "detections is not a whole number"),
        ({"detector": None}, "detector is not a name"),
        ({"version": 2}, "version 2, but 1 is needed"),
        ({"format": "x"}, "its format is not"),
    ):
        (tmp_path / "n.json").write_text(json.dumps({**good, **change}), encoding="utf-8")
        with pytest.raises(FileDamaged, match=why):
            read_noise_map(tmp_path / "n.json")
    del good["sigma_mm"]
    (tmp_path / "n.json").write_text(json.dumps(good), encoding="utf-8")
    with pytest.raises(FileDamaged, match="it has no sigma_mm"):
        read_noise_map(tmp_path / "n.json")


def test_weighted_confidences_are_not_measured_again(tmp_path: Path) -> None:
    weighted = replace(capture(frames=20), noise_map="a")
    write_capture(tmp_path / "c.npz", weighted)
    assert main(["cameras noise", str(tmp_path / "c.npz"), "--out", str(tmp_path / "noise.json")]) == 2
    assert not (tmp_path / "noise.json").exists()


def test_a_detector_that_errs_nowhere_has_a_map(tmp_path: Path) -> None:
    exact = measure_noise_map([capture(frames=30, scatter=0.0)], "toy")
    (tmp_path / "n.json").write_text(json.dumps(exact.as_dict()), encoding="utf-8")
    assert (read_noise_map(tmp_path / "n.json").sigma_mm < 0.1).all()
