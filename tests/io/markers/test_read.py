"""A file's format is recognised by its ending and by how it begins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, FileMissing, NoDetections
from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.markers.camera_systems import write_trc
from solver_backend.io.markers.read import MARKERS, read_markers
from solver_backend.types import MarkerCloud

TEXTS = {
    "a.csv": ("OptiTrack Motive CSV", "Format Version,1.23,Take Name,x\n"),
    "b.csv": ("Vicon Nexus CSV", "\n\nTrajectories\n100\n"),
    "c.txt": ("Vicon Nexus CSV", "Devices\n1000\n"),
    "d.txt": ("Qualisys TSV", "NO_OF_FRAMES\t3\n"),
    "e.tsv": ("Qualisys TSV", "NO_OF_FRAMES\t3\n"),
    "f.TRC": ("TRC", ""),
    "g.c3d": ("C3D", ""),
}


@pytest.mark.parametrize("name", TEXTS)
def test_one_reader_knows_each_file(tmp_path: Path, name: str) -> None:
    expected, text = TEXTS[name]
    (tmp_path / name).write_text(text)
    known = [reader.kind for reader in MARKERS if reader.recognises(tmp_path / name)]
    assert [kind.split(" (")[0] for kind in known] == [expected]
    with pytest.raises((FileDamaged, NoDetections)):
        read_markers(tmp_path / name)


def test_what_none_knows(tmp_path: Path) -> None:
    for name in ("a.csv", "b.bvh", "c", "d.tsv"):
        (tmp_path / name).write_bytes(b"\xff\x00 1,2,3\n")
        with pytest.raises(CaptureNotRecognised, match="not a readable marker recording") as caught:
            read_markers(tmp_path / name)
        assert all(reader.kind in caught.value.hint for reader in MARKERS)
    with pytest.raises(FileMissing):
        read_markers(tmp_path / "none.c3d")
    assert not any(reader.recognises(tmp_path / "none.c3d") for reader in MARKERS)


def test_options_reach_the_reader(tmp_path: Path) -> None:
    cloud = MarkerCloud(np.random.default_rng(1).uniform(0.1, 1.9, (3, 4, 3)), 100.0, ("A", "B", "C", "D"))
    for path in (write_c3d(tmp_path / "t.c3d", cloud), write_trc(tmp_path / "t.trc", cloud, up_axis="z")):
        found = read_markers(path, fps=50.0, up_axis="-z", unit="cm")
        assert found.cloud.fps == 50.0
        np.testing.assert_allclose(found.cloud.positions, cloud.positions * [10, -10, -10], rtol=1e-5)
