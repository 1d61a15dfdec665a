"""Several takes at a time without Dask: the same takes, the same records, the same ends of bad ones."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from blender_addon._exchange.errors import Cancelled
from blender_addon._exchange.progress import silent
from blender_addon.headless.batch import run_batch as batches
from blender_addon.headless.batch.record import read_record
from blender_addon.headless.batch.request import BatchRequest, Spread
from blender_addon.headless.batch.run_batch import run_batch
from tests.support.stand_in_solver import write_stand_in


@pytest.fixture
def captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(batches, "find_spec", lambda name: None)
    folder = tmp_path / "captures"
    folder.mkdir()
    for name in ("a", "bad", "crash", "z"):
        (folder / f"{name}.npz").write_bytes(name.encode())
    return folder


@pytest.mark.slow
def test_the_same_batch_runs_in_processes(captures: Path, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    request = BatchRequest(captures, tmp_path / "out", python=write_stand_in(tmp_path))
    result = run_batch(request, lambda *one: told.append(one), Spread(workers=3))
    assert {take["take"]: take["status"] for take in result["takes"]} == {
        "a": "done", "bad": "failed", "crash": "set aside", "z": "done",
    }  # fmt: skip
    assert told[0] == ("takes", 0, 4) and told[-1] == ("takes", 4, 4)
    assert [attempt["how"] for attempt in (read_record(request.out / "crash") or {})["attempts"]] == ["solver_died"] * 2
    (captures / "crash.npz").write_bytes(b"another capture")
    again = run_batch(request, silent, Spread(workers=3))
    assert len((read_record(request.out / "crash") or {})["attempts"]) == 2, "a new capture is tried anew"
    assert {take["take"]: take["status"] for take in again["takes"]}["a"] == "skipped"


def test_cancelling_ends_the_solvers_and_keeps_what_is_done(captures: Path, tmp_path: Path) -> None:
    def cancelled(stage: str, done: int, total: int) -> None:
        if done:
            raise Cancelled("The batch was cancelled.")

    for name in ("b", "c", "d"):
        (captures / f"{name}.npz").write_bytes(b"x")
    (captures / "crash.npz").unlink()
    request = BatchRequest(captures, tmp_path / "out", python=write_stand_in(tmp_path, 1.0))
    start = time.monotonic()
    with pytest.raises(Cancelled):
        run_batch(request, cancelled, Spread(workers=1))
    assert time.monotonic() - start < 60
    kept = [path.parent.name for path in request.out.glob("*/take.json")]
    assert (read_record(request.out / "a") or {})["status"] == "done" and len(kept) <= 3
    result = run_batch(request, silent, Spread(workers=2))
    assert {take["take"] for take in result["takes"] if take["status"] == "skipped"} >= {"a"}
