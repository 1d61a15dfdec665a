"""What a prior's recipe is given and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.progress import Progress
from training.data.corpus import Corpus
from training.engine.loop import TrainingSettings


@dataclass(frozen=True)
class TrainingJob:
    """One prior to train."""

    training: Corpus
    validation: Corpus
    settings: TrainingSettings
    out: Path
    """Folder of the weights and the model card."""
    work: Path
    """Folder of the checkpoint and the log."""
    command: str
    """The command that repeats the training."""
    data: dict[str, object]
    """Counts of clips and frames, for the model card."""
    progress: Progress
    hidden: int = 512
    """Width of SPoser's decoder layers."""
    far: Corpus | None = None
    """Motions unlike the corpus, to evaluate on; None where they are not there."""
    start: Path | None = None
    """Weights to start from (SPoser and the lifter)."""


@dataclass(frozen=True)
class Finished:
    """A trained prior."""

    weights: Path
    metrics: dict[str, float]
    absent: tuple[str, ...] = ()
    """Held-out subjects that the recordings lack: the figures are without them."""
