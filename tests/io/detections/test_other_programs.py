"""Forms of other programs and of people's own scripts: what was written comes back, by camera, frame and keypoint."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.column_table import is_table
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import JointSet
from tests.support.calibration_files import toml_text

COCO = JointSet.COCO_17.keypoints
CAMERAS, FRAMES, SIZE = ("cam01", "cam02", "cam03"), 4, (1920, 1080)
_RANDOM = np.random.default_rng(5)
POINTS = np.concatenate(
    [_RANDOM.uniform(1, 900, (3, FRAMES, 17, 2)).round(2), _RANDOM.uniform(0.3, 0.9, (3, FRAMES, 17, 1)).round(2)], -1
)


def _write(path: Path, *documents: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(map(json.dumps, documents)))


def _table(path: Path, rows: Sequence[Sequence[object]], separator: str = ",") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=separator).writerows(rows)


def _pifpaf(c: int, f: int) -> dict[str, object]:
    return {"keypoints": POINTS[c, f].ravel().tolist(), "bbox": [1, 2, 3, 4], "score": 0.9, "category_id": 1}


def pifpaf_pictures(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            _write(root / name / f"{f:06d}.jpg.predictions.json", [_pifpaf(c, f)])


def pifpaf_videos(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        lines = [{"frame": f + 1, "predictions": [_pifpaf(c, f)]} for f in range(FRAMES)]
        _write(root / f"{name}.mp4.openpifpaf.json", *lines)


def _instance(c: int, f: int) -> dict[str, object]:
    return {"keypoints": POINTS[c, f, :, :2].tolist(), "keypoint_scores": POINTS[c, f, :, 2].tolist()}


def mmpose_list(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = [{"frame_id": f, "instances": [_instance(c, f)]} for f in range(FRAMES)]
        _write(root / "predictions" / f"{name}.json", frames)


def sapiens(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            _write(root / name / f"{f:06d}.json", {"meta_info": {}, "instance_info": [_instance(c, f)]})


def movenet(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = [
            {"frame": f, "poses": [{"keypoints": [dict(zip(("x", "y", "score"), p, strict=True), name=n)
                                                  for n, p in zip(COCO, POINTS[c, f].tolist(), strict=True)]}]}
            for f in range(FRAMES)
        ]  # fmt: skip
        _write(root / f"{name}.json", frames)


def alphapose_deeper(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            people = [{"pose_keypoints_2d": POINTS[c, f].ravel().tolist()}]
            _write(root / name / "sep-json" / f"{f}.json", {"version": "AlphaPose v0.3", "people": people})


def coco_of_all_cameras(root: Path) -> None:
    shown = [(c, f, f"pictures/{name}/{f:06d}.jpg") for c, name in enumerate(CAMERAS) for f in range(FRAMES)]
    images = [{"id": i, "file_name": picture} for i, (_, _, picture) in enumerate(shown)]
    people = [{"image_id": i, "keypoints": POINTS[c, f].ravel().tolist()} for i, (c, f, _) in enumerate(shown)]
    _write(root / "person_keypoints.json", {"images": images, "annotations": people,
                                            "categories": [{"keypoints": list(COCO)}]})  # fmt: skip


def sleap_table(root: Path) -> None:
    heading = ["track", "frame_idx", "instance.score", *(f"{n}.{x}" for n in COCO for x in ("x", "y", "score"))]
    for c, name in enumerate(CAMERAS):
        rows = [["track_0", f, 0.9, *POINTS[c, f].ravel()] for f in range(FRAMES)]
        _table(root / f"labels.v001.000_{name}.analysis.csv", [heading, *rows])


def own_table(root: Path) -> None:
    heading = ["Frame", *(f"{n.replace('_', ' ')} {x}" for n in COCO for x in ("X", "Y", "Confidence"))]
    for c, name in enumerate(CAMERAS):
        _table(root / f"{name}.csv", [heading, *([f, *POINTS[c, f].ravel()] for f in range(FRAMES))], ";")


def jarvis(root: Path) -> None:
    columns = [(n, x) for n in COCO for x in ("x", "y", "state")]
    headings = [
        ["Scorer", *["me"] * len(columns)],
        ["entities", *["a"] * len(columns)],
        ["bodyparts", *(n for n, _ in columns)],
        ["coords", *(x for _, x in columns)],
    ]
    for c, name in enumerate(CAMERAS):
        rows = [[f"Frame_{f}.jpg", *POINTS[c, f].ravel()] for f in range(FRAMES)]
        _table(root / name / "annotations.csv", [*headings, *rows])


def arrays(root: Path) -> None:
    root.mkdir(parents=True)
    for name, points in zip(CAMERAS, POINTS, strict=True):
        np.save(root / f"{name}.npy", points)


@pytest.mark.parametrize(
    "write",
    [pifpaf_pictures, pifpaf_videos, mmpose_list, sapiens, movenet, alphapose_deeper, coco_of_all_cameras, sleap_table,
     own_table, jarvis, arrays],
    ids=lambda write: write.__name__,
)  # fmt: skip
def test_what_a_program_writes_comes_back(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "take")
    sources = camera_sources(tmp_path / "take")
    assert tuple(sources) == CAMERAS
    found = read_detections(sources, joint_set=JointSet.COCO_17)
    assert found.num_frames == FRAMES
    np.testing.assert_allclose(found.xy[:, :, 0], POINTS[..., :2], rtol=1e-6)
    if write is not coco_of_all_cameras:  # whose third number is a visibility
        np.testing.assert_allclose(found.confidence[:, :, 0], POINTS[..., 2], rtol=1e-6)


def _yolo_line(points: np.ndarray) -> str:
    shares = points / [*SIZE, 1.0]
    return " ".join(f"{v:.6f}" for v in (0.5, 0.5, 0.2, 0.6, *shares.ravel()))


@pytest.mark.parametrize("deeper", [False, True])
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
    assert any("shares of the picture" in note for note in capture.notes)
    assert not any("joint set" in problem for problem in capture.problems)
    seen = capture.keypoints.confidence > 0
    np.testing.assert_allclose(capture.keypoints.xy[seen], points[0][:, :, columns][seen], atol=2e-3)


def test_positions_in_space_are_no_detections(tmp_path):
    _table(tmp_path / "walk.csv", [["frame", *(f"{n}_{x}" for n in COCO for x in "xyz")], [0, *range(51)]])
    assert not is_table(tmp_path / "walk.csv")
    np.save(tmp_path / "walk.npy", np.full((9, 17, 3), 800.0))
    assert camera_sources(tmp_path) == {}


def test_a_short_row_is_named(tmp_path):
    own_table(tmp_path)
    path = tmp_path / "cam02.csv"
    path.write_text(path.read_text().rstrip().rpartition(";")[0])
    with pytest.raises(FileDamaged, match="short"):
        read_detections(camera_sources(tmp_path), joint_set=JointSet.COCO_17)
