"""Lenses and camera poses from a carried board: known truths are recovered, impossible footage is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, lens_of
from solver_backend.camera_calibration.boards import footage as board_files
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.footage import BoardFootage
from solver_backend.camera_calibration.extrinsics.board_session import (
    calibrate_by_board,
    calibrate_from_board,
    zoom_doubts,
)
from solver_backend.camera_calibration.extrinsics.two_views import result_of
from solver_backend.camera_calibration.intrinsics.lens_fit import advice, camera_lens, fitted_lens
from solver_backend.exchange.diagnostics import diagnostic, sentence, word
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras
from tests.support.carried_board import BOARD, carried, ring

SIZE = (1280, 720)


def apart(found: Cameras, truth: Cameras) -> tuple[float, float]:
    """Return the largest distance of centres in mm and of directions in degrees, after a rigid alignment."""
    _, R, t = umeyama(found.centres, truth.centres)
    far = np.linalg.norm(found.centres @ R.T + t - truth.centres, axis=1).max()
    turn = log_so3(truth.R @ R @ np.swapaxes(found.R, 1, 2))
    return 1000 * float(far), float(np.degrees(np.linalg.norm(turn, axis=1).max()))


@pytest.mark.parametrize("model", ["pinhole4", "fisheye"])
def test_a_lens_is_recovered(model: str) -> None:
    bent = (
        (-0.12, 0.08, 0.0008, -0.0005, 0, 0, 0, 0) if model == "pinhole4" else (0.05, -0.02, 0.01, -0.002, 0, 0, 0, 0)
    )
    cameras = ring(1, LENS_MODELS[model].distortion_model, radius=1.6, lens=bent)
    views = list(carried(cameras, 200, noise_px=0.1)[0].values())[::6]
    fit = fitted_lens(BOARD, views, SIZE, LENS_MODELS[model])
    assert abs(fit.lens.K[0, 0] / 1100 - 1) < 0.005
    assert np.abs(fit.lens.K[:2, 2] - [639.5, 359.5]).max() < 4.0
    assert fit.rmse_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert 0.2 < abs(fit.lens.K[0, 0] - 1100) / fit.focal_sigma_px + 0.2 < 4.0


def test_the_simplest_model_that_predicts_is_chosen_and_a_bad_picture_left_out() -> None:
    views = carried(ring(1, radius=1.6, lens=(-0.2, 0.1, 0, 0, 0, 0, 0, 0)), 160, noise_px=0.1)[0]
    frames = sorted(views)[::10]
    some = {f: views[f] for f in frames}
    bad = frames[3]
    some[bad] = replace(some[bad], px=some[bad].px + np.random.default_rng(0).normal(0, 8, some[bad].px.shape))
    found = camera_lens(BOARD, some, SIZE, ("radial2", "pinhole5", "fisheye"))
    assert found.left_out == (bad,)
    assert found.fit.model.name == "radial2"
    assert found.held_out < 0.2


def test_what_to_film_again_is_named_with_its_camera() -> None:
    views = list(carried(ring(1, radius=1.6), 40, noise_px=0.1)[0].values())[:3]
    found = advice(views, SIZE, 1, "left")
    assert {"board_views_weak"} <= {item.code for item in found}
    assert all(item.where.cameras == ("left",) for item in found)
    assert word(found[0]).what == "left: only 3 images show the board."
    assert diagnostic("board_views_weak", lack="tilts", cameras=["left"], count=1) in found


def test_a_rig_is_recovered() -> None:
    cameras = ring(4)
    lenses = [lens_of(cameras, c) for c in range(4)]
    rig = calibrate_from_board(cameras.names, lenses, BOARD, carried(cameras, 40, seed=2))
    far, turned = apart(rig.adjusted.cameras, cameras)
    assert far < 1.0
    assert turned < 0.03
    sigma = 1000 * float(result_of("board", rig.adjusted).centre_sigma_m.max())
    assert 0.2 < far / sigma < 3.0
    assert rig.adjusted.rmse_px == pytest.approx(0.15 * np.sqrt(2), rel=0.1)


def test_delays_of_cameras_are_found() -> None:
    cameras = ring(3)
    lenses = [lens_of(cameras, c) for c in range(3)]
    late = (0.0, 0.012, -0.009)
    seen = carried(cameras, 50, delays_s=late, fps=30.0)
    blind = calibrate_from_board(cameras.names, lenses, BOARD, seen)
    rig = calibrate_from_board(cameras.names, lenses, BOARD, seen, fps=30.0)
    assert np.abs(rig.adjusted.delays - late).max() < 0.001
    assert rig.adjusted.rmse_px < 0.5 * blind.adjusted.rmse_px
    assert apart(rig.adjusted.cameras, cameras)[0] < 3.0


def test_cameras_that_never_see_it_together_are_named() -> None:
    cameras = ring(4)
    seen = carried(cameras, 40)
    early = [{f: s for f, s in by.items() if (f < 20) == (c < 2)} for c, by in enumerate(seen)]
    lenses = [lens_of(cameras, c) for c in range(4)]
    with pytest.raises(CalibrationInvalid, match="cam1, cam2 never see the target at the same time as cam3, cam4"):
        calibrate_from_board(cameras.names, lenses, BOARD, early)
    with pytest.raises(CalibrationInvalid, match="never see the target"):
        calibrate_from_board(cameras.names, lenses, BOARD, [{}] * 4)
    even = Board("checkerboard", 6, 8, 0.05)
    with pytest.raises(CalibrationInvalid, match="half a turn"):
        calibrate_from_board(cameras.names, lenses, even, seen)


def test_a_lens_of_another_zoom_is_named() -> None:
    cameras = ring(3)
    seen = carried(cameras, 30)
    lenses = [lens_of(cameras, c) for c in range(3)]
    K = lenses[1].K * np.array([[1.15, 1, 1], [1, 1.15, 1], [1, 1, 1]])
    wrong = [lenses[0], replace(lenses[1], K=K), lenses[2]]
    assert zoom_doubts(calibrate_from_board(cameras.names, lenses, BOARD, seen)) == ()
    [finding] = zoom_doubts(calibrate_from_board(cameras.names, wrong, BOARD, seen))
    assert sentence(finding).startswith("cam2 has a focal length of 11")
    assert "1288 px in the lens calibration" in sentence(finding)


def test_too_few_pictures_are_named() -> None:
    views = list(carried(ring(1, radius=1.6), 10)[0].values())[:2]
    with pytest.raises(CalibrationInvalid, match="2 images"):
        fitted_lens(BOARD, views, SIZE, LENS_MODELS["radial2"])


def filmed_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seen: dict[str, dict]) -> BoardFootage:
    """Return footage whose pictures say what is told here."""
    footage = {name: tmp_path / f"{name}.mp4" for name in seen}
    monkeypatch.setattr(board_files, "find_boards", lambda path, board: (seen[path.stem], SIZE))
    return BoardFootage({}, footage)


def test_a_mirrored_camera_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = ring(3)
    seen = dict(zip(cameras.names, carried(cameras, 30), strict=True))
    lenses = {name: lens_of(cameras, c) for c, name in enumerate(cameras.names)}
    some = sorted(seen["cam2"])
    few = {f: replace(s, mirrored=f in some[:2]) for f, s in seen["cam2"].items()}
    found = calibrate_by_board(filmed_folder(tmp_path, monkeypatch, {**seen, "cam2": few}), BOARD, lenses)
    assert diagnostic("board_mirrored", cameras=["cam2"], count=2) in found.findings
    seen["cam2"] = {f: replace(s, mirrored=True) for f, s in seen["cam2"].items()}
    with pytest.raises(CalibrationInvalid, match="The board is mirrored") as caught:
        calibrate_by_board(filmed_folder(tmp_path, monkeypatch, seen), BOARD, lenses)
    assert caught.value.where == "camera cam2"


def test_a_board_nowhere_found_and_a_camera_alone_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = ring(3)
    seen = dict(zip(cameras.names, carried(cameras, 30), strict=True))
    lenses = {name: lens_of(cameras, c) for c, name in enumerate(cameras.names) if name != "cam2"}
    with pytest.raises(CalibrationInvalid) as caught:
        calibrate_by_board(filmed_folder(tmp_path, monkeypatch, {**seen, "cam2": {}}), BOARD, lenses)
    assert caught.value.where.startswith("camera cam2, ") and caught.value.hint
    with pytest.raises(CalibrationMissing, match="1 cameras filmed"):
        calibrate_by_board(filmed_folder(tmp_path, monkeypatch, {"cam1": seen["cam1"]}), BOARD, lenses)
