"""Trace how a folder of views goes through the reader; ``python -m tests.support.walk FOLDER`` lists the stops."""

from __future__ import annotations

import sys
import tomllib
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from solver_backend.io.calibration.entry import Calibration
from solver_backend.io.captures.detection_folders import READER
from solver_backend.io.reader import ReadOptions
from solver_backend.types import Cameras, Capture, Detections, Keypoints2D

ROOT = Path(__file__).resolve().parents[2]
SOLVER = f"{ROOT / 'solver_backend'}/"
CARRIED = (Path, Detections, Calibration, Cameras, Keypoints2D, Capture)
"""Values of a folder. What the engine builds of them stays in its own layer."""


class Stop(NamedTuple):
    """A function that a value of the folder is passed to."""

    layer: int  # Place of its package in the order of imports, the lowest first.
    module: str
    name: str


def _layers() -> dict[str, int]:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    [order] = [contract["layers"] for contract in contracts if contract["id"] == "order"]
    return {part.strip(): n for n, layer in enumerate(reversed(order)) for part in layer.split("|")}


def _carries(value: Any) -> bool:
    """Return whether a value, or the first one in it, is of the folder."""
    if isinstance(value, dict):
        value = next(iter(value.values()), None)
    elif isinstance(value, list | tuple) and value:
        value = value[0]
    return isinstance(value, CARRIED)


def stops_of(folder: Path) -> list[Stop]:
    """Return the functions of the solver that values of a folder are passed to while it is read, by first visit."""
    layers, found = _layers(), dict[Stop, None]()

    def visit(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(SOLVER) and not code.co_name.startswith("<"):
            names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
            if any(_carries(frame.f_locals.get(name)) for name in names if name not in ("self", "cls")):
                module = code.co_filename.removeprefix(SOLVER).removesuffix(".py")
                found[Stop(layers.get(module.split("/")[0], 0), module, code.co_qualname)] = None

    before = sys.getprofile()
    sys.setprofile(visit)
    try:
        READER.read(folder, ReadOptions())
    finally:
        sys.setprofile(before)
    return list(found)


def climbs(stops: list[Stop]) -> int:
    """Return how often the walk returns to a higher layer."""
    return sum(after.layer > before.layer for before, after in pairwise(stops))


if __name__ == "__main__":
    walked = stops_of(Path(sys.argv[1]))
    sys.stdout.writelines(f"{'  ' * stop.layer}{stop.module}: {stop.name}\n" for stop in walked)
    sys.stdout.write(f"{len(walked)} stops, {climbs(walked)} climbs\n")
