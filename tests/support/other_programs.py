"""Detections as other programs and people's own scripts write them, each as a function of the recording's folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.types import JointSet

COCO = JointSet.COCO_17.keypoints
CAMERAS, FRAMES, SIZE = ("cam01", "cam02", "cam03"), 4, (1920, 1080)
_RANDOM = np.random.default_rng(5)
POINTS = np.concatenate(
    [_RANDOM.uniform(1, 900, (3, FRAMES, 17, 2)).round(2), _RANDOM.uniform(0.3, 0.9, (3, FRAMES, 17, 1)).round(2)], -1
)


def write_lines(path: Path, *documents: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(map(json.dumps, documents)))


def write_table(path: Path, rows: Sequence[Sequence[object]], separator: str = ",") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=separator).writerows(rows)


def _pifpaf(c: int, f: int) -> dict[str, object]:
    return {"keypoints": POINTS[c, f].ravel().tolist(), "bbox": [1, 2, 3, 4], "score": 0.9, "category_id": 1}


def pifpaf_pictures(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            write_lines(root / name / f"{f:06d}.jpg.predictions.json", [_pifpaf(c, f)])


def pifpaf_videos(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        lines = [{"frame": f + 1, "predictions": [_pifpaf(c, f)]} for f in range(FRAMES)]
        write_lines(root / f"{name}.mp4.openpifpaf.json", *lines)


def instance(c: int, f: int) -> dict[str, object]:
    return {"keypoints": POINTS[c, f, :, :2].tolist(), "keypoint_scores": POINTS[c, f, :, 2].tolist()}


def mmpose_list(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = [{"frame_id": f, "instances": [instance(c, f)]} for f in range(FRAMES)]
        write_lines(root / "predictions" / f"{name}.json", frames)


def sapiens(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            write_lines(root / name / f"{f:06d}.json", {"meta_info": {}, "instance_info": [instance(c, f)]})


def movenet(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = [
            {"frame": f, "poses": [{"keypoints": [dict(zip(("x", "y", "score"), p, strict=True), name=n)
                                                  for n, p in zip(COCO, POINTS[c, f].tolist(), strict=True)]}]}
            for f in range(FRAMES)
        ]  # fmt: skip
        write_lines(root / f"{name}.json", frames)


def alphapose_deeper(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            people = [{"pose_keypoints_2d": POINTS[c, f].ravel().tolist()}]
            write_lines(root / name / "sep-json" / f"{f}.json", {"version": "AlphaPose v0.3", "people": people})


def coco_of_all_cameras(root: Path) -> None:
    shown = [(c, f, f"pictures/{name}/{f:06d}.jpg") for c, name in enumerate(CAMERAS) for f in range(FRAMES)]
    images = [{"id": i, "file_name": picture} for i, (_, _, picture) in enumerate(shown)]
    people = [{"image_id": i, "keypoints": POINTS[c, f].ravel().tolist()} for i, (c, f, _) in enumerate(shown)]
    write_lines(root / "person_keypoints.json", {"images": images, "annotations": people,
                                            "categories": [{"keypoints": list(COCO)}]})  # fmt: skip


def sleap_table(root: Path) -> None:
    heading = ["track", "frame_idx", "instance.score", *(f"{n}.{x}" for n in COCO for x in ("x", "y", "score"))]
    for c, name in enumerate(CAMERAS):
        rows = [["track_0", f, 0.9, *POINTS[c, f].ravel()] for f in range(FRAMES)]
        write_table(root / f"labels.v001.000_{name}.analysis.csv", [heading, *rows])


def own_table(root: Path) -> None:
    heading = ["Frame", *(f"{n.replace('_', ' ')} {x}" for n in COCO for x in ("X", "Y", "Confidence"))]
    for c, name in enumerate(CAMERAS):
        write_table(root / f"{name}.csv", [heading, *([f, *POINTS[c, f].ravel()] for f in range(FRAMES))], ";")


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
        write_table(root / name / "annotations.csv", [*headings, *rows])


def arrays(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    for name, points in zip(CAMERAS, POINTS, strict=True):
        np.save(root / f"{name}.npy", points)


def _by_name(c: int, f: int) -> dict[str, list[float]]:
    return dict(zip(COCO, POINTS[c, f].tolist(), strict=True))


def points_by_name(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        write_lines(root / f"{name}.json", [_by_name(c, f) for f in range(FRAMES)])


def points_by_name_a_picture(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            write_lines(root / name / f"{f:04d}.json", _by_name(c, f))


def points_by_name_of_people(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        frames = [{"frame": f, "people": [{"id": 3, "keypoints": _by_name(c, f)}]} for f in range(FRAMES)]
        write_lines(root / f"{name}.jsonl", *frames)


def points_by_name_and_camera(root: Path) -> None:
    as_objects = [
        {f"{f:04d}.jpg": {n: {"x": x, "y": y, "score": p} for n, (x, y, p) in _by_name(c, f).items()}
         for f in range(FRAMES)}
        for c in range(len(CAMERAS))
    ]  # fmt: skip
    write_lines(root / "walk.json", dict(zip(CAMERAS, as_objects, strict=True)))


def _openpose(c: int, f: int) -> dict[str, object]:
    return {"version": 1.3, "people": [{"pose_keypoints_2d": POINTS[c, f].ravel().tolist()}]}


def openpose_lines(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        write_lines(root / f"{name}.jsonl", *(_openpose(c, f) for f in range(FRAMES)))


def openpose_in_one_folder(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            write_lines(root / f"{name}_{f:012d}_keypoints.json", _openpose(c, f))


def openpose_list(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        write_lines(root / f"{name}.json", [_openpose(c, f) for f in range(FRAMES)])


def mmdet_arrays(root: Path) -> None:
    """MMDetection's and DeepStream's kind: lists of everybody in the picture, one of points and one of scores."""
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            lists = {"labels": [0], "scores": [0.9], "bboxes": [[0, 0, 9, 9]]}
            points = {name: [values] for name, values in instance(c, f).items()}
            write_lines(root / "preds" / name / f"{f:06d}.json", lists | points)


def opencap(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        for f in range(FRAMES):
            folder = root / "Videos" / name / "OutputJsons_1x736" / "walk1"
            write_lines(folder / f"walk1_{f:012d}_keypoints.json", _openpose(c, f))


def table_of_all_cameras(root: Path) -> None:
    heading = ["camera", "frame", *(f"{n}_{x}" for n in COCO for x in ("x", "y", "conf"))]
    rows = [[name, f, *POINTS[c, f].ravel()] for f in range(FRAMES) for c, name in enumerate(CAMERAS)]
    write_table(root / "keypoints.csv", [heading, *rows])


def _rows_of_points(c: int) -> list[list[object]]:
    return [[f, n, *point] for f in range(FRAMES) for n, point in zip(COCO, POINTS[c, f].tolist(), strict=True)]


def a_row_a_point(root: Path) -> None:
    for c, name in enumerate(CAMERAS):
        write_table(root / f"{name}.csv", [["frame", "bodypart", "x", "y", "likelihood"], *_rows_of_points(c)])


def a_row_a_point_of_all_cameras(root: Path) -> None:
    heading = ["Camera", "Person", "Frame", "Keypoint", "X", "Y", "Confidence"]
    rows = [[name, 0, *row] for c, name in enumerate(CAMERAS) for row in _rows_of_points(c)]
    write_table(root / "keypoints.csv", [heading, *rows])


def arrays_of_all_cameras_and_people(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    np.save(root / "keypoints.npy", POINTS[:, :, None])


def archive_of_all_cameras(root: Path) -> None:
    root.mkdir(parents=True, exist_ok=True)
    np.savez(root / "keypoints.npz", **dict(zip(CAMERAS, POINTS, strict=True)))


WRITERS = (
    mmdet_arrays,
    opencap,
    pifpaf_pictures,
    pifpaf_videos,
    mmpose_list,
    sapiens,
    movenet,
    alphapose_deeper,
    coco_of_all_cameras,
    sleap_table,
    own_table,
    jarvis,
    arrays,
    points_by_name,
    points_by_name_a_picture,
    points_by_name_of_people,
    points_by_name_and_camera,
    openpose_lines,
    openpose_list,
    table_of_all_cameras,
    a_row_a_point,
    a_row_a_point_of_all_cameras,
    arrays_of_all_cameras_and_people,
    archive_of_all_cameras,
)
"""All of them."""
