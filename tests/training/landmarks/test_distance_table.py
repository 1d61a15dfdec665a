"""The table of distances tells what bodies are like."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.tracklets import load_distances
from training.landmarks.distance_table import write_distance_table
from training.landmarks.poses import PoseTable


def test_a_table_of_few_windows_is_near_the_one_that_ships(tmp_path):
    rng = np.random.default_rng(0)
    poses = (0.25 * rng.standard_normal((60, 22, 3))).astype(np.float16)
    path = write_distance_table(tmp_path / "marker_distances.npz", PoseTable({"training": poses}), windows=12)
    mine, ships = load_distances(path), load_distances()
    head = [MARKERS.index(name) for name in ("LFHD", "RFHD", "LBHD", "RBHD", "C7")]
    apart = np.abs(mine.mean - ships.mean)[np.ix_(head, head)]
    assert apart.max() < 0.03 and (mine.mean == mine.mean.T).all()
    stiff = mine.change[MARKERS.index("LFHD"), MARKERS.index("RFHD")]
    assert stiff < mine.change[MARKERS.index("LFIN"), MARKERS.index("LANK")] - 0.5
    assert (
        path.read_bytes()
        == write_distance_table(tmp_path / "again.npz", PoseTable({"training": poses}), windows=12).read_bytes()
    )
