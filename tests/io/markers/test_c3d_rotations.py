"""C3D files that hold rotations of segments and no points: their origins are joint centres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import NoDetections
from solver_backend.io.markers.c3d import read_c3d
from tests.support.marker_reading import taken
from tests.support.segment_bytes import file_of
from tests.support.words import words


def test_origins_are_joint_centres(tmp_path: Path) -> None:
    origins = np.random.default_rng(1).uniform(-300, 900, (6, 4, 3)) + [0, 0, 900]
    seen = np.ones((6, 4), dtype=bool)
    seen[2, 1] = False
    path = tmp_path / "theia.c3d"
    path.write_bytes(file_of(origins, seen))
    take = taken(read_c3d, path, up_axis="z")
    assert take.cloud.labels == ("pelvis", "left_thigh", "right_upper_arm") and take.cloud.fps == 85.0
    expected = np.where(seen[:, 1:, None], 0.001 * origins[:, 1:], np.nan)
    np.testing.assert_allclose(take.cloud.positions, expected, atol=1e-6)
    assert any("origins of 3 segments are used as joint centres" in note for note in words(take.notes))


def test_a_file_without_either_holds_no_markers(tmp_path: Path) -> None:
    path = tmp_path / "none.c3d"
    path.write_bytes(file_of(np.zeros((2, 4, 3)), np.ones((2, 4), dtype=bool), used=0))
    with pytest.raises(NoDetections, match="contains no markers"):
        taken(read_c3d, path)


@pytest.mark.shared
def test_theias_example_has_rigid_bones(shared_data: Path) -> None:
    take = taken(read_c3d, shared_data / "cases/markers/c3d_rotations/C3DRotationExample.c3d")
    labels = take.cloud.labels or ()
    assert take.cloud.positions.shape == (340, 20, 3)
    hip, knee = (take.cloud.positions[:, labels.index(name)] for name in ("left_thigh", "left_shank"))
    length = np.linalg.norm(hip - knee, axis=-1)
    assert 0.41 < np.nanmean(length) < 0.42 and np.nanstd(length) < 1e-4
