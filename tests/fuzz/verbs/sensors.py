"""Verbs that read recordings of sensors and of wands, and boards."""

from __future__ import annotations

import multiprocessing
import os
import socket
import threading
from collections.abc import Callable
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar
from unittest import mock

from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.camera_calibration.formats import board_toml, write_calibration
from solver_backend.sensors import chain
from tests.fuzz.odd_values import BOARDS
from tests.fuzz.target import Target, file
from tests.fuzz.verbs.running import verb, verb_target
from tests.support.recorded_markers import recorded
from tests.support.waved_wand import Waving, as_tables, sensors, waved

_FRAMES = 3
_KINDS = {".json": "json", ".csv": "table", ".toml": "text", ".bin": "binary"}
_WAVING = Waving(seconds=6.0, fps=15.0)


class _ProcessHere:
    """A thread in the place of a sensor's process, which takes a second to begin."""

    broke: ClassVar[list[BaseException]] = []  # What ended one unnamed.

    def __init__(self, target: Callable[..., object], args: tuple[Any, Connection], daemon: bool) -> None:
        task, there = args
        out, kept = Connection(os.dup(there.fileno())), socket.socket(fileno=os.dup(there.fileno()))

        def run() -> None:
            try:
                target(task, out)
            except BaseException as error:
                self.broke.append(error)
            kept.shutdown(socket.SHUT_RDWR)  # as the end of a process does; a thread of it still listens
            kept.close()

        self._thread = threading.Thread(target=run, daemon=daemon)
        self.start, self.join, self.is_alive = self._thread.start, self._thread.join, self._thread.is_alive

    def terminate(self) -> None:
        """Wait no longer: a thread ends by itself when its pipe is closed, or sleeps until its frame is due."""
        self.join = lambda timeout=None: None


def _in_threads(line: str) -> Callable[[Path], object]:
    """Return what runs a verb whose sensors are threads."""
    here, run = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=_ProcessHere), verb(line)

    def run_in_threads(folder: Path) -> object:
        _ProcessHere.broke.clear()
        with mock.patch.object(chain.multiprocessing, "get_context", return_value=here):
            done = run(folder)
        if _ProcessHere.broke:
            raise _ProcessHere.broke[0]
        return done

    return run_in_threads


def _recording(folder: Path) -> None:
    recorded(folder / "recording", frames=_FRAMES)


@cache
def _tables() -> dict[str, str]:
    return as_tables(waved(sensors(), _WAVING))


def _wand(folder: Path) -> None:
    (folder / "wand").mkdir()
    write_calibration(folder / "lenses.toml", sensors())
    for name, text in _tables().items():
        (folder / "wand" / name).write_text(text)


TARGETS: tuple[Target, ...] = (
    verb_target(
        "sensors markers", (_recording,), verb("sensors markers ./recording --out ./out.c3d"), _KINDS,
    ),
    verb_target(
        "sensors copy", (_recording,), _in_threads("sensors copy ./recording --out ./out"), _KINDS,
    ),
    verb_target(
        "sensors live", (_recording,),
        _in_threads("sensors live ./recording --poses --seconds 0.2 --lines ./out.jsonl --record ./out"), _KINDS,
    ),
    verb_target(
        "sensors calibrate", (_wand,), verb("sensors calibrate ./wand --lenses ./lenses.toml --out ./out.toml"),
        {".csv": "table", ".toml": "text"},
    ),
    verb_target(
        "board", (file("a.toml", board_toml(board_named("charuco:5x7:35mm"))),),
        verb("cameras board ./a.toml --out ./out.svg"), {".toml": "text"}, BOARDS,
    ),
)  # fmt: skip
