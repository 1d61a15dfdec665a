"""A calibration is read as it is meant: every spoiled one comes back exactly, and no good one is touched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement import calibration_fit, reading_scores
from solver_backend.agreement.body_breadth import has_a_bodys_breadth, shoulders_of_leg
from solver_backend.agreement.calibration_fit import fit_calibration
from solver_backend.agreement.detections import Detections
from solver_backend.cameras.camera_corrections import SHAPES, CameraCorrection, corrected
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras

DEMO = demo_capture()
assert DEMO.cameras is not None and DEMO.keypoints is not None
CAMERAS, KEYPOINTS = DEMO.cameras, DEMO.keypoints
FRAMES = slice(40, 160)


def detections(xy: np.ndarray) -> Detections:
    return Detections(CAMERAS.names, xy[:, :, None], KEYPOINTS.confidence[:, FRAMES][:, :, None], KEYPOINTS.joint_set)


def filmed() -> np.ndarray:
    return KEYPOINTS.xy[:, FRAMES].copy()


def half(xy: np.ndarray, chosen: tuple[int, ...] = (0, 1, 2, 3)) -> np.ndarray:
    for c in chosen:
        xy[c] = (xy[c] + 0.5) / 2 - 0.5
    return xy


def turned(xy: np.ndarray, chosen: tuple[int, ...] = (0, 1, 2, 3)) -> np.ndarray:
    for c in chosen:
        xy[c] = np.stack([CAMERAS.image_size[c, 1] - 1 - xy[c, ..., 1], xy[c, ..., 0]], axis=-1)
    return xy


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (half, [CameraCorrection(factor=0.5)] * 4),
        (lambda xy: half(xy, (1,)), [CameraCorrection(factor=0.5 if c == 1 else 1.0) for c in range(4)]),
        (turned, [CameraCorrection(turn=1)] * 4),
        (lambda xy: turned(xy, (0, 2)), [CameraCorrection(turn=(c + 1) % 2) for c in range(4)]),
        (lambda xy: half(turned(xy)), [CameraCorrection(factor=0.5, turn=1)] * 4),
    ],
    ids=["half", "one camera half", "turned", "two turned", "turned and half"],
)
def test_pictures_of_another_size_or_turned(
    spoil: Callable[[np.ndarray], np.ndarray], expected: list[CameraCorrection]
) -> None:
    fit = fit_calibration(CAMERAS, detections(spoil(filmed())))
    assert list(fit.corrections) == expected
    assert fit.agreement > 0.9 and all(correction.meaning() in fit.meanings() for correction in expected)
    again = corrected(CAMERAS, expected)
    np.testing.assert_allclose(fit.cameras.K, again.K)
    np.testing.assert_allclose(fit.cameras.R, again.R)


def scaled(xy: np.ndarray, x: float, y: float, bars: float = 0.0, chosen: tuple[int, ...] = (0, 1, 2, 3)) -> np.ndarray:
    for c in chosen:
        xy[c] = (xy[c] + 0.5) * [x, y] - 0.5 + [0, bars]
    return xy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda xy: scaled(xy, 0.75, 1.0), [CameraCorrection(shape="squeezed")] * 4),
        (lambda xy: scaled(xy, 1 / 3, 1 / 3, 140), [CameraCorrection(1 / 3, shape="boxed")] * 4),
        (lambda xy: xy - [320, 180], [CameraCorrection(shape="middle 2/3")] * 4),
        pytest.param(
            lambda xy: scaled(xy, 0.75, 1.0, 0, (1,)),
            [CameraCorrection(shape="squeezed" if c == 1 else "") for c in range(4)],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["anamorphic", "a square with bars", "cropped", "one anamorphic"],
)  # fmt: skip
def test_pictures_of_another_shape(spoil: Callable[[np.ndarray], np.ndarray], expected: list[CameraCorrection]) -> None:
    fit = fit_calibration(CAMERAS, detections(spoil(filmed())))
    assert list(fit.corrections) == expected
    shape = next(c.shape for c in expected if c.shape)
    assert SHAPES[shape] in fit.meanings() and "1 times" not in fit.meanings()


def test_another_shape_needs_more_agreement_than_a_standard_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thousands of shapes and sizes are tried: one of them brings a calibration of nothing to 0.8."""
    squeezed, small = detections(scaled(filmed(), 0.75, 1.0)), detections(half(filmed()))
    found = fit_calibration(CAMERAS, squeezed).agreement
    monkeypatch.setattr(calibration_fit, "SURE_OF_SHAPE", found + 0.01)
    assert not fit_calibration(CAMERAS, squeezed).changed
    assert fit_calibration(CAMERAS, small).changed


@pytest.mark.slow
def test_a_size_that_is_no_standard() -> None:
    fit = fit_calibration(CAMERAS, detections(scaled(filmed(), 0.4375, 0.4375)))
    assert fit.corrections[0].factor == pytest.approx(0.4375, rel=0.01) and len(set(fit.corrections)) == 1


@pytest.mark.slow
def test_one_camera_with_another_fault_does_not_hide_what_all_have() -> None:
    xy = filmed()
    xy[2, ..., 0] = CAMERAS.image_size[2, 0] - 1 - xy[2, ..., 0]
    fit = fit_calibration(CAMERAS, detections(half(xy)))
    assert list(fit.corrections) == [CameraCorrection(factor=0.5)] * 4


AXES = np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    "written",
    [
        replace(CAMERAS, R=CAMERAS.R.swapaxes(1, 2)),
        replace(CAMERAS, R=CAMERAS.R.swapaxes(1, 2), t=CAMERAS.centres),
        replace(CAMERAS, t=CAMERAS.centres),
        replace(CAMERAS, R=AXES @ CAMERAS.R, t=CAMERAS.t @ AXES),
        replace(CAMERAS, R=(AXES @ CAMERAS.R).swapaxes(1, 2), t=CAMERAS.centres),
    ],
    ids=["transposed", "camera to world", "positions", "OpenGL", "camera to world in OpenGL's axes"],
)
def test_rotations_and_places_written_the_other_way(written: Cameras) -> None:
    fit = fit_calibration(written, detections(filmed()))
    np.testing.assert_allclose(fit.cameras.R, CAMERAS.R, atol=1e-9)
    np.testing.assert_allclose(fit.cameras.t, CAMERAS.t, atol=1e-9)


def test_an_up_axis_that_was_stated_stays() -> None:
    to_z_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    in_file = CAMERAS.R @ to_z_up
    written = replace(CAMERAS, R=in_file.swapaxes(1, 2) @ to_z_up.T)
    fit = fit_calibration(written, detections(filmed()), to_z_up)
    np.testing.assert_allclose(fit.cameras.R, CAMERAS.R, atol=1e-9)


def late(xy: np.ndarray) -> np.ndarray:
    xy[1] = np.roll(xy[1], 60, axis=0)
    return xy


@pytest.mark.parametrize(
    ("cameras", "spoil"),
    [
        (CAMERAS, lambda xy: xy),
        (replace(CAMERAS, t=100 * CAMERAS.t), lambda xy: xy),
        (CAMERAS, late),
        (CAMERAS, lambda xy: xy[[1, 0, 2, 3]]),
        pytest.param(CAMERAS, lambda xy: xy[[1, 2, 3, 0]], marks=pytest.mark.slow),
        pytest.param(
            CAMERAS, lambda xy: np.stack([xy[0], [1919, 0] + xy[1] * [-1, 1], xy[2], xy[3]]), marks=pytest.mark.slow
        ),
        (CAMERAS, lambda xy: np.random.default_rng(1).uniform(0, 1000, xy.shape)),
        pytest.param(CAMERAS, lambda xy: xy + np.random.default_rng(2).normal(0, 20, xy.shape), marks=pytest.mark.slow),
    ],
    ids=["as it should be", "cm", "late", "exchanged", "all exchanged", "mirrored", "nonsense", "noise"],
)
def test_nothing_changes_without_evidence(cameras: Cameras, spoil: Callable[[np.ndarray], np.ndarray]) -> None:
    fit = fit_calibration(cameras, detections(spoil(filmed())))
    assert not fit.changed
    assert fit.cameras is cameras


def test_corrections_move_pictures_and_nothing_else() -> None:
    lens = np.tile([-0.05, 0.1, 0.002, -0.003, 0.0, 0.0, 0.0, 0.0], (4, 1))
    cameras, points = replace(CAMERAS, distortion=lens), np.random.default_rng(0).uniform(-1, 2, (50, 3))
    plain = project(cameras, points)
    seen = corrected(cameras, [CameraCorrection(factor=0.5, turn=1)] * 4)
    found = project(seen, points)
    small = (plain + 0.5) / 2 - 0.5
    height = np.round(cameras.image_size[:, 1, None] / 2)
    np.testing.assert_allclose(found, np.stack([height - 1 - small[..., 1], small[..., 0]], axis=-1), atol=1e-9)


@pytest.mark.slow
def test_an_array_of_many_cameras_is_read_alike_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    count, calls = 40, []
    one, several = reading_scores.pair_agreement, reading_scores.pair_agreements
    kind = np.arange(count) % len(CAMERAS)
    turned_about = np.stack([exp_so3(np.array([0.0, 0.0, 0.1 * i])) for i in range(count)])
    cameras = Cameras(
        tuple(f"c{i}" for i in range(count)), CAMERAS.K[kind], CAMERAS.distortion[kind],
        CAMERAS.R[kind] @ turned_about, CAMERAS.t[kind], CAMERAS.image_size[kind],
    )  # fmt: skip
    xy = project(cameras, DEMO.truth["keypoints3d"][FRAMES])
    seen = Detections(
        cameras.names, half(xy, tuple(range(count)))[:, :, None], np.ones((*xy.shape[:2], 1, xy.shape[2])),
        KEYPOINTS.joint_set,
    )  # fmt: skip
    monkeypatch.setattr(reading_scores, "pair_agreement", lambda *v: calls.append(1) or one(*v))
    monkeypatch.setattr(reading_scores, "pair_agreements", lambda *v: calls.append(len(v[0])) or several(*v))
    fit = fit_calibration(cameras, seen)
    assert set(fit.corrections) == {CameraCorrection(factor=0.5)}
    assert sum(calls) < 30_000


@pytest.mark.slow
@pytest.mark.parametrize("places", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_exchanged_cameras_are_no_shape_of_pictures(places: int) -> None:
    """The views agree by 85 % as pictures of half the rows, and the person would be a seventh as broad as tall."""
    ring = Detections(
        CAMERAS.names, np.roll(half(filmed()), -places, axis=0)[:, :, None],
        np.roll(KEYPOINTS.confidence[:, FRAMES], -places, axis=0)[:, :, None], KEYPOINTS.joint_set,
    )  # fmt: skip
    fit = fit_calibration(CAMERAS, ring)
    assert not fit.changed, fit.meanings()


def test_cameras_in_one_place_show_no_breadth() -> None:
    one = CAMERAS.subset([0])
    seen = detections(filmed())
    alone = replace(seen, cameras=one.names, xy=seen.xy[:1], confidence=seen.confidence[:1])
    assert np.isnan(shoulders_of_leg(one, alone)) and has_a_bodys_breadth(one, alone)


def test_the_demos_person_has_the_breadth_of_a_body() -> None:
    assert shoulders_of_leg(CAMERAS, detections(filmed())) == pytest.approx(0.42, abs=0.04)
