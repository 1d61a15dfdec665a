"""A recording that grows is readable at any moment, wherever it is cut and whatever a byte of it becomes."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.io.load import load_capture
from solver_backend.io.markers.live_recording import (
    DEFAULT_RATE,
    MARK,
    LiveBlock,
    measure_recording,
    pack_block,
    rate_of,
    read_blocks,
    read_live_recording,
)
from tests.support.marker_reading import taken
from tests.support.words import codes

TO_METRES = 1e-3 * np.eye(3)[[0, 2, 1]] * [[1], [-1], [1]]
RNG = np.random.default_rng(5)
BLOCKS = [
    LiveBlock(
        k / 60.0, RNG.normal(1000.0, 300.0, (20 + k % 3, 3)).astype(np.float32), 60.0, TO_METRES if k > 4 else None
    )
    for k in range(12)
]
DATA = [pack_block(block) for block in BLOCKS]


def read(data: bytes) -> tuple[list[float], int]:
    """Return the times of the blocks that are read, and how many bytes are not."""
    found = list(read_blocks(io.BytesIO(data)))
    return [b.time for b in found if isinstance(b, LiveBlock)], sum(b for b in found if isinstance(b, int))


def test_blocks_come_back_as_they_were_written() -> None:
    for block, data in zip(BLOCKS, DATA, strict=True):
        [back] = read_blocks(io.BytesIO(data))
        assert isinstance(back, LiveBlock) and back.time == block.time and back.fps == 60.0
        assert np.array_equal(back.points, block.points)
        assert (back.to_metres is None) == (block.to_metres is None)
        if block.to_metres is not None:
            assert np.array_equal(back.to_metres, block.to_metres)


def test_wherever_it_is_cut_the_blocks_before_are_read() -> None:
    whole = b"".join(DATA)
    ends = np.cumsum([len(data) for data in DATA])
    for end in RNG.integers(0, len(whole), 200).tolist():
        times, damaged = read(whole[:end])
        blocks = int((ends <= end).sum())
        assert times == [block.time for block in BLOCKS[:blocks]]
        assert damaged == end - (ends[blocks - 1] if blocks else 0)


def test_a_changed_byte_costs_one_block() -> None:
    whole = b"".join(DATA)
    for at in RNG.integers(0, len(whole), 200).tolist():
        data = bytearray(whole)
        data[at] ^= int(RNG.integers(1, 256))
        times, damaged = read(bytes(data))
        assert len(times) == len(BLOCKS) - 1 and damaged in {len(block) for block in DATA}


def test_what_stands_between_blocks_is_passed_over() -> None:
    for rubbish in (b"\xff", MARK, MARK * 3, bytes(3000), MARK + bytes(90), RNG.bytes(70_000)):
        times, damaged = read(DATA[0] + rubbish + DATA[1] + rubbish)
        assert times == [0.0, 1 / 60.0] and damaged == 2 * len(rubbish)


def test_an_unfinished_recording_is_a_capture_that_says_where_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.recording"
    path.write_bytes(b"".join(DATA)[:-7])
    capture = load_capture(path)
    assert capture.markers is not None and capture.markers.positions.shape == (11, 22, 3) and capture.fps == 60.0
    expected = BLOCKS[7].points.astype(np.float64) @ TO_METRES.T
    assert np.allclose(capture.markers.positions[7, : len(expected)], expected, atol=1e-6)
    unfinished, damaged = capture.problems
    assert codes(capture.problems) == ("live_recording_incomplete", "live_recording_incomplete")
    assert "incomplete. It ends with frame 11, at 0.17 s" in sentence(unfinished)
    assert damaged.values["bytes"] == len(DATA[-1]) - 7 and f"{len(DATA[-1]) - 7} bytes" in sentence(damaged)


def test_recordings_without_frames_or_points_are_named(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.recording"
    for data, error in ((b"", FileDamaged), (MARK, FileDamaged), (b"text", FileDamaged)):
        path.write_bytes(data)
        with pytest.raises(error, match="no whole frame"):
            taken(read_live_recording, path)
    path.write_bytes(pack_block(LiveBlock(0.0, np.zeros((0, 3)))))
    with pytest.raises(NoDetections, match="has points"):
        taken(read_live_recording, path)


@pytest.mark.slow
def test_a_few_bytes_cannot_ask_for_much_memory(tmp_path: Path) -> None:
    path = tmp_path / "walk.c3d.recording"
    empty = pack_block(LiveBlock(0.0, np.zeros((0, 3))))
    with path.open("wb") as stream:
        stream.write(pack_block(LiveBlock(0.0, np.ones((400, 3)))))
        for _ in range(40):
            stream.write(empty * 10_000)
    with pytest.raises(FileDamaged, match="too large to read at once"):
        taken(read_live_recording, path)


@pytest.mark.parametrize(
    ("times", "fps", "rate"),
    [
        ([0, 0.01, 0.02, 0.05], None, 100.0), ([0, 0.01], 120.0, 120.0), ([], None, DEFAULT_RATE),
        ([0, 0, 0], None, DEFAULT_RATE), ([0, 1e-300], None, DEFAULT_RATE), ([0, 1e300], 1e300, DEFAULT_RATE),
        ([5, 4, 4.02, 4.04], None, 50.0),
    ],
)  # fmt: skip
def test_the_rate_is_a_possible_one(times: list[float], fps: float | None, rate: float) -> None:
    assert rate_of(np.array(times, float), fps) == pytest.approx(rate)


def test_the_extent_knows_the_last_world() -> None:
    extent = measure_recording(io.BytesIO(b"".join(DATA)))
    assert (extent.frames, extent.most, extent.damaged) == (12, 22, 0)
    assert extent.to_metres is not None and extent.last == BLOCKS[-1].time
