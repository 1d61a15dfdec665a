"""A walker in front of a carried camera, simulated: recorded walks, a simulated detector, and a stored camera path.

Six held-out walks of subjects 03 and 49, hand-held and from a dolly. ``wa`` is WA-MPJPE-100: the mean distance of all
joints after the best similarity of every 100 frames (Shin et al. 2024, "WHAM"). ``root`` is the mean distance of the
pelvis after the best rigid motion of the whole take, as a share of the walked distance (Wang et al. 2024, "TRAM").
``true`` has the camera's true path in metres with up, ``file`` the same path in a world of unknown scale and up, placed
by the person. ``scale_error`` is of ``file``, RMS, with its stated deviation ``scale_sigma``. The stature is not given.
These walks also chose ``BIAS`` of ``path_fit``, so ``scale_sigma`` is not held out. The errors do not depend on it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import replace

import numpy as np

from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.camera_paths import FilmedPath
from solver_backend.io.recognition.path_fit import fit_path
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import read_take
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.carried_camera import Carried, film_carried
from tests.support.recordings import ABSENT, recordings_folder

WALKS = (
    ("03_03", 60, "hand-held"), ("03_03", 400, "dolly"), ("03_04", 60, "dolly"), ("03_04", 500, "hand-held"),
    ("03_02", 0, "hand-held"), ("49_01", 0, "hand-held"),
)  # fmt: skip
"""File under ``motion_cmu/asfamc``, first frame, and the way the camera is carried."""
FRAMES, SEGMENT = 150, 100
TURN, SCALE = exp_so3(np.array([0.4, 0.7, -0.3])), 0.37  # Rotation and scale of the file's world.


def run() -> list[Metric]:
    """Solve every walk with each path."""
    rows = defaultdict[str, list[float]](list)
    for number, (file, start, style) in enumerate(WALKS):
        path = recordings_folder() / "motion_cmu" / "asfamc" / f"{file}.npz"
        if not path.is_file():
            raise BenchmarkSkipped("The motions are not here.", hint=ABSENT)
        filmed = film_carried(read_take(path, FRAMES, start), style, number)
        placed, error, sigma = placed_by_person(filmed)
        rows["scale_error"].append(error)
        rows["scale_sigma"].append(sigma)
        for name, capture in (("true", filmed.capture), ("file", placed)):
            wa, root = figures_of(capture)
            rows[f"{name}_wa"].append(wa)
            rows[f"{name}_root"].append(root)
            sys.stdout.write(f"  {file} {style} {name}: wa {wa:.0f} mm, root {root:.1f} %, scale {error:.1f} %\n")
            sys.stdout.flush()
    units = {"wa": "mm", "root": "%"}
    means = [(key, float(np.mean(values))) for key, values in rows.items() if "scale" not in key]
    return [
        *(Metric(key, value, units[key.split("_")[1]], rel_tol=0.1) for key, value in means),
        Metric("scale_error", float(np.sqrt(np.mean(np.square(rows["scale_error"])))), "%", abs_tol=1.0),
        Metric("scale_sigma", float(np.mean(rows["scale_sigma"])), "%", abs_tol=1.0),
    ]


def placed_by_person(filmed: Carried) -> tuple[Capture, float, float]:
    """Return the capture with a path from a world of another scale and up, and its scale error and deviation in %."""
    cameras, keypoints = filmed.capture.cameras, filmed.capture.keypoints
    assert cameras is not None and keypoints is not None
    centre = -np.einsum("fba,fb->fa", filmed.R, filmed.t)
    path = FilmedPath(TURN @ filmed.R.swapaxes(-1, -2), SCALE * centre @ TURN.T, 0.0, None, "file")
    found, note = fit_path(replace(cameras, path=None), keypoints, path)
    R, t = found.poses(0, len(centre))
    places = -np.einsum("fba,fb->fa", R, t)
    lengths = [np.linalg.norm(way - way.mean(axis=0)) for way in (places, centre)]
    capture = replace(filmed.capture, cameras=found, floor_from_person=True)
    return capture, 100.0 * (lengths[0] / lengths[1] - 1.0), float(note.values["share"])  # type: ignore[arg-type]


def figures_of(capture: Capture) -> tuple[float, float]:
    """Return WA-MPJPE-100 in mm, and the root's error in percent of the walked distance."""
    found, truth = solve(capture).motion.joints, capture.truth["joints"]
    parts = [slice(start, start + SEGMENT) for start in range(0, max(1, len(found) - SEGMENT // 2), SEGMENT)]
    off = np.concatenate([_aligned(found[part], truth[part], with_scale=True).ravel() for part in parts])
    walked = float(np.linalg.norm(np.diff(truth[::5, 0], axis=0), axis=1).sum())
    return 1000.0 * float(off.mean()), 100.0 * float(_aligned(found[:, 0], truth[:, 0]).mean()) / walked


def _aligned(found: np.ndarray, truth: np.ndarray, *, with_scale: bool = False) -> np.ndarray:
    """Return distances after the best rigid motion or similarity."""
    a, b = found.reshape(-1, 3), truth.reshape(-1, 3)
    s, R, t = umeyama(a, b, with_scale=with_scale)
    return np.linalg.norm(s * a @ R.T + t - b, axis=-1)
