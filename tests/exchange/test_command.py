"""Streams of both command lines."""

import copy
import io
import os
import sys

import pytest

from solver_backend.cli.live_verb import Lines
from solver_backend.exchange.command import LenientStream


def test_a_stream_can_be_copied() -> None:
    stream = io.StringIO()
    copy.copy(LenientStream(stream)).write("text")
    assert stream.getvalue() == "text"


def test_lines_of_a_live_run_may_have_a_closed_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "__stdout__", None)
    with Lines(None) as lines:
        lines.write({"frame": 1})
        lines.require_whole()
        os.close(lines._file.handle)
