"""Stand-ins for Google's LiteRT, which is in an environment of its own: files of known content answer as models do."""

from __future__ import annotations

import hashlib
import sys
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pytest


@dataclass(frozen=True)
class FakeModel:
    """What a model takes and gives."""

    name: str
    takes: tuple[int, ...]
    answer: Callable[[np.ndarray], Sequence[np.ndarray]]
    """Returns the outputs for an input, each without the dimension of the batch."""
    gives: Sequence[tuple[int, ...]]


def install(monkeypatch: pytest.MonkeyPatch, models: dict[bytes, FakeModel]) -> None:
    """Let ``ai_edge_litert`` be there, and run these models by the content of their files."""

    class Interpreter:
        """As ``ai_edge_litert.interpreter.Interpreter`` answers."""

        def __init__(self, model_content: bytes, num_threads: int) -> None:
            self._model, self._ready = models[model_content], False
            self._found: Sequence[np.ndarray] = ()

        def allocate_tensors(self) -> None:
            self._ready = True

        def get_input_details(self) -> list[dict]:
            return [{"index": 7, "shape": np.array([1, *self._model.takes]), "dtype": np.float32}]

        def get_output_details(self) -> list[dict]:
            shapes = enumerate(self._model.gives)
            return [{"index": 100 + k, "name": f"out_{k}", "shape": np.array([1, *shape])} for k, shape in shapes]

        def set_tensor(self, index: int, value: np.ndarray) -> None:
            assert self._ready and index == 7 and value.dtype == np.float32 and value.shape == (1, *self._model.takes)
            self._given = value[0].copy()

        def invoke(self) -> None:
            self._found = self._model.answer(self._given)

        def get_tensor(self, index: int) -> np.ndarray:
            return np.asarray(self._found[index - 100], np.float32).reshape(1, *self._model.gives[index - 100])

    module = types.ModuleType("ai_edge_litert.interpreter")
    module.Interpreter = Interpreter  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "ai_edge_litert", types.ModuleType("ai_edge_litert"))
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", module)


def sha256(content: bytes) -> str:
    """Return the hash that workers know models by."""
    return hashlib.sha256(content).hexdigest()
