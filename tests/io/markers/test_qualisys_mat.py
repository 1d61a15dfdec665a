"""MATLAB files of QTM: read within bounds, else refused by name."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, MocapError
from solver_backend.io.markers.mat_file import read_mat
from solver_backend.io.markers.read import read_markers
from tests.support.mat_bytes import mat_with_an_object

FRAMES = 6


def write(path: Path, **changes: Any) -> Path:
    """Write a file as QTM does: two labelled trajectories, one of which is not seen in a frame, and a stray one."""
    matlab = pytest.importorskip("scipy.io")
    data = np.zeros((2, 4, FRAMES))
    data[0, :3] = np.array([100.0, -20.0, 1500.0])[:, None] + np.arange(FRAMES)
    data[1, :3] = np.array([90.0, 15.0, 30.0])[:, None]
    data[1, :3, 2] = np.nan
    labeled = {"Count": 2, "Labels": np.array(["C7", "LTOE"], dtype=object), "Data": data}
    stray = {"Count": 1, "Data": data[:1] + 300.0}
    record = {
        "File": "walk.qtm", "StartFrame": 11, "Frames": FRAMES, "FrameRate": 200,
        "Trajectories": {"Labeled": labeled, "Unidentified": stray}, **changes,
    }  # fmt: skip
    matlab.savemat(path, {"walk_0001": record})
    return path


def test_a_file_of_qtm(tmp_path: Path) -> None:
    found = read_markers(write(tmp_path / "walk.mat"))
    cloud = found.cloud
    assert cloud.labels is not None and cloud.labels[:2] == ("C7", "LTOE") and cloud.fps == 200.0
    assert cloud.positions.shape == (FRAMES, 3, 3)
    np.testing.assert_allclose(cloud.positions[1, 0], [0.101, -0.019, 1.501])
    assert np.isnan(cloud.positions[2, 1]).all() and np.isfinite(cloud.positions[3, 1]).all()
    assert len(found.unlabelled) == 1


def test_one_trajectory_and_one_group_are_read_alike(tmp_path: Path) -> None:
    one = {"Count": 1, "Labels": "C7", "Data": np.array([100.0, 20.0, 300.0, 1.0])[None, :, None] + np.arange(FRAMES)}
    found = read_markers(write(tmp_path / "walk.mat", Trajectories={"Labeled": one}))
    assert found.cloud.labels == ("C7",) and found.cloud.positions.shape == (FRAMES, 1, 3)


def test_objects_of_matlab_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.mat").write_bytes(mat_with_an_object())
    found = read_mat(tmp_path / "a.mat")
    assert found.keys() == {"x", "y"} and found["x"] == 1.0 and found["y"] == 2.0


def test_what_is_none_of_qtm_is_named(tmp_path: Path) -> None:
    pytest.importorskip("scipy.io").savemat(tmp_path / "other.mat", {"x": np.eye(3)})
    with pytest.raises(CaptureNotRecognised, match="not from Qualisys"):
        read_markers(tmp_path / "other.mat")
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0 MAT-file, and no more")
    with pytest.raises(FileDamaged, match="truncated"):
        read_markers(tmp_path / "broken.mat")
    head = b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "new.mat").write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(CaptureNotRecognised, match=r"not supported: MATLAB 7\.3"):
        read_markers(tmp_path / "new.mat")


@pytest.mark.parametrize("packed", [False, True])
def test_values_are_those_that_scipy_wrote(packed: bool, tmp_path: Path) -> None:
    matlab = pytest.importorskip("scipy.io")
    cell = np.empty((1, 3), object)
    cell[0] = ["abc", np.arange(6, dtype=np.int16).reshape(2, 3), "ü"]
    array = np.array([(1, "x"), (2, "y")], [("a", object), ("b", object)])
    values = {
        "cell": cell, "cube": np.arange(24.0).reshape(2, 3, 4), "rows": np.array(["one", "three"]), "z": np.array(1j),
        "deep": {"inner": {"text": "t", "no": np.zeros((0, 3))}}, "array": array, "flag": np.array([True, False]),
    }  # fmt: skip
    matlab.savemat(tmp_path / "a.mat", values, do_compression=packed)
    found = read_mat(tmp_path / "a.mat")
    assert found["cell"][0] == "abc" and found["cell"][2] == "ü" and found["cell"][1].dtype == np.int16
    np.testing.assert_array_equal(found["cell"][1], cell[0, 1])
    np.testing.assert_array_equal(found["cube"], values["cube"])
    assert found["rows"] == ["one", "three"] and found["z"] == 0 and found["flag"].ravel().tolist() == [1, 0]
    assert found["deep"]["inner"]["text"] == "t" and found["deep"]["inner"]["no"].shape == (0, 3)
    assert [item["b"] for item in found["array"]] == ["x", "y"]


def test_a_variable_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    deflate, zeros = zlib.compressobj(1), bytes(2**20)
    packed = b"".join(deflate.compress(zeros) for _ in range(300)) + deflate.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "a.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(FileDamaged, match="far larger than a file of this size"):
        read_markers(tmp_path / "a.mat")


def test_damaged_files_are_named(tmp_path: Path) -> None:
    sound = write(tmp_path / "walk.mat").read_bytes()
    rng, named = np.random.default_rng(0), 0
    for _ in range(200):
        data = bytearray(sound)
        for _ in range(int(rng.integers(1, 4))):
            data[int(rng.integers(128, len(data)))] = int(rng.choice([0, 1, 3, 14, 255, rng.integers(256)]))
        (tmp_path / "walk.mat").write_bytes(data[: rng.integers(128, len(data))] if rng.random() < 0.2 else data)
        try:
            read_markers(tmp_path / "walk.mat")
        except MocapError:
            named += 1
    assert 50 < named < 200
