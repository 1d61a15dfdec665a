"""Detections as other programs write them: what was written comes back, by camera, frame and keypoint."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, KeypointCountMismatch
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.types import Detections, JointSet
from tests.support.words import words

COCO = JointSet.COCO_17.keypoints
CAMERAS, FRAMES = ("cam01", "cam02", "cam03"), 4
RNG = np.random.default_rng(3)
POINTS = np.concatenate(
    [RNG.uniform(1, 900, (3, FRAMES, 33, 2)).round(2), RNG.uniform(0.3, 0.9, (3, FRAMES, 33, 1)).round(2)], axis=-1
)
"""(C, F, K, 3) pixels and confidence; sets of fewer keypoints take the first."""


def person(c: int, f: int, count: int = 17) -> list[float]:
    return POINTS[c, f, :count].ravel().tolist()


def alphapose(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        people = [
            {"image_id": f"{f}.jpg", "category_id": 1, "keypoints": person(c, f), "score": 2} for f in range(FRAMES)
        ]
        _write(root / "pose" / f"{name}_json" / "alphapose-results.json", people)


def alphapose_cmu(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = {f"{f}.jpg": {"version": "x", "bodies": [{"joints": person(c, f)}]} for f in range(FRAMES)}
        _write(root / "pose" / f"{name}_json" / "alphapose-results-forvis.json", frames)


def mmpose(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        found = [{"keypoints": POINTS[c, f, :17, :2].tolist(), "keypoint_scores": POINTS[c, f, :17, 2].tolist()}
                 for f in range(FRAMES)]  # fmt: skip
        frames = [{"frame_id": f + 1, "instances": [one]} for f, one in enumerate(found)]
        _write(root / "predictions" / f"results_{name}.json", {"meta_info": {}, "instance_info": frames})


def coco(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        images = [{"id": 7 + f, "file_name": f"{name}_{f:06d}.png"} for f in range(FRAMES)]
        people = [{"image_id": 7 + f, "keypoints": person(c, f)} for f in range(FRAMES)]
        document = {"images": images, "annotations": people, "categories": [{"keypoints": list(COCO)}]}
        _write(root / "annotations" / f"{name}.json", document)


def easymocap(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            people = [{"personID": 0, "keypoints": POINTS[c, f, :17].tolist()}]
            _write(root / "annots" / name / f"{f:06d}.json", {"annots": people, "height": 1080})


def flat(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            _write(root / f"{name}_{f:012d}_keypoints.json", {"people": [{"pose_keypoints_2d": person(c, f)}]})


def old_openpose(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            _write(root / "pose" / f"{name}_json" / f"{f:06d}.json", {"people": [{"pose_keypoints": person(c, f)}]})


def deeplabcut(root: Path, names: tuple[str, ...] = COCO) -> None:
    root.mkdir(parents=True, exist_ok=True)
    for c, camera in enumerate(CAMERAS):
        columns = [(n, x) for n in names for x in ("x", "y", "likelihood")]
        rows = [
            ["scorer", *["net"] * len(columns)],
            ["bodyparts", *(n for n, _ in columns)],
            ["coords", *(x for _, x in columns)],
        ]
        rows += [[str(f), *map(str, person(c, f, len(names)))] for f in range(FRAMES)]
        (root / f"{camera}DLC_resnet50_danceshuffle1_500000.csv").write_text("\n".join(",".join(row) for row in rows))


def _write(path: Path, document: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document))


def read(root: Path) -> Detections:
    return read_detections(camera_sources(root))


@pytest.mark.parametrize(
    "write", [alphapose, alphapose_cmu, mmpose, coco, easymocap, flat, old_openpose, deeplabcut],
    ids=lambda write: write.__name__,
)  # fmt: skip
def test_what_a_program_writes_comes_back(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "take")
    found = read(tmp_path / "take")
    assert (found.cameras, found.joint_set, found.num_frames) == (CAMERAS, JointSet.COCO_17, FRAMES)
    np.testing.assert_allclose(found.xy[:, :, 0], POINTS[:, :, :17, :2], atol=1e-3)
    np.testing.assert_allclose(found.confidence[:, :, 0], POINTS[:, :, :17, 2], atol=1e-6)


def test_freemocap_keeps_all_cameras_in_one_array(tmp_path: Path) -> None:
    folder = tmp_path / "take" / "output_data" / "raw_data"
    folder.mkdir(parents=True)
    array = np.full((3, FRAMES, 553, 2), np.nan)
    array[:, :, :33] = POINTS[..., :2]
    np.save(folder / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", array)
    found = read(tmp_path / "take")
    assert found.joint_set is JointSet.MEDIAPIPE_33
    assert found.cameras == tuple(f"Camera_{c:03d}_synchronized" for c in range(3))
    np.testing.assert_allclose(found.xy[:, :, 0], POINTS[..., :2], atol=1e-3)
    np.save(folder / "mediapipe2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", array[0])
    with pytest.raises(FileDamaged, match=r"shape \(4, 553, 2\)"):
        read(tmp_path / "take")


def test_names_of_keypoints_are_known_however_they_are_written(tmp_path: Path) -> None:
    written = {"left": "L", "right": "R"}
    sides = [name.split("_") for name in COCO]
    names = tuple(f"{written[s[0]]}{s[1].capitalize()}" if len(s) == 2 else s[0].capitalize() for s in sides)
    deeplabcut(tmp_path / "take", names)
    np.testing.assert_allclose(read(tmp_path / "take").xy[:, :, 0], POINTS[:, :, :17, :2], atol=1e-3)


def test_keypoints_of_an_animal_are_named_not_guessed(tmp_path: Path) -> None:
    deeplabcut(tmp_path / "take", ("snout", "withers", "tail_base", "left_hoof"))
    with pytest.raises(KeypointCountMismatch, match="Of the 4 named keypoints only 0 are known: snout"):
        read(tmp_path / "take")


def test_nobody_in_a_matched_frame_is_no_damage(tmp_path: Path) -> None:
    flat_people = {"people": [{"pose_keypoints_2d": person(0, 0)}, {}]}
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            people = {"people": [{}]} if f == 2 else flat_people
            _write(tmp_path / "take" / "pose-associated" / f"{name}_json" / f"{f:06d}.json", people)
        _write(
            tmp_path / "take" / "pose" / f"{name}_json" / "000000.json",
            {"people": [{"pose_keypoints_2d": person(c, 1)}]},
        )
    found = read(tmp_path / "take")
    np.testing.assert_array_equal(found.people(), [[1, 1, 0, 1]] * 3)


def test_names_beside_a_body_are_left_out_and_listed(tmp_path: Path) -> None:
    feet = ("left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel")
    deeplabcut(tmp_path / "take", (*COCO, *feet, "racket_tip"))
    found = read(tmp_path / "take")
    assert found.joint_set is JointSet.COCO_WHOLEBODY_133
    assert "Keypoints that are not part of COCO_WHOLEBODY_133 are ignored: racket_tip." in words(found.notes)
    columns = [found.joint_set.keypoints.index(name) for name in (*COCO, *feet)]
    np.testing.assert_allclose(found.xy[:, :, 0, columns], POINTS[:, :, :23, :2], atol=1e-3)
