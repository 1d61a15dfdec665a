"""Takes over real schedulers and workers, as processes on the loopback address; the solver alone is a stand-in."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("distributed")

from blender_addon._exchange.progress import silent
from blender_addon.errors import BatchTaken, EngineMissing, SchedulerMissing, WorkersUnsuitable
from blender_addon.headless.batch.engines.cluster_task import put_marker
from blender_addon.headless.batch.engines.local_cluster import LocalCluster
from blender_addon.headless.batch.record import read_record
from blender_addon.headless.batch.request import BatchRequest, Spread, TakeLimits
from blender_addon.headless.batch.run_batch import run_batch
from tests.support.stand_in_solver import write_stand_in
from tests.support.tended_cluster import Tended

ROOT = Path(__file__).resolve().parents[5]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tended]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "1")
        cluster = Tended(2, tmp_path_factory.mktemp("cluster"))
        yield cluster
        cluster.close()
    with warnings.catch_warnings():  # Dask leaves sockets of schedulers that have died to the collector
        warnings.simplefilter("ignore")
        gc.collect()


def batch(folder: Path, names: list[str], seconds: float = 0.2, **more: Any) -> BatchRequest:
    captures = folder / "captures"
    captures.mkdir()
    for name in names:
        (captures / f"{name}.npz").write_bytes(name.encode())
    return BatchRequest(captures, folder / "out", python=write_stand_in(folder, seconds), **more)


def states(result: dict[str, Any]) -> dict[str, str]:
    return {take["take"]: take["status"] for take in result["takes"]}


def times_done(request: BatchRequest, name: str) -> int:
    record = read_record(request.out / name) or {}
    return sum(attempt["how"] == "done" for attempt in record["attempts"])


def worker_of_its_own(cluster: LocalCluster, folder: Path, path: Path, *before: str, preload: Path | None = None):
    """Start one more worker, with a program of its own before it on its path."""
    command = [*before, sys.executable, "-m", "distributed.cli.dask_worker", cluster.address, "--nthreads", "1",
               "--no-nanny", "--no-dashboard", "--memory-limit", "0", "--local-directory", str(folder),
               "--host", "127.0.0.1", "--name", "odd", *(["--preload", str(preload)] if preload else [])]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(path), str(ROOT)))}
    return subprocess.Popen(command, env=environment, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def odd_worker(cluster: Tended, tmp_path: Path) -> Iterator[Any]:
    started = []

    def start(*before: str, path: Path = ROOT, preload: Path | None = None) -> None:
        from distributed import Client

        started.append(worker_of_its_own(cluster, tmp_path, path, *before, preload=preload))
        with Client(cluster.address, set_as_default=False) as client:
            end = time.monotonic() + 60
            while time.monotonic() < end:
                if any(info["name"] == "odd" for info in client.scheduler_info(n_workers=-1)["workers"].values()):
                    return
                time.sleep(0.1)
        raise AssertionError("the worker did not come")

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_every_take_is_done_once_though_workers_and_the_scheduler_die(cluster: Tended, tmp_path: Path) -> None:
    request = batch(tmp_path, [f"t{n:02}" for n in range(16)], 0.8)

    def kill() -> None:
        for number, done in ((1, 1), (2, 4), (0, 7)):  # two workers, then the scheduler
            while sum((read_record(path) or {}).get("status") == "done" for path in request.out.glob("t*")) < done:
                time.sleep(0.05)
            cluster.kill(number)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    result = run_batch(request, silent, Spread(cluster.address))
    killer.join()
    assert set(states(result).values()) == {"done"} and len(result["takes"]) == 16, result["table"]
    assert {times_done(request, take["take"]) for take in result["takes"]} == {1}
    page = (request.out / "summary.html").read_text(encoding="utf-8")
    assert "16 takes, worst first" in page and "done in" in page and " by 0 workers" not in page
    again = run_batch(request, silent, Spread(cluster.address))
    assert set(states(again).values()) == {"skipped"}
    assert not (request.out / ".batch").exists()


def test_takes_that_crash_are_set_aside_with_their_log_and_the_rest_goes_on(cluster: Tended, tmp_path: Path) -> None:
    request = batch(tmp_path, ["a", "bad", "crash", "poison", "z"])
    cluster.wait_for_workers(2)
    result = run_batch(request, silent, Spread(cluster.address))
    assert states(result) == {"bad": "failed", "crash": "set aside", "poison": "set aside", "a": "done", "z": "done"}
    errors = {take["take"]: take["error"]["code"] for take in result["takes"] if "error" in take}
    assert errors == {"bad": "too_few_views", "crash": "solver_died", "poison": "take_undoable"}
    tried = (read_record(request.out / "crash") or {})["attempts"]
    assert [attempt["how"] for attempt in tried] == ["solver_died"] * 3
    assert len({attempt["worker"] for attempt in tried}) > 1, "another worker has tried it"
    log = (request.out / "crash" / "take.log").read_text()
    assert "3. solve on tcp://" in log and "signal 11" in log
    assert "begun" in (request.out / "poison" / "take.log").read_text()
    again = run_batch(request, silent, Spread(cluster.address))
    assert states(again)["poison"] == "set aside" and again["exit_code"] == 4
    assert len((read_record(request.out / "crash") or {})["attempts"]) == 3, "it is not retried"


def test_a_worker_of_another_version_is_named_with_both_and_gets_nothing(
    cluster: Tended, tmp_path: Path, odd_worker: Any
) -> None:
    other = tmp_path / "other" / "blender_addon"
    other.mkdir(parents=True)
    for path in (ROOT / "blender_addon").iterdir():
        (other / path.name).symlink_to(path)
    exchange = other / "_exchange"
    exchange.unlink()
    shutil.copytree(ROOT / "solver_backend" / "exchange", exchange)
    (exchange / "version.py").write_text('VERSION = "7.8.9"\n', encoding="utf-8")
    odd_worker(path=other.parent)
    request = batch(tmp_path, ["a", "b", "c", "d"])
    result = run_batch(request, silent, Spread(cluster.address))
    assert set(states(result).values()) == {"done"}
    [note] = [note for note in result["notes"] if "gets no takes" in note]
    assert "Manifold MoCap 7.8.9, but this program has 0.1.0" in note


@pytest.mark.skipif(
    not shutil.which("unshare") or subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode != 0,
    reason="a worker with other folders needs a mount namespace",
)
def test_a_worker_without_the_shared_folder_gets_nothing(cluster: Tended, tmp_path: Path, odd_worker: Any) -> None:
    request = batch(tmp_path, ["a", "b", "c", "d"])
    request.out.mkdir()
    odd_worker("unshare", "--mount", "sh", "-c", f"mount -t tmpfs none '{request.out}' && exec \"$@\"", "sh")
    result = run_batch(request, silent, Spread(cluster.address))
    assert set(states(result).values()) == {"done"}
    assert any(f"it does not see the folder {request.out}" in note for note in result["notes"])


def test_what_a_worker_with_a_full_disk_cannot_write_others_do(
    cluster: Tended, tmp_path: Path, odd_worker: Any
) -> None:
    odd_worker("sh", "-c", 'ulimit -f 40; exec "$@"', "sh")  # its files end at 20 or 40 kB
    request = batch(tmp_path, [f"t{n}" for n in range(12)])
    result = run_batch(request, silent, Spread(cluster.address))
    assert set(states(result).values()) == {"done"}, result["table"]
    assert any("could not write" in note and "File too large" in note for note in result["notes"]), result["notes"]


def test_a_clock_that_differs_is_told(cluster: Tended, tmp_path: Path, odd_worker: Any) -> None:
    preload = tmp_path / "other_clock.py"
    preload.write_text(
        "import time, types\nfrom blender_addon.headless.batch.engines import cluster_task\n"
        "cluster_task.time = types.SimpleNamespace(time=lambda: time.time() + 7200, monotonic=time.monotonic)\n"
    )
    odd_worker(preload=preload)
    result = run_batch(batch(tmp_path, ["a", "b", "c"]), silent, Spread(cluster.address))
    assert set(states(result).values()) == {"done"}
    assert any("differs by +7200 s" in note for note in result["notes"])


def test_more_memory_than_a_worker_has_is_named_with_both(cluster: Tended, tmp_path: Path) -> None:
    request = batch(tmp_path, ["a"], limits=TakeLimits(memory_mb=5000.0))
    with pytest.raises(WorkersUnsuitable, match=r"No worker has the 5000 MB .* The largest has 1000 MB"):
        run_batch(request, silent, Spread(cluster.address))


def test_a_second_batch_in_the_same_folder_takes_it_over(cluster: Tended, tmp_path: Path) -> None:
    request = batch(tmp_path, ["a", "b", "c", "d", "e", "f", "g", "h"], 1.5)
    threading.Timer(2.0, put_marker, [request.out]).start()
    with pytest.raises(BatchTaken, match="Another batch"):
        run_batch(request, silent, Spread(cluster.address))


def test_a_scheduler_that_dies_for_good_is_named_and_what_is_done_stays(tmp_path: Path) -> None:
    from distributed import Client

    cluster, request = LocalCluster(1, None, tmp_path), batch(tmp_path, [f"t{n}" for n in range(6)], 0.5)

    def kill() -> None:
        while not any((read_record(path) or {}).get("status") == "done" for path in request.out.glob("t*")):
            time.sleep(0.05)
        scheduler = cluster.processes[0]
        assert scheduler is not None
        scheduler.kill()

    killer = threading.Thread(target=kill, daemon=True)
    try:
        with Client(cluster.address, set_as_default=False, timeout=60) as client:
            client.wait_for_workers(1, timeout=60)
        killer.start()
        with pytest.raises(SchedulerMissing):
            run_batch(request, silent, Spread(cluster.address, patience_s=10))
    finally:
        cluster.close()
    done = {path.name for path in request.out.glob("t*") if (read_record(path) or {}).get("status") == "done"}
    assert done
    found = states(run_batch(request, silent))
    assert {name for name, state in found.items() if state == "skipped"} >= done
    assert set(found.values()) <= {"done", "skipped"} and len(found) == 6


def test_slow_connections_that_never_finish_hold_up_no_take(cluster: Tended, tmp_path: Path) -> None:
    import socket
    from contextlib import ExitStack
    from urllib.parse import urlsplit

    from distributed import Client

    with Client(cluster.address, set_as_default=False, timeout=60) as client:
        addresses = [cluster.address, *client.scheduler_info(n_workers=-1)["workers"]]
    with ExitStack() as open_ones:
        for address in addresses:
            where = urlsplit(address)
            for _ in range(40):
                there = open_ones.enter_context(socket.create_connection((where.hostname, where.port), 10))
                there.sendall(b"\1")  # of the eight bytes that say how long a message is
        found = states(run_batch(batch(tmp_path, ["a", "b", "c"]), silent, Spread(cluster.address)))
    assert found == {"a": "done", "b": "done", "c": "done"}


def test_no_scheduler_is_named(tmp_path: Path) -> None:
    request = batch(tmp_path, ["a"])
    with pytest.raises(SchedulerMissing, match="No scheduler responds"):
        run_batch(request, silent, Spread("tcp://127.0.0.1:9", patience_s=1))
    assert not (tmp_path / "out").exists()


def test_a_scheduler_without_workers_is_named(tmp_path: Path) -> None:
    from distributed import Client

    cluster = LocalCluster(1, None, tmp_path)
    try:
        worker = cluster.processes[1]
        assert worker is not None
        worker.kill()
        with Client(cluster.address, set_as_default=False, timeout=60):
            pass
        with pytest.raises(WorkersUnsuitable, match="The scheduler has no workers"):
            run_batch(batch(tmp_path, ["a"]), silent, Spread(cluster.address, patience_s=3))
    finally:
        cluster.close()


def test_without_dask_a_scheduler_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(EngineMissing, match="Dask is not installed"):
        run_batch(batch(tmp_path, ["a"]), silent, Spread("tcp://127.0.0.1:9"))
