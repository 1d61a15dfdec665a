"""Verbs that read recordings of sensors and of wands, and boards."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from solver_backend.camera_calibration.boards.board import board_named, board_toml
from solver_backend.camera_calibration.formats.write import write_calibration
from tests.fuzz.odd_values import BOARDS
from tests.fuzz.target import Target, file
from tests.fuzz.verbs.running import verb, verb_target
from tests.support.recorded_markers import recorded
from tests.support.waved_wand import Waving, as_tables, sensors, waved

_FRAMES = 3
_KINDS = {".json": "json", ".csv": "table", ".toml": "text", ".bin": "binary"}
_WAVING = Waving(seconds=6.0, fps=15.0)


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
        "markers-from-sensors", (_recording,), verb("markers-from-sensors ./recording --out ./out.c3d"), _KINDS, 2,
    ),
    verb_target(
        "calibrate-wand", (_wand,), verb("calibrate-wand ./wand --lenses ./lenses.toml --out ./out.toml"),
        {".csv": "table", ".toml": "text"}, 4,
    ),
    verb_target(
        "board", (file("a.toml", board_toml(board_named("charuco:5x7:35mm"))),),
        verb("board ./a.toml --out ./out.svg"), {".toml": "text"}, 24, BOARDS,
    ),
)  # fmt: skip
