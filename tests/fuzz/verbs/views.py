"""Verbs that read views: captures, calibrations and jobs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet, PersonInViews
from tests.fuzz.capture_targets import small_trial
from tests.fuzz.target import Target, Write
from tests.fuzz.verbs.running import verb, verb_target
from tests.support.calibration_files import toml_text
from tests.support.short_motion import short_motion
from tests.support.short_solves import cut

FRAMES, _APART = 5, 8
_SETTINGS = {"iterations": 1, "learn_noise": False, "sync": "off"}
_NPZ, _TRIAL = {".npz": "npz"}, {".json": "json", ".toml": "text"}
_SOLVE = "solve --job ./job.json"


@cache
def short_views(views: int = 4) -> Capture:
    """Return some frames and views of the embedded capture."""
    whole = cut(demo_capture(), 40, 40 + FRAMES)
    cameras, keypoints = whole.require_multiview()
    chosen = list(range(views))
    kept = replace(keypoints, xy=keypoints.xy[chosen], confidence=keypoints.confidence[chosen])
    return replace(whole, cameras=cameras.subset(chosen), keypoints=kept, footage=whole.footage[:views])


def _write_long(folder: Path) -> None:
    """Write a capture in which somebody crosses the room, for what is found from many pictures."""
    whole = demo_capture()
    cameras, keypoints = whole.require_multiview()
    chosen = slice(0, 36 * _APART, _APART)
    kept = replace(
        keypoints, xy=keypoints.xy[:4, chosen], confidence=keypoints.confidence[:4, chosen], fps=keypoints.fps / _APART
    )
    write_capture(
        folder / "capture.npz",
        replace(whole, cameras=cameras.subset([0, 1, 2, 3]), keypoints=kept, footage=whole.footage[:4], truth={}),
    )


def write_views(folder: Path) -> None:
    """Write a short capture."""
    write_capture(folder / "capture.npz", short_views())


def write_solved(folder: Path) -> None:
    """Write a short capture and a motion of as many frames."""
    write_views(folder)
    write_motion(folder / "motion.npz", short_motion(FRAMES, short_views().fps))


def _job(settings: Mapping[str, Any] = {}, capture: Capture | None = None, **values: object) -> Write:
    """Return what writes a capture, a motion and the job of a solve."""

    def write(folder: Path) -> None:
        write_solved(folder)
        if capture is not None:
            write_capture(folder / "capture.npz", capture, overwrite=True)
        job = {"version": 1, "settings": _SETTINGS | dict(settings), "capture": "capture.npz", "out": "out.npz"}
        (folder / "job.json").write_text(json.dumps(job | values))

    return write


def _one_view(folder: Path) -> None:
    _job(capture=short_views(1), report="out.html")(folder)


def _two_people(folder: Path) -> None:
    views = short_views()
    keypoints = views.keypoints
    assert keypoints is not None
    people = (PersonInViews("left", keypoints), PersonInViews("right", replace(keypoints, xy=keypoints.xy + 9.0)))
    _job(capture=replace(views, people=people, person="left"), person="all")(folder)


_PIN = {"frame": 2, "global_orient": [1.57, 0.0, 0.0], "body_pose": [0.1] * 69, "transl": [0.0, 0.0, 0.9]}
_AGAIN = {"motion": "motion.npz", "first": 1, "last": 4, "pins": [_PIN]}


def _clicks(folder: Path) -> None:
    """Write points with known places as they were clicked in each camera's picture, its lenses, and a take."""
    cameras, _ = short_views().require_multiview()
    points = np.random.default_rng(0).uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 1.8], (9, 3))
    px = project(cameras, points[None])[:, 0]
    rows = [f"p{k},{name},{x:.2f},{y:.2f}" for c, name in enumerate(cameras.names) for k, (x, y) in enumerate(px[c])]
    rows += [f"p{k},world,{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(points)]
    (folder / "clicks.csv").write_text("\n".join(["point,camera,x,y,z", *rows]) + "\n")
    (folder / "rig.toml").write_text(toml_text(cameras))
    _write_long(folder)


def _write_moved(folder: Path) -> None:
    """Write the longer capture with a camera that has been touched."""
    _write_long(folder)
    capture = read_capture(folder / "capture.npz")
    cameras = capture.cameras
    assert cameras is not None
    turned = cameras.R.copy()
    turned[0] = exp_so3(np.array([0.0, 0.02, 0.0])) @ turned[0]
    write_capture(folder / "capture.npz", replace(capture, cameras=replace(cameras, R=turned)), overwrite=True)


_OTHER_METHODS = tuple(_job({"method": name, "window": 4}) for name in ("sliding", "frame", "noise-aware"))
_BOTH = {".npz": "npz", ".json": "json"}
_CLICKED = {".csv": "table", ".toml": "text", ".npz": "npz"}


TARGETS: tuple[Target, ...] = (
    verb_target("info", (write_views,), verb("info ./capture.npz --report ./out.html"), _NPZ),
    verb_target("info, trial", (small_trial(JointSet.COCO_17),), verb("info ./trial"), _TRIAL),
    verb_target("info, people", (_two_people,), verb("info ./capture.npz"), _NPZ),
    verb_target("convert", (small_trial(JointSet.COCO_17),), verb("convert ./trial --out ./out.npz"), _TRIAL),
    verb_target("solve", (_job(report="out.html"), _job(), _one_view), verb(_SOLVE), _BOTH),
    verb_target("solve, methods", _OTHER_METHODS, verb(_SOLVE), _BOTH),
    verb_target("solve, two people", (_two_people,), verb(_SOLVE), _BOTH),
    verb_target("solve, resolve", (_job(resolve=_AGAIN), _job(resolve=_AGAIN | {"pins": []})), verb(_SOLVE), _BOTH),
    verb_target("evaluate", (write_solved,), verb("evaluate ./capture.npz ./motion.npz"), _NPZ),
    verb_target("cameras noise", (write_views,), verb("cameras noise ./capture.npz --out ./out.json"), _NPZ),
    verb_target("cameras check", (_write_long,), verb("cameras check ./capture.npz"), _NPZ),
    verb_target("cameras fit", (write_views,), verb("cameras fit ./capture.npz --stature 1.8 --out ./a.toml"), _NPZ),
    verb_target("cameras refine", (_write_moved,), verb("cameras refine ./capture.npz --out ./out.npz"), _NPZ),
    verb_target(
        "cameras calibrate, person", (_write_long,),
        verb("cameras calibrate ./capture.npz --from person --stature 1.74 --out ./out.toml"), _NPZ,
    ),
    verb_target(
        "cameras calibrate, refine", (_write_long,),
        verb("cameras calibrate ./capture.npz --from refine --out ./out.toml"), _NPZ,
    ),
    verb_target(
        "cameras calibrate, points", (_clicks,),
        verb("cameras calibrate ./clicks.csv --from points --lenses ./rig.toml --out ./out.toml"), _CLICKED,
    ),
    verb_target(
        "cameras calibrate, together", (_clicks,),
        verb("cameras calibrate ./rig.toml --from together --take ./capture.npz --clicks ./clicks.csv --out ./a.toml"),
        _CLICKED,
    ),
    verb_target("motion fit", (write_solved,), verb("motion fit ./capture.npz ./motion.npz ./out.npz"), _NPZ),
)  # fmt: skip
