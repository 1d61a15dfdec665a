"""Folder layouts and detections of other programs and of users. Each function writes a take with one of them."""

from __future__ import annotations

import gzip
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import JointSet
from tests.benchmarks.strangers.faults import all_of, half, mirrored
from tests.benchmarks.strangers.take import COCO, FPS, Take, write_openpose, write_rate, write_take, write_toml


def _document(person: np.ndarray) -> str:
    people = [{"person_id": [-1], "pose_keypoints_2d": person.ravel().tolist()}] if person.any() else []
    return json.dumps({"version": 1.3, "people": people})


def _calibrated(folder: Path, take: Take) -> None:
    write_toml(folder, take.cameras)
    write_rate(folder)


def _files(take: Take, place: Callable[[str, int], Path], step: int = 1) -> None:
    for c, name in enumerate(take.names):
        for f in range(0, take.points.shape[1], step):
            path = place(name, f)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(_document(take.points[c, f]))


def deeper(folder: Path, take: Take) -> None:
    """Write one folder per camera, with the files two folders deeper."""
    _files(take, lambda name, f: folder / name / "openpose" / "json" / f"{name}_{f:012d}_keypoints.json")
    _calibrated(folder, take)


def frame_before_camera(folder: Path, take: Take) -> None:
    """Write all files into one folder, named by frame and then camera."""
    _files(take, lambda name, f: folder / "pose" / f"{f:06d}_{name}.json")
    _calibrated(folder, take)


def a_folder_a_frame(folder: Path, take: Take) -> None:
    """Write a folder per frame with a file per camera."""
    _files(take, lambda name, f: folder / "pose" / f"frame_{f:05d}" / f"{name}.json")
    _calibrated(folder, take)


def by_timestamp(folder: Path, take: Take) -> None:
    """Write files named by milliseconds since 1970, as recorders of industrial cameras do."""
    _files(take, lambda name, f: folder / "pose" / name / f"{1714552000000 + round(1000 * f / FPS)}.json")
    _calibrated(folder, take)


def global_counter(folder: Path, take: Take) -> None:
    """Write files with one counter over all cameras: 0, 4, 8 for cam01, and 1, 5, 9 for cam02."""
    _files(take, lambda name, f: folder / "pose" / name / f"{name}_{4 * f + take.names.index(name):07d}.json")
    _calibrated(folder, take)


def zipped(folder: Path, take: Take) -> None:
    """Write each camera's files into a zip file."""
    (folder / "pose").mkdir(parents=True)
    for c, name in enumerate(take.names):
        with zipfile.ZipFile(folder / "pose" / f"{name}_json.zip", "w") as archive:
            for f, person in enumerate(take.points[c]):
                archive.writestr(f"{name}_{f:012d}_keypoints.json", _document(person))
    _calibrated(folder, take)


def gzipped(folder: Path, take: Take) -> None:
    """Write every file compressed as .json.gz."""
    for c, name in enumerate(take.names):
        (folder / "pose" / name).mkdir(parents=True)
        for f, person in enumerate(take.points[c]):
            path = folder / "pose" / name / f"{f:012d}_keypoints.json.gz"
            path.write_bytes(gzip.compress(_document(person).encode()))
    _calibrated(folder, take)


def openpose_yml(folder: Path, take: Take) -> None:
    """Write OpenPose's ``--write_keypoint`` format: a matrix in OpenCV's YAML per picture."""
    for c, name in enumerate(take.names):
        (folder / "pose" / name).mkdir(parents=True)
        for f, person in enumerate(take.points[c]):
            data = ", ".join(f"{v:.5g}" for v in person.ravel())
            text = (
                f"%YAML:1.0\n---\npose_0: !!opencv-nd-matrix\n   sizes: [ 1, 25, 3 ]\n   dt: f\n   data: [ {data} ]\n"
            )
            (folder / "pose" / name / f"{f:012d}_pose.yml").write_text(text)
    _calibrated(folder, take)


def results_of_two_people(folder: Path, take: Take) -> None:
    """Write DeepLabCut's result for several animals (maDLC): two people, one of them absent in half of the frames."""
    other = replace(take, points=take.points[:, ::-1].copy())
    for c, name in enumerate(take.names):
        columns = [("DLC", who, part, coord) for who in ("ind1", "ind2") for part in COCO
                   for coord in ("x", "y", "likelihood")]  # fmt: skip
        titles = zip(("scorer", "individuals", "bodyparts", "coords"), zip(*columns, strict=True), strict=True)
        heads = [",".join([title, *column]) for title, column in titles]
        rows = []
        for f, person in enumerate(take.coco()[c]):
            second = other.coco()[c, f] + [300.0, 0.0, 0.0] if f % 2 else np.full((17, 3), np.nan)
            cells = ["" if np.isnan(v) else f"{v:.3f}" for v in np.concatenate([person, second]).ravel()]
            rows.append(",".join([str(f), *cells]))
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}DLC_dlcrnet_walk_el.csv").write_text("\n".join([*heads, *rows]))
    write_toml(folder, take.cameras)


def whole_bodies(folder: Path, take: Take) -> None:
    """Write RTMPose's 133 points of the whole body in OpenPose's JSON."""
    points = np.zeros((*take.points.shape[:2], 133, 3))
    points[:, :, :17] = take.coco()
    feet = [f"{side}_{part}" for side in ("left", "right") for part in ("big_toe", "small_toe", "heel")]
    points[:, :, 17:23] = take.points[:, :, [JointSet.BODY_25.keypoints.index(name) for name in feet]]
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [points[c]])
    _calibrated(folder, take)


def pickled(folder: Path, take: Take) -> None:
    """Write results in Python's pickle format, as MMPose and HybrIK do."""
    (folder / "pose").mkdir(parents=True)
    for name in take.names:
        (folder / "pose" / f"{name}.pkl").write_bytes(b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00}\x94.")
    _calibrated(folder, take)


def spaces_and_umlauts(folder: Path, take: Take) -> None:
    """Write cameras with informal names."""
    names = ("Kamera links", "Kamera rechts", "Tür", "über Fenster #2")
    for c, name in enumerate(names):
        write_openpose(folder, name, [take.points[c]])
    write_toml(folder, replace(take.cameras, names=names))
    write_rate(folder)


def one_starts_numbered_later(folder: Path, take: Take) -> None:
    """Delete one camera's first 30 files and renumber the others from 0, with all pictures half as large."""
    small = all_of(take, half)
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [small.points[c, 30 if c == 2 else 0 :]])
    _calibrated(folder, take)


def others_left_over(folder: Path, take: Take) -> None:
    """Add the last files of an earlier, longer take that the new files did not overwrite."""
    write_take(folder, take)
    for c, name in enumerate(take.names):
        place = folder / "pose" / f"{name}_json"
        for f in range(40):
            person = take.points[c, 3 * f % 120].copy()
            person[person[:, 2] > 0, 0] += 150 * (1 + c % 2)
            (place / f"{name}_{f + 120:012d}_keypoints.json").write_text(_document(person))


def one_of_another_take(folder: Path, take: Take) -> None:
    """Write one camera's folder from another take."""
    points = take.points.copy()
    points[1] = points[1, ::-1]
    write_take(folder, replace(take, points=points))


def two_of_another_take(folder: Path, take: Take) -> None:
    """Write two cameras' folders from another take."""
    points = take.points.copy()
    points[:2] = points[:2, ::-1]
    write_take(folder, replace(take, points=points))


def clipped_scores(folder: Path, take: Take) -> None:
    """Write a detector that also locates unseen points, with a confidence of 0.5 for all."""
    rng = np.random.default_rng(0)
    points = take.points.copy()
    hidden = points[..., 2] == 0
    points[hidden] = np.concatenate(
        [rng.uniform(0, [1920, 1080], (int(hidden.sum()), 2)), np.ones((hidden.sum(), 1))], 1
    )
    points[..., 2] = 0.5
    write_take(folder, replace(take, points=points))


def mirrored_selfies(folder: Path, take: Take) -> None:
    """Write mirrored pictures of all cameras, as phones do, with detections half as large."""
    write_take(folder, all_of(all_of(take, mirrored), half))


def frozen(folder: Path, take: Take) -> None:
    """Write one camera that repeats the same detections after a third of the take."""
    points = take.points.copy()
    points[2, 40:] = points[2, 40]
    write_take(folder, replace(take, points=points))


def doubled_frames(folder: Path, take: Take) -> None:
    """Write one camera at 30 Hz with each picture repeated, to match the others' 60 Hz."""
    points = take.points.copy()
    points[1] = points[1, np.arange(points.shape[1]) // 2 * 2]
    write_take(folder, replace(take, points=points))


LAYOUTS: dict[str, Callable[[Path, Take], None]] = {
    f.__name__.replace("_", " "): f
    for f in (
        deeper, frame_before_camera, a_folder_a_frame, by_timestamp, global_counter, zipped, gzipped, openpose_yml,
        results_of_two_people, whole_bodies, pickled, spaces_and_umlauts, one_starts_numbered_later, others_left_over,
        one_of_another_take, two_of_another_take, clipped_scores, mirrored_selfies, frozen, doubled_frames,
    )
}  # fmt: skip
"""Functions that write a case, by name."""
