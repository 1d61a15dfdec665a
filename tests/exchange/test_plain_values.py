"""JSON that every program reads: no bare NaN, no arrays."""

from __future__ import annotations

import io
import json

import numpy as np

from solver_backend.exchange.json_file import as_plain
from solver_backend.exchange.progress import JsonProgress


def test_an_event_holds_no_bare_nan() -> None:
    stream = io.StringIO()
    values = {"a": np.float64("nan"), "b": [float("inf"), np.arange(2)], "c": {"d": -np.inf, "e": None, "f": True}}
    JsonProgress(stream).event({"event": "result", **values})

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    assert json.loads(stream.getvalue(), parse_constant=refuse) == {
        "event": "result", "a": None, "b": [None, [0, 1]], "c": {"d": None, "e": None, "f": True},
    }  # fmt: skip


def test_what_json_has_no_type_for_is_text() -> None:
    assert as_plain({1: (np.int64(3), "x", object)}) == {"1": [3, "x", "<class 'object'>"]}
