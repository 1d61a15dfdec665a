"""Verbs that read: what lies behind the readers, called as the command line calls it, on small files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from blender_addon._exchange.progress import silent as quiet
from solver_backend.cli.arguments import parse
from solver_backend.cli.main import function_of
from solver_backend.exchange.progress import silent
from solver_backend.io.markers.write import write_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.embedded.marker_demo import record_markers
from solver_backend.types import Capture, JointSet
from tests.fuzz.capture_targets import small_trial
from tests.fuzz.target import Target
from tests.support.short_motion import short_motion
from tests.support.short_solves import cut

_FRAMES = 6
_LIMIT_S = 20.0
_SETTINGS = {"window": 4, "iterations": 2}
_NPZ, _C3D = {".npz": "npz"}, {".c3d": "binary"}


def verb(*arguments: str) -> Callable[[Path], object]:
    """Return what runs a verb in a folder; words that name files of it begin with ``./``."""

    def run(folder: Path) -> object:
        words = [str(folder / word[2:]) if word.startswith("./") else word for word in arguments]
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            return function_of(words[0])(parse(words), silent)

    return run


@cache
def _capture() -> Capture:
    return cut(demo_capture(_FRAMES), 0, _FRAMES)


def _write_views(folder: Path) -> None:
    write_capture(folder / "capture.npz", _capture())
    values = {"version": 1, "settings": _SETTINGS, "capture": "capture.npz", "out": "out.npz", "report": "out.html"}
    (folder / "job.json").write_text(json.dumps({**values, "overwrite": True}))


def _write_solved(folder: Path) -> None:
    _write_views(folder)
    write_motion(folder / "motion.npz", short_motion(_FRAMES, 60.0))


def _write_again(folder: Path) -> None:
    _write_solved(folder)
    job = json.loads((folder / "job.json").read_text())
    job |= {"resolve": {"motion": "motion.npz", "first": 1, "last": 4, "pins": []}}
    del job["report"]
    (folder / "job.json").write_text(json.dumps(job))


def _write_take(folder: Path) -> None:
    cloud = record_markers().cloud
    write_markers(folder / "take.c3d", replace(cloud, positions=cloud.positions[:12], residual=None))


def _write_marked(folder: Path) -> None:
    marked = replace(
        short_motion(_FRAMES), markers=np.zeros((_FRAMES, 2, 3), np.float32), marker_labels=("A", "B"),
        marker_residual_mm=np.zeros((_FRAMES, 2), np.float32), cleaned_markers=None,
    )  # fmt: skip
    write_motion(folder / "motion.npz", marked)


def _bake(folder: Path) -> object:
    from blender_addon.headless.bake import BakeRequest, run_bake

    return run_bake(
        BakeRequest(folder / "motion.npz", folder / "baked", video=False, pictures=False, overwrite=True), quiet
    )


_BOTH = {".npz": "npz", ".json": "json"}
_TRIAL = {".json": "json", ".toml": "text"}
_INTO = ("--out", "./out.npz", "--overwrite")
TARGETS: tuple[Target, ...] = (
    Target("verb info", (small_trial(JointSet.COCO_17),), verb("info", "./trial", "--report", "./out.html",
           "--overwrite"), _TRIAL, 2, limit_s=_LIMIT_S),
    Target("verb people", (small_trial(JointSet.COCO_17),), verb("people", "./trial"), _TRIAL, 1, limit_s=_LIMIT_S),
    Target("verb convert", (small_trial(JointSet.COCO_17),), verb("convert", "./trial", *_INTO), _TRIAL, 1,
           limit_s=_LIMIT_S),
    Target("verb solve", (_write_views,), verb("solve", "--job", "./job.json"), _BOTH, 2, limit_s=_LIMIT_S),
    Target("verb solve, resolve", (_write_again,), verb("solve", "--job", "./job.json"), _BOTH, 2, limit_s=_LIMIT_S),
    Target("verb evaluate", (_write_solved,), verb("evaluate", "./capture.npz", "./motion.npz"), _NPZ, 2,
           limit_s=_LIMIT_S),
    Target("verb detector-noise", (_write_views,), verb("detector-noise", "./capture.npz", "--out", "./out.json",
           "--overwrite"), _NPZ, 1, (), limit_s=_LIMIT_S),
    Target("verb layout", (_write_take,), verb("layout", "./take.c3d", "--out", "./out.json", "--overwrite"), _C3D, 1,
           limit_s=_LIMIT_S),
    Target("verb label", (_write_take,), verb("label", "./take.c3d", "--out", "./out.c3d", "--overwrite"), _C3D, 1,
           limit_s=_LIMIT_S),
    Target("verb live", (_write_take,), verb("live", "./take.c3d", "--fast", "--record", "./out.c3d", "--lines",
           "./out.jsonl", "--overwrite"), _C3D, 1, limit_s=_LIMIT_S),
    Target("verb live, motion", (_write_solved,), verb("live", "./motion.npz", "--fast", "--lines", "./out.jsonl",
           "--overwrite"), _NPZ, 2, limit_s=_LIMIT_S),
    Target("verb export-markers", (_write_marked,), verb("export-markers", "./motion.npz", "--contents", "solved",
           "--out", "./out.c3d", "--overwrite"), _NPZ, 2, limit_s=_LIMIT_S),
    Target("verb interpolate", (_write_solved,), verb("interpolate", "./motion.npz", *_INTO[1:2], "--frames", "1", "4",
           "--count", "2", "--overwrite"), _NPZ, 1, limit_s=_LIMIT_S),
    *((Target("verb bake", (_write_solved,), _bake, _NPZ, 1, limit_s=_LIMIT_S),) if find_spec("bpy") else ()),
)  # fmt: skip
