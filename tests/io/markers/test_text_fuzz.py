"""Whatever the text of a table of markers, it is read or refused by a named error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import MocapError
from solver_backend.io.markers.read import read_markers
from tests.support.marker_reading import stated
from tests.support.marker_texts import TEXTS

BYTES = [0, 9, 10, 13, 32, 34, 44, 45, 46, 48, 57, 58, 101, 110, 0xC3, 0xFF]
"""What separates cells, makes numbers, or breaks UTF-8."""


@pytest.mark.parametrize("name", TEXTS)
def test_changed_text(tmp_path: Path, name: str) -> None:
    rng, path = np.random.default_rng(4), tmp_path / name
    original = TEXTS[name].encode()
    read = 0
    for _ in range(400):
        data = bytearray(original)
        for _ in range(int(rng.integers(1, 5))):
            data[int(rng.integers(len(data)))] = int(rng.choice(BYTES))
        if rng.random() < 0.2:
            del data[int(rng.integers(len(data))) :]
        path.write_bytes(bytes(data))
        try:
            found = read_markers(path)
        except MocapError:
            continue
        read += 1
        assert found.cloud.positions.shape[0] == stated(found).frames
        assert not np.isinf(found.cloud.positions).any()
    assert read > 100
