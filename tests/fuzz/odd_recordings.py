"""Recordings that are odd or cannot be: each is read with a problem or refused by name, and mutations go on from it."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.types import Cameras, JointSet
from tests.fuzz.target import Write, file
from tests.support.calibration_files import json_text, qca_text, toml_text, yaml_camera
from tests.support.scenes import detected, ring_of_cameras, walker
from tests.support.trial_files import mp4_bytes, renamed, write_trial

People = list[dict[str, Any]]  # OpenPose's people of one frame.
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


def _each_frame(content: bytes) -> Callable[[Path], object]:
    """Return what writes this into every frame of every camera."""
    return lambda trial: [path.write_bytes(content) for path in (trial / "pose").rglob("*.json")]


def _no_frames_in_common(trial: Path) -> None:
    folder = sorted((trial / "pose").iterdir())[0]
    for number, path in enumerate(sorted(folder.iterdir())):
        path.rename(path.with_name(f"cam01_{5000 + number:012d}_keypoints.json"))


def _named_like_a_session(trial: Path) -> None:
    """Move the calibration three levels up, as far as Pose2Sim's names of sessions and people let it be found."""
    place = trial.with_name("S00") / "S00_P01" / "trial"
    place.parent.mkdir(parents=True)
    trial.rename(place)
    (place / "calibration").rename(trial.with_name("calibration"))
    trial.symlink_to(place)


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
    _trial(lambda trial: [(path / "words.json").write_text("[") for path in (trial / "pose").iterdir()]),
    _trial(_each_frame(b"{")),
    _trial(_each_frame(b"[]")),
    _trial(_each_frame(b'{"people": [{}]}')),
    _trial(_each_frame(b'{"people": [{"pose_keypoints_2d": [1, 2]}]}')),
    _trial(_each_frame(b'{"people": [{"pose_keypoints_2d": [1, 2, "x"]}]}')),
    _trial(_people(lambda people: people.extend(people * 30))),
    _trial(_no_frames_in_common),
    _trial(_people(_scaled(300.0, 2))),
    _trial(lambda trial: None, config='[project]\nframe_rate = 30\n[pose]\npose_model = "COCO_17"\n'),
    _trial(_moved(replace(_CAMERAS, t=_CAMERAS.t * 0.3))),
    _trial(_moved(replace(_CAMERAS, t=_CAMERAS.t - _CAMERAS.R @ [0.0, 0.0, 1.0]))),
    _trial(_moved(replace(_CAMERAS, K=_CAMERAS.K * [[[1.6, 1.0, 1.0], [1.0, 1.6, 1.0], [1.0, 1.0, 1.0]]]))),
    _trial(_calibration("a.yml", "a: [")),
    _trial(_calibration("a.json", json_text(_CAMERAS, "list"))),
    _trial(_named_like_a_session),
)  # fmt: skip
"""What is called ``trial`` in the folder."""


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


def _box(kind: bytes, content: bytes, large: bool = False) -> bytes:
    if large:
        return struct.pack(">I4sQ", 1, kind, 16 + len(content)) + content
    return struct.pack(">I4s", 8 + len(content), kind) + content


_VIDEO = mp4_bytes(30, 3, (1920, 1080))
_MOOV = _VIDEO[_VIDEO.index(b"moov") + 4 :]
VIDEOS: tuple[bytes, ...] = (
    b"", b"\0\0", _box(b"mdat", bytes(9), large=True) + _box(b"moov", _MOOV, large=True),
    struct.pack(">I4s", 3, b"ftyp") + _VIDEO, _box(b"ftyp", b"isom"), struct.pack(">I4s", 1, b"mdat"),
    _box(b"moov", _box(b"trak", b"", large=True) + _MOOV), _box(b"moov", struct.pack(">I4s", 4, b"trak") + _MOOV),
    struct.pack(">I4s", 0, b"moov") + _MOOV, _VIDEO.replace(struct.pack(">I", 90000), bytes(4)),
    _VIDEO.replace(b"vide", b"text"), _VIDEO.replace(b"stts", b"none"),
)  # fmt: skip
"""Headers of videos whose boxes are long, empty, too short or not there."""
