"""Whatever the bytes of a C3D file, it is read or refused by a named error, quickly and in little memory."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import MocapError
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.source import MarkerTake
from tests.support.c3d_bytes import DEC, INTEL, MIPS, C3dBytes
from tests.support.marker_reading import stated, taken

MUTATIONS = 1500
SLOWEST_S = 1.0


def originals() -> list[bytes]:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1000, 1000, (6, 4, 3)).round(1)
    files = []
    for processor in (INTEL, DEC, MIPS):
        for floating in (True, False):
            file = C3dBytes(points, ("A:LFHD", "A:LTOE", "*2", ""), processor, floating, channels=("F",), samples=2)
            file.more = {
                "TRIAL": {"ACTUAL_START_FIELD": file.ints(1, 0), "ACTUAL_END_FIELD": file.ints(6, 0)},
                "EVENT": {"USED": file.ints(1), "LABELS": file.text(["Foot"]), "TIMES": (4, (2, 1), file.real(0, 1))},
            }
            files.append(file.to_bytes())
    return files


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the file with bytes changed where its head is, with a piece cut out, or with its end cut off."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 8))):
        at = int(rng.integers(0, 24 if rng.random() < 0.4 else len(changed)))
        changed[at] = int(rng.choice([0, 1, 127, 128, 255, int(rng.integers(256))]))
    if rng.random() < 0.2:
        at = int(rng.integers(512, len(changed)))
        del changed[at : at + int(rng.integers(1, 600))]
    if rng.random() < 0.2:
        del changed[int(rng.integers(0, len(changed))) :]
    return bytes(changed)


def outcome(path: Path) -> MarkerTake | MocapError:
    """Return what came of reading; any other error than ours ends the test."""
    start = time.process_time()
    try:
        found: MarkerTake | MocapError = taken(read_c3d, path)
    except MocapError as error:
        found = error
    assert time.process_time() - start < SLOWEST_S
    return found


@pytest.mark.slow
def test_changed_bytes(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(11), tmp_path / "take.c3d"
    files = originals()
    read = 0
    for i in range(MUTATIONS):
        path.write_bytes(mutated(files[i % len(files)], rng))
        found = outcome(path)
        if isinstance(found, MocapError):
            assert found.message
            assert found.where
            continue
        read += 1
        assert found.cloud.positions.nbytes < 1e7
        assert found.cloud.positions.shape[0] == stated(found).frames
        assert not np.isinf(found.cloud.positions).any()
    assert MUTATIONS * 0.2 < read < MUTATIONS * 0.95


def test_noise_behind_a_good_beginning(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(12), tmp_path / "take.c3d"
    for i in range(300):
        noise = rng.integers(0, 256, 6000, dtype=np.uint8)
        noise[:2], noise[515] = (2, 0x50), (INTEL, DEC, MIPS)[i % 3]
        path.write_bytes(noise.tobytes())
        found = outcome(path)
        assert isinstance(found, MocapError) or found.cloud.positions.nbytes < 1e6
