"""The verbs of cameras: board, cameras calibrate, cameras check."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.camera_calibration.intrinsics.known_lenses import read_lenses
from solver_backend.cameras.projection import project
from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.events import what_is_wrong
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.recordings import recordings_folder
from tests.support.trial_files import write_trial
from tests.support.walking_take import EXACT, walk


def said(capsys: pytest.CaptureFixture[str]) -> dict:
    return json.loads(capsys.readouterr().out.strip().splitlines()[-1])


def test_a_board_is_written_with_the_file_that_tells_it(tmp_path: Path, capsys) -> None:
    out = tmp_path / "board.svg"
    assert main(["cameras board", "checkerboard:8x5:30mm", "--paper", "A3", "--out", str(out), "--json"]) == 0
    assert said(capsys)["page_mm"] in ([297.0, 420.0], [420.0, 297.0])
    assert out.read_text().startswith("<svg") and out.with_suffix(".toml").exists()
    assert main(["cameras board", "checkerboard:8x5:30mm", "--out", str(out), "--json"]) == 3
    assert said(capsys)["code"] == "output_exists"
    assert main(["cameras board", "checkerboard:8x5:30mm", "--out", str(tmp_path / "b.docx"), "--json"]) == 2


@pytest.mark.slow
def test_a_capture_calibrates_its_cameras_anew_and_is_checked(tmp_path: Path, capsys) -> None:
    capture = benchmark_capture(walk(60), BenchmarkSettings(detector=EXACT, calibration_mm=0.0, anatomy_mm=0.0))
    path, out = tmp_path / "take.npz", tmp_path / "rig.toml"
    write_capture(path, capture)
    for method in ("person", "refine"):
        arguments = ["cameras calibrate", str(path), "--from", method, "--out", str(out), "--overwrite", "--json"]
        assert main(arguments) == 0
        found = said(capsys)
        assert found["method"] == method and found["rmse_px"] < 0.5
        assert read_calibration(out).cameras.names == capture.cameras.names
    assert np.abs(read_calibration(out).cameras.centres - capture.cameras.centres).max() < 0.01
    assert main(["cameras check", str(path), "--json"]) == 0
    assert said(capsys)["median_px"] < 0.5


@pytest.mark.slow
def test_a_calibration_is_written_as_it_is_meant(tmp_path: Path, capsys) -> None:
    cameras, keypoints = demo_capture(num_frames=60).require_multiview()
    trial, out = tmp_path / "trial", tmp_path / "meant.toml"
    in_cm = replace(cameras, t=100 * cameras.t)
    seen = [((keypoints.xy + 0.5) / 2 - 0.5, keypoints.confidence)]
    write_trial(trial, cameras=in_cm, people=seen, names=cameras.names, calibrated=cameras.names)
    assert main(["cameras fit", str(trial), "--out", str(out), "--json"]) == 0
    found = said(capsys)
    assert what_is_wrong(found, "cameras fit") == "" and found["cameras"] == list(cameras.names)
    assert [any(word in problem for problem in found["problems"]) for word in ("0.5 times", "interpreted as cm")] == [
        True,
        True,
    ]
    meant = read_calibration(out).cameras
    np.testing.assert_allclose(meant.centres, cameras.centres, atol=1e-3)
    np.testing.assert_allclose(meant.K[:, 0, 0], cameras.K[:, 0, 0] / 2, rtol=1e-6)
    assert main(["cameras check", str(trial), "--json"]) == 0
    checked = said(capsys)
    assert what_is_wrong(checked, "cameras check") == ""
    assert any("0.5 times" in problem for problem in checked["problems"])
    assert {"calibration_corrected", "unit_by_person"} <= {item["code"] for item in checked["capture_diagnostics"]}
    assert main(["cameras check", str(trial)]) == 0
    assert "0.5 times" in capsys.readouterr().out
    # Read again with what was written, nothing is left to correct.
    (trial / "calibration" / "Calib.toml").write_text(out.read_text())
    assert main(["info", str(trial), "--json"]) == 0
    assert not any("correct" in problem or "interpreted as cm" in problem for problem in said(capsys)["problems"])
    assert main(["cameras fit", str(trial), "--out", str(out), "--json"]) == 3
    assert said(capsys)["code"] == "output_exists"


def test_what_a_method_lacks_is_named(tmp_path: Path, capsys) -> None:
    clicks, out = tmp_path / "clicks.csv", str(tmp_path / "rig.toml")
    clicks.write_text("p,cam,1,2\n")
    assert main(["cameras calibrate", str(clicks), "--from", "points", "--out", out, "--json"]) == 2
    assert "--lenses" in said(capsys)["hint"]
    assert main(["cameras calibrate", str(tmp_path), "--out", out, "--json"]) == 2
    assert "--board" in said(capsys)["hint"]
    arguments = ["cameras calibrate", str(tmp_path), "--board", "charuco:5x7:35mm", "--out", out, "--json"]
    assert main(arguments) == 3
    assert said(capsys)["code"] == "capture_not_recognised"
    assert (
        main(["cameras calibrate", str(tmp_path / "none"), "--board", "charuco:5x7:35mm", "--out", out, "--json"]) == 3
    )
    assert said(capsys)["code"] == "file_missing"
    assert not Path(out).exists()


@pytest.mark.slow
def test_lenses_of_real_pictures_go_into_a_library_and_out_again(tmp_path: Path, capsys) -> None:
    pytest.importorskip("cv2", reason="the extra capture is not installed")
    pictures = recordings_folder() / "multiview" / "pose2sim" / "S00_Calibration"
    if not pictures.is_dir():
        pytest.skip("The recordings are not here.")
    folder = tmp_path / "intrinsics"
    folder.mkdir()
    (folder / "int_cam02_img").symlink_to(pictures / "intrinsics" / "int_cam02_img")
    library = tmp_path / "lenses.json"
    arguments = ["--from", "lenses", "--board", "checkerboard:5x8:60mm", "--lens", "radial2", "--out", str(library)]
    arguments += ["--coverage", str(tmp_path / "boards")]
    assert main(["cameras calibrate", str(tmp_path), *arguments, "--json"]) == 0
    assert [path.name for path in (tmp_path / "boards").iterdir()] == ["cam02.png"]
    told = said(capsys)["cameras"]["cam02"]
    assert told["held_out_px"] < 0.3
    assert told["findings"]
    lens = read_lenses(library)["cam02"]
    kept = read_calibration(pictures / "Calib.qca.txt").cameras
    assert abs(lens.K[0, 0] / kept.K[1, 0, 0] - 1) < 0.01
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(FileDamaged, match="not a lens library"):
        read_lenses(tmp_path / "other.json")


@pytest.mark.slow
def test_lenses_of_another_calibration_are_used(tmp_path: Path, capsys) -> None:
    capture = benchmark_capture(walk(60), BenchmarkSettings(detector=EXACT, calibration_mm=0.0, anatomy_mm=0.0))
    path, lenses, out = tmp_path / "take.npz", tmp_path / "lenses.toml", tmp_path / "rig.yml"
    write_capture(path, capture)
    write_calibration(lenses, capture.cameras)
    length = ["--length", "left_knee", "left_ankle", "0.5"]
    arguments = ["cameras calibrate", str(path), "--from", "person", "--lenses", str(lenses), *length]
    assert main([*arguments, "--out", str(out), "--json"]) == 0
    assert "0.5 m" in said(capsys)["notes"][0]
    found = read_calibration(out).cameras
    assert np.abs(found.K - capture.cameras.K).max() < 1e-6


@pytest.mark.slow
def test_an_earlier_calibration_a_take_and_clicks_are_adjusted_together(tmp_path: Path, capsys) -> None:
    truth = benchmark_capture(walk(60), BenchmarkSettings(detector=EXACT, calibration_mm=0.0, anatomy_mm=0.0))
    path, start, out, clicks = (tmp_path / name for name in ("take.npz", "start.toml", "rig.toml", "clicks.csv"))
    write_capture(path, truth)
    cameras = truth.cameras
    shift = np.random.default_rng(0).normal(0, 0.02, cameras.t.shape)
    write_calibration(start, replace(cameras, t=cameras.t + shift))
    places = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.2)]
    px = project(cameras, np.array(places))
    rows = [f"p{i},world,{x},{y},{z}" for i, (x, y, z) in enumerate(places)]
    rows += [f"p{i},{name},{u},{v}" for name, seen in zip(cameras.names, px, strict=True)
             for i, (u, v) in enumerate(seen)]  # fmt: skip
    clicks.write_text("\n".join(rows))
    verb = ["cameras calibrate", str(start), "--from", "together", "--out", str(out), "--json"]
    assert main([*verb, "--take", str(path), "--clicks", str(clicks)]) == 0
    found = said(capsys)
    assert found["method"] == "together" and len(found["notes"]) == 3 and found["findings"] == []
    assert np.abs(read_calibration(out).cameras.centres - cameras.centres).max() < 0.003
    assert max(camera["centre_sigma_mm"] for camera in found["cameras"]) < 20.0
    assert main([*verb, "--overwrite"]) == 2
    assert "--footage" in said(capsys)["hint"]
    assert main([*verb, "--overwrite", "--take", str(path), "--hold", "-1"]) == 2
    clicks.write_text("p0,elsewhere,1,2\n")
    assert main([*verb, "--overwrite", "--clicks", str(clicks)]) == 3
    assert said(capsys)["code"] == "calibration_mismatch"
