"""Everybody in every frame comes back where the detector put them; damaged files are named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import (
    FileDamaged,
    FrameCountMismatch,
    KeypointCountMismatch,
    NoDetections,
    NonFiniteData,
)
from solver_backend.io.detections.read import MAX_PEOPLE
from solver_backend.io.recognition.frame_numbers import frame_numbers
from solver_backend.io.recognition.joint_sets import bone_score, choose_joint_set
from solver_backend.types import JointSet
from tests.support.scenes import detected, ring_of_cameras, walker
from tests.support.trial_files import frame_text, read_folders
from tests.support.words import words


def write(folder: Path, frames: dict[int, list[np.ndarray]], pattern: str = "cam_{:012d}_keypoints.json") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, people in frames.items():
        (folder / pattern.format(number)).write_text(frame_text(people))
    return folder


def person(seed: int, keypoints: int = 26) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(1, 900, (keypoints, 2)).round(3), rng.uniform(0.2, 0.9, keypoints).round(3)])


def test_everybody_is_read_in_order_with_gaps_as_missing_frames(tmp_path: Path) -> None:
    first, second, third = person(1), person(2), person(3)
    third[4] = 0.0
    folders = {
        "a": write(tmp_path / "a", {3: [first, second], 5: [third]}),
        "b": write(tmp_path / "b", {3: [], 4: [second], 5: [first]}),
    }
    calls: list[tuple[str, int, int]] = []
    found = read_folders(folders, progress=lambda stage, done, total: calls.append((stage, done, total)))
    assert found.cameras == ("a", "b")
    assert (found.first_frame, found.num_frames, found.joint_set) == (3, 3, JointSet.HALPE_26)
    np.testing.assert_array_equal(found.people(), [[2, 0, 1], [0, 1, 1]])
    np.testing.assert_allclose(found.xy[0, 0, 0], first[:, :2], rtol=1e-6)
    np.testing.assert_allclose(found.confidence[0, 0, 1], second[:, 2], rtol=1e-6)
    assert np.isnan(found.xy[0, 2, 0, 4]).all()
    assert found.confidence[0, 2, 0, 4] == 0
    assert np.isnan(found.xy[0, 1]).all()
    assert found.problems == (diagnostic("frame_files_missing", count=1),)
    assert words(found.problems)[0].startswith("1 frame files are missing. These frames have no detections. ")
    assert calls[0] == ("Reading the detections", 0, 5)
    assert calls[-1] == ("Reading the detections", 5, 5)


@pytest.mark.parametrize("text", ["null", "[]", '{"people": null}', '{"version": 1.3, "people": []}'])
def test_frames_without_people_are_written_in_several_ways(tmp_path: Path, text: str) -> None:
    folders = {
        name: write(tmp_path / name, {0: [person(1)], 1: [person(2)], 2: [person(3)]}) for name in ("cam01", "cam02")
    }
    (tmp_path / "cam01" / "cam_000000000001_keypoints.json").write_text(text)
    found = read_folders(folders)
    assert (found.confidence[..., :].max((2, 3)) > 0).tolist() == [[True, False, True], [True, True, True]]
    assert found.problems == ()


@pytest.mark.parametrize("key", ["joints2d", "keypoints_2d", "kpts", "keypoints"])
def test_people_with_points_of_other_names(tmp_path: Path, key: str) -> None:
    shown = person(1)
    folders = {name: write(tmp_path / name, {f: [shown] for f in range(3)}) for name in ("cam01", "cam02")}
    for path in tmp_path.rglob("*.json"):
        path.write_text(json.dumps({"people": [{key: shown.tolist()}]}))
    found = read_folders(folders)
    np.testing.assert_allclose(found.xy[:, :, 0], np.broadcast_to(shown[:, :2], (2, 3, 26, 2)), rtol=1e-6)


def test_padding_files_of_pose2sim_are_frames_without_people(tmp_path: Path) -> None:
    folders = {
        "a": write(tmp_path / "a", {n: [person(n)] for n in range(4)}),
        "b": write(tmp_path / "b", {n: [person(n)] for n in range(2, 4)}),
    }
    write(folders["b"], {n: [] for n in (0, 1, 2)}, "del_{:06d}_0.json")
    found = read_folders(folders)
    assert (found.first_frame, found.num_frames) == (0, 4)
    np.testing.assert_array_equal(found.people(), [[1, 1, 1, 1], [0, 0, 1, 1]])


@pytest.mark.parametrize(
    ("stems", "numbers"),
    [
        (["cam01.0000", "cam01.0001"], [0, 1]),
        (["Static_cam_01.00007", "Static_cam_01.00009"], [7, 9]),
        (["take2_cam1_000000000012_keypoints", "take2_cam1_000000000013_keypoints"], [12, 13]),
        (["frame_0001_cam2", "frame_0002_cam2"], [1, 2]),
        (["7"], [7]),
        (["0_1", "0_10", "0_9"], [1, 10, 9]),
    ],
)
def test_frame_numbers_of_every_naming(stems: list[str], numbers: list[int]) -> None:
    assert frame_numbers(stems, where="x").tolist() == numbers


def test_names_that_give_no_frame_number() -> None:
    with pytest.raises(FileDamaged, match=r"'first' contains no frame number.*folder x"):
        frame_numbers(["first", "second"], where="folder x")
    with pytest.raises(FileDamaged, match="2 files have the frame number 1"):
        frame_numbers(["a_1", "b_1", "b_2"], where="x")


def test_different_lengths_name_each_camera_and_can_be_trimmed(tmp_path: Path) -> None:
    folders = {
        "left": write(tmp_path / "left", {f: [person(f)] for f in range(5)}),
        "right": write(tmp_path / "right", {f: [person(10 + f)] for f in range(1, 4)}),
    }
    with pytest.raises(
        FrameCountMismatch, match=r"left: 5 \(numbers 0 to 4\); right: 3 \(numbers 1 to 3\).*--trim.* 3 "
    ):
        read_folders(folders)
    found = read_folders(folders, trim=True)
    assert (found.num_frames, found.first_frame) == (3, 1)
    np.testing.assert_allclose(found.xy[0, 0, 0], person(1)[:, :2], rtol=1e-6)
    np.testing.assert_allclose(found.xy[1, 2, 0], person(13)[:, :2], rtol=1e-6)


def test_no_frame_in_common(tmp_path: Path) -> None:
    folders = {
        "a": write(tmp_path / "a", {1: [person(1)]}), "b": write(tmp_path / "b", {2: [person(1)]}),
    }  # fmt: skip
    with pytest.raises(FrameCountMismatch, match="no frame number in common"):
        read_folders(folders, trim=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"version": 1.3, "people": [{"pose_key', "truncated or is not JSON"),
        ("", "truncated or is not JSON"),
        ("hello", "truncated or is not JSON"),
        ("[1, 2]", "has no OpenPose list 'people'"),
        ('{"people": [{"face_keypoints_2d": []}]}', "has no 'pose_keypoints_2d'"),
        ('{"people": [{"pose_keypoints_2d": [1, "x", 3]}]}', "values that are not numbers"),
        ('{"people": [{"pose_keypoints_2d": [1, [2], 3]}]}', "values that are not numbers"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    folder = write(tmp_path / "a", {f: [person(1)] for f in range(3)})
    (folder / "cam_000000000001_keypoints.json").write_text(text)
    with pytest.raises(FileDamaged, match=message + r".*cam_000000000001_keypoints\.json"):
        read_folders({"a": folder})


def test_wrong_numbers_of_keypoints_name_the_sets_that_fit(tmp_path: Path) -> None:
    odd = write(tmp_path / "odd", {0: [person(1, 22)]})
    with pytest.raises(
        KeypointCountMismatch, match=r"No known joint set has 22.*BODY_25 \(25/135\).*COCO_WHOLEBODY_133 \(133/23\)"
    ):
        read_folders({"a": odd})
    good = write(tmp_path / "good", {0: [person(1, 25)]})
    with pytest.raises(
        KeypointCountMismatch, match=r"have 25 .* HALPE_26 has 26.*Joint sets with 25 .*: BODY_25, BODY_25B"
    ):
        read_folders({"a": good}, joint_set=JointSet.HALPE_26)
    mixed = write(tmp_path / "mixed", {0: [person(1, 25)], 1: [person(1, 17)]})
    with pytest.raises(KeypointCountMismatch, match=r"has 17 keypoints, but earlier people have 25.*000000000001"):
        read_folders({"a": mixed})
    (good / "cam_000000000000_keypoints.json").write_text('{"people": [{"pose_keypoints_2d": [1, 2, 3, 4]}]}')
    with pytest.raises(KeypointCountMismatch, match="contains 4 numbers, but x, y and confidence"):
        read_folders({"a": good})


def test_nobody_at_all(tmp_path: Path) -> None:
    with pytest.raises(NoDetections, match="All lists of people are empty"):
        read_folders({"a": write(tmp_path / "a", {0: [], 1: []})})


def test_infinite_and_nan_values(tmp_path: Path) -> None:
    folder = write(tmp_path / "a", {0: [person(1)]})
    values = person(1).ravel().tolist()
    path = folder / "cam_000000000000_keypoints.json"
    path.write_text(json.dumps({"people": [{"pose_keypoints_2d": [*values[:6], float("inf"), *values[7:]]}]}))
    with pytest.raises(NonFiniteData, match=r"Keypoint 2 of a person is infinite.*000000000000.*0 0 0"):
        read_folders({"a": folder})
    path.write_text(json.dumps({"people": [{"pose_keypoints_2d": [*values[:6], float("nan"), *values[7:]]}]}))
    found = read_folders({"a": folder})
    assert found.confidence[0, 0, 0, 2] == 0


@pytest.mark.parametrize("number", [1e9, -1e30, 1e300])
def test_a_point_beyond_any_picture_is_not_seen(number: float, tmp_path: Path) -> None:
    values = [person(1).ravel().tolist() for _ in range(2)]
    values[1][6] = number
    folder = write(tmp_path / "a", {0: [person(1)]})
    pair = {"people": [{"pose_keypoints_2d": row} for row in values]}
    (folder / "cam_000000000000_keypoints.json").write_text(json.dumps(pair))
    found = read_folders({"a": folder})
    assert found.confidence[0, 0, 1, 2] == 0 and found.confidence[0, 0, 0, 2] > 0
    assert "keypoints_nan" in {problem.code for problem in found.problems}
    assert found.problems == (diagnostic("keypoints_nan", count=1),)
    assert words(found.problems)[0].startswith("1 keypoints have a confidence but no position (NaN)")


def test_confidences_above_one_are_taken_as_one(tmp_path: Path) -> None:
    big = person(1)
    big[3, 2] = 2.5
    found = read_folders({"a": write(tmp_path / "a", {0: [big]})})
    assert found.confidence.max() == 1
    assert words(found.notes)[0].startswith("The highest confidence is 2.5. Values above 1 are treated as 1.")


def test_logarithms_of_confidences_are_read_as_confidences(tmp_path: Path) -> None:
    people = {f: [person(f)] for f in range(6)}
    logarithms = {f: [np.column_stack([p[:, :2], np.log(p[:, 2])]) for p in listed] for f, listed in people.items()}
    plain, read = (
        read_folders({"a": write(tmp_path / n, frames)}) for n, frames in zip("ab", (people, logarithms), strict=True)
    )
    np.testing.assert_allclose(read.confidence, plain.confidence, atol=2e-3)
    np.testing.assert_allclose(read.xy, plain.xy)


def test_a_crowd_is_cut_to_the_strongest(tmp_path: Path) -> None:
    crowd = [person(i) for i in range(MAX_PEOPLE + 5)]
    for i, one in enumerate(crowd):
        one[:, 2] = 0.9 if i % 4 else 0.1
    found = read_folders({"a": write(tmp_path / "a", {0: crowd})})
    assert found.people().tolist() == [[MAX_PEOPLE]]
    np.testing.assert_allclose(found.xy[0, 0, 0], crowd[1][:, :2], rtol=1e-6)


def test_whole_body_files_give_their_body_columns(tmp_path: Path) -> None:
    found = read_folders({"a": write(tmp_path / "a", {0: [person(1, 133)]})})
    assert found.joint_set is JointSet.COCO_WHOLEBODY_133
    assert found.xy.shape == (1, 1, 1, 23, 2)


@pytest.mark.parametrize("written", [JointSet.BODY_25, JointSet.BODY_25B, JointSet.COCO_17, JointSet.H36M_17])
def test_sets_with_equal_numbers_are_recognised_by_anatomy(written: JointSet) -> None:
    cameras = ring_of_cameras(2)
    names = JointSet.BODY_25.keypoints if written is JointSet.H36M_17 else written.keypoints
    base = JointSet.BODY_25 if written is JointSet.H36M_17 else written
    points = walker(base, 30, (0.0, 0.0), (0.3, 0.0))
    if written is JointSet.H36M_17:
        stand_in = {"spine": "mid_hip", "thorax": "neck", "head_top": "nose"}
        points = points[:, [names.index(stand_in.get(name, name)) for name in written.keypoints]]
    xy, confidence = detected(cameras, points, np.random.default_rng(0), sigma_px=8.0)
    scores = {s: bone_score(s, xy[0], confidence[0]) for s in JointSet.fitting(points.shape[1])}
    assert min(scores, key=lambda s: scores[s]) is written
    chosen, notes, problems = choose_joint_set(xy, confidence, None, None)
    assert (chosen, problems) == (written, ())
    assert [note.code for note in notes] == ["joint_set_chosen"] and "chosen by bone length" in words(notes)[0]
    other = next(s for s in scores if s is not written)
    assert choose_joint_set(xy, confidence, other, None)[0] is other
    chosen, _, problems = choose_joint_set(xy, confidence, None, other)
    assert chosen is written
    values = {"configured": other.value, "joint_set": written.value}
    assert problems == (diagnostic("joint_set_uncertain", reason="config", **values),)
    notes = choose_joint_set(xy, confidence, None, written)[1]
    assert words(notes) == (f"The joint set is {written.value}, as set in Config.toml.",)


def test_anatomy_that_shows_nothing_is_a_problem() -> None:
    rng = np.random.default_rng(0)
    xy, confidence = rng.uniform(0, 1000, (50, 25, 2)), np.ones((50, 25))
    assert "is uncertain" in words(choose_joint_set(xy, confidence, None, None)[2])[0]
    assert choose_joint_set(xy, confidence, None, JointSet.BODY_25)[0] is JointSet.BODY_25
    _, [note], [problem] = choose_joint_set(xy, confidence * 0, None, None)
    assert (note.code, problem.code) == ("joint_set_chosen", "joint_set_uncertain")


def test_a_folder_without_json(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(FileDamaged, match="contains no JSON files"):
        read_folders({"a": tmp_path / "a"})
