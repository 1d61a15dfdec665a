"""Mistakes in recordings and detections, one or two at once. Each function writes a take with them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.benchmarks.strangers.take import (
    FPS,
    LENGTH,
    Take,
    demo_take,
    write_openpose,
    write_rate,
    write_take,
    write_toml,
)

_SIDES = list(JointSet.BODY_25.mirrored())
_LEGS = [JointSet.BODY_25.keypoints.index(n) for n in JointSet.BODY_25.keypoints
         if any(part in n for part in ("knee", "ankle", "toe", "heel"))]  # fmt: skip


def half(take: Take, c: int, factor: float = 0.5) -> Take:
    return take.mapped(c, (take.points[c, ..., :2] + 0.5) * factor - 0.5)


def turned(take: Take, c: int) -> Take:
    u, v = take.points[c, ..., 0], take.points[c, ..., 1]
    return take.mapped(c, np.stack([take.cameras.image_size[c, 1] - 1 - v, u], -1))


def mirrored(take: Take, c: int) -> Take:
    u, v = take.points[c, ..., 0], take.points[c, ..., 1]
    moved = take.mapped(c, np.stack([take.cameras.image_size[c, 0] - 1 - u, v], -1))
    points = moved.points.copy()
    points[c] = points[c][:, _SIDES]
    return replace(moved, points=points)


def all_of(take: Take, change: Callable[[Take, int], Take]) -> Take:
    """Return the take with every camera changed."""
    for c in range(len(take.names)):
        take = change(take, c)
    return take


def turned_and_half(folder: Path, take: Take) -> None:
    """Write all pictures rotated and half as large."""
    write_take(folder, all_of(all_of(take, turned), half))


def one_turned_one_half(folder: Path, take: Take) -> None:
    """Write one camera rotated, and another with half the size."""
    write_take(folder, half(turned(take, 0), 2))


def one_two_thirds(folder: Path, take: Take) -> None:
    """Write one camera with 720 rows instead of the calibrated 1080."""
    write_take(folder, half(take, 1, 2 / 3))


def odd_size(folder: Path, take: Take) -> None:
    """Write pictures scaled by 0.4375 (1080 to 472.5 rows), which is no common size."""
    write_take(folder, all_of(take, lambda t, c: half(t, c, 0.4375)))


def cropped(folder: Path, take: Take) -> None:
    """Write one camera's pictures cropped by 200 px on the left and 40 px at the top."""
    write_take(folder, take.mapped(3, take.points[3, ..., :2] - [200, 40]))


def anamorphic(folder: Path, take: Take) -> None:
    """Write all pictures compressed to 3/4 of their width: 1440 x 1080."""
    write_take(folder, all_of(take, lambda t, c: t.mapped(c, t.points[c, ..., :2] * [0.75, 1.0])))


def one_anamorphic(folder: Path, take: Take) -> None:
    """Write one camera's pictures compressed to 3/4 of their width."""
    write_take(folder, take.mapped(1, take.points[1, ..., :2] * [0.75, 1.0]))


def square_letterboxed(folder: Path, take: Take) -> None:
    """Write pictures scaled into a square of 640 pixels with black bars, as detectors use them."""
    write_take(folder, all_of(take, lambda t, c: t.mapped(c, t.points[c, ..., :2] / 3 + [0, 140])))


def one_mirrored(folder: Path, take: Take) -> None:
    """Write one camera's pictures mirrored."""
    write_take(folder, mirrored(take, 2))


def mirrored_and_half(folder: Path, take: Take) -> None:
    """Write one camera's pictures mirrored, and all half as large as calibrated."""
    write_take(folder, all_of(mirrored(take, 2), half))


def one_upside_down(folder: Path, take: Take) -> None:
    """Write one camera upside down, with its picture rotated by 180 degrees."""
    write_take(folder, take.mapped(0, take.cameras.image_size[0] - 1 - take.points[0, ..., :2]))


def two_takes(folder: Path, take: Take) -> None:
    """Write two takes of each camera in one folder of files."""
    for c, name in enumerate(take.names):
        for number in (1, 2):
            place = folder / "pose" / f"{name}_json"
            place.mkdir(parents=True, exist_ok=True)
            for f, person in enumerate(take.points[c]):
                text = json.dumps({"people": [{"pose_keypoints_2d": person.ravel().tolist()}]})
                (place / f"walk{number}_{name}_{f:06d}_keypoints.json").write_text(text)
    write_toml(folder, take.cameras)
    write_rate(folder)


def two_takes_on(folder: Path, take: Take) -> None:
    """Write two successive takes in each folder, numbered continuously, so that the person jumps."""
    other = demo_take(240, 100)
    write_take(folder, replace(take, points=np.concatenate([take.points, other.points], 1)))


def animal(folder: Path, take: Take) -> None:
    """Write a dog with DeepLabCut's SuperAnimal names."""
    names = ["nose", "left_eye", "right_eye", "left_ear", "right_ear", "neck_base", "tail_base", "back_middle",
             "front_left_thai", "front_left_knee", "front_left_paw", "front_right_thai", "front_right_knee",
             "front_right_paw", "back_left_thai", "back_left_knee", "back_left_paw", "back_right_thai",
             "back_right_knee", "back_right_paw"]  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    for c, name in enumerate(take.names):
        rows = [["scorer", *["superanimal"] * 60], ["bodyparts", *(n for n in names for _ in range(3))]]
        rows += [["coords", *["x", "y", "likelihood"] * 20]]
        rows += [[str(f), *map(str, person[:20].ravel())] for f, person in enumerate(take.points[c])]
        (folder / f"{name}DLC_superanimal.csv").write_text("\n".join(",".join(row) for row in rows))
    write_toml(folder, take.cameras)


def animal_unnamed(folder: Path, take: Take) -> None:
    """Write a quadruped in MMPose's AP-10K without names: 17 points, as many as in COCO."""
    coco = take.coco()
    spine = np.concatenate([coco[:, :, [1, 2, 0, 5, 11, 5, 7, 9, 6, 8, 10, 11, 13, 15, 12, 14, 16]]], -1)
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [spine[c]])
    write_toml(folder, take.cameras)
    write_rate(folder)


def half_body(folder: Path, take: Take) -> None:
    """Write cameras that see nothing below the hips."""
    points = take.points.copy()
    points[:, :, _LEGS] = 0.0
    write_take(folder, replace(take, points=points))


def half_body_turned(folder: Path, take: Take) -> None:
    """Write cameras that see nothing below the hips, two of them rotated."""
    points = take.points.copy()
    points[:, :, _LEGS] = 0.0
    write_take(folder, turned(turned(replace(take, points=points), 1), 3))


def missing_files(folder: Path, take: Take) -> None:
    """Write takes with missing files in the middle, different ones for each camera."""
    write_take(folder, take)
    rng = np.random.default_rng(3)
    for place in sorted((folder / "pose").iterdir()):
        for path in sorted(place.iterdir())[10:-10]:
            if rng.uniform() < 0.2:
                path.unlink()


def empty_people(folder: Path, take: Take) -> None:
    """Write no people, {} or all-zero people in a fifth of the files."""
    write_take(folder, take)
    rng = np.random.default_rng(4)
    for path in sorted((folder / "pose").rglob("*.json")):
        if rng.uniform() < 0.2:
            nobody = [[], [{}], [{"pose_keypoints_2d": [0.0] * 75}], [{"pose_keypoints_2d": []}]]
            path.write_text(json.dumps({"people": nobody[int(rng.integers(4))]}))


def empty_files(folder: Path, take: Take) -> None:
    """Write some files without any bytes, as a full disk leaves them."""
    write_take(folder, take)
    for path in sorted((folder / "pose" / "cam02_json").iterdir())[30:34]:
        path.write_text("")


def from_one(folder: Path, take: Take) -> None:
    """Number frames from 1 in two cameras and from 1000 in the others, all synchronous."""
    _numbered(folder, take, (1, 1, 1000, 1000))


def from_thousand(folder: Path, take: Take) -> None:
    """Number the frames of all cameras from 1000."""
    _numbered(folder, take, (1000, 1000, 1000, 1000))


def one_from_one(folder: Path, take: Take) -> None:
    """Number one camera's frames from 1, the others' from 0, all synchronous."""
    _numbered(folder, take, (0, 1, 0, 0))


def _numbered(folder: Path, take: Take, firsts: tuple[int, ...]) -> None:
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]], firsts[c])
    write_toml(folder, take.cameras)
    write_rate(folder)


def every_second_number(folder: Path, take: Take) -> None:
    """Write one camera at half the frame rate: 60 files instead of 120."""
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c][:: 2 if c == 1 else 1]])
    write_toml(folder, take.cameras)
    write_rate(folder)


def _beside(take: Take, path_m: np.ndarray) -> Take:
    """Return a second person, seen by the same cameras, who performs later motion at another position.

    Args:
        take: F frames of the first person.
        path_m: (F, 2) or (2,) shift on the floor in metres.
    """
    frames = take.points.shape[1]
    world = np.asarray(demo_capture(LENGTH, FPS).truth["keypoints3d"])[200 : 200 + frames].copy()
    world[..., :2] += np.broadcast_to(path_m, (frames, 2))[:, None]
    return replace(take, points=_seen(take, world, 0.8))


def _seen(take: Take, world: np.ndarray, confidence: float) -> np.ndarray:
    """Return (C, F, K, 3) detections of (F, K, 3) points with errors of 3 px, zero outside the pictures."""
    cameras = take.cameras
    xy = project(cameras, world)
    xy = xy + np.random.default_rng(6).normal(0, 3, xy.shape)
    inside = ((xy >= 0) & (xy < cameras.image_size[:, None, None])).all(-1, keepdims=True)
    return np.where(inside, np.concatenate([xy, np.full((*xy.shape[:-1], 1), confidence)], -1), 0.0)


def crossing(folder: Path, take: Take) -> None:
    """Write a second person who passes the first at half a metre. Then their order in the lists is exchanged."""
    frames = take.points.shape[1]
    path = np.column_stack([np.linspace(1.6, -1.6, frames), np.full(frames, 0.5)])
    a, b = take.points.copy(), _beside(take, path).points
    half = frames // 2
    a[:, half:], b[:, half:] = b[:, half:].copy(), a[:, half:].copy()
    write_take(folder, replace(take, points=a), replace(take, points=b))


def ids_swap(folder: Path, take: Take) -> None:
    """Write two people with a random order in the lists."""
    other = _beside(take, np.array([0.9, 0.5]))
    rng = np.random.default_rng(5)
    swap = rng.uniform(size=take.points.shape[:2]) < 0.5
    a = np.where(swap[..., None, None], other.points, take.points)
    b = np.where(swap[..., None, None], take.points, other.points)
    write_take(folder, replace(take, points=a), replace(take, points=b))


def mirror_behind(folder: Path, take: Take) -> None:
    """Write a mirror behind the person. Two cameras also see the reflection, with exchanged sides."""
    frames = take.points.shape[1]
    world = np.asarray(demo_capture(LENGTH, FPS).truth["keypoints3d"])[60 : 60 + frames].copy()
    world[..., 1] = 2 * (world[..., 1].max() + 0.8) - world[..., 1]
    image = _seen(take, world[:, _SIDES], 0.7)
    image[[2, 3]] = 0.0
    write_take(folder, take, replace(take, points=image))


def ghosts(folder: Path, take: Take) -> None:
    """Add two people of random points to every picture."""
    rng = np.random.default_rng(7)
    ghost = [
        np.concatenate(
            [rng.uniform(0, 1000, (*take.points.shape[:-1], 2)), rng.uniform(0.1, 0.6, (*take.points.shape[:-1], 1))],
            -1,
        )
        for _ in range(2)
    ]
    write_take(folder, take, *(replace(take, points=g) for g in ghost))


def truncated_focal(folder: Path, take: Take) -> None:
    """Write a calibration of other pictures: K for half the size, image size of the full one."""
    K = take.cameras.K.copy()
    K[:, :2] *= 0.5
    write_take(folder, take, calibration=replace(take.cameras, K=K))


def cm_and_turned(folder: Path, take: Take) -> None:
    """Write a calibration in cm, with all pictures rotated."""
    write_take(folder, all_of(take, turned), calibration=replace(take.cameras, t=take.cameras.t * 100))


def apart_and_half(folder: Path, take: Take) -> None:
    """Write cameras started up to 70 frames apart, with pictures half as large."""
    long = all_of(demo_take(0, 360), half)
    for c, start in enumerate((0, 70, 33, 12)):
        write_openpose(folder, take.names[c], [long.points[c, start : start + 280]])
    write_toml(folder, take.cameras)
    write_rate(folder)


def y_up(folder: Path, take: Take) -> None:
    """Write a calibration with Y up."""
    to_z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    write_take(folder, take, calibration=replace(take.cameras, R=take.cameras.R @ to_z))


def y_down_half(folder: Path, take: Take) -> None:
    """Write a calibration with Y down (as in OpenCV), and pictures half as large."""
    to_z = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    write_take(folder, all_of(take, half), calibration=replace(take.cameras, R=take.cameras.R @ to_z))


def rate_doubled(folder: Path, take: Take) -> None:
    """Write a configuration of 120 frames per second for a recording of 60."""
    write_take(folder, take)
    write_rate(folder, 120.0)


def wrong_joint_set(folder: Path, take: Take) -> None:
    """Write a configuration with COCO's 17 points for a recording of 25."""
    write_take(folder, take)
    (folder / "Config.toml").write_text('[project]\nframe_rate = 60\n[pose]\npose_model = "COCO_17"\n')


def shuffled_points(folder: Path, take: Take) -> None:
    """Write 17 points in a random order."""
    order = np.random.default_rng(8).permutation(17)
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.coco()[c][:, order]])
    write_toml(folder, take.cameras)
    write_rate(folder)


def two_cameras_one_name(folder: Path, take: Take) -> None:
    """Write two views as copies of one camera's detections."""
    points = take.points.copy()
    points[3] = points[2]
    write_take(folder, replace(take, points=points))


def four_of_eight_two_moved(folder: Path, take: Take) -> None:
    """Write a calibration with two of four cameras moved."""
    R, t = take.cameras.R.copy(), take.cameras.t.copy()
    for c, turn in ((1, [0.0, 0.15, 0.02]), (2, [0.1, -0.1, 0.0])):
        R[c], t[c] = exp_so3(np.array(turn)) @ R[c], exp_so3(np.array(turn)) @ t[c] + [0.2, 0, 0]
    write_take(folder, take, calibration=replace(take.cameras, R=R, t=t))


FAULTS: dict[str, Callable[[Path, Take], None]] = {
    f.__name__.replace("_", " "): f
    for f in (
        turned_and_half, one_turned_one_half, one_two_thirds, odd_size, cropped, anamorphic, one_anamorphic,
        square_letterboxed, one_mirrored, mirrored_and_half, one_upside_down, two_takes, two_takes_on, animal,
        animal_unnamed, half_body, half_body_turned, missing_files, empty_people, empty_files, from_one, from_thousand,
        one_from_one, every_second_number, ids_swap, crossing, mirror_behind, ghosts, truncated_focal, cm_and_turned,
        apart_and_half, y_up, y_down_half, rate_doubled, wrong_joint_set, shuffled_points, two_cameras_one_name,
        four_of_eight_two_moved,
    )
}  # fmt: skip
"""Functions that write a case, by name."""
