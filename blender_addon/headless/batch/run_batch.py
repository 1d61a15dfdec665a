"""Every capture of a folder, take by take, and the summary.

A take that fails does not stop the others. What was done is recorded beside each take, so that a batch that is started
again does only what is missing or whose inputs, settings or version have changed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..._exchange.outputs import atomic_outputs
from ..._exchange.progress import Progress
from .request import BatchRequest, find_captures
from .run_take import run_take
from .summary import table, worst_first

SUMMARY = "summary"


def run_batch(request: BatchRequest, progress: Progress) -> dict[str, Any]:
    """Do all takes and write ``summary.json`` and ``summary.txt``.

    Returns:
        The ``result`` event: the takes, worst first, the table, the outputs and the exit code.

    Raises:
        BatchInvalid: there are no captures, or the job file is not one for batches.
        OutputNotWritable: the folder of the results cannot be written to.
        Cancelled: the work was interrupted; finished takes are kept.
    """
    request.limits.require_possible()
    choices = request.choices()
    captures = find_captures(request)
    takes = []
    for number, capture in enumerate(captures):
        progress("takes", number, len(captures))
        takes.append(run_take(request, choices, capture, progress))
        _write_summary(request.out, takes)
    progress("takes", len(captures), len(captures))
    ordered = worst_first(takes)
    outputs = [str(request.out / f"{SUMMARY}{suffix}") for suffix in (".json", ".txt")]
    codes = [take["error"]["exit_code"] for take in takes if take.get("error")]
    return {
        "event": "result", "takes": ordered, "table": table(ordered), "outputs": outputs, "notes": [],
        "exit_code": max(codes, default=0),
    }  # fmt: skip


def _write_summary(out: Path, takes: list[dict[str, Any]]) -> None:
    ordered = worst_first(takes)
    texts = {
        f"{SUMMARY}.json": json.dumps(ordered, indent=1, ensure_ascii=False),
        f"{SUMMARY}.txt": table(ordered) + "\n",
    }
    with atomic_outputs(out, tuple(texts), overwrite=True) as temporary:
        for name, text in texts.items():
            temporary[name].write_text(text, encoding="utf-8")
