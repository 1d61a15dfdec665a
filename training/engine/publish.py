"""From a trained network to the weight file that ships, measured as it ships, and its model card."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.priors.weights import PriorWeights, write_weights
from training.engine.model_card import Card, write_model_card
from training.engine.recipe import Finished, TrainingJob

Figures = dict[str, Any]
"""``metrics``, the figures of the card by name, and perhaps ``by_source``."""


def publish(
    job: TrainingJob, prior: str, arrays: dict[str, np.ndarray], header: dict[str, Any], settings: dict[str, Any],
    measure: Callable[[Path], Figures], card: Card,
) -> Finished:  # fmt: skip
    """Write ``<prior>.npz``, measure what it holds, and write ``<prior>.md`` beside it.

    Args:
        job: the order.
        prior: name of the prior.
        arrays: what the weight file holds.
        header: what loading needs to know besides the arrays.
        settings: what the training was asked for, for the card.
        measure: loads the file and returns its figures.
        card: what the card states besides.
    """
    path = job.out / f"{prior}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {**header, "command": job.command, "settings": settings, "data": job.data}
    write_weights(path, PriorWeights(prior, arrays, metadata))
    metadata |= measure(path)
    metadata["sha256"] = write_weights(path, PriorWeights(prior, arrays, metadata))
    write_model_card(path.with_suffix(".md"), card, metadata)
    return Finished(path, metadata["metrics"])
