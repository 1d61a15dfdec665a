"""A calibration's world is turned, scaled and levelled by what the person and the cameras show, and by nothing less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.reading_settings import LEVELS, WorldSettings
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.recognition.gravity import measure_level
from solver_backend.io.recognition.world_fit import check_world, find_people, fit_world, scale_world
from solver_backend.io.units_and_axes import UP_AXES, rotation_to_z_up
from solver_backend.synthesis.embedded.demo import DEMO_TAKE, demo_capture
from solver_backend.synthesis.simulation.cast import cast_person
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D
from tests.support.camera_ring import ring
from tests.support.recordings import BALANCING_TRIAL
from tests.support.walking_take import circling
from tests.support.words import words

SET = JointSet.BODY_25
Z = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=360)


@pytest.fixture(scope="module")
def short() -> Capture:
    return demo_capture(num_frames=60)


@pytest.fixture(scope="module")
def walked() -> np.ndarray:
    rng = np.random.default_rng(3)
    points = cast_person(circling(120), rng).landmarks(SET).points
    return points + rng.normal(0, 0.01, points.shape)


def turned(cameras: Cameras, turn: np.ndarray, floor_m: float = 0.0) -> Cameras:
    """Return cameras in the world ``x' = turn (x + (0, 0, floor))``."""
    return replace(cameras, R=cameras.R @ turn.T, t=cameras.t - floor_m * cameras.R[..., 2])


def off_degrees(cameras: Cameras, true: Cameras) -> float:
    """Return the angle between two worlds' up."""
    return float(np.degrees(np.arccos(np.clip(cameras.R[0, :, 2] @ true.R[0, :, 2], -1.0, 1.0))))


@pytest.mark.slow
@pytest.mark.parametrize("axis", sorted(UP_AXES))
def test_the_person_shows_which_axis_points_up(short: Capture, axis: str) -> None:
    cameras = replace(short.cameras, R=short.cameras.R @ rotation_to_z_up(axis))
    fit = fit_world(cameras, short.keypoints)
    np.testing.assert_allclose(fit.cameras.R, short.cameras.R, atol=1e-12)
    assert fit.check.upright[2] > 0.9
    expected = () if axis == "z" else (diagnostic("up_by_person", basis="axis", axis=axis.upper()),)
    assert fit.found == expected


def test_an_axis_that_the_user_stated_stays_and_is_doubted(short: Capture) -> None:
    cameras = turned(short.cameras, rotation_to_z_up("-y").T)
    fit = fit_world(cameras, short.keypoints, WorldSettings(level="off"), "z")
    np.testing.assert_array_equal(fit.cameras.R, cameras.R)
    assert fit.found == () and diagnostic("person_along_axis", axis="-Y") in fit.check.found()


def test_pictures_found_turned_do_not_show_that_somebody_lies(short: Capture) -> None:
    """Calibrated upright in the first camera's world, recorded with all pictures turned: either roll may be upright."""
    world = turned(short.cameras, short.cameras.R[0])
    rolled = corrected(world, [CameraCorrection(turn=1)] * len(world))
    height = world.image_size[:, 1, None, None] - 1
    xy = np.stack([height - short.keypoints.xy[..., 1], short.keypoints.xy[..., 0]], axis=-1)
    fit = fit_world(rolled, replace(short.keypoints, xy=xy), rolls=(1,) * len(world))
    assert fit.found[0] == diagnostic("up_by_person", basis="axis", axis="-Y")
    assert fit.check.upright[2] > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "around"), [(10.6, 0.0), (10.6, 2.5), (35.0, 1.0), (35.0, 4.4)])
def test_a_tilted_world_is_levelled_and_reported(capture: Capture, degrees: float, around: float) -> None:
    tilt = exp_so3(np.radians(degrees) * np.array([np.cos(around), np.sin(around), 0.0]))
    fit = fit_world(turned(capture.cameras, tilt, -1.3), capture.keypoints)
    assert off_degrees(fit.cameras, capture.cameras) < 3.0
    assert abs(fit.check.found()[0].values["lowest"]) < 0.06
    assert fit.found[-1].code == "world_levelled"
    assert "The world was levelled by a rotation of" in words(fit.found)[-1] and "--level off" in words(fit.found)[-1]


def test_a_level_world_stays_bit_for_bit(short: Capture) -> None:
    fit = fit_world(short.cameras, short.keypoints)
    assert fit.cameras is short.cameras and fit.found == ()


def test_a_level_that_was_asked_for_is_a_note(capture: Capture) -> None:
    tilt = exp_so3(np.radians(5.0) * np.array([0.6, 0.8, 0.0]))
    fit = fit_world(turned(capture.cameras, tilt), capture.keypoints, WorldSettings(level="on"))
    assert off_degrees(fit.cameras, capture.cameras) < 3.0
    assert [(item.code, item.severity.value) for item in fit.found] == [("world_levelled", "note")]


@pytest.mark.slow
def test_a_floor_above_the_feet_is_moved_and_a_stage_is_not(short: Capture) -> None:
    lower = fit_world(turned(short.cameras, np.eye(3), -0.9), short.keypoints)
    assert abs(lower.check.found()[0].values["lowest"]) < 0.06
    assert [item.code for item in lower.found] == ["floor_by_feet"]
    assert lower.found[0].values["depth"] == pytest.approx(0.9, abs=0.06)
    stage = turned(short.cameras, np.eye(3), 0.5)
    assert fit_world(stage, short.keypoints).cameras is stage


def climbing(points: np.ndarray, step_m: float = 0.0) -> np.ndarray:
    """Return a walk up a slope of 10.6 degrees, or up stairs so high, along the direction in which she walks about."""
    hips = points[:, [SET.keypoints.index("left_hip"), SET.keypoints.index("right_hip")]].mean(1)[:, :1]
    rise = step_m * np.floor(hips / 0.28) if step_m else np.tan(np.radians(10.6)) * hips
    return points + (rise - rise.min())[:, None] * Z


def lying(points: np.ndarray, floor_m: float) -> np.ndarray:
    """Return the same movement of somebody who lies on a floor or a table."""
    flat = (points - np.median(points, axis=(0, 1))) @ exp_so3(np.array([np.pi / 2, 0.0, 0.0])).T
    return flat + (floor_m - flat[..., 2].min()) * Z


@pytest.mark.parametrize("rolls", [0.0, 4.0])
@pytest.mark.parametrize(
    "stand", [climbing, lambda p: climbing(p, 0.17), lambda p: lying(p, 0.0), lambda p: lying(p, 0.7)],
    ids=["slope", "stairs", "lying", "on a table"],
)  # fmt: skip
def test_who_climbs_or_lies_tilts_no_world(walked: np.ndarray, stand, rolls: float) -> None:
    cameras = ring(4)
    rng = np.random.default_rng(1)
    roll = exp_so3(np.stack([np.zeros(4), np.zeros(4), np.radians(rolls) * rng.normal(size=4)], axis=1))
    level = measure_level(stand(walked), SET, roll @ cameras.R, 30.0)
    assert not level.is_tilted and not level.is_above_feet


@pytest.mark.parametrize("up_axis", [None, "z"])
def test_who_lies_in_front_of_level_cameras_does_not_show_another_axis(walked: np.ndarray, up_axis: str | None) -> None:
    cameras, points = ring(4), lying(walked, 0.0)
    keypoints = Keypoints2D(project(cameras, points), np.ones((4, *points.shape[:2])), SET, 30.0)
    fit = fit_world(cameras, keypoints, up_axis=up_axis)
    assert fit.cameras is cameras and fit.found == ()
    assert check_world(cameras, keypoints).found() == fit.check.found()
    assert [item.code for item in fit.check.found()] == ["person_triangulated"]


def test_a_slope_tilts_no_world_of_cameras_that_roll(walked: np.ndarray) -> None:
    cameras = ring(4)
    roll = exp_so3(np.radians(25.0) * np.array([1.0, -1.0, 1.0, -1.0])[:, None] * Z)
    assert not measure_level(climbing(walked), SET, roll @ cameras.R, 30.0).is_tilted


def test_a_strong_witness_against_a_tilt_refutes_it(walked: np.ndarray) -> None:
    level = replace(measure_level(walked, SET, ring(4).R, 30.0), tilt=0.2, sigma=0.01)
    assert replace(level, gains=(25.0, 25.0, -4.0)).is_tilted
    assert not replace(level, gains=(25.0, 25.0, -19.0)).is_tilted


@pytest.mark.slow
def test_a_recorded_balance_tilts_no_world(shared_data) -> None:
    found = load_capture(shared_data / BALANCING_TRIAL)
    assert not {"world_levelled", "floor_by_feet"} & {item.code for item in found.problems}


def test_the_world_is_scaled_to_a_stature(short: Capture) -> None:
    squares = replace(short.cameras, t=3.3 * short.cameras.t)
    cameras, notes = scale_world(squares, short.keypoints, WorldSettings(stature=1.76))
    np.testing.assert_allclose(cameras.t, short.cameras.t, rtol=0.02)
    assert "so that the person is 1.76 m tall" in words(notes)[0]
    by_factor, notes = scale_world(squares, short.keypoints, WorldSettings(scale=1 / 3.3))
    np.testing.assert_allclose(by_factor.t, short.cameras.t)
    assert notes == (diagnostic("world_scaled", reason="scale", scale=1 / 3.3),)
    assert scale_world(squares, short.keypoints, WorldSettings())[0] is squares


@pytest.mark.parametrize(
    ("stature", "contradicts"),
    [
        (1.5, True),
        (1.7, False),
        pytest.param(1.8, False, marks=pytest.mark.slow),
        pytest.param(2.0, True, marks=pytest.mark.slow),
    ],
)
def test_a_stature_that_the_calibration_contradicts_is_doubted(
    short: Capture, stature: float, contradicts: bool
) -> None:
    _, found = scale_world(short.cameras, short.keypoints, WorldSettings(stature=stature))
    assert ("stature_contradicts" in {item.code for item in found}) is contradicts
    _, own_unit = scale_world(
        replace(short.cameras, t=3.3 * short.cameras.t), short.keypoints, WorldSettings(stature=1.5)
    )
    assert [item.code for item in own_unit] == ["world_scaled"]


def test_people_are_found_again_in_another_scale(short: Capture) -> None:
    class Person:
        keypoints = short.keypoints

    calls: list[Cameras] = []

    def select(cameras: Cameras):
        calls.append(cameras)
        return (Person(),)

    find_people(short.cameras, select, WorldSettings())
    assert len(calls) == 1
    find_people(short.cameras, select, WorldSettings(scale=3.0))
    assert len(calls) == 3


def test_stature_and_scale_exclude_one_another(short: Capture) -> None:
    with pytest.raises(JobInvalid, match="set the scale of the world"):
        scale_world(short.cameras, short.keypoints, WorldSettings(stature=1.8, scale=2.0))
    with pytest.raises(JobInvalid, match="impossible"):
        scale_world(short.cameras, short.keypoints, WorldSettings(stature=0.2))


def test_settings_of_the_world_are_checked() -> None:
    for wrong in ({"stature": 17.6}, {"scale": 0.0}, {"level": "yes"}):
        with pytest.raises(JobInvalid, match=f"The setting {next(iter(wrong))} = "):
            WorldSettings(**wrong)
    assert [choice.value for choice in LEVELS] == ["auto", "on", "off"]


@pytest.mark.slow
def test_our_own_capture_changes_only_where_it_is_asked_for(short: Capture, tmp_path) -> None:
    path = write_capture(tmp_path / "c.npz", replace(short, cameras=turned(short.cameras, np.eye(3), -0.9)))
    np.testing.assert_array_equal(load_capture(path).cameras.t, turned(short.cameras, np.eye(3), -0.9).t)
    half = load_capture(path, scale=0.5)
    np.testing.assert_allclose(half.cameras.centres, 0.5 * load_capture(path).cameras.centres, atol=1e-9)
    assert diagnostic("world_scaled", reason="scale", scale=0.5) in half.notes and half.truth == {}


def test_a_recording_of_markers_has_no_world_to_level() -> None:
    with pytest.raises(JobInvalid, match="--stature.* does not apply to C3D") as caught:
        load_capture(DEMO_TAKE, stature=1.8)
    assert "--unit" in caught.value.hint


def test_two_cameras_that_face_each_other_are_reported(short: Capture) -> None:
    cameras, keypoints = short.views([0, 2]).require_multiview()
    assert "views_in_line" not in {item.code for item in check_world(cameras, keypoints).found()}
    middle = np.nanmedian(check_world(cameras, keypoints).points, axis=(0, 1))
    across = np.cross(cameras.centres[0] - middle, Z)
    half_turn = 2.0 * np.outer(across, across) / (across @ across) - np.eye(3)  # to the place opposite to the first
    R = np.stack([cameras.R[0], cameras.R[0] @ half_turn.T])
    t = np.stack([cameras.t[0], cameras.t[0] + cameras.R[0] @ (middle - half_turn.T @ middle)])
    facing = replace(cameras, R=R, t=t)
    points = short.truth["keypoints3d"]
    seen = replace(keypoints, xy=project(facing, points), confidence=np.ones(keypoints.confidence.shape))
    (found,) = [item for item in check_world(facing, seen).found() if item.code == "views_in_line"]
    assert found.where.cameras == cameras.names


def test_a_camera_whose_keypoints_are_off_by_a_fortieth_of_the_person_is_named(short: Capture) -> None:
    cameras, keypoints = short.require_multiview()
    check = check_world(cameras, keypoints)
    assert "cameras_shifted" not in {item.code for item in check.found()}
    xy = keypoints.xy.copy()
    xy[1, ..., 0] += check.person_px[1] / 40.0
    (found,) = [i for i in check_world(cameras, replace(keypoints, xy=xy)).found() if i.code == "cameras_shifted"]
    assert cameras.names[1] in found.where.cameras


def test_a_camera_far_off_is_named_alone(short: Capture) -> None:
    """Without it, the other views agree at most points, so that their own cameras are not shifted."""
    cameras, keypoints = short.require_multiview()
    xy = keypoints.xy.copy()
    xy[1, ..., 0] += 0.15 * check_world(cameras, keypoints).person_px[1]
    (found,) = [i for i in check_world(cameras, replace(keypoints, xy=xy)).found() if i.code == "cameras_shifted"]
    assert found.where.cameras == (cameras.names[1],)
