"""Unfinished recordings of live poses with damaged rows, and clocks that are set while a recording runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.native.motion_file import read_motion
from solver_backend.live.recordings import PosesRecording


def recorded(folder: Path, times: np.ndarray, damaged: tuple[int, int, float] | None = None) -> Path:
    """Write an unfinished recording, with one damaged number (row, column, value) if given."""
    format_ = PosesRecording()
    head = format_.head()
    rows = [np.frombuffer(format_.encode(t, np.full((24, 3), 0.1), np.full(3, k)), "<f8") for k, t in enumerate(times)]
    table = np.stack(rows).copy()
    if damaged is not None:
        table[damaged[:2]] = damaged[2]
    (folder / "a.recording").write_bytes(head + table.tobytes())
    return folder / "a.recording"


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (2, np.inf), (9, 1e200), (9, np.nan)])
def test_a_damaged_row_costs_that_row(column: int, value: float, tmp_path: Path) -> None:
    recording = recorded(tmp_path, np.arange(31) / 30.0, (12, column, value))
    assert PosesRecording().finish(recording, tmp_path / "a.npz")
    motion = read_motion(tmp_path / "a.npz")
    assert len(motion.transl) == 31 and np.allclose(motion.transl[:, 0], np.arange(31), atol=1e-4)


def test_times_that_no_recording_has_are_named_and_the_file_stays(tmp_path: Path) -> None:
    recording = recorded(tmp_path, np.arange(31) / 30.0, (30, 0, 1e300))
    with pytest.raises(FileDamaged, match="times are damaged"):
        PosesRecording().finish(recording, tmp_path / "a.npz")
    assert recording.is_file() and not (tmp_path / "a.npz").exists()


@pytest.mark.parametrize("jump_s", [-3600.0, 3600.0, -0.5])
def test_a_clock_that_is_set_loses_no_more_than_it_was_set_back(jump_s: float, tmp_path: Path) -> None:
    times = np.arange(120) / 60.0
    times[60:] += jump_s
    assert PosesRecording().finish(recorded(tmp_path, times), tmp_path / "a.npz")
    motion = read_motion(tmp_path / "a.npz")
    assert 85 < len(motion.transl) < 200 and motion.transl[-1, 0] == pytest.approx(119)
