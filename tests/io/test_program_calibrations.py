"""Calibrations of programs come back as the same cameras, and an unknown form is named with its keys."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.forms import Content, cameras_in_tree
from solver_backend.io.calibration.matrices import MatrixFile, read_matrix_file, stated_cameras
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import find_calibration
from tests.support import program_calibrations as written
from tests.support.calibration_files import qca_text, toml_text, yaml_matrix
from tests.support.program_calibrations import CAMERAS, NAMES, PAIRS, RELATIVE, WRITERS


def assert_same(found: Calibration, count: int, *, relative: bool) -> None:
    cameras, expected = found.cameras, CAMERAS.subset(list(range(count)))
    np.testing.assert_allclose(cameras.K, expected.K, atol=1e-6)
    turn = expected.R[0].T if relative else np.eye(3)
    np.testing.assert_allclose(cameras.R, expected.R @ turn, atol=1e-6)
    centres = (expected.centres - expected.centres[0]) @ turn if relative else expected.centres
    np.testing.assert_allclose(cameras.centres, centres, atol=1e-5)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_the_cameras_of_a_program_are_found(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    found = find_calibration(tmp_path, NAMES)
    assert found.cameras.names == NAMES
    assert_same(found, 4, relative=write in RELATIVE)


@pytest.mark.parametrize("write", PAIRS, ids=lambda write: write.__name__)
def test_a_pair_of_opencv_is_left_and_right(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path)
    found = find_calibration(tmp_path, ("left", "right"))
    assert_same(found, 2, relative=True)


def test_qualisys_in_whole_pixels_is_told_by_the_picture(tmp_path: Path) -> None:
    cameras = CAMERAS
    text = qca_text(cameras)
    for c in range(4):
        for row, key in ((0, "U"), (1, "V")):
            f, middle = cameras.K[c, row, row], cameras.K[c, row, 2]
            text = text.replace(f'focalLength{key}="{64 * f}"', f'focalLength{key}="{f}"')
            text = text.replace(f'centerPoint{key}="{64 * middle}"', f'centerPoint{key}="{middle}"')
    (tmp_path / "c.qca.txt").write_text(text)
    found = read_calibration(tmp_path / "c.qca.txt")
    assert_same(found, 4, relative=False)
    assert [problem.code for problem in found.problems] == ["calibration_read_as"]


def test_cameras_without_common_views_are_refused(tmp_path: Path) -> None:
    written.mccalib(tmp_path, groups=2)
    with pytest.raises(CalibrationInvalid, match="2 groups"):
        find_calibration(tmp_path, NAMES)


def test_poses_in_a_circle_are_refused(tmp_path: Path) -> None:
    written.multical(tmp_path)
    path = tmp_path / "calibration.json"
    text = path.read_text().replace(f'"{NAMES[0]}": {{"R"', f'"{NAMES[0]}_to_{NAMES[1]}": {{"R"')
    path.write_text(text)
    with pytest.raises(CalibrationInvalid, match="in a loop"):
        find_calibration(tmp_path, NAMES)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            {"cameras": {"a": {"fisheye_params": [1.0], "orientation_deg": [0, 0, 0]}}},
            "keys cameras.*in the first.*intrinsic",
        ),
        ({"a": {"rotation": [0, 0, 0], "translation": [0, 0, 1]}}, "poses of a without intrinsics"),
        ({"a": {"K": np.eye(3).tolist(), "lens_pose": [1]}}, "no rotation. It has the keys K, lens_pose"),
    ],
)
def test_an_unknown_form_is_named_with_its_keys(content: object, words: str, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text(json.dumps(content))
    with pytest.raises((CalibrationMissing, CalibrationInvalid), match=words) as caught:
        find_calibration(tmp_path, ("a",))
    assert "cameras.json" in caught.value.where


def test_a_pickle_that_would_run_code_is_refused(tmp_path: Path) -> None:
    (tmp_path / "cameras.pkl").write_bytes(b"cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(FileDamaged, match="os.system"):
        find_calibration(tmp_path, NAMES)


def test_a_damaged_model_of_a_neighbour_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    for name in ("cameras.txt", "images.txt"):
        (tmp_path / "other" / name).write_text("1 NOTHING 10 10 5 5 5\n", encoding="utf-8")
    (tmp_path / "mine").mkdir()
    with pytest.raises(CalibrationMissing):
        find_calibration(tmp_path / "mine", ["cam1", "cam2"])


def test_cameras_of_easymocap_with_numbers_are_no_pair(tmp_path: Path) -> None:
    intrinsics = "".join(yaml_matrix(f"K_{c + 1}", CAMERAS.K[c]) for c in range(3))
    intrinsics += "".join(yaml_matrix(f"dist_{c + 1}", np.zeros((1, 5))) for c in range(3))
    extrinsics = "".join(yaml_matrix(f"Rot_{c + 1}", CAMERAS.R[c]) for c in range(3))
    extrinsics += "".join(yaml_matrix(f"T_{c + 1}", CAMERAS.t[c][:, None]) for c in range(3))
    for name, text in (("intri", intrinsics), ("extri", extrinsics)):
        (tmp_path / f"{name}.yml").write_text(f"%YAML:1.0\n---\n{text}")
    found = find_calibration(tmp_path, ("1", "2", "3"))
    np.testing.assert_allclose(found.cameras.centres, CAMERAS.centres[:3], atol=1e-5)


def test_three_matrices_are_no_pair() -> None:
    K = np.eye(3).tolist()
    assert not cameras_in_tree("a", {f"camera_matrix_{c}": K for c in (1, 2, 3)}).nodes
    assert len(cameras_in_tree("a", {f"camera_matrix_{c}": K for c in (1, 2)}).nodes) == 2
    stored = {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()}
    pair = cameras_in_tree("a", {"K_1": stored, "K_2": stored, "R": stored, "T": [1, 0, 0]}).nodes
    assert [name for name, _ in pair] == ["left", "right"]


def test_radial_terms_are_no_matrices(tmp_path: Path) -> None:
    for c, name in enumerate(NAMES):
        lens = dict(zip(("fx", "fy", "cx", "cy"), CAMERAS.K[c][[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), strict=True))
        terms = {"k1": 0.1, "k2": 0.01, "p1": 0.0, "p2": 0.0}
        pose = {"R": CAMERAS.R[c].tolist(), "T": CAMERAS.t[c].tolist()}
        (tmp_path / f"{name}.json").write_text(json.dumps({**lens, **terms, **pose}))
    found = find_calibration(tmp_path, NAMES)
    np.testing.assert_allclose(found.cameras.distortion[:, :2], [[0.1, 0.01]] * 4)
    assert_same(found, 4, relative=False)


def test_a_quaternion_without_a_place_is_no_pose() -> None:
    assert not cameras_in_tree("a", {"imu": {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}).nodes


def test_an_infinite_position_of_unity_is_refused(tmp_path: Path) -> None:
    written.unity(tmp_path)
    path = tmp_path / "cameras.json"
    content = json.loads(path.read_text())
    content["cameras"][1]["position"]["x"] = float("inf")
    path.write_text(json.dumps(content))
    with pytest.raises(CalibrationInvalid, match="NaN or infinite value"):
        find_calibration(tmp_path, NAMES)


@pytest.mark.parametrize("number", ["-1e308", "0", "3"])
def test_an_orientation_of_vicon_that_is_no_rotation_is_refused(number: str, tmp_path: Path) -> None:
    written.vicon(tmp_path)
    (path,) = tmp_path.glob("*.xcp")
    path.write_text(re.sub('ORIENTATION="[^"]*"', f'ORIENTATION="0 {number} 0 0"', path.read_text()))
    with pytest.raises(CalibrationInvalid, match="'ORIENTATION' is not a unit quaternion"):
        find_calibration(tmp_path, NAMES)


@pytest.mark.parametrize("single", [False, True])
def test_cameras_of_unity_by_name_are_not_of_ros(single: bool, tmp_path: Path) -> None:
    written.unity(tmp_path)
    path = tmp_path / "cameras.json"
    cameras = {camera.pop("name"): camera for camera in json.loads(path.read_text())["cameras"]}
    path.unlink()
    moved = ("position", "rotation")
    for name, camera in cameras.items() if single else ():
        lens = {key: value for key, value in camera.items() if key not in moved}
        content = {**lens, "transform": {key: camera[key] for key in moved}}
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    if not single:
        path.write_text(json.dumps(cameras))
    assert_same(find_calibration(tmp_path, NAMES), 4, relative=False)


def _toml(folder: Path) -> None:
    (folder / "Calib.toml").write_text(toml_text(CAMERAS))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("cameras/settings.yaml", "%YAML:1.0\ncamera: ["),
        ("cameras/camera.json", '{"iso": 100}'),
        ("cameras/cam1/000001.json", '{"people": ['),
        ("cameras/camera_1.json", '{"K": [[1, 2], [3, 4]], "R": [0, 0, 0], "T": [0, 0, 0]}'),
        ("sparse/0/cameras.txt", "1 NOTHING 10 10 5 5 5\n"),
        ("calibration/camera.json", '{"iso": 100}'),
    ],
)
def test_other_files_of_a_data_set_do_not_hide_a_calibration(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).parent.mkdir(parents=True)
    (tmp_path / name).write_text(text)
    (tmp_path / name).with_name("images.txt").write_text("")
    _toml(tmp_path)
    assert find_calibration(tmp_path, NAMES).source.name == "Calib.toml"


def test_a_damaged_file_of_a_data_set_is_told_if_there_is_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "settings.yaml").write_text("%YAML:1.0\ncamera: [")
    with pytest.raises(FileDamaged):
        find_calibration(tmp_path, NAMES)


@pytest.mark.parametrize("name", ["left_cam", "webcam", "camera"])
def test_detections_with_the_name_of_a_camera_are_no_damaged_calibration(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.json").write_text('{"people": [{"pose_keypoints_2d": [1, 2, 3]}]}')
    with pytest.raises(CalibrationMissing, match=r"no camera calibration.*not recognised.*keys people"):
        find_calibration(tmp_path, (name,))


def test_the_size_and_lists_of_opencvs_xml_are_read(tmp_path: Path) -> None:
    matrix = "<K><rows>3</rows><cols>3</cols><data>900. 0. 500. 0. 900. 400. 0. 0. 1.</data></K>"
    rest = "<R>0 0 1e-1</R><T>0 0 2.</T><imageSize>1000 800</imageSize>"
    text = f"<opencv_storage><cameras><_>{matrix}{rest}</_><_>{matrix}{rest}</_></cameras></opencv_storage>"
    (tmp_path / "rig.xml").write_text(text)
    nodes = read_matrix_file(tmp_path / "rig.xml").content.nodes
    entries = stated_cameras([MatrixFile(tmp_path, Content(nodes))]).entries
    assert [entry.image_size for entry in entries] == [(1000, 800)] * 2


def _values(**camera: object) -> dict[str, Any]:
    ((_, values),) = cameras_in_tree("a", camera).nodes
    return dict(values)


BLENDER: dict[str, Any] = {"location": [0, 0, 0], "lens": 24.0, "width": 1000, "height": 800}
UNITY: dict[str, Any] = {"position": [0, 0, 0], "rotation": [0, 0, 0], "focalLength": 20.0, "sensorSize": [40, 20],
                         "width": 1000, "height": 800}  # fmt: skip


def test_blenders_quaternion_counts_in_its_mode_only() -> None:
    turns = {"rotation_euler": [0.0, 0.0, 0.0], "rotation_quaternion": [0.0, 1.0, 0.0, 0.0]}
    upright = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(_values(**BLENDER, **turns)["extrinsics"][:3, :3], upright, atol=1e-12)
    turned = _values(**BLENDER, **turns, rotation_mode="QUATERNION")["extrinsics"]
    np.testing.assert_allclose(turned[:3, :3], np.eye(3), atol=1e-12)


def test_blenders_sensor_is_24_mm_high() -> None:
    values = _values(**BLENDER, rotation_euler=[0, 0, 0], sensor_fit="VERTICAL")
    assert values["fy"] == pytest.approx(800.0)


@pytest.mark.parametrize(
    ("fit", "expected"), [({}, (500, 500)), ({"gateFit": "Vertical"}, (800, 800)), ({"gateFit": "None"}, (500, 800))]
)
def test_unitys_pixels_are_square_unless_there_is_no_gate_fit(fit: dict[str, str], expected: tuple[int, int]) -> None:
    values = _values(**UNITY, **fit)
    assert (values["fx"], values["fy"]) == pytest.approx(expected)


def test_a_file_without_a_unit_leaves_the_known_one(tmp_path: Path) -> None:
    lens = {"K": np.eye(3).tolist(), "R": np.eye(3).tolist(), "T": [0, 0, 0]}
    files = [MatrixFile(tmp_path / unit, Content([(unit or "b", lens)], unit)) for unit in ("mm", "")]
    assert stated_cameras(files).unit == "mm"
