"""Every capture of a folder, and the summary.

A take that fails does not stop the others. What was done is recorded beside each take, so that a batch that is started
again does only what is missing or whose inputs, settings or version have changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ..._exchange.outputs import temporary_folder
from ..._exchange.progress import Progress
from ...errors import BatchInvalid
from ..result import CommandResult
from .dispatch import dispatch
from .engines.base import Engine
from .engines.here import HereEngine, ProcessesEngine
from .record import TakeRecord
from .request import BatchRequest, Spread, find_captures
from .results import Results
from .source import Listed, Watched
from .summary import table
from .takes import Takes
from .work import Work


class BatchResult(CommandResult):
    """Of ``batch``."""

    takes: list[TakeRecord]
    """Worst first."""


def run_batch(request: BatchRequest, progress: Progress, spread: Spread = Spread()) -> BatchResult:
    """Do all takes and write ``summary.json``, ``summary.txt`` and ``summary.html``.

    Args:
        request: what to do.
        progress: receives how many takes are done and how far each is.
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
    work = Takes(request, request.choices())
    if spread.watch and not request.captures.is_dir():
        raise BatchInvalid("There is no such folder.", where=str(request.captures), hint="Make it first.")
    source = Watched(request, spread.settled_s, spread.idle_s) if spread.watch else Listed(find_captures(request))
    results = Results(request.out)
    try:
        with engine_for(work, progress, spread) as engine:
            with results.made_by(engine):
                dispatch(work, source, engine, progress, results.add)
            notes = engine.notes() + source.notes()
    finally:
        results.write()
    ordered = results.ordered()
    codes = [take["error"]["exit_code"] for take in ordered if "error" in take]
    return {
        "event": "result", "takes": ordered, "table": table(ordered), "outputs": results.outputs, "notes": notes,
        "exit_code": max(codes, default=0),
    }  # fmt: skip


@contextmanager
def engine_for(work: Work, progress: Progress, spread: Spread) -> Iterator[Engine]:
    """Yield who does the takes, and end them afterwards, however the batch ends."""
    if spread.scheduler:
        from .engines.cluster import ClusterEngine

        address, patience_s = spread.scheduler, spread.patience_s
        engine: Engine = ClusterEngine(work, address, patience_s=patience_s, stretches=spread.stretches)
    elif spread.workers and _has_dask():
        with _local(work, spread) as engine:
            yield engine
        return
    elif spread.workers:
        engine = ProcessesEngine(work, spread.workers)
    else:
        engine = HereEngine(work, progress)
    try:
        yield engine
    finally:
        engine.close()


@contextmanager
def _local(work: Work, spread: Spread) -> Iterator[Engine]:
    """Yield a cluster of this machine."""
    from .engines.cluster import ClusterEngine
    from .engines.local_cluster import LocalCluster, machine_memory_mb

    with temporary_folder() as folder:
        cluster = LocalCluster(spread.workers, machine_memory_mb(), folder)
        try:
            engine = ClusterEngine(work, cluster.address, cluster.tend, spread.patience_s, spread.stretches)
            try:
                yield engine
            finally:
                engine.close()
        finally:
            cluster.close()


def _has_dask() -> bool:
    from importlib.util import find_spec

    return find_spec("distributed") is not None
