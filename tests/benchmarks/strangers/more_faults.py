"""More mistakes: unusual calibrations and files, and two faults at once. Each function writes a take with them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import JointSet
from solver_backend.types import Cameras
from tests.benchmarks.strangers.faults import all_of, half, mirrored, turned
from tests.benchmarks.strangers.forms import dlc, with_more
from tests.benchmarks.strangers.take import COCO, Take, demo_take, write_openpose, write_rate, write_take, write_toml

METRES_PER_FOOT = 0.3048


def _as_written(take: Take, **changed: np.ndarray) -> Cameras:
    return replace(take.cameras, **changed)


def _world(take: Take, axes: np.ndarray) -> Cameras:
    return replace(take.cameras, R=take.cameras.R @ axes.T)


def in_feet(folder: Path, take: Take) -> None:
    """Write a calibration in feet. The person is 5.8 units tall."""
    write_take(folder, take, calibration=_as_written(take, t=take.cameras.t / METRES_PER_FOOT))


def cm_and_y_up(folder: Path, take: Take) -> None:
    """Write the world of Unity and Maya: Y up, in cm."""
    cameras = _world(take, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    write_take(folder, take, calibration=replace(cameras, t=cameras.t * 100))


def graphics_in_mm(folder: Path, take: Take) -> None:
    """Write OpenGL's camera axes with lengths in mm."""
    flip = np.diag([1.0, -1.0, -1.0])
    cameras = take.cameras
    write_take(folder, take, calibration=replace(cameras, R=flip @ cameras.R, t=(flip @ cameras.t.T).T * 1000))


def places_in_cm(folder: Path, take: Take) -> None:
    """Write the cameras' positions in cm as translations."""
    write_take(folder, take, calibration=_as_written(take, t=take.cameras.centres * 100))


def z_down(folder: Path, take: Take) -> None:
    """Write a world with Z down, as in aeronautics."""
    write_take(folder, take, calibration=_world(take, np.diag([1.0, -1.0, -1.0])))


def left_handed(folder: Path, take: Take) -> None:
    """Write a world with mirrored X, as in Unreal: matrices with determinant -1."""
    cameras = take.cameras
    R = cameras.R @ np.diag([-1.0, 1.0, 1.0])
    listed = [{"id": name, "K": cameras.K[c].tolist(), "distortion": cameras.distortion[c, :5].tolist(),
               "R": R[c].tolist(), "t": cameras.t[c].tolist(), "resolution": cameras.image_size[c].tolist()}
              for c, name in enumerate(take.names)]  # fmt: skip
    (folder / "calibration").mkdir(parents=True, exist_ok=True)
    (folder / "calibration" / "cameras.json").write_text(json.dumps({"cameras": listed}))
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]])
    write_rate(folder)


def no_middle(folder: Path, take: Take) -> None:
    """Write principal points at 0."""
    K = take.cameras.K.copy()
    K[:, :2, 2] = 0.0
    write_take(folder, take, calibration=_as_written(take, K=K))


def shares_in_K(folder: Path, take: Take) -> None:
    """Write focal lengths and principal points as fractions of the picture."""
    K = take.cameras.K.copy()
    K[:, :2] /= take.cameras.image_size[:, :, None]
    write_take(folder, take, calibration=_as_written(take, K=K))


def one_zoomed(folder: Path, take: Take) -> None:
    """Write one camera zoomed in by a third after the calibration."""
    centre = take.cameras.K[2, :2, 2]
    write_take(folder, take.mapped(2, (take.points[2, ..., :2] - centre) * 1.33 + centre))


def one_half_and_mirrored(folder: Path, take: Take) -> None:
    """Write one camera's pictures mirrored and half as large."""
    write_take(folder, half(mirrored(take, 2), 2))


def one_upside_down_others_half(folder: Path, take: Take) -> None:
    """Write one camera upside down, and all pictures half as large."""
    points = take.mapped(0, take.cameras.image_size[0] - 1 - take.points[0, ..., :2])
    write_take(folder, all_of(points, half))


def one_swapped_axes(folder: Path, take: Take) -> None:
    """Write one camera's x and y exchanged."""
    write_take(folder, take.mapped(1, take.points[1][..., [1, 0]]))


def half_body_turned_half(folder: Path, take: Take) -> None:
    """Write nothing below the hips, with all pictures rotated and half as large."""
    points = take.points.copy()
    names = JointSet.BODY_25.keypoints
    points[:, :, [i for i, n in enumerate(names) if any(p in n for p in ("knee", "ankle", "toe", "heel"))]] = 0.0
    write_take(folder, all_of(all_of(replace(take, points=points), turned), half))


def two_cameras_turned(folder: Path, take: Take) -> None:
    """Write only two cameras, both rotated."""
    two = replace(all_of(take, turned), points=all_of(take, turned).points[:2], cameras=take.cameras.subset([0, 1]))
    write_take(folder, two)


def unpadded_numbers(folder: Path, take: Take) -> None:
    """Number files without leading zeros: frame_1.json, frame_10.json, frame_2.json."""
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [take.points[c]], 1, digits=1)
    write_toml(folder, take.cameras)
    write_rate(folder)


def numbered_in_twos(folder: Path, take: Take) -> None:
    """Write every second frame with its original number, at the full rate."""
    for c, name in enumerate(take.names):
        place = folder / "pose" / f"{name}_json"
        place.mkdir(parents=True)
        for f in range(0, take.points.shape[1], 2):
            text = json.dumps({"people": [{"pose_keypoints_2d": take.points[c, f].ravel().tolist()}]})
            (place / f"{name}_{f:06d}_keypoints.json").write_text(text)
    write_toml(folder, take.cameras)
    write_rate(folder)


def a_fifth_camera(folder: Path, take: Take) -> None:
    """Write five recorded cameras with four calibrated ones."""
    write_take(folder, take)
    write_openpose(folder, "cam05", [take.points[0]])


def numbers_of_others(folder: Path, take: Take) -> None:
    """Name folders cam1 to cam4, although these cameras are cam5 to cam8 in the calibration."""
    more = replace(with_more(take.cameras, 8), names=tuple(f"cam{i + 1}" for i in range(8)))
    for c in range(4):
        write_openpose(folder, f"cam{c + 1}", [take.points[c]])
    write_toml(folder, more)
    write_rate(folder)


def one_empty(folder: Path, take: Take) -> None:
    """Write one camera that sees nobody."""
    points = take.points.copy()
    points[3] = 0.0
    write_take(folder, replace(take, points=points))


def missing_stretch(folder: Path, take: Take) -> None:
    """Remove 15 frames from one camera's middle, and number the later ones continuously."""
    points = take.points.copy()
    points[1, 60:-15], points[1, -15:] = points[1, 75:].copy(), 0.0
    write_take(folder, replace(take, points=points))


def runs_fast(folder: Path, take: Take) -> None:
    """Write one camera with a clock that runs 5 % fast."""
    rows = np.minimum(np.round(np.arange(take.points.shape[1]) / 1.05).astype(int), take.points.shape[1] - 1)
    points = take.points.copy()
    points[2] = take.points[2, rows]
    write_take(folder, replace(take, points=points))


def smoothed_late(folder: Path, take: Take) -> None:
    """Delay one camera's detections by six frames, as a filter does."""
    points = take.points.copy()
    points[0, 6:] = take.points[0, :-6]
    write_take(folder, replace(take, points=points))


def heat_scores(folder: Path, take: Take) -> None:
    """Write confidences as heat map values from 0 to 8."""
    write_take(folder, replace(take, points=take.points * [1, 1, 8.0]))


def texts_for_numbers(folder: Path, take: Take) -> None:
    """Write coordinates as strings in the JSON."""
    for c, name in enumerate(take.names):
        place = folder / "pose" / f"{name}_json"
        place.mkdir(parents=True)
        for f, person in enumerate(take.points[c]):
            people = [{"pose_keypoints_2d": [f"{v:.3f}" for v in person.ravel()]}]
            (place / f"{f:06d}.json").write_text(json.dumps({"people": people}))
    write_toml(folder, take.cameras)
    write_rate(folder)


def nulls_for_unseen(folder: Path, take: Take) -> None:
    """Write unseen points as null."""
    for c, name in enumerate(take.names):
        place = folder / "pose" / f"{name}_json"
        place.mkdir(parents=True)
        for f, person in enumerate(take.points[c]):
            values = [v if seen > 0 else None for *xy, seen in person.tolist() for v in (*xy, seen)]
            (place / f"{f:06d}.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": values}]}))
    write_toml(folder, take.cameras)
    write_rate(folder)


def decimal_commas(folder: Path, take: Take) -> None:
    """Write tables of a German spreadsheet, with semicolons and decimal commas."""
    folder.mkdir(parents=True, exist_ok=True)
    heading = ";".join(["frame", *(f"{n}_{x}" for n in COCO for x in ("x", "y", "score"))])
    for c, name in enumerate(take.names):
        rows = [";".join([str(f), *(f"{v:.3f}".replace(".", ",") for v in p.ravel())])
                for f, p in enumerate(take.coco()[c])]  # fmt: skip
        (folder / f"{name}.csv").write_text("\n".join([heading, *rows]), encoding="utf-8")
    write_toml(folder, take.cameras)


def dlc_twice(folder: Path, take: Take) -> None:
    """Write DeepLabCut's tables and the filtered ones next to them."""
    dlc(folder, take, lambda c: COCO)
    for path in sorted(folder.glob("*.csv")):
        path.with_name(f"{path.stem}_filtered.csv").write_text(path.read_text())


def dlc_two_takes(folder: Path, take: Take) -> None:
    """Write DeepLabCut's tables of two takes in one folder."""
    dlc(folder, take, lambda c: COCO)
    for path in sorted(folder.glob("*.csv")):
        path.with_name(f"walk2_{path.name}").write_text(path.read_text())
        path.rename(path.with_name(f"walk1_{path.name}"))


def h5_without_the_extra(folder: Path, take: Take) -> None:
    """Write DeepLabCut's HDF5 files, which need h5py."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in take.names:
        (folder / f"{name}DLC_resnet50_walk.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(2000))
    write_toml(folder, take.cameras)


def late_in_the_take(folder: Path, take: Take) -> None:
    """Write a person who enters for the last third."""
    points = take.points.copy()
    points[:, :80] = 0.0
    write_take(folder, replace(take, points=points))


def short(folder: Path, take: Take) -> None:
    """Write eight frames."""
    write_take(folder, replace(take, points=take.points[:, :8]))


def two_thirds_and_apart(folder: Path, take: Take) -> None:
    """Write cameras started up to 60 frames apart, one of them at two thirds of the size."""
    long = half(demo_take(0, 360), 1, 2 / 3)
    for c, start in enumerate((0, 60, 25, 10)):
        write_openpose(folder, take.names[c], [long.points[c, start : start + 290]])
    write_toml(folder, take.cameras)
    write_rate(folder)


MORE: dict[str, Callable[[Path, Take], None]] = {
    f.__name__.replace("_", " "): f
    for f in (
        in_feet, cm_and_y_up, graphics_in_mm, places_in_cm, z_down, left_handed, no_middle, shares_in_K, one_zoomed,
        one_half_and_mirrored, one_upside_down_others_half, one_swapped_axes, half_body_turned_half,
        two_cameras_turned, unpadded_numbers, numbered_in_twos, a_fifth_camera, numbers_of_others, one_empty,
        missing_stretch, runs_fast, smoothed_late, heat_scores, texts_for_numbers, nulls_for_unseen, decimal_commas,
        dlc_twice, dlc_two_takes, h5_without_the_extra, late_in_the_take, short, two_thirds_and_apart,
    )
}  # fmt: skip
"""Functions that write a case, by name."""
