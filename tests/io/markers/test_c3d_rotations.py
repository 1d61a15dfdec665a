"""C3D files that hold rotations of segments and no points: their origins are joint centres."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import NoDetections
from solver_backend.io.markers.c3d import read_c3d
from tests.support.marker_reading import taken
from tests.support.words import words

SEGMENTS = ("worldbody_4X4", "pelvis_4X4", "l_thigh_4X4", "r_uarm_4X4")


def parameter(group: int, name: str, kind: int, dimensions: tuple[int, ...], data: bytes) -> bytes:
    body = struct.pack("<bB", kind, len(dimensions)) + bytes(dimensions) + data + b"\0"
    return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<h", 2 + len(body)) + body


def file_of(origins: np.ndarray, seen: np.ndarray, used: int = len(SEGMENTS)) -> bytes:
    """Return a file of (F, S, 3) origins in millimetres."""
    frames, width = len(origins), max(map(len, SEGMENTS))
    labels = "".join(name.ljust(width) for name in SEGMENTS).encode()
    records = b"".join([
        struct.pack("<bb", 5, -1) + b"POINT" + struct.pack("<hB", 3, 0),
        struct.pack("<bb", 8, -2) + b"ROTATION" + struct.pack("<hB", 3, 0),
        parameter(1, "USED", 2, (), struct.pack("<h", 0)),
        parameter(1, "UNITS", -1, (2,), b"mm"),
        parameter(1, "RATE", 4, (), struct.pack("<f", 85.0)),
        parameter(1, "FRAMES", 2, (), struct.pack("<h", frames)),
        parameter(2, "LABELS", -1, (width, len(SEGMENTS)), labels),
        parameter(2, "USED", 2, (), struct.pack("<h", used)),
        parameter(2, "RATE", 4, (), struct.pack("<f", 85.0)),
        parameter(2, "DATA_START", 2, (), struct.pack("<h", 4)),
    ])  # fmt: skip
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 0, 1, frames, 0, -1.0, 4, 0, 85.0)
    section = (b"\x01\x50\x02\x54" + records).ljust(1024, b"\0")
    matrices = np.tile(np.eye(4, dtype="<f4").T, (*origins.shape[:2], 1, 1))
    matrices[..., 3, :3] = origins
    words = np.concatenate([matrices.reshape(*origins.shape[:2], 16), np.where(seen, 0.0, -1.0)[..., None]], axis=-1)
    return header.ljust(512, b"\0") + section + words.astype("<f4").tobytes()


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
    with pytest.raises(NoDetections, match="holds no markers"):
        taken(read_c3d, path)


@pytest.mark.shared
def test_theias_example_has_rigid_bones(shared_data: Path) -> None:
    take = taken(read_c3d, shared_data / "cases/markers/c3d_rotations/C3DRotationExample.c3d")
    labels = take.cloud.labels or ()
    assert take.cloud.positions.shape == (340, 20, 3)
    hip, knee = (take.cloud.positions[:, labels.index(name)] for name in ("left_thigh", "left_shank"))
    length = np.linalg.norm(hip - knee, axis=-1)
    assert 0.41 < np.nanmean(length) < 0.42 and np.nanstd(length) < 1e-4
