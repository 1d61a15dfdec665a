"""A file's format is told by its ending and by how it begins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged, FileMissing, NoDetections
from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.markers.read import FORMATS, format_of, read_markers
from solver_backend.io.markers.trc_writer import write_trc
from solver_backend.types import MarkerCloud

TEXTS = {
    "a.csv": ("OptiTrack Motive CSV", "Format Version,1.23,Take Name,x\n"),
    "b.csv": ("Vicon Nexus CSV", "\n\nTrajectories\n100\n"),
    "c.txt": ("Vicon Nexus CSV", "Devices\n1000\n"),
    "d.txt": ("Qualisys TSV", "NO_OF_FRAMES\t3\n"),
    "e.tsv": ("Qualisys TSV", "anything"),
    "f.TRC": ("TRC", ""),
    "g.c3d": ("C3D", ""),
}


@pytest.mark.parametrize("name", TEXTS)
def test_formats(tmp_path: Path, name: str) -> None:
    expected, text = TEXTS[name]
    (tmp_path / name).write_text(text)
    found = format_of(tmp_path / name)
    assert found is not None
    assert found.name == expected
    with pytest.raises((FileDamaged, NoDetections)):
        read_markers(tmp_path / name)


def test_what_has_none(tmp_path: Path) -> None:
    for name in ("a.csv", "b.bvh", "c"):
        (tmp_path / name).write_bytes(b"\xff\x00 1,2,3\n")
        assert format_of(tmp_path / name) is None
        with pytest.raises(CaptureNotRecognised, match="Readable are C3D") as caught:
            read_markers(tmp_path / name)
        assert all(known.name in caught.value.hint for known in FORMATS)
    with pytest.raises(FileMissing):
        read_markers(tmp_path / "none.c3d")


def test_options_reach_the_reader(tmp_path: Path) -> None:
    cloud = MarkerCloud(np.random.default_rng(1).uniform(0.1, 1.9, (3, 4, 3)), 100.0, ("A", "B", "C", "D"))
    for path in (write_c3d(tmp_path / "t.c3d", cloud), write_trc(tmp_path / "t.trc", cloud, up_axis="z")):
        found = read_markers(path, fps=50.0, up_axis="-z", unit="cm")
        assert found.cloud.fps == 50.0
        np.testing.assert_allclose(found.cloud.positions, cloud.positions * [10, -10, -10], rtol=1e-5)
