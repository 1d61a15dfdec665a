"""Weight files with random numbers, for what must hold whatever was learned."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.priors.weights import PriorWeights, write_weights

WIDTHS: dict[str, tuple[int, int]] = {"vposer": (64, 32), "rvposer": (64, 32), "svae": (33, 32), "lie_vae": (90, 90)}
"""Outputs of the encoder and inputs of the decoder."""
HIDDEN = (24, 20)


def write_random(path: Path, prior: str, **changed: Any) -> Path:
    """Write random weights of a variational autoencoder; ``changed`` replaces entries of the header."""
    rng = np.random.default_rng(0)
    outputs, inputs = WIDTHS[prior]
    arrays: dict[str, np.ndarray] = {"residual_sigma": np.full((21, 3), 0.1, np.float32)}
    for part, widths in (("encoder", (63, *HIDDEN, outputs)), ("decoder", (inputs, *HIDDEN, 126))):
        for i, (a, b) in enumerate(pairwise(widths)):
            arrays[f"{part}_w{i}"] = (rng.standard_normal((b, a)) / np.sqrt(a)).astype(np.float32)
            arrays[f"{part}_b{i}"] = (0.3 * rng.standard_normal(b)).astype(np.float32)
    header = {
        "encoder_hidden": HIDDEN, "decoder_hidden": HIDDEN, "activation": "leaky_relu",
        "activate_last": prior == "vposer",
    }  # fmt: skip
    write_weights(path, PriorWeights(changed.pop("written_as", prior), arrays, header | changed))
    return path
