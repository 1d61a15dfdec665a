"""A row of the tables as its training left it: ``figures.json`` names the network, ``weights.npz`` has its numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.exchange.npz import read_npz
from training.landmarks.models import LandmarkModel
from training.landmarks.rows import Row


def read_trained(folder: Path) -> LandmarkModel:
    """Return the network in the folder that a training's ``--work`` named.

    Raises:
        FileMissing, FileDamaged: there is no trained row in the folder, or it cannot be read.
    """
    try:
        figures = json.loads((folder / "figures.json").read_text(encoding="utf-8"))
    except OSError as error:
        raise FileMissing(
            "There is no trained row of the landmark networks here.", where=str(folder),
            hint="Give the folder that train landmarks --work named; it holds figures.json and weights.npz.",
        ) from error  # fmt: skip
    except ValueError as error:
        raise FileDamaged("The figures of the training cannot be read.", where=str(folder / "figures.json")) from error
    return trained_model(figures, folder / "weights.npz")


def trained_model(figures: Mapping[str, Any], weights: Path) -> LandmarkModel:
    """Return the network of a row, ready to read clouds.

    Args:
        figures: what the training wrote.
        weights: of the same training.

    Raises:
        FileMissing, FileDamaged: the weights are not there, or are another network's.
    """
    known = {field.name for field in fields(Row)} - {"balance", "variety"}
    try:
        model = Row(**{name: value for name, value in figures["row"].items() if name in known}).model()
        arrays = {name: torch.as_tensor(array).float() for name, array in read_npz(weights).items()}
        lost, foreign = model.load_state_dict(arrays, strict=False)
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise FileDamaged("The weights are of another network than the figures.", where=str(weights)) from error
    if foreign or any(name in dict(model.named_parameters()) for name in lost):
        raise FileDamaged("The weights are of another network than the figures.", where=str(weights))
    return model.eval()
