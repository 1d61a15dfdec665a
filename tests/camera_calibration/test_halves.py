"""Deviations of a board's cameras cover what halves of the footage show; one lens family is chosen for all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, lens_of
from solver_backend.camera_calibration.extrinsics.board_session import calibrate_from_board, widen_by_halves
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, result_of
from solver_backend.camera_calibration.intrinsics.lens_fit import CameraLens, camera_lens, choose_family, in_family
from tests.support.carried_board import BOARD, carried, ring

CAMERAS = ring(3)
LENSES = [lens_of(CAMERAS, c) for c in range(3)]
MODELS = ("radial2", "fisheye")


def widened(bent_px: float) -> tuple[CalibratedCameras, CalibratedCameras]:
    """Return a calibration before and after, of pictures each of whose corners are off by so much together."""
    rng = np.random.default_rng(4)
    seen = carried(CAMERAS, 40, seed=2)
    bent = [{f: replace(s, px=s.px + rng.normal(0, bent_px, 2)) for f, s in one.items()} for one in seen]
    rig = calibrate_from_board(CAMERAS.names, LENSES, BOARD, bent)
    found = result_of("board", rig.adjusted)
    return found, widen_by_halves(found, LENSES, BOARD, bent)


def test_independent_errors_are_claimed_as_they_are() -> None:
    before, after = widened(0.0)
    assert 1.0 <= (after.centre_sigma_m / before.centre_sigma_m).max() < 3.0
    assert "halves_differ" in [note.code for note in after.notes]


@pytest.mark.slow
def test_errors_that_corners_share_widen_what_is_claimed() -> None:
    before, after = widened(3.0)
    ratio = after.centre_sigma_m / before.centre_sigma_m
    assert ratio.min() == pytest.approx(ratio.max()) and ratio.max() > 1.2
    assert (after.turn_sigma >= before.turn_sigma).all()


def test_footage_too_short_for_halves_is_named() -> None:
    seen = carried(CAMERAS, 40, seed=2)
    moments = sorted(set.intersection(*(set(one) for one in seen)))[:3]
    few = [{f: one[f] for f in moments} for one in seen]
    found = result_of("board", calibrate_from_board(CAMERAS.names, LENSES, BOARD, few).adjusted)
    after = widen_by_halves(found, LENSES, BOARD, few)
    np.testing.assert_array_equal(after.centre_sigma_m, found.centre_sigma_m)
    assert after.findings[-1].code == "halves_differ"


@pytest.fixture(scope="module")
def filmed() -> CameraLens:
    views = carried(ring(1, radius=1.6, lens=(-0.2, 0.1, 0, 0, 0, 0, 0, 0)), 160, noise_px=0.1)[0]
    return camera_lens(BOARD, {f: views[f] for f in sorted(views)[::10]}, (1280, 720), MODELS)


def told(lens: CameraLens, **errors: float) -> CameraLens:
    """Return a lens with other errors of pictures left out, its model the best of them."""
    best = min(errors, key=lambda name: errors[name])
    return replace(lens, fit=replace(lens.fit, model=LENS_MODELS[best]), held_out_px=errors)


def test_a_family_is_chosen_by_all_cameras(filmed: CameraLens) -> None:
    lens = filmed
    three_against_one = {
        "a": told(lens, radial2=0.30, fisheye=0.29), "b": told(lens, radial2=0.2, fisheye=0.3),
        "c": told(lens, radial2=0.2, fisheye=0.25), "d": told(lens, radial2=0.2, fisheye=0.22),
    }  # fmt: skip
    assert choose_family(three_against_one, MODELS) == "opencv"
    fish = {"a": told(lens, radial2=9.0, fisheye=0.2), "b": told(lens, radial2=0.2, fisheye=0.21)}
    assert choose_family(fish, MODELS) == "fisheye"
    assert choose_family({"a": told(lens, radial2=9.0)}, ("radial2",)) == "opencv"
    assert choose_family({"a": told(lens, radial2=1.0), "b": told(lens, fisheye=1.0)}, MODELS) is None


def test_a_lens_of_another_family_is_fitted_to_the_same_pictures(filmed: CameraLens) -> None:
    lens = filmed
    assert in_family(BOARD, lens, "opencv", MODELS) is lens
    fish = in_family(BOARD, lens, "fisheye", MODELS)
    assert fish.lens.distortion_model == "fisheye" and fish.frames == lens.frames
    assert set(fish.held_out_px) == set(MODELS)
    assert in_family(BOARD, lens, "fisheye", ("radial2",)) is lens
