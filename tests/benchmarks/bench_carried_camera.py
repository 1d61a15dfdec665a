"""A walker in front of a carried camera, simulated: recorded walks, a simulated detector, and a stored camera path.

Six walks of subjects 08 and 49 over a level floor, hand-held and from a dolly. The lifter is not trained on them.
Constants of ``fit_path`` were chosen on other subjects. Constants of the solve were also chosen on walks of subject 08,
with other bodies and static cameras. ``wa`` is WA-MPJPE-100: the mean distance of all joints after the best similarity
of every 100 frames (Shin et al. 2024, "WHAM"). ``root`` is the mean distance of the pelvis after the best rigid motion
of the whole take, as a share of the walked distance (Wang et al. 2024, "TRAM"). ``true`` has the camera's true path in
metres with up, ``file`` the same path in a world of unknown scale and up, placed by the person, and ``estimated`` the
path that is estimated from simulated tracks of a room's points and placed by the person. ``path`` is the mean error of
the estimated positions after the best similarity, as a share of the camera's way, ``path_turn`` of its rotations after
the best one, and ``paths`` the share of walks with an estimate. ``false_paths`` counts paths of a camera that stands,
one that only turns, and one in front of a plain wall with 15 points. ``scale_error`` is of ``file``, RMS, with its
stated deviation ``scale_sigma``. The stature is not given. Planted feet of the walkers are flat, touch the floor and do
not slide (``grounded``).
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import replace

import numpy as np

from solver_backend.camera_calibration.extrinsics.camera_path import Tracks, estimate_path
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.camera_paths import ESTIMATED, FilmedPath
from solver_backend.io.recognition.path_fit import fit_path
from solver_backend.types import Cameras, Capture
from tests.benchmarks.metric import Metric
from tests.benchmarks.one_view_takes import short_take
from tests.support.carried_camera import Carried, film_carried
from tests.support.room_tracks import KEPT, room_tracks

WALKS = (
    ("mb2/08_01", "hand-held"), ("mb2/08_03", "dolly"), ("mb2/08_04", "dolly"), ("mb2/08_11", "hand-held"),
    ("asfamc/49_01", "hand-held"), ("asfamc/49_01", "dolly"),
)  # fmt: skip
"""File under ``motion_cmu``, and the way the camera is carried. Subject 03 walks over uneven ground."""
SEGMENT = 100
PLAIN = 15  # Tracks before a plain wall.
TURN, SCALE = exp_so3(np.array([0.4, 0.7, -0.3])), 0.37  # Of the file's world.


def run() -> list[Metric]:
    """Solve every walk with each path."""
    rows = defaultdict[str, list[float]](list)
    for number, (file, style) in enumerate(WALKS):
        filmed = film_carried(short_take(file, 0), style, number)
        placed, error, sigma = placed_by_person(filmed, of_file(filmed))
        rows["scale_error"].append(error)
        rows["scale_sigma"].append(sigma)
        takes = {"true": filmed.capture, "file": placed}
        found, figures = estimated(filmed, number)
        if found is not None:
            takes["estimated"] = placed_by_person(filmed, found)[0]
        for key, value in figures.items():
            rows[key].append(value)
        sys.stdout.write(f"  {file} {style} estimated: {figures}\n")
        rows["false_paths"].append(false_paths(filmed, number))
        for name, capture in takes.items():
            wa, root = figures_of(capture)
            rows[f"{name}_wa"].append(wa)
            rows[f"{name}_root"].append(root)
            sys.stdout.write(f"  {file} {style} {name}: wa {wa:.0f} mm, root {root:.1f} %, scale {error:.1f} %\n")
            sys.stdout.flush()
    units = {"wa": "mm", "root": "%"}
    means = {key: float(np.mean(values)) for key, values in rows.items() if "scale" not in key}
    return [
        Metric("paths", 100.0 * means.pop("paths"), "%", "higher"),
        Metric("path", means.pop("path"), "%", rel_tol=0.2),
        Metric("path_turn", means.pop("path_turn"), "°", rel_tol=0.2),
        Metric("false_paths", len(WALKS) * means.pop("false_paths"), "", abs_tol=0.0),
        *(Metric(key, value, units[key.split("_")[1]], rel_tol=0.1) for key, value in means.items()),
        Metric("scale_error", float(np.sqrt(np.mean(np.square(rows["scale_error"])))), "%", abs_tol=1.0),
        Metric("scale_sigma", float(np.mean(rows["scale_sigma"])), "%", abs_tol=1.0),
    ]


def of_file(filmed: Carried) -> FilmedPath:
    """Return the true path in a world of another scale and up."""
    places = SCALE * centres(filmed.R, filmed.t) @ TURN.T
    return FilmedPath(TURN @ filmed.R.swapaxes(-1, -2), places, 0.0, None, "file")


def estimated(filmed: Carried, seed: int) -> tuple[FilmedPath | None, dict[str, float]]:
    """Return the path that tracks of a room show, and its figures."""
    camera, tracks = tracked(filmed, (filmed.R, filmed.t), seed)
    found = estimate_path(camera, tracks)
    if found is None:
        return None, {"paths": 0.0}
    places, truth = centres(found.R, found.t), centres(filmed.R, filmed.t)
    U, _, Vt = np.linalg.svd(np.einsum("fba,fbc->ac", filmed.R, found.R))  # A straight way would leave a turn open.
    off = log_so3(filmed.R @ (U @ Vt) @ found.R.swapaxes(-1, -2))
    way = float(np.linalg.norm(np.diff(truth[::5], axis=0), axis=1).sum())
    figures = {
        "paths": 1.0,
        "path": 100.0 * float(_aligned(places, truth, with_scale=True).mean()) / way,
        "path_turn": float(np.degrees(np.linalg.norm(off, axis=1)).mean()),
    }
    return FilmedPath(found.R.swapaxes(-1, -2), places, 0.0, None, ESTIMATED), figures


def false_paths(filmed: Carried, seed: int) -> float:
    """Return the number of paths found for a camera that stands, one that turns, and one before a plain wall."""
    R, t = filmed.R, filmed.t
    still = np.tile(R[:1], (len(R), 1, 1)), np.tile(t[:1], (len(t), 1))
    turns = R, -np.einsum("fab,b->fa", R, centres(R, t)[0])
    found = [estimate_path(*tracked(filmed, poses, seed)) for poses in (still, turns)]
    found.append(estimate_path(*tracked(filmed, (R, t), seed, PLAIN)))
    return float(sum(path is not None for path in found))


def tracked(
    filmed: Carried, poses: tuple[np.ndarray, np.ndarray], seed: int, kept: int = KEPT
) -> tuple[Cameras, Tracks]:
    """Return the camera and tracks of the room around the person, for these poses of the camera."""
    cameras, keypoints = filmed.capture.cameras, filmed.capture.keypoints
    assert cameras is not None and keypoints is not None
    way = filmed.capture.truth["joints"][:, 0]
    return replace(cameras, path=None), Tracks.of(room_tracks(cameras, poses, keypoints, way, seed, kept))


def centres(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the places (F, 3) of a camera."""
    return -np.einsum("fba,fb->fa", R, t)


def placed_by_person(filmed: Carried, path: FilmedPath) -> tuple[Capture, float, float]:
    """Return the capture with a path from a world of another scale and up, and its scale's error and deviation, %."""
    cameras, keypoints = filmed.capture.cameras, filmed.capture.keypoints
    assert cameras is not None and keypoints is not None
    centre = centres(filmed.R, filmed.t)
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
