"""Compare filled gaps with Momentum (Meta, MIT) on our skeleton: hidden markers of real takes of other laboratories.

``python -m tests.benchmarks.marker_takes.momentum --python PYTHON`` needs a Python 3.12 in which ``pip install
pymomentum-core`` was run. 15 % of the samples are hidden as in ``held_out``. Momentum gets the known markers in
centimetres and calibrates proportions and marker positions with its default settings. A marker's position is the mean
of its visible positions in its bone's frame, so Momentum profits from every visible sample. Its own characters and an
operator's settings are not tried. ``--seed`` draws other gaps.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from solver_backend.types import MarkerCloud

FRAMES, STRIDE = 400, 2  # Frames of each take, and every how many are used.
SCALED = {"scale_global": (0,), "scale_leg": (1, 2), "scale_arm": (13, 14), "scale_trunk": (3,)}
"""Parameters that scale the bones below these joints, so that proportions are calibrated."""


def main() -> None:
    """Print the mean distances of hidden markers in millimetres, for each take and as shares."""
    parser = argparse.ArgumentParser(prog="momentum", description=__doc__)
    parser.add_argument("--python", type=Path, required=True, help="Python 3.12 with pymomentum-core")
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--takes", type=int, metavar="N", help="only the first N takes")
    arguments = parser.parse_args()
    from tests.benchmarks.marker_takes.takes import part, takes_of_other_labs

    rows = []
    for number, take in enumerate(takes_of_other_labs()[: arguments.takes]):
        some = replace(part(take, slice(0, FRAMES, STRIDE)), fps=take.fps / STRIDE)
        rows.append(_row(some, arguments.seed, arguments.python))
        sys.stdout.write("  take {}: Momentum {:.1f} mm, rigid {:.1f} mm, ours {:.1f} mm\n".format(number, *rows[-1]))
        sys.stdout.flush()
    momentum, rigid, ours = np.array(rows).T
    share = ours / np.minimum(momentum, rigid)
    sys.stdout.write(f"  ours / Momentum {(ours / momentum).mean():.2f}, ours / rigid {(ours / rigid).mean():.2f}\n")
    sys.stdout.write(f"  ours / better of both {share.mean():.2f}, worst {share.max():.2f}, {len(share)} takes\n")


def _row(cloud: MarkerCloud, seed: int, python: Path) -> tuple[float, float, float]:
    from research.baselines.rigid_filling import fill_rigidly
    from solver_backend.body.body import load_body
    from solver_backend.body.marker_names import name_markers
    from solver_backend.body.markers import marker_landmarks
    from tests.benchmarks.marker_takes.held_out import hidden, solved_hidden

    hide = hidden(cloud, seed)
    shown = np.where(hide[..., None], np.nan, cloud.positions)
    motion, labels = solved_hidden(cloud, hide), list(cloud.names)
    body, names = load_body(), name_markers(cloud.names).known
    both = [label for label in motion.marker_labels or () if label in names and names[label][0] != "@"]
    landmarks = marker_landmarks(body, tuple(names[label] for label in both))
    bones = np.argmax(landmarks.weights, axis=1)
    offsets = landmarks.anchors.sum(axis=1) - body.joints_template[bones]
    columns = [labels.index(label) for label in both]
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.npz", Path(folder) / "found.npy"
        np.savez(
            given, rest=body.joints_template[:24], parents=np.array(body.parents[:24]), bones=bones, offsets=offsets,
            points=shown[:, columns], fps=cloud.fps,
        )  # fmt: skip
        subprocess.run([python, __file__, "worker", given, found], check=True, stdout=subprocess.DEVNULL)
        momentum = np.load(found)
    own = [(motion.marker_labels or ()).index(label) for label in both]
    judged, truth = hide[:, columns], cloud.positions[:, columns]
    fillings = momentum, fill_rigidly(shown)[:, columns], motion.cleaned_markers[:, own]
    off = np.array([1000 * np.linalg.norm(points - truth, axis=-1)[judged] for points in fillings])
    away = off[:, np.isfinite(off).all(axis=0)].mean(axis=1)  # a marker that is hidden throughout has no place
    return float(away[0]), float(away[1]), float(away[2])


def _worker(given: str, found: str) -> None:
    """Track the markers with Momentum and write their (F, M, 3) positions on the tracked bones in metres."""
    geometry, marker_tracking = map(import_module, ("pymomentum.geometry", "pymomentum.marker_tracking"))

    values = dict(np.load(given))
    rest, parents, bones = 100 * values["rest"], values["parents"], values["bones"]
    points, count = 100 * values["points"], len(values["rest"])
    still = np.array([0, 0, 0, 1], np.float32)
    offsets = [rest[j] - (rest[p] if p >= 0 else 0) for j, p in enumerate(parents)]
    joints = [geometry.Joint(f"joint{j}", int(p), still, offsets[j].astype(np.float32)) for j, p in enumerate(parents)]
    skeleton = geometry.Skeleton(joints)
    names = [f"root_{axis}" for axis in ("tx", "ty", "tz", "rx", "ry", "rz")]
    rows = [[k] for k in range(6)]
    for j in range(1, count):
        names += [f"joint{j}_{axis}" for axis in ("rx", "ry", "rz")]
        rows += [[7 * j + 3 + k] for k in range(3)]
    names += list(SCALED)
    rows += [[7 * j + 6 for j in joint] for joint in SCALED.values()]
    transform = np.zeros((7 * count, len(names)), np.float32)
    for column, row in enumerate(rows):
        transform[row, column] = 1.0
    parameters = geometry.ParameterTransform(names, skeleton, transform)
    locators = [
        geometry.Locator(f"m{m}", int(bone), (100 * offset).astype(np.float32))
        for m, (bone, offset) in enumerate(zip(bones, values["offsets"], strict=True))
    ]
    character = geometry.Character("body", skeleton, parameters, locators=locators)
    frames = [
        [geometry.Marker(f"m{m}", np.nan_to_num(point), bool(np.isnan(point).any())) for m, point in enumerate(frame)]
        for frame in points
    ]
    motion = marker_tracking.process_markers(
        character, np.zeros(0, np.float32), frames,
        marker_tracking.TrackingConfig(), marker_tracking.CalibrationConfig(),
    )  # fmt: skip
    motion = motion if len(motion) == len(points) else motion.T
    state = np.asarray(geometry.model_parameters_to_skeleton_state(character, np.ascontiguousarray(motion)))
    place, turn, scale = state[:, bones, :3], _matrices(state[:, bones, 3:7]), state[:, bones, 7:]
    local = np.einsum("fmji,fmj->fmi", turn, points - place) / scale
    steady = np.nanmean(local, axis=0)
    np.save(found, 0.01 * (place + scale * np.einsum("fmij,mj->fmi", turn, steady)))


def _matrices(q: np.ndarray) -> np.ndarray:
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["worker"]:
        _worker(*sys.argv[2:4])
    else:
        main()
