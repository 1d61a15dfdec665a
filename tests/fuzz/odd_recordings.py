"""Recordings that are odd or cannot be: each is read with a problem or refused by name, and mutations go on from it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Cameras, Capture, JointSet
from tests.fuzz.odd_motions import changed
from tests.fuzz.target import Write, file
from tests.support.calibration_files import json_text, qca_text, toml_text, yaml_camera
from tests.support.scenes import detected, ring_of_cameras, small_capture, small_markers, walker
from tests.support.trial_files import mp4_bytes, renamed, write_trial

People = list[dict[str, Any]]
"""OpenPose's people of one frame."""
_NAMES, _CALIBRATED = ("cam01", "cam02"), ("cam_1", "cam_2")
_CAMERAS = renamed(ring_of_cameras(2), _CALIBRATED)


def _trial(change: Callable[[Path], object], **options: Any) -> Write:
    """Return what writes a trial of two frames and changes it."""

    def write(folder: Path) -> None:
        trial = folder / "trial"
        write_trial(trial, **{"frames": 2, "names": _NAMES, "calibrated": _CALIBRATED, **options})
        change(trial)

    return write


def _calibration(name: str, content: str) -> Callable[[Path], object]:
    def change(trial: Path) -> None:
        (trial / "calibration" / "Calib.toml").unlink()
        (trial / "calibration" / name).write_text(content)

    return change


def _yaml_folder(trial: Path) -> None:
    (trial / "calibration" / "Calib.toml").unlink()
    for c, name in enumerate(_CALIBRATED):
        text = yaml_camera(_CAMERAS, c, "rt")
        (trial / "calibration" / f"{name}.yml").write_text(
            text.replace("image_width", "w").replace("image_height", "h")
        )


def _frames_called(*stems: str) -> Callable[[Path], object]:
    def change(trial: Path) -> None:
        for folder in (trial / "pose").iterdir():
            for path, stem in zip(sorted(folder.iterdir()), stems, strict=False):
                path.rename(path.with_name(f"{stem}.json"))

    return change


def _people(change: Callable[[People], object], every: bool = True) -> Callable[[Path], object]:
    """Return what changes the people of the first camera's frames, or of every camera's."""

    def change_files(trial: Path) -> None:
        folders = sorted((trial / "pose").iterdir())
        for path in [p for folder in folders[: None if every else 1] for p in sorted(folder.iterdir())]:
            content = json.loads(path.read_text())
            change(content["people"])
            path.write_text(json.dumps(content))

    return change_files


def _scaled(factor: float, column: int) -> Callable[[People], object]:
    def change(people: People) -> None:
        for person in people:
            values = np.array(person["pose_keypoints_2d"]).reshape(-1, 3)
            values[:, column] *= factor
            person["pose_keypoints_2d"] = values.ravel().tolist()

    return change


def _keypoints(count: int) -> Callable[[People], object]:
    return lambda people: [person.update(pose_keypoints_2d=[100.0, 100.0, 0.9] * count) for person in people]


def _footage(trial: Path) -> None:
    (trial / "videos").mkdir()
    (trial / "videos" / "cam01.mp4").write_bytes(mp4_bytes(30, 5, (960, 540)))
    (trial / "videos" / "cam02.mp4").write_bytes(mp4_bytes(25, 5, (640, 640)))


def _footage_of(scale: int) -> Callable[[Path], object]:
    """Return what adds videos of another size in the cameras' shape, in whose pixels the detections are."""

    def change(trial: Path) -> None:
        (trial / "videos").mkdir()
        width, height = (scale * int(n) for n in _CAMERAS.image_size[0])
        (trial / "videos" / "cam01.mp4").write_bytes(mp4_bytes(30, 5, (width, height)))
        _people(lambda people: (_scaled(scale, 0)(people), _scaled(scale, 1)(people)))(trial)

    return change


def _pictures(trial: Path) -> None:
    for name in _NAMES:
        (trial / "images" / name).mkdir(parents=True)
        (trial / "images" / name / "0001.jpg").write_bytes(b"\xff\xd8")


def _moved(cameras: Cameras) -> Callable[[Path], object]:
    return _calibration("Calib.toml", toml_text(cameras))


_THREE = ("cam01", "cam02", "cam03")


def _turned_third(trial: Path) -> None:
    cameras = renamed(ring_of_cameras(3), ("cam_1", "cam_2", "cam_3"))
    _moved(replace(cameras, t=cameras.t + np.array([[0.0], [0.0], [0.15]])))(trial)


def _above(trial: Path) -> None:
    trial.rename(trial.with_name("first"))
    trial.mkdir()
    trial.with_name("first").rename(trial / "first")


def _two_people() -> list[tuple[np.ndarray, np.ndarray]]:
    places, rng = ((-0.5, 0.0), (0.7, 0.6)), np.random.default_rng(1)
    return [detected(_CAMERAS, walker(JointSet.BODY_25, 6, place, (0.1, 0.1)), rng) for place in places]


_UPSIDE_DOWN = replace(_CAMERAS, R=_CAMERAS.R * [[[1.0, -1.0, -1.0]]])
_CONFIG = '[project]\nframe_rate = "auto"\nframe_range = [1, 2]\n[pose]\npose_model = "BODY_25"\n'
_NO_SIZE = toml_text(_CAMERAS).replace("size =", "format =")
_POSE = "rotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 1.0]\n"
_MATRIX = "matrix = [[900.0, 0.0, 500.0], [0.0, 900.0, 400.0], [0.0, 0.0, 1.0]]\n"
_EVERY_FRAME = "matrix = [[[900.0, 0.0, 500.0], [0.0, 900.0, 400.0], [0.0, 0.0, 1.0]]]\n"
CAMERAS = (
    f"[a]\nmatrix = {{fx = 900.0, fy = 900.0, cx = 500.0, cy = 400.0}}\n{_POSE}",
    f"[a]\nmatrix = [900.0, 0.0, 500.0, 0.0, 900.0, 400.0, 0.0, 0.0, 1.0]\n{_POSE}",
    f"[a]\nmatrix = [1.0, 2.0]\n{_POSE}",
    f"[a]\n{_EVERY_FRAME}rotation = [[0.0, 0.0, 0.0]]\ntranslation = [[0.0, 0.0, 1.0]]\n",
    f"[a]\n{_EVERY_FRAME}rotation = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\ntranslation = [[0.0, 0.0, 1.0]]\n",
    f"[a]\n{_MATRIX}extrinsics = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]\n",
    f"[a]\n{_MATRIX}extrinsics = [1.0, 0.0]\n",
    f"[a]\n{_MATRIX}rotation = [1.0, 0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, 1.0]\n",
    f"[a]\n{_MATRIX}rotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0]\n",
    f"[a]\n{_MATRIX}{_POSE}fisheye = true\n[b]\n{_MATRIX}{_POSE}",
    f"[a]\n{_MATRIX}{_POSE}size = [0, 0]\n",
    f"[a]\n{_MATRIX}{_POSE}distortions = [{', '.join(['0.1'] * 20)}]\n",
)
"""TOML of cameras that state their values in other ways, or wrongly."""
TRIALS: tuple[Write, ...] = (
    _trial(_footage_of(2)),
    _trial(_people(_scaled(float("inf"), 0))),
    _trial(lambda trial: [path.unlink() for path in (trial / "pose").rglob("*.json")]),
    _trial(lambda trial: (trial / "calibration" / "Calib.toml").unlink()),
    _trial(lambda trial: None, names=_THREE, calibrated=("cam_1", "cam_2", "cam_3")),
    _trial(_turned_third, names=_THREE, calibrated=("cam_1", "cam_2", "cam_3")),
    _trial(lambda trial: None, calibrated=None),
    _trial(lambda trial: None, calibrated=("left", "right")),
    _trial(lambda trial: None, lengths=(2, 1), frames=3),
    _trial(lambda trial: None, config=_CONFIG),
    _trial(lambda trial: None, people=_two_people()),
    _trial(lambda trial: None, names=("cam01",), calibrated=("cam_1",)),
    _trial(_calibration("Calib.toml", toml_text(renamed(ring_of_cameras(3), ("cam_1", "cam_2", "cam_3"))))),
    _trial(_calibration("a.qca.txt", qca_text(_CAMERAS))),
    _trial(_calibration("a.json", json_text(_CAMERAS, "dict"))),
    _trial(_calibration("a.toml", "cameras = [[\n")),
    _trial(_calibration("a.toml", _NO_SIZE)),
    _trial(lambda trial: (_calibration("a.toml", _NO_SIZE)(trial), _footage(trial))),
    _trial(_yaml_folder),
    _trial(_footage, config=""),
    _trial(_footage),
    _trial(_pictures),
    _trial(_moved(_UPSIDE_DOWN)),
    _trial(_moved(replace(_CAMERAS, t=_CAMERAS.t * 1000))),
    _trial(_moved(replace(_CAMERAS, t=_CAMERAS.t[::-1]))),
    _trial(_frames_called("a", "b")),
    _trial(_frames_called("a_1", "b_1")),
    _trial(_frames_called("c_1", "c_9")),
    _trial(_frames_called("t_1700000000000", "t_1700000033333", "t_1700000066666"), frames=3),
    _trial(_frames_called("t_" + "9" * 23, "t_1")),
    _trial(_people(_scaled(100.0, 2))),
    _trial(_people(_scaled(0.0, 2))),
    _trial(_people(_scaled(50.0, 0), every=False)),
    _trial(_people(_scaled(float("nan"), 0), every=False)),
    _trial(_people(list.clear)),
    _trial(_people(list.clear, every=False)),
    _trial(_people(_keypoints(9))),
    _trial(_people(_keypoints(26), every=False)),
    _trial(_people(_keypoints(33))),
    _trial(_people(_keypoints(133))),
    _trial(_above),
)  # fmt: skip
"""What is called ``trial`` in the folder."""


def _capture(**told: Callable[[Any], Any]) -> Write:
    """Return what writes a capture whose cameras are changed, or whose keypoints are."""

    def write(folder: Path) -> None:
        base = small_capture(2, views=2)
        points = walker(JointSet.COCO_17, 2, (0.0, 0.0), (0.1, 0.0))
        xy, confidence = detected(base.cameras, points, np.random.default_rng(0))
        keypoints = replace(base.keypoints, xy=xy, confidence=confidence)
        of_cameras = {key: value for key, value in told.items() if hasattr(base.cameras, key)}
        others = {key: value for key, value in told.items() if key not in of_cameras}
        keypoints = replace(keypoints, **{key: value(getattr(keypoints, key)) for key, value in others.items()})
        cameras = replace(base.cameras, **{key: value(getattr(base.cameras, key)) for key, value in of_cameras.items()})
        write_capture(folder / "a.npz", replace(base, cameras=cameras, keypoints=keypoints))

    return write


def _set(place: Any, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(array: np.ndarray) -> np.ndarray:
        array = np.array(array, dtype=np.float64)
        array[place] = value
        return array

    return change


def _markers_as(**arrays: object) -> Write:
    """Return what writes a capture of markers and changes its arrays."""
    return changed(lambda folder: write_capture(folder / "a.npz", Capture("m", markers=small_markers())), **arrays)


_PLAIN = small_capture(2, views=2)
_FORGED: tuple[dict[str, Any], ...] = (
    {"K": -_PLAIN.cameras.K}, {"K": _PLAIN.cameras.K * np.nan}, {"K": _PLAIN.cameras.K[:1]}, {"K": None},
    {"image_size": [[0, 0], [0, 0]]}, {"image_size": [["a", "b"], ["c", "d"]]}, {"footage": ["a.mp4"]},
    {"distortion_model": "other"}, {"confidence": None}, {"confidence": np.zeros((2, 2, 3))}, {"xy": np.zeros((2, 2))},
    {"camera_names": ["a", "a"]}, {"camera_names": ["", ""]}, {"joint_set": "NONE"}, {"fps": 0.0}, {"fps": "fast"},
    {"footage": ["/elsewhere/a.mp4", "..\\b.mp4"]}, {"name": 3}, {"sources": 1},
)  # fmt: skip
CAPTURES: tuple[Write, ...] = (
    *(changed(lambda folder: write_capture(folder / "a.npz", _PLAIN), **forged) for forged in _FORGED),
    _markers_as(marker_labels=["C7", "C7", ""]),
    _markers_as(marker_labels=["C7"]),
    _markers_as(markers=np.zeros((5, 3))),
    _markers_as(markers=np.full((5, 3, 3), np.inf)),
    _capture(),
    _capture(K=_set((0, 2, 0), 3.0)),
    _capture(K=_set((0, 0, 0), 3.0)),
    _capture(K=_set((0, 0, 0), 1e6)),
    _capture(K=_set((0, 0, 0), 300.0)),
    _capture(K=_set((0, 0, 2), -900.0)),
    _capture(distortion=_set((0, 0), -0.9)),
    _capture(t=_set((0, 2), 500.0)),
    _capture(t=_set((0, 2), 1e9)),
    _capture(t=lambda t: t[[0, 0]], R=lambda R: R[[0, 0]]),
    _capture(fps=lambda fps: 5000.0),
    _capture(fps=lambda fps: 1e6),
    _capture(confidence=lambda c: c * 100),
    _capture(confidence=lambda c: c * 3),
    _capture(confidence=lambda c: c * 0),
    _capture(confidence=_set((0,), 0.0)),
    _capture(xy=lambda xy: xy + 1e6),
    _capture(xy=lambda xy: xy + 5000),
    _capture(xy=lambda xy: xy[::-1]),
    _capture(xy=lambda xy: xy[:, :1], confidence=lambda c: c[:, :1]),
)

_HEADER = "sync_index,port,point_id,img_loc_x,img_loc_y\n"
TABLES: tuple[Write, ...] = tuple(
    file("xy_POSE.csv", text)
    for text in (
        "", "a,b\n1,2\n", _HEADER, f"{_HEADER}1,0,0,5\n", f"{_HEADER}1,0,left,5,5\n", f"{_HEADER}1,0,0.5,5,5\n",
        f"{_HEADER}1,0,0,5,5\n99999999,0,0,5,5\n", f"{_HEADER}1,0,501,5,5\n", f"{_HEADER}1,0,1e30,5,5\n",
        f"{_HEADER}1,0,0,,5\n",
    )
)  # fmt: skip
"""Tables of tracked points that cannot be read."""


def table(camera: str = "port", rate: str = "fps_recording = 24\n", points: int = 33) -> Write:
    """Return what writes a project of two cameras with one table of tracked points."""

    def write(folder: Path) -> None:
        place = folder / "project" / "recordings" / "walk" / "POSE"
        place.mkdir(parents=True)
        text = toml_text(renamed(_CAMERAS, ("cam_0", "cam_1")), nested=True)
        (folder / "project" / "config.toml").write_text(rate + text)
        rows = [
            f"{f},{c},{f},0.1,{k},{300 + 7 * k},{400 + 5 * k}" for f in (3, 4) for c in (0, 1) for k in range(points)
        ]
        header = f"sync_index,{camera},frame_index,frame_time,point_id,img_loc_x,img_loc_y"
        (place / "xy_POSE.csv").write_text("\n".join([header, *rows, "4,0,4,0.1,104,10,10"]) + "\n")

    return write
