"""The operations that are killed."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.kills.operation import Operation
from tests.kills.recordings import RECORDINGS
from tests.support.short_solves import cut

FRAMES = 8
SETTINGS = {"iterations": 1, "learn_noise": False}
_EARLIER = b"what the user had there before"


def write_solved(folder: Path) -> None:
    """Write the short capture that every operation begins from."""
    capture = cut(demo_capture(FRAMES), 0, FRAMES)
    write_capture(folder / "capture.npz", replace(capture, truth={}))


def _job(folder: Path, **paths: str) -> None:
    values = {"version": 1, "settings": SETTINGS, **paths}
    (folder / "job.json").write_text(json.dumps(values))


def _solve(folder: Path, solved: Path) -> None:
    shutil.copyfile(solved / "capture.npz", folder / "capture.npz")
    _job(folder, capture="capture.npz", out="take.npz", report="take.html")


def _solve_again(folder: Path, solved: Path) -> None:
    _solve(folder, solved)
    _job(folder, capture="capture.npz", out="take.npz", report="take.html", overwrite=True)  # type: ignore[arg-type]
    for name in ("take.npz", "take.html"):
        shutil.copyfile(solved / name, folder / name)


def _bake(folder: Path, solved: Path) -> None:
    for name in ("capture.npz", "take.npz"):
        shutil.copyfile(solved / name, folder / name)
    (folder / "out").mkdir()
    (folder / "out" / "keep.txt").write_bytes(_EARLIER)


def _batch(folder: Path, solved: Path) -> None:
    (folder / "captures").mkdir()
    for name in ("a", "b"):
        shutil.copyfile(solved / "capture.npz", folder / "captures" / f"{name}.npz")
    _job(folder)


def _watch(folder: Path, solved: Path) -> None:
    _batch(folder, solved)
    (folder / "captures").rename(folder / "arriving")


def _save(folder: Path, solved: Path) -> None:
    shutil.copytree(solved, folder / "elsewhere")
    (folder / "project").mkdir()
    (folder / "project" / "keep.txt").write_bytes(_EARLIER)


_OF_A_TAKE = ("{0}.npz", "{0}.html", "{0}.job.json", "{0}_capture.npz", "take.json")
_OF_A_BATCH = frozenset(
    {f"out/{take}/{name.format(take)}" for take in "ab" for name in _OF_A_TAKE}
    | {"out/summary.json", "out/summary.txt", "out/summary.html"}
)
_INTO_OUT = ("--out", "out", "--job", "job.json")
_BATCH_COMMAND = ("-m", "blender_addon", "batch")
OPERATIONS: tuple[Operation, ...] = (
    Operation(
        "solve", _solve, ("-m", "solver_backend", "solve", "--job", "job.json"), frozenset({"take.npz", "take.html"})
    ),
    Operation(
        "solve again",
        _solve_again,
        ("-m", "solver_backend", "solve", "--job", "job.json"),
        frozenset({"take.npz", "take.html"}),
    ),
    Operation(
        "batch",
        _batch,
        (*_BATCH_COMMAND, "captures", *_INTO_OUT),
        _OF_A_BATCH,
    ),
    Operation(
        "bake",
        _bake,
        ("-m", "blender_addon", "bake", "take.npz", "--capture", "capture.npz", "--out", "out", "--no-pictures"),
        frozenset({"out/take.blend"}),
    ),
    Operation(
        "cluster",
        _batch,
        (*_BATCH_COMMAND, "captures", *_INTO_OUT, "--workers", "2"),
        _OF_A_BATCH,
    ),
    Operation(
        "watch",
        _watch,
        (
            *_BATCH_COMMAND,
            "--watch",
            "arriving",
            *_INTO_OUT,
            "--settled",
            "0.5",
            "--idle",
            "1",
        ),
        _OF_A_BATCH,
    ),
    *RECORDINGS,
    Operation("save", _save, ("-m", "tests.kills.save_program"), frozenset({"project/scene.blend"})),
)


def solve_command(folder: Path) -> list[str]:
    """Return the command that solves the capture of a folder, for what begins from a motion."""
    _job(folder, capture="capture.npz", out="take.npz", report="take.html")
    return [sys.executable, "-m", "solver_backend", "solve", "--job", str(folder / "job.json")]
