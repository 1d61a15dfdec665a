"""A folder that fills while a batch watches it."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from blender_addon._exchange.progress import silent
from blender_addon.headless.batch.request import BatchRequest, Spread, Watched
from blender_addon.headless.batch.run_batch import run_batch
from blender_addon.headless.main import main
from tests.support.stand_in_solver import write_stand_in


def test_what_arrives_is_solved_when_it_is_whole(tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    captures.mkdir()
    (captures / "first.npz").write_bytes(b"x")
    request = BatchRequest(captures, captures / "out", python=write_stand_in(tmp_path, 0.05))
    whole = threading.Event()

    def copy() -> None:
        path = captures / "slow.npz"
        for _ in range(6):
            with path.open("ab") as stream:
                stream.write(b"part")
            time.sleep(0.2)
        whole.set()

    copying = threading.Thread(target=copy)
    copying.start()
    result = run_batch(request, silent, Spread(watch=True, settled_s=0.8, idle_s=1.5))
    copying.join()
    assert whole.is_set() and [take["status"] for take in result["takes"]] == ["done", "done"]
    assert (request.out / "slow" / "slow_capture.npz").read_bytes() == b"part" * 6


def test_a_capture_that_changes_arrives_again_and_a_second_of_its_name_is_told_of(tmp_path: Path) -> None:
    captures = tmp_path / "captures"
    captures.mkdir()
    request = BatchRequest(captures, tmp_path / "out")
    source = Watched(request, settled_s=0.0, poll_s=0.0)
    assert source.arrived() == [] and not source.closed
    path = captures / "a.npz"
    path.write_bytes(b"1")
    assert source.arrived() == [path] and source.arrived() == []
    path.write_bytes(b"22")
    assert source.arrived() == [path]
    (captures / "a").mkdir()
    (captures / "a" / "frame.json").write_text("{}")
    assert source.arrived() == []
    assert source.notes() == ["a is skipped, because a.npz has the same name."]


@pytest.mark.parametrize("given", [[], ["captures", "--watch", "captures"]])
def test_a_batch_has_one_folder(given: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", *given, "--out", str(tmp_path / "out")]) == 2
    assert "or one to watch" in capfd.readouterr().err
    assert main(["batch", "--watch", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
