"""Verbs that read descriptions of shots, data sets of the studio, and what a batch is asked for and has recorded."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from blender_addon._exchange.progress import silent
from blender_addon.errors import SolverStopped
from blender_addon.headless.batch import takes
from blender_addon.headless.batch.request import BatchRequest
from blender_addon.headless.batch.run_batch import run_batch
from solver_backend.exchange.errors import MocapError
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.studio.data_set import make_data_set
from solver_backend.synthesis.studio.spec import spec_of
from tests.fuzz.driver import scratch_folder
from tests.fuzz.target import Target, Write
from tests.fuzz.verbs.running import in_a_copy, verb, verb_target
from tests.fuzz.verbs.views import FRAMES, write_solved
from tests.support.short_motion import short_motion

_JSON = {".json": "json"}
_SPEC: dict[str, Any] = {
    "version": 1, "camera_arrays": [{"preset": "azure_kinect_3", "scale": 0.1}], "frames": 4, "fps": 10,
    "film": [], "write": ["pose2sim", "c3d"], "seed": 9, "perturb": "detector",
}  # fmt: skip


def _spec(**values: object) -> Write:
    return lambda folder: (folder / "spec.json").write_text(json.dumps(_SPEC | values))


@cache
def _made() -> dict[str, bytes]:
    """Return the files of a small data set."""
    with scratch_folder() as folder:
        make_data_set(spec_of(_SPEC), folder / "set")
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _set(folder: Path) -> None:
    for name, content in _made().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def _solver(verb_name: str, given: list[str], *_: Any, **__: Any) -> dict[str, Any]:
    """Stand in for the solver's process: a capture that is read becomes a short motion."""
    if verb_name == "convert":
        try:
            write_capture(Path(given[2]), load_capture(given[0]), overwrite=True)
        except MocapError as error:
            raise SolverStopped(error.as_event(), 3) from error
        return {"event": "result"}
    job = json.loads(Path(given[1]).read_text(encoding="utf-8"))
    folder = Path(given[1]).parent
    write_motion(folder / job["out"], short_motion(FRAMES, 60.0), overwrite=True)
    (folder / job["report"]).write_text("<html></html>\n")
    figures = {"frames": 5, "reprojection_median_px": 2.5, "unsure_frames": 0, "unseen_frames": 0}
    return {"event": "result", "motion": job["out"], "diagnostics": [], **figures}


def _captures(folder: Path) -> None:
    write_solved(folder)
    (folder / "motion.npz").unlink()
    (folder / "captures").mkdir()
    (folder / "capture.npz").rename(folder / "captures" / "a.npz")
    (folder / "job.json").write_text(json.dumps({"version": 1, "fps": 30.0, "settings": {"window": 20}}))


def _resumed(folder: Path) -> None:
    """Write a batch that is done."""
    _captures(folder)
    _run(folder)


def _run(folder: Path) -> object:
    with mock.patch.object(takes, "run_solver", _solver):
        done = run_batch(BatchRequest(folder / "captures", folder / "out", folder / "job.json"), silent)
    broken = [take["error"] for take in done["takes"] if take.get("error", {}).get("code") == "take_failed"]
    if broken:
        raise AssertionError(str(broken[0]))
    return done


def _batch(folder: Path) -> object:
    with in_a_copy(folder) as copy:
        return _run(copy)


TARGETS: tuple[Target, ...] = (
    verb_target("studio, plan", (_spec(),), verb("dataset make ./spec.json --out ./out --plan"), _JSON),
    verb_target("dataset make", (_spec(),), verb("dataset make ./spec.json --out ./out"), _JSON),
    verb_target("dataset cameras", (_spec(),), verb("dataset cameras ./spec.json --out ./out.html"), _JSON),
    verb_target(
        "dataset benchmark", (_set,), verb("dataset benchmark ./set --methods triangulation"),
        {".json": "json", ".toml": "text", ".npz": "npz"},
    ),
    verb_target("batch", (_captures, _resumed), _batch, _JSON | {".npz": "npz"}),
)  # fmt: skip
