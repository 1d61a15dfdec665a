"""Every capture of a folder, and the summary.

A take that fails does not stop the others. What was done is recorded beside each take, so that a batch that is started
again does only what is missing or whose inputs, settings or version have changed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..._exchange.progress import Progress
from ...errors import BatchInvalid
from .dispatch import SET_ASIDE, dispatch
from .engines.base import Engine
from .engines.here import HereEngine, ProcessesEngine
from .request import BatchRequest, Spread, Work
from .results import Results
from .source import Folder, Watched
from .summary import table


def run_batch(request: BatchRequest, progress: Progress, spread: Spread = Spread()) -> dict[str, Any]:
    """Do all takes and write ``summary.json``, ``summary.txt`` and ``summary.html``.

    Args:
        request: what to do.
        progress: told how many takes are done and how far each is.
        spread: who does it.

    Returns:
        The ``result`` event: the takes, worst first, the table, the outputs and the exit code.

    Raises:
        BatchInvalid: there are no captures, or the job file is not one for batches.
        EngineMissing, SchedulerMissing, WorkersUnsuitable: nobody can do the takes.
        OutputNotWritable: the folder of the results cannot be written to.
        Cancelled: the work was interrupted; finished takes are kept.
    """
    request.limits.require_possible()
    choices = request.choices()
    if spread.watch and not request.captures.is_dir():
        raise BatchInvalid("There is no such folder.", where=str(request.captures), hint="Make it first.")
    source = Watched(request, choices, spread.settled_s, spread.idle_s) if spread.watch else Folder(request)
    results = Results(request.out)
    try:
        with engine_for(request, choices, progress, spread) as engine:
            with results.made_by(engine):
                dispatch(request, choices, source, engine, progress, results.add)
            notes = engine.notes()
    finally:
        results.write()
    if isinstance(source, Watched):
        notes += source.doubled.values()
    ordered = results.ordered()
    codes = [take["error"]["exit_code"] for take in ordered if take["status"] in ("failed", SET_ASIDE)]
    return {
        "event": "result", "takes": ordered, "table": table(ordered), "outputs": results.outputs, "notes": notes,
        "exit_code": max(codes, default=0),
    }  # fmt: skip


@contextmanager
def engine_for(request: Work, choices: dict[str, Any], progress: Progress, spread: Spread) -> Iterator[Engine]:
    """Yield who does the takes, and end them afterwards, however the batch ends."""
    if spread.scheduler:
        from .engines.cluster import ClusterEngine

        address, patience_s = spread.scheduler, spread.patience_s
        engine: Engine = ClusterEngine(request, choices, address, patience_s=patience_s, stretches=spread.stretches)
    elif spread.workers and _has_dask():
        with _local(request, choices, spread) as engine:
            yield engine
        return
    elif spread.workers:
        engine = ProcessesEngine(request, choices, spread.workers)
    else:
        engine = HereEngine(request, choices, progress)
    try:
        yield engine
    finally:
        engine.close()


@contextmanager
def _local(request: Work, choices: dict[str, Any], spread: Spread) -> Iterator[Engine]:
    """Yield a cluster of this machine."""
    from .engines.cluster import ClusterEngine
    from .engines.local_cluster import LocalCluster, machine_memory_mb

    with tempfile.TemporaryDirectory(prefix="manifold_mocap_", ignore_cleanup_errors=True) as folder:
        cluster = LocalCluster(spread.workers, machine_memory_mb(), Path(folder))
        try:
            engine = ClusterEngine(request, choices, cluster.address, cluster.tend, spread.patience_s, spread.stretches)
            try:
                yield engine
            finally:
                engine.close()
        finally:
            cluster.close()


def _has_dask() -> bool:
    from importlib.util import find_spec

    return find_spec("distributed") is not None
