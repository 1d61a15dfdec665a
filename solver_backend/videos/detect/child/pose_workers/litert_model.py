"""Google's models run by LiteRT: known files alone, each by its SHA-256."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .serve import Refused

LICENCE = "Apache-2.0"
"""Of all models that are known."""


class LiteRtModel:
    """One model: a tensor goes in, tensors come out."""

    def __init__(self, path: Path, known: Mapping[str, str], package: str, threads: int) -> None:
        """Load a model.

        Args:
            known: name of each model that may be run, by its SHA-256.
        """
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        if digest not in known:
            raise Refused(
                "detector_outputs_unknown",
                f"The SHA-256 of {path.name} is {digest}; it is not one of {', '.join(known.values())}.",
                f"Take it out of the npm package {package}.",
            )
        try:
            from ai_edge_litert.interpreter import (  # pyright: ignore[reportMissingImports] - of its own environment
                Interpreter,
            )
        except ImportError as error:
            raise Refused(
                "detector_missing",
                f"This Python has no ai-edge-litert: {error} ({sys.executable})",
                "pip install ai-edge-litert numpy in an environment of its own, and name its Python with --python.",
            ) from error
        self.name = known[digest]
        self._model = Interpreter(model_content=content, num_threads=threads)
        self._model.allocate_tensors()
        self._into = self._model.get_input_details()[0]["index"]
        outputs = self._model.get_output_details()
        self._out = [output["index"] for output in outputs]
        self._widths = [int(np.prod(output["shape"])) for output in outputs]

    def require_outputs(self, widths: Sequence[int]) -> None:
        """Check that the first outputs hold so many numbers.

        Raises:
            Refused: they do not.
        """
        if self._widths[: len(widths)] != list(widths):
            raise Refused(
                "detector_outputs_unknown",
                f"The outputs of {self.name} hold {self._widths} numbers; {list(widths)} are expected first.",
            )

    def run(self, picture: np.ndarray) -> list[np.ndarray]:
        """Return the outputs for a picture (h, w, 3) of the model's size and range, each of one dimension less."""
        self._model.set_tensor(self._into, np.ascontiguousarray(picture[None], np.float32))
        self._model.invoke()
        return [np.asarray(self._model.get_tensor(index))[0] for index in self._out]
