"""Files are read as they are meant: every fault comes back exactly, and no good capture is touched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from solver_backend.agreement.body_evidence import refit_pose
from solver_backend.agreement.evidence import TakeEvidence, count_in_bins, fit_noise
from solver_backend.agreement.explain import AS_EXACT, Explanation, _Search, explain
from solver_backend.agreement.hypotheses import FREE, ROWS, fit_window, one_window
from solver_backend.agreement.reading import PLAIN, PictureReading, Reading, apply_reading
from solver_backend.agreement.single_view import pictures_of_one_view
from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.captures.agreement import Agreeing
from solver_backend.io.reader import ReadOptions
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.keypoint_detector import miscalibrated
from solver_backend.types import Cameras, Detections, JointSet
from tests.support.scenes import look_at, ring_of_cameras

DEMO = demo_capture()
CAMERAS, KEYPOINTS = DEMO.require_multiview()
FRAMES = slice(40, 160, 2)
WRITTEN = Reading.as_written(4)
EVERY = (0, 1, 2, 3)
SLOW = pytest.mark.slow  # More faults of a kind. Each takes seconds.


def detections(xy: np.ndarray | None = None) -> Detections:
    xy = KEYPOINTS.xy[:, FRAMES] if xy is None else xy
    return Detections(CAMERAS.names, xy[:, :, None], KEYPOINTS.confidence[:, FRAMES][:, :, None], KEYPOINTS.joint_set)


def half(seen: Detections, chosen: tuple[int, ...] = EVERY) -> Detections:
    xy = seen.xy.copy()
    xy[list(chosen)] = (xy[list(chosen)] + 0.5) / 2 - 0.5
    return replace(seen, xy=xy)


def turned(seen: Detections, chosen: tuple[int, ...] = EVERY) -> Detections:
    xy = seen.xy.copy()
    for c in chosen:
        xy[c] = np.stack([CAMERAS.image_size[c, 1] - 1 - seen.xy[c, ..., 1], seen.xy[c, ..., 0]], axis=-1)
    return replace(seen, xy=xy)


def scaled(seen: Detections, x: float, y: float, bars: float = 0.0, chosen: tuple[int, ...] = EVERY) -> Detections:
    xy = seen.xy.copy()
    xy[list(chosen)] = (xy[list(chosen)] + 0.5) * [x, y] - 0.5 + [0, bars]
    return replace(seen, xy=xy)


def mirrored(seen: Detections, chosen: tuple[int, ...] = EVERY, sides: bool = True) -> Detections:
    xy = seen.xy.copy()
    for c in chosen:
        xy[c, ..., 0] = CAMERAS.image_size[c, 0] - 1 - xy[c, ..., 0]
        xy[c] = xy[c][..., list(seen.joint_set.mirrored(xy.shape[-2])), :] if sides else xy[c]
    return replace(seen, xy=xy)


def pictures_of(*kinds: PictureReading) -> Reading:
    return replace(WRITTEN, pictures=kinds * (4 // len(kinds)))


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        pytest.param(half, pictures_of(PictureReading(0.5)), marks=SLOW),
        (lambda seen: half(seen, (1,)), pictures_of(PLAIN, PictureReading(0.5), PLAIN, PLAIN)),
        pytest.param(turned, pictures_of(PictureReading(turn=1)), marks=SLOW),
        (lambda seen: turned(seen, (0, 2)), pictures_of(PictureReading(turn=1), PLAIN)),
        pytest.param(lambda seen: half(turned(seen)), pictures_of(PictureReading(0.5, 1)), marks=SLOW),
        pytest.param(
            lambda seen: turned(half(seen, (2,)), (0,)),
            pictures_of(PictureReading(turn=1), PLAIN, PictureReading(0.5), PLAIN),
            marks=SLOW,
        ),
    ],
    ids=["half", "one camera half", "turned", "two turned", "turned and half", "one turned and another half"],
)
def test_pictures_of_another_size_or_turned(spoil: Callable[[Detections], Detections], expected: Reading) -> None:
    found = explain(CAMERAS, spoil(detections()))
    assert found.reading == expected and found.agrees
    assert {a.code for a in found.applied} == {"calibration_corrected"} and all(a.gain > 6 for a in found.applied)
    cameras, _ = apply_reading(CAMERAS, spoil(detections()), found.reading)
    again = corrected(CAMERAS, [picture.correction for picture in expected.pictures])
    np.testing.assert_allclose(cameras.K, again.K)
    np.testing.assert_allclose(cameras.R, again.R)


@pytest.mark.parametrize(
    ("spoil", "pictures"),
    [
        (lambda seen: half(seen, (2,)), (PLAIN, PLAIN, PictureReading(0.5), PLAIN)),
        (lambda seen: turned(seen, (0, 2)), (PictureReading(turn=1), PLAIN) * 2),
    ],
    ids=["one half", "two turned"],
)
def test_a_person_who_stands_in_one_pose(
    spoil: Callable[[Detections], Detections], pictures: tuple[PictureReading, ...]
) -> None:
    """All keypoints of a wrong view deviate alike, so the files as written seem to have a single constraint."""
    held = DEMO.truth["keypoints3d"][[40] * 60]
    noise = np.random.default_rng(0).normal(0, 3.0, (4, *held.shape[:2], 2))
    rotated = miscalibrated(CAMERAS, held.mean((0, 1)), 3.0, np.random.default_rng(1))
    found = explain(rotated, spoil(detections(project(CAMERAS, held) + noise)))
    assert found.reading.pictures == pictures and {a.code for a in found.applied} == {"calibration_corrected"}


@pytest.mark.parametrize("one", [0, pytest.param(1, marks=SLOW), pytest.param(2, marks=SLOW)])
def test_three_cameras_with_rotated_images_and_one_of_half_size(one: int) -> None:
    """The half-size image hides the rotation on which the other two views agree."""
    seen = detections()
    xy = np.stack([seen.xy[..., 1], CAMERAS.image_size[:, 0, None, None, None] - 1 - seen.xy[..., 0]], axis=-1)
    turned_back = half(replace(seen, xy=xy), (one,))
    three = replace(turned_back, cameras=seen.cameras[:3], xy=turned_back.xy[:3], confidence=seen.confidence[:3])
    pictures = explain(CAMERAS.subset([0, 1, 2]), three).reading.pictures
    assert pictures == tuple(PictureReading(0.5 if view == one else 1.0, 3) for view in range(3))


def test_images_counted_from_below_with_swapped_names() -> None:
    seen = detections()
    below = replace(seen, xy=(np.array([0, 1079]) + seen.xy * [1, -1])[[1, 0, 2, 3]])
    found = explain(CAMERAS, replace(below, confidence=seen.confidence[[1, 0, 2, 3]]))
    assert {a.code for a in found.applied} == {"detections_corrected", "camera_names_exchanged"}
    assert found.reading.owners == (1, 0, 2, 3) and found.reading.pictures[0] == PictureReading(turn=2, mirrored=True)


@pytest.mark.parametrize(
    ("spoil", "views", "size", "window"),
    [
        (lambda seen: replace(seen, xy=seen.xy - [300, 0]), EVERY, 1.0, (1.0, -300 / 1080, 0.0)),
        pytest.param(lambda seen: scaled(seen, 0.8, 1.0), EVERY, 1.0, (0.8, 0.0, 0.0), marks=SLOW),
        pytest.param(lambda seen: scaled(seen, 1 / 3, 1 / 3, 140), EVERY, 1 / 3, (1.0, 0.0, 420 / 1080), marks=SLOW),
        pytest.param(
            lambda seen: replace(seen, xy=seen.xy - [320, 180]), EVERY, 1.0, (1.0, -8 / 27, -1 / 6), marks=SLOW
        ),
        pytest.param(lambda seen: scaled(seen, 0.75, 1.0, 0, (1,)), (1,), 1.0, (0.75, 0.0, 0.0), marks=SLOW),
        (lambda seen: scaled(seen, 0.9, 1.0, 0, (1,)), (1,), 1.0, (0.9, 0.0, 0.0)),
    ],
    ids=["cut at the left", "squeezed", "a square with bars", "cropped", "one anamorphic", "one squeezed a little"],
)
def test_pictures_of_another_shape(
    spoil: Callable[[Detections], Detections],
    views: tuple[int, ...],
    size: float,
    window: tuple[float, float, float],
) -> None:
    found = explain(CAMERAS, spoil(detections()))
    assert [(a.code, a.views) for a in found.applied] == [("calibration_corrected", views)]
    for view, picture in enumerate(found.reading.pictures):
        expected = (size, *window) if view in views else (1.0, 1.0, 0.0, 0.0)
        np.testing.assert_allclose((picture.size, *picture.window), expected, atol=0.012)


def test_cropped_pictures_of_a_person_and_a_bystander() -> None:
    alone = detections()
    pair = np.concatenate([alone.xy, 0.5 * alone.xy[:, ::-1] + [900, 300]], axis=2) - [300, 0]
    sure = np.concatenate([alone.confidence, alone.confidence[:, ::-1]], axis=2)
    sure[2:, :, 1] = 0.0
    found = explain(CAMERAS, replace(alone, xy=np.where(sure[..., None] > 0, pair, np.nan), confidence=sure))
    assert [(a.code, a.views) for a in found.applied] == [("calibration_corrected", EVERY)]
    np.testing.assert_allclose(found.reading.pictures[0].window, (1.0, -300 / 1080, 0.0), atol=0.012)


@pytest.mark.parametrize("views", [(1,), (1, 2)])
def test_a_larger_bystander_in_some_views_is_no_fault(views: tuple[int, ...]) -> None:
    alone = detections()
    xy = np.concatenate([1.5 * alone.xy[:, ::-1] - [300, 400], alone.xy], axis=2)
    sure = np.concatenate([alone.confidence[:, ::-1], alone.confidence], axis=2)
    sure[[view for view in EVERY if view not in views], :, 0] = 0.0
    found = explain(CAMERAS, replace(alone, xy=np.where(sure[..., None] > 0, xy, np.nan), confidence=sure))
    assert (found.reading, found.agrees, found.applied, found.open) == (WRITTEN, True, (), ())


def test_fits_of_pictures_change_nothing_that_agrees() -> None:
    """The views' own pictures remain, and no sentence would name a change by less than 1 %."""
    xy = project(CAMERAS, DEMO.truth["keypoints3d"][FRAMES])
    seen = detections(xy + np.random.default_rng(0).normal(0, 0.5, xy.shape))
    for chosen, reading in ((), WRITTEN), ((0,), pictures_of(PictureReading(0.5), PLAIN, PLAIN, PLAIN)):
        evidence = TakeEvidence(CAMERAS, half(seen, chosen)).quick()
        assert fit_window(evidence, reading, FREE[-1]) == reading


AXES = np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    "written",
    [
        replace(CAMERAS, R=CAMERAS.R.swapaxes(1, 2)),
        pytest.param(replace(CAMERAS, R=CAMERAS.R.swapaxes(1, 2), t=CAMERAS.centres), marks=SLOW),
        pytest.param(replace(CAMERAS, t=CAMERAS.centres), marks=SLOW),
        pytest.param(replace(CAMERAS, R=AXES @ CAMERAS.R, t=CAMERAS.t @ AXES), marks=SLOW),
        replace(CAMERAS, R=(AXES @ CAMERAS.R).swapaxes(1, 2), t=CAMERAS.centres),
    ],
    ids=["transposed", "camera to world", "positions", "OpenGL", "camera to world in OpenGL's axes"],
)
def test_rotations_and_places_written_the_other_way(written: Cameras) -> None:
    cameras, _ = apply_reading(written, detections(), explain(written, detections()).reading)
    np.testing.assert_allclose(cameras.R, CAMERAS.R, atol=1e-9)
    np.testing.assert_allclose(cameras.t, CAMERAS.t, atol=1e-9)


@pytest.mark.parametrize(
    ("spoil", "meaning"),
    [
        pytest.param(
            mirrored,
            "the images are mirrored, and left and right are swapped in the keypoint names",
            marks=SLOW,
        ),
        (lambda seen: mirrored(seen, (1,)), "the images are mirrored, and left and right are swapped"),
        (lambda seen: replace(seen, xy=np.array([0, 1079]) + seen.xy * [1, -1]), "y counts from the bottom"),
        pytest.param(lambda seen: replace(seen, xy=seen.xy[..., ::-1]), "x and y are swapped", marks=SLOW),
        pytest.param(
            lambda seen: replace(seen, xy=seen.xy[..., list(seen.joint_set.mirrored()), :]),
            "left and right are swapped",
            marks=SLOW,
        ),
    ],
    ids=["mirrored", "one mirrored", "from below", "x and y", "sides"],
)
def test_flipped_pictures_and_exchanged_sides(spoil: Callable[[Detections], Detections], meaning: str) -> None:
    spoiled = spoil(detections())
    found = explain(CAMERAS, spoiled)
    assert [a.code for a in found.applied] == ["detections_corrected"] and found.applied[0].meaning.startswith(meaning)
    cameras, undone = apply_reading(CAMERAS, spoiled, found.reading)
    np.testing.assert_allclose(undone.xy, detections().xy, atol=1e-3)
    np.testing.assert_array_equal(cameras.R, CAMERAS.R)


@pytest.mark.parametrize(
    "order",
    [pytest.param([1, 0, 2, 3], marks=SLOW), [1, 2, 3, 0], pytest.param([2, 3, 0, 1], marks=SLOW)],
    ids=["two", "round", "two pairs"],
)
def test_cameras_that_bear_each_others_names(order: list[int]) -> None:
    found = explain(CAMERAS, detections(KEYPOINTS.xy[order][:, FRAMES]))
    assert list(found.reading.owners) == order
    assert [a.code for a in found.applied] == ["camera_names_exchanged"]


@pytest.mark.parametrize("pair", [(0, 2), pytest.param((1, 3), marks=SLOW)])
def test_half_pictures_of_opposite_cameras_with_each_others_names_are_not_mirrored(pair: tuple[int, int]) -> None:
    order = list(EVERY)
    order[pair[0]], order[pair[1]] = order[pair[1]], order[pair[0]]
    seen = half(detections())
    found = explain(CAMERAS, replace(seen, xy=seen.xy[order], confidence=seen.confidence[order]))
    assert found.reading == replace(pictures_of(PictureReading(0.5)), owners=tuple(order))


def test_two_cameras_with_each_others_names_are_not_mirrored() -> None:
    """Seen from cameras at equal heights, a mirrored person would agree nearly as well."""
    seen = detections()
    two = replace(seen, cameras=CAMERAS.names[:2], xy=seen.xy[[1, 0]], confidence=seen.confidence[[1, 0]])
    assert explain(CAMERAS.subset([0, 1]), two).reading == replace(Reading.as_written(2), owners=(1, 0))


@pytest.mark.parametrize("stated", [(), ("cam_a=0",)])
def test_stated_names_are_not_exchanged(stated: tuple[str, ...]) -> None:
    seen = detections(KEYPOINTS.xy[[1, 2, 3, 0]][:, FRAMES])
    found = Agreeing(Calibration(CAMERAS, Path()), seen, (False,) * 4).explained(ReadOptions(offset=stated))
    assert ("camera_names_exchanged" in {a.code for a in found.applied}) != bool(stated)


def moved(angle: float, by_m: float) -> Cameras:
    R, t = CAMERAS.R.copy(), CAMERAS.t.copy()
    turn = exp_so3(np.radians(angle) * np.array([0.3, 0.95, 0.05]))
    R[2], t[2] = turn @ R[2], turn @ t[2] + by_m * np.array([0.6, -0.8, 0.0])
    return replace(CAMERAS, R=R, t=t)


@pytest.mark.parametrize(
    ("angle", "noise_px", "codes"),
    [pytest.param(2.0, 0.0, ["camera_placed"], marks=SLOW), (1.6, 10.0, [])],
    ids=["no squeezed pictures", "within the noise"],
)
def test_a_camera_that_is_slightly_off(angle: float, noise_px: float, codes: list[str]) -> None:
    R, t, turn = CAMERAS.R.copy(), CAMERAS.t.copy(), exp_so3(np.radians([0.0, angle, 0.0]))
    R[1], t[1] = turn @ R[1], turn @ t[1]
    xy = KEYPOINTS.xy[:, FRAMES]
    found = explain(replace(CAMERAS, R=R, t=t), detections(xy + np.random.default_rng(0).normal(0, noise_px, xy.shape)))
    assert [a.code for a in found.applied] == codes


@pytest.mark.parametrize(
    ("angle", "by_m"), [pytest.param(15.0, 0.0, marks=SLOW), pytest.param(0.0, 0.6, marks=SLOW), (15.0, 0.6)]
)
def test_a_moved_camera_is_placed_by_the_others(angle: float, by_m: float) -> None:
    cameras = moved(angle, by_m)
    found = explain(cameras, detections())
    assert [(a.code, a.views) for a in found.applied] == [("camera_placed", (2,))]
    placed, _ = apply_reading(cameras, detections(), found.reading)
    assert np.degrees(np.arccos((np.trace(placed.R[2] @ CAMERAS.R[2].T) - 1) / 2)) < 1.0
    np.testing.assert_allclose(placed.centres[2], CAMERAS.centres[2], atol=0.05)


def test_only_a_camera_that_contradicts_all_others_is_searched() -> None:
    evidence = TakeEvidence(CAMERAS, half(detections(), (1,)))
    everybody = _Search(evidence, ROWS).search()
    turns = {tuple(np.roll(EVERY, k).tolist()) for k in range(1, 4)}
    assert {r.owners for r in everybody} == {EVERY} | turns, "in a ring, neighbours' names leave most views agreeing"
    readings = [reading for reading in everybody if reading.owners == EVERY]
    assert {r.pose for r in readings} == {WRITTEN.pose}
    assert all(r.pictures[view] == PLAIN and not r.late[view] for r in readings for view in (0, 2, 3))
    assert {r.left_out for r in readings} <= {(), (1,)} and len(readings) > 4


def test_a_camera_is_placed_by_two_others_that_hardly_show_depth() -> None:
    cameras, points = ring_of_cameras(8).subset([0, 1, 2]), DEMO.truth["keypoints3d"]
    xy = project(cameras, points) + np.random.default_rng(0).normal(0, 6.0, (3, *points.shape[:2], 2))
    t = cameras.t + [[0.4, -0.4, 0.0], [0.0] * 3, [0.0] * 3]
    seen = replace(detections(), cameras=cameras.names, xy=xy[:, :, None], confidence=np.ones((*xy.shape[:2], 1, 25)))
    pose = refit_pose(TakeEvidence(replace(cameras, t=t), seen).quick(), Reading.as_written(3), 0)
    assert pose is not None
    np.testing.assert_allclose(np.reshape(pose[:9], (3, 3)), cameras.R[0], atol=0.05)


@pytest.mark.parametrize(
    ("angle", "by_m", "view"),
    [(15.0, 0.6, 1), pytest.param(15.0, 0.0, 0, marks=SLOW), pytest.param(0.0, 0.6, 1, marks=SLOW)],
)
def test_a_moved_camera_and_half_pictures_of_another_are_both_found(angle: float, by_m: float, view: int) -> None:
    found = explain(moved(angle, by_m), half(detections(), (view,)))
    assert [(a.code, a.views) for a in found.applied] == [("calibration_corrected", (view,)), ("camera_placed", (2,))]
    assert found.reading.pictures[view] == PictureReading(0.5)


def test_a_camera_of_another_take_is_named() -> None:
    xy = KEYPOINTS.xy[:, FRAMES].copy()
    xy[1] = xy[1, ::-1] + [150.0, -60.0]
    found = explain(CAMERAS, detections(xy))
    assert [(a.code, a.views) for a in found.applied] == [("camera_unexplained", (1,))]


def test_a_camera_of_another_take_is_not_read_as_a_stretched_one() -> None:
    xy = KEYPOINTS.xy[:, FRAMES].copy()
    xy[1] = xy[1, ::-1] + [150.0, -60.0]
    assert min(lacks(detections(xy))) > AS_EXACT > min(lacks(scaled(detections(), 0.75, 1.0, 0, (1,))))


def lacks(seen: Detections) -> list[float]:
    """Return what the density of the second view, with fitted pictures or a fitted pose, lacks against the others'."""
    evidence = TakeEvidence(CAMERAS, seen).quick()
    evidence.suspects = (1,)
    pose = refit_pose(evidence, WRITTEN, 1)
    fitted = [*one_window(evidence, WRITTEN), *([] if pose is None else [WRITTEN.with_view(1, moved=pose)])]
    densities = [evidence.fits_of(reading, [1]).density for reading in fitted]
    return [float(rest - own) for own, rest in densities]


def late(seen: Detections) -> Detections:
    xy = seen.xy.copy()
    xy[1] = np.roll(xy[1], 10, axis=0)
    return replace(seen, xy=xy)


def test_a_late_camera_is_late_and_nothing_else() -> None:
    found = explain(CAMERAS, late(detections()))
    assert [(a.code, a.views) for a in found.applied] == [("camera_late", (1,))]
    assert replace(found.reading, late=WRITTEN.late) == WRITTEN


@pytest.mark.parametrize(
    ("cameras", "seen"),
    [
        (CAMERAS, detections()),
        (replace(CAMERAS, t=100 * CAMERAS.t), detections()),
        pytest.param(
            CAMERAS,
            detections(np.random.default_rng(1).uniform(0, 1000, KEYPOINTS.xy[:, FRAMES].shape)),
            marks=SLOW,
        ),
        (CAMERAS, detections(KEYPOINTS.xy[:, FRAMES] + np.random.default_rng(2).normal(0, 20, (4, 60, 25, 2)))),
        (CAMERAS, replace(detections(), confidence=np.zeros((4, 60, 1, 25)))),
    ],
    ids=["as it should be", "cm", "nonsense", "noise", "nobody"],
)
def test_nothing_changes_without_evidence(cameras: Cameras, seen: Detections) -> None:
    found = explain(cameras, seen)
    assert not found.changed and found.reading == WRITTEN


def test_two_views_of_nonsense_are_refused() -> None:
    xy = np.random.default_rng(1).uniform(0, 1000, (2, 40, 25, 2))
    seen = Detections(CAMERAS.names[:2], xy[:, :, None], np.ones((2, 40, 1, 25)), KEYPOINTS.joint_set)
    found = explain(CAMERAS.subset([0, 1]), seen)
    assert not found.changed and not found.agrees


def test_a_person_in_the_middle_of_a_level_ring_is_told_by_the_body() -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))

    def seen_by_ring(shown: np.ndarray) -> tuple[Cameras, Detections]:
        cameras = ring_of_cameras(height=0.9)
        px = project(cameras, shown)
        confidence = np.ones((*px.shape[:2], 1, px.shape[2]))
        return cameras, Detections(cameras.names, px[:, :, None], confidence, KEYPOINTS.joint_set)

    cameras, seen = seen_by_ring(points)
    assert not explain(cameras, seen).changed
    from_below = replace(seen, xy=np.array([0, cameras.image_size[0, 1] - 1]) + seen.xy * [1, -1])
    found = explain(cameras, from_below)
    assert [a.meaning for a in found.applied] == ["y counts from the bottom of the images"]
    handstand = (points - [0, 0, 0.9]) * [1, -1, -1] + [0, 0, 0.9]
    assert not explain(*seen_by_ring(handstand)).changed


def test_a_person_who_stands_without_face_and_toes_keeps_the_sides() -> None:
    """Knee definitions behind the leg's line are one observation, however many frames show them."""
    body = JointSet.COCO_17
    names = KEYPOINTS.joint_set.keypoints
    columns = [names.index(name) for name in body.keypoints]
    points = np.repeat(DEMO.truth["keypoints3d"][40:41, columns], 120, axis=0)
    left, up = points[0, 5] - points[0, 6], np.array([0.0, 0.0, 1.0])
    back = -np.cross(left, up) / np.linalg.norm(np.cross(left, up))
    for knee in (13, 14):
        points[:, knee] += 0.04 * back
    points += 0.01 * np.random.default_rng(0).normal(size=(120, 1, 3))
    xy = project(CAMERAS, points)
    confidence = np.ones(xy.shape[:3])
    confidence[..., :5] = 0.0
    seen = Detections(CAMERAS.names, xy[:, :, None], confidence[:, :, None], body)
    assert not explain(CAMERAS.subset([0, 1, 2]), replace(
        seen, cameras=CAMERAS.names[:3], xy=seen.xy[:3], confidence=seen.confidence[:3]
    )).changed  # fmt: skip


@pytest.mark.slow
def test_cameras_in_one_place_explain_nothing() -> None:
    one = replace(CAMERAS, R=np.tile(np.eye(3), (4, 1, 1)), t=np.zeros((4, 3)))
    found = explain(one, detections())
    assert isinstance(found, Explanation) and not found.changed and not found.agrees


def test_corrections_move_pictures_and_nothing_else() -> None:
    lens = np.tile([-0.05, 0.1, 0.002, -0.003, 0.0, 0.0, 0.0, 0.0], (4, 1))
    cameras, points = replace(CAMERAS, distortion=lens), np.random.default_rng(0).uniform(-1, 2, (50, 3))
    plain = project(cameras, points)
    seen = corrected(cameras, [CameraCorrection(factor=0.5, turn=1)] * 4)
    small = (plain + 0.5) / 2 - 0.5
    height = np.round(cameras.image_size[:, 1, None] / 2)
    turned_once = np.stack([height - 1 - small[..., 1], small[..., 0]], axis=-1)
    np.testing.assert_allclose(project(seen, points), turned_once, atol=1e-9)


def test_hands_are_flipped_with_the_body() -> None:
    hands = np.random.default_rng(0).uniform(0, 1000, (4, 60, 1, 2, 21, 3))
    reading = replace(WRITTEN, pictures=(PictureReading(mirrored=True),) * 4, sides=(True,) * 4)
    _, undone = apply_reading(CAMERAS, replace(detections(), hands=hands), reading)
    assert undone.hands is not None
    np.testing.assert_allclose(undone.hands[..., 0, :, 0], 1919 - hands[..., 1, :, 0])
    np.testing.assert_allclose(undone.hands[..., 1:], hands[..., ::-1, :, 1:])


def test_noise_and_outlier_rate_are_estimated() -> None:
    rng = np.random.default_rng(3)
    distance = np.where(rng.uniform(size=(2, 20_000)) < 0.1, rng.uniform(-2, 2, (2, 20_000)), 0.0)
    distance = np.where(distance == 0, rng.normal(0, [[0.01], [0.04]], (2, 20_000)), distance)
    noise = fit_noise(count_in_bins(distance, np.ones(())))
    np.testing.assert_allclose(noise.sigma, [0.01, 0.04], rtol=0.1)
    np.testing.assert_allclose(noise.outliers, 0.1, atol=0.02)


@pytest.mark.parametrize("turn", [1, 3])
def test_turned_pictures_of_a_single_camera_are_found(turn: int) -> None:
    seen = replace(
        detections(), cameras=CAMERAS.names[:1], xy=detections().xy[:1], confidence=detections().confidence[:1]
    )
    camera = CAMERAS.subset([0])
    assert pictures_of_one_view(camera, seen) is None
    width, height = CAMERAS.image_size[0].tolist()
    u, v = np.moveaxis(seen.xy + [0 if turn == 1 else -300, 0], -1, 0)  # off the middle of the picture
    xy = np.stack([height - 1 - v, u] if turn == 1 else [v, width - 1 - u], axis=-1)
    found = pictures_of_one_view(camera, replace(seen, xy=xy))
    assert found is not None and not found.rival and found.picture.turn == turn and 0.0 < found.outside < 1.0


def test_turned_pictures_are_found_without_ankles() -> None:
    seen = replace(
        detections(), cameras=CAMERAS.names[:1], xy=detections().xy[:1], confidence=detections().confidence[:1]
    )
    height = int(CAMERAS.image_size[0, 1])
    u, v = np.moveaxis(seen.xy, -1, 0)
    names = KEYPOINTS.joint_set.keypoints
    kept = [k for k, name in enumerate(names) if not name.endswith(("ankle", "toe", "heel"))]
    mirror = [kept.index(KEYPOINTS.joint_set.mirrored()[k]) for k in kept]
    joints = SimpleNamespace(keypoints=[names[k] for k in kept], num_keypoints=len(kept), mirrored=lambda: mirror)
    xy = np.stack([height - 1 - v, u], axis=-1)[..., kept, :]
    without = replace(seen, xy=xy, confidence=seen.confidence[..., kept], joint_set=joints)
    found = pictures_of_one_view(CAMERAS.subset([0]), without)
    assert found is not None and not found.rival and found.picture.turn == 1
    upright = replace(without, xy=seen.xy[..., kept, :])
    assert pictures_of_one_view(CAMERAS.subset([0]), upright) is None


@pytest.mark.parametrize("turn", [1, 3])
def test_a_person_within_turned_pictures_stands_on_the_floor_in_one_turn(turn: int) -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))
    camera = ring_of_cameras(radius=8.0, distortion=0.0).subset([0])
    width, height = camera.image_size[0].tolist()

    def turned_view(shown: np.ndarray) -> Detections:
        u, v = np.moveaxis(project(camera, shown), -1, 0)
        xy = np.stack([height - 1 - v, u] if turn == 1 else [v, width - 1 - u], axis=-1)
        return Detections(camera.names, xy[:, :, None], np.ones((*xy.shape[:2], 1, xy.shape[2])), KEYPOINTS.joint_set)

    found = pictures_of_one_view(camera, turned_view(points))
    assert found is not None and not found.rival and found.picture.turn == turn
    # One who lies along the picture's rows is upright in a turned picture, and touches the floor as recorded.
    side = camera.R[0, 0]
    lying = points[..., 2:] * side + 0.1 * points[..., 1:2] * np.array([0, 0, 1.0]) + [0, 0, 0.1]
    assert pictures_of_one_view(camera, seen_by(camera, lying - 0.8 * side)) is None


@pytest.mark.parametrize("size", [0.5, 1.5])
def test_resized_pictures_of_a_single_camera_are_suspected(size: float) -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))
    camera = ring_of_cameras(radius=6.0, distortion=0.0).subset([0])
    seen = seen_by(camera, points)
    assert pictures_of_one_view(camera, seen) is None
    found = pictures_of_one_view(camera, replace(seen, xy=size * seen.xy))
    assert found is not None and found.picture.size == size and found.rival, "the floor may be at another height"
    assert pictures_of_one_view(camera, seen_by(camera, points + [0.0, 0.0, 0.3])) is None


def test_pictures_of_half_the_size_are_certain_once_the_person_walks_over_the_floor() -> None:
    points = np.tile(DEMO.truth["keypoints3d"][:1], (60, 1, 1))  # upright: in a squat both readings change the height
    points[..., :2] -= points[..., :2].mean(axis=1, keepdims=True)
    points += np.linspace(-2.0, 2.0, len(points))[:, None, None] * np.array([0.7, 0.7, 0.0])
    camera = ring_of_cameras(radius=6.0, distortion=0.0).subset([0])
    seen = seen_by(camera, points)
    found = pictures_of_one_view(camera, replace(seen, xy=0.5 * seen.xy))
    assert pictures_of_one_view(camera, seen) is None
    assert found is not None and found.picture.size == 0.5 and not found.rival


def test_a_sloping_floor_off_its_level_makes_no_size_certain() -> None:
    points = np.tile(DEMO.truth["keypoints3d"][:1], (60, 1, 1))
    points[..., :2] -= points[..., :2].mean(axis=1, keepdims=True)
    way = np.array([np.cos(0.11), np.sin(0.11), 0.133])  # a slope of 7.6 degrees
    points = 0.964 * points + np.linspace(-1.58, 1.58, 60)[:, None, None] * way + [0.0, 0.0, -0.927]
    camera = ring_of_cameras(radius=6.0, distortion=0.0).subset([0])
    found = pictures_of_one_view(camera, seen_by(camera, points))
    assert found is not None and found.picture.size == 1.5 and found.rival


def seen_by(camera: Cameras, points: np.ndarray) -> Detections:
    xy = project(camera, points)
    return Detections(camera.names, xy[:, :, None], np.ones((*xy.shape[:2], 1, xy.shape[2])), KEYPOINTS.joint_set)


@pytest.mark.parametrize("height", [0.5, 0.7, 1.0])
@pytest.mark.parametrize("lift", [-0.9, 0.0, 1.0])
def test_a_person_who_lies_on_a_table_is_not_turned(height: float, lift: float) -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))
    camera = ring_of_cameras(radius=5.0, distortion=0.0).subset([0])
    camera = replace(camera, t=camera.t - camera.R @ [0, 0, lift])
    for sign in (-1, 1):
        side = sign * camera.R[0, 0]
        lying = (points[..., 2:] - 0.8) * side + 0.1 * points[..., 1:2] * np.array([0, 0, 1.0]) + [0, 0, height + 0.1]
        found = pictures_of_one_view(camera, seen_by(camera, lying))
        assert found is None or found.rival


def test_a_handstand_is_not_turned() -> None:
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] -= points[..., :2].mean(axis=(0, 1))
    camera = ring_of_cameras(radius=5.0, distortion=0.0).subset([0])
    for reach in np.linspace(1.5, 2.2, 8):
        found = pictures_of_one_view(camera, seen_by(camera, points * [1, 1, -1] + [0, 0, reach]))
        assert found is None or found.rival


def test_a_view_from_the_ceiling_is_not_turned() -> None:
    """Below the middle of such a view, heads are farther down in the image than feet."""
    points = DEMO.truth["keypoints3d"][FRAMES].copy()
    points[..., :2] += [0.0, -0.7] - points[..., :2].mean(axis=(0, 1))
    centre = np.array([0.0, 0.0, 3.5])
    R = look_at(centre, np.array([0.0, 1e-3, 0.0]))
    camera = ring_of_cameras(radius=5.0, distortion=0.0).subset([0])
    camera = replace(camera, R=R[None], t=-(R @ centre)[None])
    assert pictures_of_one_view(camera, seen_by(camera, points)) is None


def test_windows_move_and_squeeze_pictures() -> None:
    found = corrected(CAMERAS, [CameraCorrection(window=(0.75, -0.25, 0.5))] * 4)
    points = DEMO.truth["keypoints3d"][40]
    expected = (project(CAMERAS, points) + 0.5) * [0.75, 1.0] - 0.5 + 1080 * np.array([-0.25, 0.5])
    np.testing.assert_allclose(project(found, points), expected, atol=1e-9)
    assert found.image_size.tolist() == [[1440 - 270, 1080 + 540]] * 4


def test_pictures_that_were_cut_end_where_an_even_cut_ends_if_all_keypoints_fit() -> None:
    shown = PictureReading(1.0, window=(1.0, -320 / 1080, -180 / 1080))
    seen = replace(detections(), xy=np.full((4, 60, 1, 25, 2), 500.0))
    sizes = apply_reading(CAMERAS, seen, pictures_of(shown))[0].image_size
    assert sizes.tolist() == [[1280, 720]] * 4
    seen.xy[0, 0, 0, 0] = 1400.0, 500.0
    sizes = apply_reading(CAMERAS, seen, pictures_of(shown))[0].image_size
    assert sizes.tolist() == [[1600, 720], *[[1280, 720]] * 3]
