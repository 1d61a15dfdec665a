"""A training run's figures: JSON lines for programs, and TensorBoard's event files where it is installed."""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import Any

from solver_backend.exchange.outputs import write_text

logger = logging.getLogger(__name__)


class EventLog:
    """Writes ``log.jsonl`` and event files into a folder."""

    def __init__(self, folder: Path, step: int) -> None:
        """Go on after ``step``: what a killed run wrote later is dropped, so that no step stands there twice."""
        self._path = folder / "log.jsonl"
        if self._path.is_file():
            lines = self._path.read_text(encoding="utf-8").splitlines(keepends=True)
            kept = [line for line in lines if line.endswith("\n") and json.loads(line)["step"] <= step]
            write_text(self._path, "".join(kept), overwrite=True)
        self._events = _summary_writer(folder, step)

    def figures(self, step: int, figures: dict[str, float]) -> None:
        """Append the figures of a validation."""
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"step": step, **figures}) + "\n")
        self.scalars(step, {f"validation/{name}": value for name, value in figures.items() if name != "loss"})

    def scalars(self, step: int, scalars: dict[str, float]) -> None:
        """Add points to TensorBoard's curves."""
        for name, value in scalars.items():
            if self._events is not None:
                self._events.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is still in memory."""
        if self._events is not None:
            self._events.close()


def _summary_writer(folder: Path, step: int) -> Any:
    """Return TensorBoard's writer, None where it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        logger.info("TensorBoard is not installed; the curves are in log.jsonl alone.")
        return None
    return SummaryWriter(str(folder / "events"), purge_step=step + 1)
