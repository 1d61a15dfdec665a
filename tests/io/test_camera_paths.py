"""Paths of carried cameras are the same from every program's file, and a path of another video is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CalibrationInvalid, FrameCountMismatch
from solver_backend.geometry.rotations import exp_so3, quat_from_matrix
from solver_backend.io.camera_paths import read_camera_path

FRAMES, FPS = 31, 30.0
GL = np.diag([1.0, -1.0, -1.0])


def poses() -> tuple[np.ndarray, np.ndarray]:
    """Return rotations camera to world and places of a camera that walks and turns."""
    time = np.arange(FRAMES) / FPS
    R = exp_so3(np.stack([0.1 * time, 0.8 * time, -0.1 * time], axis=1))
    return R, np.stack([1.2 * time, 0.05 * np.sin(6 * time), 0.3 * time**2], axis=1)


def matrices(axes: np.ndarray = GL) -> np.ndarray:
    R, centre = poses()
    M = np.tile(np.eye(4), (FRAMES, 1, 1))
    M[:, :3, :3], M[:, :3, 3] = R @ axes, centre
    return M


def write_colmap(folder: Path) -> Path:
    R, centre = poses()
    back = R.swapaxes(-1, -2)
    lines = ["# Image list with two lines of data per image:"]
    for n in range(FRAMES):
        t = -back[n] @ centre[n]
        numbers = " ".join(f"{x:.12g}" for x in (*quat_from_matrix(back[n]), *t))
        lines += [f"{n + 7} {numbers} 1 walk_{n + 1:05d}.jpg", "10.5 20.5 -1 30.5 40.5 17 50.0 60.0 -1"]
    (folder / "images.txt").write_text("\n".join(lines), encoding="utf-8")
    return folder


def write_trajectory(folder: Path, scale: float = 1.0 / FPS, start: float = 1.7e9) -> Path:
    R, centre = poses()
    rows = [
        f"{start + scale * n:.9f} {' '.join(f'{x:.12g}' for x in (*centre[n], *np.roll(quat_from_matrix(R[n]), -1)))}"
        for n in range(FRAMES)
    ]
    (folder / "path.txt").write_text("\n".join(rows), encoding="utf-8")
    return folder / "path.txt"


def write_frames(folder: Path) -> Path:
    return write_trajectory(folder, 1.0, 0.0)


def write_json(folder: Path, document: object) -> Path:
    (folder / "path.json").write_text(json.dumps(document), encoding="utf-8")
    return folder / "path.json"


def write_arkit(folder: Path) -> Path:
    M = matrices().swapaxes(-1, -2).reshape(FRAMES, 16)
    return write_json(folder, [{"timestamp": 50.0 + n / FPS, "transform": M[n].tolist()} for n in range(FRAMES)])


def write_arcore(folder: Path) -> Path:
    R, centre = poses()
    rows = []
    for n in range(FRAMES):
        w, x, y, z = quat_from_matrix(R[n] @ GL)
        place = dict(zip("xyz", centre[n], strict=True))
        rows.append({"time": n / FPS, "translation": place, "rotation": {"x": x, "y": y, "z": z, "w": w}})
    return write_json(folder, {"frames": rows})


def write_record3d(folder: Path) -> Path:
    R, centre = poses()
    return write_json(
        folder,
        {"poses": [[*np.roll(quat_from_matrix(R[n] @ GL), -1).tolist(), *centre[n].tolist()] for n in range(FRAMES)]},
    )


def write_blender(folder: Path) -> Path:
    rows = [{"frame": n + 1, "matrix": M.tolist()} for n, M in enumerate(matrices())]
    return write_json(folder, {"axes": "opengl", "frames": rows})


def write_nerf(folder: Path) -> Path:
    rows = [{"file_path": f"images/{n:04d}.png", "transform_matrix": M.tolist()} for n, M in enumerate(matrices())]
    return write_json(folder, {"frames": rows})


METRIC = (write_arkit, write_arcore, write_record3d)
WRITERS = (write_colmap, write_trajectory, write_frames, *METRIC, write_blender, write_nerf)


@pytest.mark.parametrize("write", WRITERS)
def test_every_program_tells_the_same_path(write: Callable[[Path], Path], tmp_path: Path) -> None:
    R, centre = poses()
    found = read_camera_path(write(tmp_path), FRAMES, FPS)
    np.testing.assert_allclose(found.R, R, atol=1e-6)
    np.testing.assert_allclose(found.centre, centre, atol=1e-6)
    assert found.metres == (1.0 if write in METRIC else 0.0)
    np.testing.assert_equal(found.up, np.array([0.0, 1.0, 0.0]) if write in METRIC else None)


def test_a_document_may_state_its_axes_unit_and_up(tmp_path: Path) -> None:
    rows = [{"frame": n, "matrix": M.tolist()} for n, M in enumerate(matrices(np.eye(3)))]
    document = {"axes": "opencv", "metres_per_unit": 0.1, "up": "z", "frames": rows}
    found = read_camera_path(write_json(tmp_path, document), FRAMES, FPS)
    np.testing.assert_allclose(found.R, poses()[0], atol=1e-9)
    assert found.metres == 0.1
    np.testing.assert_array_equal(found.up, [0.0, 0.0, 1.0])


def test_frames_without_a_pose_are_interpolated_and_long_gaps_refused(tmp_path: Path) -> None:
    R, centre = poses()
    rows = [{"frame": n, "matrix": M.tolist()} for n, M in enumerate(matrices())]
    found = read_camera_path(write_json(tmp_path, {"frames": rows[::5]}), FRAMES, FPS)
    np.testing.assert_allclose(found.centre, centre, atol=0.008)
    np.testing.assert_allclose(found.R, R, atol=3e-3)
    with pytest.raises(FrameCountMismatch, match="no pose near frame") as error:
        read_camera_path(write_json(tmp_path, {"frames": [*rows[:5], *rows[-2:]]}), FRAMES, 10.0)
    assert "--frames" in error.value.hint


@pytest.mark.parametrize("tick", [1.0, 1e-3, 1e-9])
def test_a_tracker_that_began_late_keeps_the_times_of_the_video(tick: float, tmp_path: Path) -> None:
    """The video has 300 frames of 30 per second, and the tracker began at the thirteenth."""
    place = np.arange(12, 300) / FPS
    rows = [{"timestamp": x / tick, "translation": [x, 0, 0], "rotation": [0, 0, 0, 1]} for x in place]
    found = read_camera_path(write_json(tmp_path, rows), 300, FPS)
    np.testing.assert_allclose(found.centre[[0, 12, 100, 299], 0], [place[0], place[0], 100 / FPS, 299 / FPS])
    later = [{**row, "timestamp": row["timestamp"] + 1e6 / tick} for row in rows]
    with pytest.raises(FrameCountMismatch, match="12 frames shorter"):
        read_camera_path(write_json(tmp_path, later), 300, FPS)
    later = [{**row, "timestamp": row["timestamp"] + 1e6 / tick} for row in rows]
    found = read_camera_path(write_json(tmp_path, later), 288, FPS)
    np.testing.assert_allclose(found.centre[:, 0], place, atol=1e-6)


@pytest.mark.parametrize(("first", "last", "base"), [(3, 299, 0), (0, 299, 0), (1, 300, 1), (13, 300, 1), (1, 297, 1)])
def test_frame_numbers_count_from_zero_or_one(first: int, last: int, base: int, tmp_path: Path) -> None:
    rows = [{"frame": n, "translation": [n - base, 0, 0], "rotation": [0, 0, 0, 1]} for n in range(first, last + 1)]
    in_lines = tmp_path / "path.txt"
    in_lines.write_text("\n".join(f"{row['frame']} {row['translation'][0]} 0 0 0 0 0 1" for row in rows))
    for file in (write_json(tmp_path, rows), in_lines):
        assert read_camera_path(file, 300, FPS).centre[100, 0] == pytest.approx(100.0)


def test_pictures_of_colmap_may_have_blanks_in_their_names(tmp_path: Path) -> None:
    file = write_colmap(tmp_path) / "images.txt"
    file.write_text(file.read_text().replace("walk_", "my walk "))
    np.testing.assert_allclose(read_camera_path(file, FRAMES, FPS).centre, poses()[1], atol=1e-6)


def test_axes_and_up_are_read_in_any_case_and_refused_if_unknown(tmp_path: Path) -> None:
    rows = [{"frame": n, "matrix": M.tolist()} for n, M in enumerate(matrices(np.eye(3)))]
    found = read_camera_path(write_json(tmp_path, {"axes": "OpenCV", "up": "Z", "frames": rows}), FRAMES, FPS)
    np.testing.assert_allclose(found.R, poses()[0], atol=1e-9)
    np.testing.assert_array_equal(found.up, [0.0, 0.0, 1.0])
    for wrong in ({"axes": "maya"}, {"axes": ""}, {"up": "w"}, {"up": [0, 0, 0]}, {"up": 3}):
        with pytest.raises(CalibrationInvalid, match="is not valid"):
            read_camera_path(write_json(tmp_path, {"frames": rows, **wrong}), FRAMES, FPS)


def test_a_path_of_another_video_is_refused(tmp_path: Path) -> None:
    for frames in (60, 20):
        with pytest.raises(FrameCountMismatch):
            read_camera_path(write_trajectory(tmp_path), frames, FPS)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("path.txt", "1 2 3", "no camera path in a known format"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 first.png", "no frame numbers"),
        ("path.txt", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n2 0 0", "does not have eight numbers"),
        ("path.txt", "0 0 0 0 0 0 0 1", "fewer than two poses"),
        ("path.json", "{}", "no poses"),
        ("path.json", '[{"timestamp": 0, "rotation": [0, 0, 0, 1]}]', "is not valid"),
        ("path.json", '[{"timestamp": 0, "transform": [1, 2]}]', "is not valid"),
    ],
)
def test_a_damaged_file_is_named(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationInvalid, match=message):
        read_camera_path(tmp_path / name, FRAMES, FPS)
