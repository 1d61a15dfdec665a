"""MATLAB files of QTM: read with SciPy, else refused by name."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, FileDamaged
from solver_backend.io.markers.read import read_markers

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


def test_what_is_none_of_qtm_is_named(tmp_path: Path) -> None:
    pytest.importorskip("scipy.io").savemat(tmp_path / "other.mat", {"x": np.eye(3)})
    with pytest.raises(CaptureNotRecognised, match="not one of Qualisys"):
        read_markers(tmp_path / "other.mat")
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0 MAT-file, and no more")
    with pytest.raises(FileDamaged, match="truncated"):
        read_markers(tmp_path / "broken.mat")
    head = b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM"
    (tmp_path / "new.mat").write_bytes(head.ljust(512, b"\0") + b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(CaptureNotRecognised, match=r"not supported: MATLAB 7\.3"):
        read_markers(tmp_path / "new.mat")


def test_without_scipy_the_way_out_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "walk.mat")
    monkeypatch.setitem(sys.modules, "scipy.io", None)
    with pytest.raises(BackendMissing) as found:
        read_markers(path)
    assert "SciPy" in str(found.value) and "TSV" in str(found.value.hint)
