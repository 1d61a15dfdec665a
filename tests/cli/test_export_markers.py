"""The markers of a motion as C3D and TRC: what is written is read back, by us and by another reader."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.npz import write_npz
from solver_backend.io.markers.read import read_markers

FRAMES, LABELS = 30, ("Anna:LFHD", "Anna:RFHD", "Anna:C7")


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    solved = rng.uniform(-1, 2, (FRAMES, len(LABELS), 3)).astype(np.float32)
    return {
        "format": np.array("manifold_mocap_motion"), "version": np.array(1), "poses": np.zeros((FRAMES, 156)),
        "trans": np.zeros((FRAMES, 3)), "mocap_framerate": np.array(120.0), "markers": solved,
        "cleaned_markers": solved + 0.01, "marker_labels": np.array(LABELS),
    }  # fmt: skip


def written(tmp_path: Path, arrays: dict[str, np.ndarray]) -> Path:
    return write_npz(tmp_path / "motion ü.npz", arrays)


@pytest.mark.parametrize(("contents", "key"), [("solved", "markers"), ("cleaned", "cleaned_markers")])
@pytest.mark.parametrize("name", ["take.c3d", "take.TRC"])
def test_what_is_written_is_read_back(tmp_path, arrays, contents, key, name, capsys):
    motion, out = written(tmp_path, arrays), tmp_path / "new" / name
    assert main(["markers export", str(motion), "--out", str(out), "--contents", contents, "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (result["frames"], result["markers"], result["markers_file"]) == (FRAMES, 3, str(out))
    cloud = read_markers(out).cloud
    assert cloud.labels == LABELS and cloud.fps == 120.0
    assert np.abs(cloud.positions - arrays[key]).max() < 1e-6
    assert main(["markers export", str(motion), "--out", str(out), "--contents", contents]) == 3  # it is there
    assert main(["markers export", str(motion), "--out", str(out), "--contents", contents, "--overwrite"]) == 0


def test_another_program_reads_the_c3d(tmp_path, arrays):
    ezc3d = pytest.importorskip("ezc3d")
    assert main(["markers export", str(written(tmp_path, arrays)), "--out", str(tmp_path / "take.c3d")]) == 0
    read = ezc3d.c3d(str(tmp_path / "take.c3d"))
    assert read["parameters"]["POINT"]["LABELS"]["value"] == list(LABELS)
    points = np.moveaxis(read["data"]["points"][:3], 0, -1).swapaxes(0, 1)
    assert np.abs(points - 1000 * arrays["cleaned_markers"]).max() < 1e-3


@pytest.mark.parametrize(
    ("left_out", "name", "message", "code"),
    [
        ("cleaned_markers", "take.c3d", "contains no cleaned markers.*export the solved ones", 3),
        ("marker_labels", "take.c3d", "was not solved from markers", 3),
        ("poses", "take.c3d", "does not contain 'poses'", 3),
        ("mocap_framerate", "take.c3d", "does not contain 'mocap_framerate'", 3),
        ("", "take.fbx", r"must end in \.c3d.* or \.\w+\.", 2),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path, arrays, left_out, name, message, code, capsys):
    arrays.pop(left_out, None)
    out = tmp_path / name
    assert main(["markers export", str(written(tmp_path, arrays)), "--out", str(out), "--json"]) == code
    error = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert re.search(message, f"{error['message']} {error['hint']}")
    assert not out.exists()


def test_labels_that_do_not_fit_are_refused(tmp_path, arrays):
    arrays["cleaned_markers"] = arrays["cleaned_markers"][:, :2]
    assert main(["markers export", str(written(tmp_path, arrays)), "--out", str(tmp_path / "take.c3d")]) == 3


@pytest.mark.parametrize("rate", [0.0, -60.0, 1e-300, 1e300, np.nan, np.inf])
def test_a_rate_that_is_none_is_named(tmp_path, arrays, rate, capsys):
    arrays["mocap_framerate"] = np.array(rate)
    assert main(["markers export", str(written(tmp_path, arrays)), "--out", str(tmp_path / "take.c3d"), "--json"]) == 3
    assert "frame rate" in json.loads(capsys.readouterr().out.splitlines()[-1])["message"]


def test_poses_without_frames_are_named(tmp_path, arrays):
    arrays["poses"] = np.array(1.0)
    assert main(["markers export", str(written(tmp_path, arrays)), "--out", str(tmp_path / "take.c3d")]) == 3
