"""``batch``: solve every capture in a folder and write a summary.

A failure does not stop the other takes. A restarted batch processes only takes without a valid record: their inputs,
settings or version have changed, or they are new.
"""

from __future__ import annotations

import json
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..._exchange.cluster_address import use_certificates
from ..._exchange.outputs import atomic_outputs, temporary_folder
from ..._exchange.progress import Progress
from ...errors import BatchInvalid
from ..process import require_blender
from ..result import CommandResult
from .dispatch import dispatch
from .engines.base import Engine, HereEngine, ProcessesEngine
from .record import TakeRecord
from .request import BatchRequest, Listed, Spread, TakeLimits, Watched, find_captures
from .summary import summary_page, table, worst_first
from .takes import Takes
from .work import Work

SUMMARY = "summary"
_RARELY = 20.0
"""Writing the summary may take at most 1 / 20 of the time. Chosen by hand."""
_LEAST_S = 2.0  # Shortest time between two writes of the summary, in seconds. Chosen by hand.


class Results:
    """Collects a batch's records and writes its summary."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._takes: dict[str, TakeRecord] = {}
        self._next, self._start = 0.0, time.monotonic()
        self._done = 0
        self._engine: Engine | None = None
        self._who = ""

    @property
    def outputs(self) -> list[str]:
        """Paths of the summary's JSON, text and HTML files."""
        return [str(self._out / f"{SUMMARY}{suffix}") for suffix in (".json", ".txt", ".html")]

    @contextmanager
    def made_by(self, engine: Engine) -> Iterator[None]:
        """Within a ``with`` block, describe the engine in the summary. Afterwards, keep its last description."""
        self._engine = engine
        try:
            yield
        finally:
            self._who, self._engine = engine.headline(), None

    def add(self, record: TakeRecord, recalled: bool) -> None:
        """Store a take's record. Write the summary unless it was written recently."""
        self._takes[record["take"]] = record
        self._done += not recalled
        if time.monotonic() > self._next:
            self.write()

    def ordered(self) -> list[TakeRecord]:
        """Return the records of all takes, worst first."""
        return worst_first(list(self._takes.values()))

    def write(self) -> None:
        """Write the summary files, unless there are no takes yet."""
        if not self._takes:
            return
        begun, ordered = time.monotonic(), self.ordered()
        texts = {
            f"{SUMMARY}.json": json.dumps(ordered, indent=1, ensure_ascii=False),
            f"{SUMMARY}.txt": table(ordered) + "\n",
            f"{SUMMARY}.html": summary_page(ordered, self._out, self._message()),
        }
        with atomic_outputs(self._out, tuple(texts), overwrite=True) as temporary:
            for name, text in texts.items():
                temporary[name].write_text(text, encoding="utf-8")
        took = time.monotonic() - begun
        self._next = time.monotonic() + max(_LEAST_S, _RARELY * took)

    def _message(self) -> str:
        minutes = (time.monotonic() - self._start) / 60
        rate = f"{self._done} done in {minutes:.1f} min" if self._done else "there was nothing to do"
        who = self._who if self._engine is None else self._engine.headline()
        return f"{rate} by {who}" if who else rate


def run_batch_verb(args: Namespace, progress: Progress) -> CommandResult:
    """Run the batch described by a command line (see ``run_batch``)."""
    if args.tls is not None:
        use_certificates(args.tls)
    if args.bake or args.render or args.export:
        require_blender(here=not (args.workers or args.scheduler))
    if (args.captures is None) == (args.watch is None):
        hint = "Use `batch FOLDER`, or `--watch FOLDER`."
        raise BatchInvalid("A batch needs a folder of captures, or one to watch.", hint=hint)
    formats, marker_formats = (tuple(dict.fromkeys(given)) for given in (args.export, args.export_markers))
    chosen: dict[str, Any] = {
        name: getattr(args, name) for name in ("job", "bake", "render", "body", "python", "strict")
    }
    chosen |= {"formats": formats, "marker_formats": marker_formats, "accept": tuple(args.accept)}
    limits = TakeLimits(args.take_seconds, args.take_memory)
    request = BatchRequest(args.captures or args.watch, args.out, limits=limits, **chosen)
    watch = {"watch": args.watch is not None, "settled_s": args.settled, "idle_s": args.idle}
    spread = Spread(args.scheduler, args.workers, stretches=args.stretches, patience_s=args.patience, **watch)
    return run_batch(request, progress, spread)


def run_batch(request: BatchRequest, progress: Progress, spread: Spread = Spread()) -> CommandResult:
    """Process all takes and write ``summary.json``, ``summary.txt`` and ``summary.html``.

    Raises:
        BatchInvalid: there are no captures, or the job file is not valid for a batch.
        EngineMissing, SchedulerMissing, WorkersUnsuitable: no worker can process the takes.
    """
    request.limits.require_possible()
    work = Takes(request, request.choices())
    if spread.watch and not request.captures.is_dir():
        raise BatchInvalid("There is no such folder.", where=str(request.captures), hint="Create it first.")
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
    worst = max(codes, default=0)
    about = {"takes": ordered, "table": table(ordered), "exit_code": worst}
    return {"outputs": results.outputs, "notes": notes, **about}


@contextmanager
def engine_for(work: Work, progress: Progress, spread: Spread) -> Iterator[Engine]:
    """Yield the engine for the takes, and always close it afterwards."""
    with ExitStack() as stack:
        engine: Engine
        if spread.scheduler or (spread.workers and find_spec("distributed")):
            from .engines.cluster import ClusterEngine
            from .engines.local_cluster import LocalCluster, machine_memory_mb

            address, tend = spread.scheduler, None
            if not address:
                folder = stack.enter_context(temporary_folder())
                cluster = LocalCluster(spread.workers, machine_memory_mb(), folder)
                stack.callback(cluster.close)
                address, tend = cluster.address, cluster.tend
            engine = ClusterEngine(work, address, tend, spread.patience_s, spread.stretches)
        elif spread.workers:
            engine = ProcessesEngine(work, spread.workers)
        else:
            engine = HereEngine(work, progress)
        stack.callback(engine.close)
        yield engine
