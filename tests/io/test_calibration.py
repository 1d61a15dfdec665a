"""Every calibration format gives the same cameras, in metres with Z up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cameras.camera_corrections import resized
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged, JobInvalid
from solver_backend.io.calibration import matrices
from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.calibration.read import calibrations_in, read_calibration
from solver_backend.io.calibration.yaml_storage import parse_yaml
from solver_backend.io.files import read_json
from solver_backend.io.units_and_axes import UP_AXES, with_up_axis
from solver_backend.types import Cameras
from tests.support.calibration_files import json_text, qca_text, toml_text, write_easymocap, yaml_camera
from tests.support.scenes import ring_of_cameras
from tests.support.words import words


def assert_same(found: Calibration, cameras: Cameras, *, sizes: bool = True) -> None:
    assert found.cameras.names == cameras.names
    for key in ("K", "distortion", "R", "t"):
        np.testing.assert_allclose(getattr(found.cameras, key), getattr(cameras, key), atol=1e-9, err_msg=key)
    if sizes:
        np.testing.assert_array_equal(found.cameras.image_size, cameras.image_size)
        assert found.size_known == (True,) * len(cameras)
        assert found.problems == ()


@pytest.fixture
def cameras() -> Cameras:
    return ring_of_cameras(3)


@pytest.mark.parametrize("matrices", [False, True])
def test_toml(tmp_path: Path, cameras: Cameras, matrices: bool) -> None:
    (tmp_path / "Calib.toml").write_text(toml_text(cameras, matrices=matrices))
    found = read_calibration(tmp_path / "Calib.toml")
    assert_same(found, cameras)
    assert words(found.notes)[0] == "The calibration of 3 cameras was read from Calib.toml (TOML)."
    assert [item.code for item in found.notes[1:]] == ["unit_read", "up_axis_read"]
    assert "in m, assumed because the cameras are up to" in words(found.notes)[1]
    assert "Z points up" in words(found.notes)[2]


def test_toml_of_caliscope_names_cameras_by_number(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "camera_array.toml").write_text(toml_text(cameras, nested=True))
    assert read_calibration(tmp_path / "camera_array.toml").cameras.names == ("cam_0", "cam_1", "cam_2")


def test_ignored_cameras_are_left_out(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "c.toml").write_text(toml_text(cameras).replace('name = "cam_b"', 'name = "cam_b"\nignore = true'))
    assert read_calibration(tmp_path / "c.toml").cameras.names == ("cam_a", "cam_c")


def test_millimetres_are_told_by_the_size_of_the_rig(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "c.toml").write_text(toml_text(cameras, scale=1000.0))
    found = read_calibration(tmp_path / "c.toml")
    assert_same(found, cameras)
    assert "in mm, assumed because the cameras are up to" in words(found.notes)[1]


def test_a_stated_unit_is_used(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "c.toml").write_text(toml_text(cameras, scale=100.0))
    assert_same(read_calibration(tmp_path / "c.toml", unit="cm"), cameras)
    with pytest.raises(JobInvalid, match="Unknown unit 'yard'. Known units: m, cm, mm"):
        read_calibration(tmp_path / "c.toml", unit="yard")


def test_fisheye(tmp_path: Path, cameras: Cameras) -> None:
    fish = replace(cameras, models=("fisheye",), distortion=cameras.distortion[:, :4])
    (tmp_path / "c.toml").write_text(toml_text(fish))
    found = read_calibration(tmp_path / "c.toml")
    assert_same(found, fish)
    assert set(found.cameras.models) == {"fisheye"}
    mixed = toml_text(fish).replace("fisheye = true", "fisheye = false", 1)
    (tmp_path / "mixed.toml").write_text(mixed)
    assert read_calibration(tmp_path / "mixed.toml").cameras.models == ("opencv", "fisheye", "fisheye")


@pytest.mark.parametrize("left", [0.0, 32.0])
def test_qualisys(tmp_path: Path, cameras: Cameras, left: float) -> None:
    (tmp_path / "Calib.qca.txt").write_text(qca_text(cameras, left=left))
    found = read_calibration(tmp_path / "Calib.qca.txt")
    assert_same(found, cameras)
    assert "1/64 pixel" in words(found.notes)[1]
    assert "Z points up, as always in Qualisys files" in words(found.notes)[2]


def test_qualisys_marker_cameras_and_turned_views(tmp_path: Path, cameras: Cameras) -> None:
    text = qca_text(cameras).replace('viewrotation="0"', 'viewrotation="90"', 1).replace("Miqus Video", "Oqus 700", 2)
    (tmp_path / "c.qca.txt").write_text(text)
    assert read_calibration(tmp_path / "c.qca.txt").cameras.names == ("cam_c",)
    (tmp_path / "d.qca.txt").write_text(text.replace("Miqus Video", "Oqus 700"))
    found = read_calibration(tmp_path / "d.qca.txt")
    assert found.cameras.names == cameras.names
    assert "view of cam_a is rotated by 90°" in words(found.problems)[0]


def test_qualisys_videos_of_another_resolution_are_named(tmp_path: Path, cameras: Cameras) -> None:
    rows = int(cameras.image_size[0, 1])
    for stated, named in ((rows // 2, True), (rows - rows // 50, False)):
        text = qca_text(cameras).replace('viewrotation="0"', f'viewrotation="0" video_resolution="{stated}p"')
        (tmp_path / "c.qca.txt").write_text(text)
        problems = words(read_calibration(tmp_path / "c.qca.txt").problems)
        assert any(f"{stated} pixel rows" in problem and f"has {rows}" in problem for problem in problems) == named


@pytest.mark.parametrize("pose", ["rt", "rvec", "extrinsics"])
def test_one_yaml_a_camera(tmp_path: Path, cameras: Cameras, pose: str) -> None:
    for c, name in enumerate(cameras.names):
        (tmp_path / f"{name}.yml").write_text(yaml_camera(cameras, c, pose))
    (tmp_path / "notes.yaml").write_text("%YAML:1.0\n---\nauthor: nobody\n")
    assert_same(read_calibration(tmp_path), cameras)
    single = read_calibration(tmp_path / "cam_b.yml")
    assert single.cameras.names == ("cam_b",)


def test_easymocap(tmp_path: Path, cameras: Cameras) -> None:
    write_easymocap(tmp_path, cameras)
    found = read_calibration(tmp_path)
    assert_same(found, cameras, sizes=False)
    assert found.size_known == (False,) * 3
    np.testing.assert_array_equal(found.cameras.image_size, cameras.image_size)


@pytest.mark.parametrize("layout", ["list", "dict", "storage"])
def test_json(tmp_path: Path, cameras: Cameras, layout: str) -> None:
    (tmp_path / "c.json").write_text(json_text(cameras, layout))
    assert_same(read_calibration(tmp_path / "c.json"), cameras)


def test_a_file_of_matrices_is_read_once(tmp_path: Path, cameras: Cameras, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "one.json").write_text(json_text(cameras, "list"), encoding="utf-8")
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    reads: list[str] = []

    def counted(path: Path) -> object:
        reads.append(path.name)
        return read_json(path)

    monkeypatch.setitem(matrices.READ, ".json", (counted, 1 << 20))
    found, _ = calibrations_in(tmp_path)
    assert (len(found), sorted(reads)) == (1, ["one.json", "other.json"])


def test_a_folder_with_several_formats_and_other_files(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "Calib.qca.txt").write_text(qca_text(cameras))
    (tmp_path / "Calib.toml").write_text(toml_text(cameras))
    (tmp_path / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    (tmp_path / "readme.txt").write_text("hello")
    (tmp_path / "c.json").write_text(json_text(cameras, "dict"))
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "unrelated.json").write_text('{"a": [1, 2]}')
    for c, name in enumerate(cameras.names):
        (tmp_path / f"{name}.yml").write_text(yaml_camera(cameras, c, "rvec"))
    found, errors = calibrations_in(tmp_path)
    assert [c.source.name for c in found] == ["Calib.toml", "Calib.qca.txt", "c.json", tmp_path.name]
    for calibration in found:
        assert_same(calibration, cameras)
    assert [type(error) for error in errors] == [FileDamaged]
    assert "broken.json" in errors[0].where


def test_no_calibration(tmp_path: Path) -> None:
    (tmp_path / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    for path in (tmp_path, tmp_path / "Config.toml", tmp_path / "x.bin"):
        with pytest.raises(CalibrationMissing, match=r"No camera calibration was found.*Supported formats: Pose2Sim"):
            read_calibration(path)


def broken(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("matrix = [[1400.0,", "matrix = [[-1400.0,", r"must be 0.001 px or more, not -1400.*camera cam_a"),
        ("[0.0, 1410.0,", "[0.0, 1e-30,", r"focal length must be 0.001 px or more, not 1400, 1e-30.*camera cam_a"),
        ("matrix = [[1400.0,", "matrix = [[nan,", r"K contains NaN.*camera cam_a"),
        ("rotation = [[", "rotation = [[9.0, 1, 1], [0, 1, 1], [0, 1, 1]]\nold = [[", "not orthonormal"),
        ("rotation = [[", "rotation = [1.0, 2.0]\nold = [[", r"rotation has 2 numbers, but a Rodrigues vector"),
        ("rotation = [[", "old = [[", r"camera has no rotation.*camera cam_a.*extrinsics"),
        ("translation = [", 'translation = ["x", ', "a value that is not a number"),
        ("translation = [", "translation = [1.0, ", "translation has 4 numbers, but 3"),
        ("translation = [", "translation = [inf, 0.0, 0.0]\nold = [", r"t contains NaN or infinite.*camera cam_a"),
        ("size = [1920.0,", "size = [0.0,", r"image size 0 x \d+ is not positive.*camera cam_a"),
        ("size = [1920.0,", "size = [1920.0, 1.0,", "must be a width and a height"),
        ("distortions = [", "distortions = [0,0,0,0,0,0,0,0,0,0,1.0,", r"distortion coefficients, but 8 are supported"),
    ],
)  # fmt: skip
def test_impossible_cameras_are_named(tmp_path: Path, cameras: Cameras, old: str, new: str, text: str) -> None:
    (tmp_path / "c.toml").write_text(broken(toml_text(cameras, matrices=True), old, new))
    with pytest.raises(CalibrationInvalid, match=text):
        read_calibration(tmp_path / "c.toml")


def test_mirrored_rotation(tmp_path: Path, cameras: Cameras) -> None:
    text = qca_text(cameras)
    row = next(line for line in text.splitlines() if "<transform" in line)
    swapped = row.replace("r11", "rXX").replace("r21", "r11").replace("rXX", "r21")
    (tmp_path / "c.qca.txt").write_text(text.replace(row, swapped))
    with pytest.raises(CalibrationInvalid, match=r"not orthonormal.*camera cam_a"):
        read_calibration(tmp_path / "c.qca.txt")


def test_a_rounded_rotation_is_made_exact(tmp_path: Path, cameras: Cameras) -> None:
    rounded = replace(cameras, R=np.round(cameras.R, 4))
    (tmp_path / "c.toml").write_text(toml_text(rounded, matrices=True))
    R = read_calibration(tmp_path / "c.toml").cameras.R
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(R, cameras.R, atol=2e-4)


def test_moving_cameras(tmp_path: Path, cameras: Cameras) -> None:
    text = toml_text(cameras)
    moving = "\n".join(
        f"{key} = [{value}, {value}]" if key in ("size", "matrix", "distortions", "rotation", "translation") else line
        for line in text.splitlines()
        for key, _, value in [line.partition(" = ")]
    )
    (tmp_path / "c.toml").write_text(moving)
    assert_same(read_calibration(tmp_path / "c.toml"), cameras)
    first = next(line for line in moving.splitlines() if line.startswith("translation"))
    (tmp_path / "d.toml").write_text(moving.replace(first, "translation = [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]]"))
    with pytest.raises(CalibrationInvalid, match=r"camera moves.*camera cam_a"):
        read_calibration(tmp_path / "d.toml")


@pytest.mark.parametrize("name", ["c.toml", "c.qca.txt", "c.json", "c.yml"])
def test_truncated_files_are_named(tmp_path: Path, cameras: Cameras, name: str) -> None:
    texts = {
        "c.toml": toml_text(cameras), "c.qca.txt": qca_text(cameras), "c.json": json_text(cameras, "list"),
        "c.yml": yaml_camera(cameras, 0, "rt"),
    }  # fmt: skip
    text = texts[name]
    (tmp_path / name).write_text(text[: text.index(".", len(text) // 2)])
    with pytest.raises((FileDamaged, CalibrationInvalid), match=name):
        read_calibration(tmp_path / name)


def test_missing_values_of_qualisys(tmp_path: Path, cameras: Cameras) -> None:
    (tmp_path / "c.qca.txt").write_text(qca_text(cameras).replace("focalLengthU", "focalLength", 1))
    with pytest.raises(CalibrationInvalid, match=r"'focalLengthU' of <intrinsic> is None.*cam_a"):
        read_calibration(tmp_path / "c.qca.txt")
    (tmp_path / "d.qca.txt").write_text("<calibration/>")
    with pytest.raises(FileDamaged, match="lists no cameras"):
        read_calibration(tmp_path / "d.qca.txt")


@pytest.mark.parametrize("axis", list(UP_AXES))
def test_up_axes_turn_the_world(tmp_path: Path, cameras: Cameras, axis: str) -> None:
    turn = np.array(UP_AXES[axis])
    assert np.linalg.det(turn) == pytest.approx(1)
    up = turn.T @ [0, 0, 1]
    assert up["xyz".index(axis[-1])] == (-1 if axis[0] == "-" else 1)
    point = np.array([0.3, -0.2, 1.1])
    other = replace(cameras, R=cameras.R @ turn)
    np.testing.assert_allclose(other.R @ (turn.T @ point) + other.t, cameras.R @ point + cameras.t, atol=1e-12)
    np.testing.assert_allclose(with_up_axis(other, axis).R, cameras.R, atol=1e-12)
    (tmp_path / "c.toml").write_text(toml_text(other))
    found = read_calibration(tmp_path / "c.toml", up_axis=axis)
    assert_same(found, cameras)
    assert f"{axis.upper()} points up, as requested" in words(found.notes)[2]


def test_unknown_up_axis(tmp_path: Path, cameras: Cameras) -> None:
    with pytest.raises(JobInvalid, match="Unknown up axis 'w'. Known axes: z, -z"):
        with_up_axis(cameras, "w")


def test_resizing_moves_pixels_with_their_centres(cameras: Cameras) -> None:
    half = resized(cameras, 1, (960, 540))
    x = np.array([0.1, -0.2, 1.0])
    full_px, half_px = (cameras.K[1] @ x)[:2], (half.K[1] @ x)[:2]
    np.testing.assert_allclose(half_px + 0.5, (full_px + 0.5) / 2)
    np.testing.assert_array_equal(half.K[0], cameras.K[0])
    assert half.image_size[1].tolist() == [960, 540]


def test_yaml_of_every_kind() -> None:
    tree = parse_yaml(
        "%YAML 1.0\n---\n# comment\na: 1\nb: .Inf\nc: [ 1., -2e-3,\n   .Nan ] # end\nd: { x:1, 'y': [2] }\n"
        "list:\n- \"#1\"\n- two\nempty:\nnested:\n   deep:\n      e: ''\n   f: true\n"
        "people:\n   -\n      name: A\n      age: 3\n   - { name: B }\n   - name: C\n     age: 4\nlast: 007x\n"
    )
    assert tree["a"] == 1
    assert tree["b"] == float("inf")
    assert tree["c"][:2] == [1.0, -0.002]
    assert np.isnan(tree["c"][2])
    assert tree["d"] == {"x": 1, "y": [2]}
    assert tree["list"] == ["#1", "two"]
    assert tree["empty"] is None
    assert tree["nested"] == {"deep": {"e": ""}, "f": True}
    assert tree["last"] == "007x"
    assert tree["people"] == [{"name": "A", "age": 3}, {"name": "B"}, {"name": "C", "age": 4}]


@pytest.mark.parametrize("text", ["a: [1, 2", "a: 1\n   b: 2", "just words", "a: { b:1", "a: [1] 2", 'a: "x'])
def test_yaml_that_is_not_understood(text: str) -> None:
    with pytest.raises(ValueError, match=r"line 1|line 2|substring"):
        parse_yaml(text)


@pytest.mark.shared
def test_calibrations_of_other_people(shared_data: Path) -> None:
    caliscope = read_calibration(shared_data / "multiview/caliscope/charuco_calibration/camera_array.toml")
    assert caliscope.cameras.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    assert caliscope.problems == ()
    apart = np.linalg.norm(caliscope.cameras.centres[:, None] - caliscope.cameras.centres, axis=-1)
    assert apart[apart > 0].min() > 0.3
    assert apart.max() < 3
    ewand = read_calibration(shared_data / "multiview/ewand/calibration_framework/test")
    assert len(ewand.cameras) == 4
    assert "in mm" in words(ewand.notes)[1]
    assert ewand.cameras.image_size.tolist() == [[1280, 1024]] * 4
