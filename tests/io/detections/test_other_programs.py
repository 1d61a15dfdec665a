"""Forms of other programs and of people's own scripts: what was written comes back, by camera, frame and keypoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged
from solver_backend.io.detections.column_table import is_table
from solver_backend.io.detections.column_table import read_point_rows as read_points
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from solver_backend.io.recognition.confidence import in_pixels
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet
from tests.support.calibration_files import json_text, toml_text
from tests.support.camera_ring import ring
from tests.support.other_programs import (
    CAMERAS,
    COCO,
    FRAMES,
    POINTS,
    SIZE,
    WRITERS,
    coco_of_all_cameras,
    instance,
    openpose_in_one_folder,
    openpose_list,
    own_table,
    write_lines,
    write_table,
)
from tests.support.words import words


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_what_a_program_writes_comes_back(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "take")
    sources = camera_sources(tmp_path / "take")
    assert tuple(sources) == CAMERAS
    found = read_detections(sources, joint_set=JointSet.COCO_17)
    assert found.num_frames == FRAMES
    np.testing.assert_allclose(found.xy[:, :, 0], POINTS[..., :2], rtol=1e-6)
    if write is not coco_of_all_cameras:  # whose third number is a visibility
        np.testing.assert_allclose(found.confidence[:, :, 0], POINTS[..., 2], rtol=1e-6)


@pytest.mark.parametrize("name", ["calibration.json", "cameras.json"])
@pytest.mark.parametrize("layout", ["list", "dict"])
@pytest.mark.parametrize("write", [*WRITERS, openpose_in_one_folder], ids=lambda write: write.__name__)
def test_a_calibration_beside_the_detections_is_no_camera(
    write: Callable[[Path], None], layout: str, name: str, tmp_path: Path
) -> None:
    write(tmp_path)
    cameras = replace(ring(3), names=CAMERAS)
    (tmp_path / name).write_text(json_text(cameras, layout))
    assert tuple(camera_sources(tmp_path)) == CAMERAS


def test_a_damaged_file_of_a_camera_is_reported(tmp_path: Path) -> None:
    openpose_list(tmp_path)
    path = tmp_path / "cam02.json"
    path.write_text(path.read_text()[:-20])
    with pytest.raises(FileDamaged, match="cam02|JSON"):
        read_detections(camera_sources(tmp_path))


@pytest.mark.parametrize("place", ["alphapose-results.json", "predictions/walk.json"])
def test_one_file_of_one_camera_is_one_camera(place: str, tmp_path: Path) -> None:
    people = [
        {"image_id": f"{f}.jpg", "category_id": 1, "keypoints": POINTS[0, f].ravel().tolist(), "score": 2.5}
        for f in range(FRAMES)
    ]
    write_lines(tmp_path / place, people)
    sources = camera_sources(tmp_path)
    assert len(sources) == 1
    found = read_detections(sources, joint_set=JointSet.COCO_17)
    np.testing.assert_allclose(found.xy[0, :, 0], POINTS[0, ..., :2], rtol=1e-6)


def _yolo_line(points: np.ndarray) -> str:
    shares = points / [*SIZE, 1.0]
    return " ".join(f"{v:.6f}" for v in (0.5, 0.5, 0.2, 0.6, *shares.ravel()))


@pytest.mark.parametrize("deeper", [pytest.param(False, marks=pytest.mark.slow), True])
def test_ultralytics_writes_shares_of_the_picture(deeper, tmp_path):
    demo = demo_capture(30)
    points = np.nan_to_num(demo.keypoints.xy[:, :30]), np.nan_to_num(demo.keypoints.confidence[:, :30])
    columns = [demo.keypoints.joint_set.keypoints.index(name) for name in COCO]
    for c, name in enumerate(demo.cameras.names):
        folder = tmp_path / (f"{name}/labels" if deeper else "labels")
        folder.mkdir(parents=True, exist_ok=True)
        for f in range(30):
            person = np.concatenate([points[0][c, f], points[1][c, f][:, None]], -1)[columns]
            (folder / f"{name}_{f + 1}.txt").write_text(f"0 {_yolo_line(person)} 1\n")
    (tmp_path / "calibration.toml").write_text(toml_text(demo.cameras))
    capture = load_capture(tmp_path, fps=60.0)
    assert any("fractions of the image size (from 0 to 1)" in note for note in words(capture.notes))
    assert not any("joint set" in problem for problem in words(capture.problems))
    seen = capture.keypoints.confidence > 0
    np.testing.assert_allclose(capture.keypoints.xy[seen], points[0][:, :, columns][seen], atol=2e-3)


def test_positions_in_space_are_no_detections(tmp_path):
    for form in ("{n}_{x}", "{x}{k}"):
        heading = [form.format(n=n, x=x, k=k) for k, n in enumerate(COCO) for x in "xyz"]
        write_table(tmp_path / "walk.csv", [["frame", *heading], [0, *range(51)]])
        assert not is_table(tmp_path / "walk.csv")
    np.save(tmp_path / "walk.npy", np.full((9, 17, 3), 800.0))
    assert camera_sources(tmp_path) == {}


def test_a_short_row_is_named(tmp_path):
    own_table(tmp_path)
    path = tmp_path / "cam02.csv"
    path.write_text(path.read_text().rstrip().rpartition(";")[0])
    with pytest.raises(FileDamaged, match="short"):
        read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)


def test_rows_of_one_frame_are_several_people_however_many_tracks_there_are(tmp_path):
    heading = ["track", "frame_idx", *(f"{n}.{x}" for n in COCO for x in ("x", "y", "score"))]
    rows = [[f"track_{i}", i // 2, *POINTS[i % 2, 0].ravel()] for i in range(600)]
    for name in CAMERAS:
        write_table(tmp_path / f"{name}.csv", [heading, *rows])
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    assert found.num_frames == 300 and found.xy.shape[2] == 2
    np.testing.assert_allclose(found.xy[1, 7, 1], POINTS[1, 0, :, :2], rtol=1e-6)


def test_numbers_that_count_no_frames_are_named(tmp_path):
    for name in CAMERAS:
        frames = [{"frame_id": f, "instances": [instance(0, 0)]} for f in (0, 1, 10**15)]
        write_lines(tmp_path / f"{name}.json", frames)
    with pytest.raises(FileDamaged, match="run from 0 to 1000000000000000"):
        read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)


def test_points_by_name_may_come_and_go(tmp_path):
    for c, name in enumerate(CAMERAS):
        named = [dict(zip(COCO, POINTS[c, f].tolist(), strict=True)) for f in range(FRAMES)]
        named[1] = {"left_wrist": named[1]["left_wrist"], "nose": None}
        write_lines(tmp_path / f"{name}.json", [*named[:2], {}, *named[3:]])
    found = read_detections(camera_sources(tmp_path))
    seen = found.confidence[:, :, 0] > 0
    assert seen[:, 0].all() and seen[:, 1].sum() == len(CAMERAS) and not seen[:, 2].any()
    wrist = COCO.index("left_wrist")
    np.testing.assert_allclose(found.xy[:, 1, 0, wrist], POINTS[:, 1, wrist, :2], rtol=1e-6)


def test_json_of_something_else_is_no_take(tmp_path):
    write_lines(tmp_path / "package.json", {"name": "walk", "version": "1.0", "dependencies": {"left": [1, 2]}})
    write_lines(tmp_path / "places.json", [{"a": [1, 2], "b": [3, 4]}])
    assert camera_sources(tmp_path) == {}


def test_cameras_whose_files_name_different_keypoints(tmp_path):
    few = [n for n in reversed(COCO) if n not in ("left_ear", "right_ear")]
    for c, name in enumerate(CAMERAS):
        chosen = few if c == 1 else COCO
        columns = [COCO.index(n) for n in chosen]
        heading = ["Frame", *(f"{n} {x}" for n in chosen for x in ("x", "y", "likelihood"))]
        write_table(tmp_path / f"{name}.csv", [heading, *([f, *POINTS[c, f, columns].ravel()] for f in range(FRAMES))])
    found = read_detections(camera_sources(tmp_path))
    seen = found.confidence[:, :, 0] > 0
    np.testing.assert_allclose(found.xy[:, :, 0][seen], POINTS[..., :2][seen], rtol=1e-6)
    assert seen.sum() == seen.size - 2 * FRAMES
    assert diagnostic("keypoints_lacking", cameras=["cam02"], joints=["left_ear", "right_ear"]) in found.problems
    expected = "The cameras have different keypoint sets. cam02 has no left_ear, right_ear. "
    assert any(problem.startswith(expected) for problem in words(found.problems))


@pytest.mark.parametrize("place", [(-1.0, -1.0), (1919.0, 1079.0)])
def test_what_stands_for_an_unseen_keypoint_is_none(place, tmp_path):
    points = POINTS.copy()
    lost = np.random.default_rng(1).uniform(size=points.shape[:-1]) < 0.2
    points[lost] = [*place, 1.0]
    for name, of_camera in zip(CAMERAS, points, strict=True):
        np.save(tmp_path / f"{name}.npy", of_camera)
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    np.testing.assert_array_equal(found.confidence[:, :, 0] == 0, lost)
    assert any("are treated as not detected" in note for note in words(found.notes))


def test_shares_from_the_centre_of_the_picture(tmp_path):
    shares = np.concatenate([2 * POINTS[..., :2] / SIZE - 1, POINTS[..., 2:]], -1)
    for name, of_camera in zip(CAMERAS, shares, strict=True):
        np.save(tmp_path / f"{name}.npy", of_camera)
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    in_px = in_pixels(found, np.tile(SIZE, (len(CAMERAS), 1)))
    np.testing.assert_allclose(in_px.xy[:, :, 0], POINTS[..., :2], rtol=1e-4, atol=0.1)


def test_points_of_everybody_without_scores_are_sure(tmp_path: Path) -> None:
    for name in CAMERAS:
        for f in range(FRAMES):
            people = [POINTS[0, f, :, :2].tolist(), POINTS[1, f, :, :2].tolist()]
            write_lines(tmp_path / name / f"{f:06d}.json", {"keypoints": people})
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    np.testing.assert_allclose(found.xy[0], np.stack([POINTS[0], POINTS[1]], 1)[..., :2], rtol=1e-6)
    assert (found.confidence == 1).all()


def test_boxes_alone_are_named(tmp_path: Path) -> None:
    for name in CAMERAS:
        write_lines(
            tmp_path / "preds" / name / "000000.json", {"labels": [0], "scores": [0.9], "bboxes": [[0, 0, 9, 9]]}
        )
    with pytest.raises(FileDamaged, match="only boxes, as MMDetection") as found:
        read_detections(camera_sources(tmp_path))
    assert "MMPose" in found.value.hint


def test_several_trials_of_opencap_are_named(tmp_path: Path) -> None:
    for name in CAMERAS:
        for trial in ("walk1", "squat2"):
            folder = tmp_path / "Videos" / name / "OutputJsons_1x736" / trial
            write_lines(folder / f"{trial}_000000000000_keypoints.json", {"people": []})
    with pytest.raises(CaptureNotRecognised, match="several trials: OutputJsons_1x736/squat2, OutputJsons_1x736/walk1"):
        read_detections(camera_sources(tmp_path))


def test_an_array_of_all_cameras_comes_back_by_camera(tmp_path: Path) -> None:
    points = np.tile(POINTS, (1, 5, 1, 1))  # more frames than people are kept
    np.save(tmp_path / "keypoints.npy", points)
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    assert found.cameras == CAMERAS
    np.testing.assert_allclose(found.xy[:, :, 0], points[..., :2], rtol=1e-6)


def test_an_array_of_people_of_one_camera_stays_one_cameras(tmp_path: Path) -> None:
    np.save(tmp_path / "cam01.npy", POINTS)
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    assert found.cameras == ("cam01",) and found.xy.shape[:3] == (1, len(POINTS), FRAMES)


def test_points_by_number_are_in_the_order_of_the_joint_set(tmp_path: Path) -> None:
    rows = [[f, k, *POINTS[0, f, k]] for f in range(FRAMES) for k in range(17)]
    write_table(tmp_path / "cam01.csv", [["frame", "keypoint_id", "x", "y", "score"], *rows[::-1]])
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    np.testing.assert_allclose(found.xy[0, :, 0], POINTS[0, ..., :2], rtol=1e-6)


@pytest.mark.parametrize("form", ["{x}{k}", "{x}_{k}", "{k}_{x}", "landmark_{k}_{x}", "{x}_{name}"])
def test_columns_that_number_the_points_or_begin_with_the_coordinate(form: str, tmp_path: Path) -> None:
    """As scripts around MediaPipe write them: x1, y1, v1 ..."""
    heading = [form.format(x=x, k=k + 1, name=n.upper()) for k, n in enumerate(COCO) for x in "xyv"]
    heading, columns = ["frame", *heading[::-1]], [*range(51)][::-1]
    write_table(tmp_path / "cam01.csv", [heading, *([f, *POINTS[0, f].ravel()[columns]] for f in range(FRAMES))])
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    np.testing.assert_allclose(found.xy[0, :, 0], POINTS[0, ..., :2], rtol=1e-6)
    np.testing.assert_allclose(found.confidence[0, :, 0], POINTS[0, ..., 2], rtol=1e-6)


def test_rows_of_points_in_space_are_no_detections(tmp_path: Path) -> None:
    write_table(tmp_path / "walk.csv", [["frame", "joint", "x", "y", "z"], [0, "nose", 1, 2, 3]])
    assert camera_sources(tmp_path) == {}


def test_decimal_commas_between_semicolons_are_read(tmp_path: Path) -> None:
    heading = ["frame", *(f"{n}_{x}" for n in COCO for x in ("x", "y", "score"))]
    for c, name in enumerate(CAMERAS):
        rows = [[f, *(f"{v:.2f}".replace(".", ",") for v in POINTS[c, f].ravel())] for f in range(FRAMES)]
        write_table(tmp_path / f"{name}.csv", [heading, *rows], ";")
    found = read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
    np.testing.assert_allclose(found.xy[:, :, 0], POINTS[..., :2], rtol=1e-6)


@pytest.mark.parametrize("change", ["quoted", "blank line", "windows", "short row", "long row"])
def test_rows_of_points_are_the_same_however_lines_are_written(change: str, tmp_path: Path) -> None:
    rows = [f"{f},{name},{f + k},{2 * k},0.5" for f in range(3) for k, name in enumerate(COCO)]
    heading, end = "frame,keypoint,x,y,score", "\n"
    if change == "quoted":
        rows = [row.replace("nose", '"nose"') for row in rows]
    elif change == "blank line":
        rows.insert(5, "")
    elif change == "windows":
        end = "\r\n"
    elif change == "short row":  # as many cells in all as rows of one length have
        rows[4], rows[7] = rows[4].rpartition(",")[0], rows[7] + ",0.5"
    else:
        rows = [row + ",more" for row in rows]
    path = tmp_path / "cam1.csv"
    path.write_bytes(end.join([heading, *rows, ""]).encode())
    if change == "short row":
        with pytest.raises(FileDamaged, match="short"):
            read_points(path)
        return
    people = read_points(path).people(2)[0]
    np.testing.assert_allclose(people, [[2 + k, 2 * k, 0.5] for k in range(len(COCO))])
