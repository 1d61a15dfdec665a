"""Check a body file: ``python -m assets_procedural.quality.figures`` exits with 1 if a figure exceeds its limit."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets_procedural.arrays import Array, half_edges
from assets_procedural.build import BODY_FILE, build_body
from assets_procedural.detail.fingers import STRAIGHTENED
from assets_procedural.layout import JOINT
from assets_procedural.mesh.meshing import euler_number
from assets_procedural.population.statistics import MEASURES, load_statistics, place_measures, place_tape
from assets_procedural.quality.contact_sheet import BENDS, EXTREMES, BakedBody, read_baked, rotations
from assets_procedural.skeleton.correctives import joint_masks, pose_features, rest_differences, sample_poses
from assets_procedural.skeleton.skinning import posed_joints, volume
from solver_backend.body.mesh import face_normals
from solver_backend.exchange.verb import flag, option, parse_script

_SHOULDER_LIMIT, _SEATED_LIMIT = 16.0, 7.0  # Largest change of volume at the shoulders, and of a seated body, in %.


@dataclass(frozen=True)
class Figure:
    """A measured value with its unit and its allowed range."""

    name: str
    value: float
    unit: str
    low: float = -np.inf
    high: float = np.inf

    @property
    def good(self) -> bool:
        """True if the value is in its allowed range."""
        return bool(self.low <= self.value <= self.high)

    def row(self) -> str:
        """Return the value, its limits and the verdict as a row of a Markdown table."""
        limits = f"{self.low:g} to {self.high:g}" if np.isfinite([self.low, self.high]).all() else ""
        limits = limits or (f"≤ {self.high:g}" if np.isfinite(self.high) else "")
        limits = limits or (f"≥ {self.low:g}" if np.isfinite(self.low) else "")
        return f"| {self.name} | {self.value:.4g} {self.unit} | {limits} | {'yes' if self.good else 'NO'} |"


def volume_l(vertices: Array, faces: Array) -> float:
    """Return the signed volume of a closed mesh in litres."""
    return 1e3 * volume(vertices, faces)


def figures(body: BakedBody, path: Path) -> Iterator[Figure]:
    """Yield every measured value of a body file."""
    yield from _mesh_figures(body)
    yield Figure("volume", volume_l(body.vertices, body.faces), "l", 60, 80)
    yield Figure("stature", float(np.ptp(body.vertices[:, 1])), "m", 1.68, 1.72)
    yield Figure("influences per vertex", float(np.max(np.sum(body.weights > 0, axis=1))), "", 1, 6)
    yield from _shape_figures(body)
    yield from _bend_figures(body)
    yield from _local_bend_figures(body)
    yield from _seated_figures(body)
    yield from _twist_figures(body)
    yield from _corrective_figures(body)
    yield from _regressor_figures(body, path)
    yield Figure("file size", path.stat().st_size / 1e6, "MB", 0, 4)


def _mesh_figures(body: BakedBody) -> Iterator[Figure]:
    faces, vertices = body.faces, body.vertices
    directed = half_edges(faces)
    opposite = np.unique(directed[:, ::-1], axis=0)
    forward = np.unique(directed, axis=0)
    open_edges = len(directed) - len(forward) + int(len(opposite) != len(forward) or np.any(opposite != forward))
    corners, doubled = vertices[faces], np.linalg.norm(face_normals(vertices, faces), axis=1)
    squares = np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=(1, 2))
    reflected = np.array(sorted(map(tuple, np.round(vertices * [-1, 1, 1], 6) + 0.0)))
    original = np.array(sorted(map(tuple, np.round(vertices, 6) + 0.0)))
    yield Figure("vertices", len(vertices), "", 6500, 7500)
    yield Figure("triangles", len(faces), "")
    yield Figure("Euler number", euler_number(faces, len(vertices)), "", 2, 2)
    yield Figure("edges without two faces", open_edges, "", 0, 0)
    yield Figure("smallest triangle", float(doubled.min()) * 0.5e6, "mm²", 0.1)
    quality = 2 * np.sqrt(3) * doubled / squares
    yield Figure("worst triangle quality (1 = equilateral)", float(quality.min()), "", 0.05)
    yield Figure("mean triangle quality", float(quality.mean()), "", 0.9)
    yield Figure("asymmetry", float(np.abs(reflected - original).max()), "m", 0, 1e-6)


def _shape_figures(body: BakedBody) -> Iterator[Figure]:
    floor = np.array([0.0, body.vertices[:, 1].min(), 0.0])
    vertices, joints, statistics = body.vertices - floor, body.joints - floor, load_statistics()
    measures = place_measures(vertices, body.faces, joints, STRAIGHTENED)
    joint_dirs = np.tensordot(body.regressor, body.shapedirs, axes=1)

    def measured(betas: Array) -> Array:
        return measures(vertices + body.shapedirs @ betas, joints + joint_dirs @ betas)

    basis, outside, worst = np.eye(body.shapedirs.shape[2]), 0, -np.inf
    for betas in (*(-2.0 * basis), *(2.0 * basis)):
        values = measured(betas)
        beyond = np.maximum(statistics.p01 - values, values - statistics.p99)
        outside, worst = outside + int(np.sum(beyond > 0)), max(worst, float(beyond.max()))
    label = f"of {20 * len(MEASURES)} ANSUR measures at one beta = ±2, outside 1st-99th percentile"
    yield Figure(label, outside, "", 0, 0)
    yield Figure("nearest approach to those limits", -worst * 1e3, "mm", 0)
    stature = MEASURES.index("stature")
    trunk = [MEASURES.index(f"{n}circumference") for n in ("chest", "waist", "buttock")]
    change = [(measured(2 * basis[k]) - measured(-2 * basis[k])) / 4 for k in range(2)]
    yield Figure("beta 0: stature per unit", 1e3 * change[0][stature], "mm", 50, 120)
    yield Figure("beta 0: chest + waist + buttock girth per unit", 1e3 * float(change[0][trunk].sum()), "mm", -2, 2)
    yield Figure("beta 1: stature per unit", 1e3 * change[1][stature], "mm", -2, 2)
    yield Figure("beta 1: chest + waist + buttock girth per unit", 1e3 * float(change[1][trunk].sum()), "mm", 150, 350)
    for name in (f"{part}circumference" for part in ("neck", "waist", "chest", "buttock")):
        k = MEASURES.index(name)
        gap = measured(np.zeros(10))[k] - statistics.mean[k]
        yield Figure(f"neutral {name} against the population's mean", 1e3 * float(gap), "mm", -5, 5)


def _bend_figures(body: BakedBody) -> Iterator[Figure]:
    rest = volume_l(body.vertices, body.faces)
    for name, pose in BENDS.items():
        for angle in (90, 120):
            change = volume_l(body.posed(rotations(pose, angle)), body.faces) / rest - 1.0
            yield Figure(f"volume, both {name}s at {angle}°", 100 * change, "%", -3, 3)


def _seated_figures(body: BakedBody) -> Iterator[Figure]:
    pose, knee = rotations(EXTREMES["cross-legged"]), JOINT["left_knee"]
    apex = posed_joints(body.joints, pose)[knee]
    moved = body.faces[np.any(joint_masks(body.weights)[body.faces, knee - 1] > 0, axis=1)]
    rest, of_knee = volume_l(body.vertices, body.faces), volume(body.vertices - body.joints[knee], moved)
    for correctives, label in ((True, ""), (False, " without correctives")):
        posed, bound = body.posed(pose, correctives=correctives), 1.0 if correctives else np.inf
        knees = 100 * (volume(posed - apex, moved) / of_knee - 1.0)
        yield Figure(f"volume of the skin that the knee moves, cross-legged{label}", knees, "%", -5 * bound, 5 * bound)
        whole = 100 * (volume_l(posed, body.faces) / rest - 1.0)
        yield Figure(f"volume, cross-legged{label}", whole, "%", -_SEATED_LIMIT * bound, _SEATED_LIMIT * bound)


def _local_bend_figures(body: BakedBody) -> Iterator[Figure]:
    masks = joint_masks(body.weights)
    for name, pose in BENDS.items():
        joint, left = JOINT[f"left_{name}"], {f"left_{name}": pose[f"left_{name}"]}
        faces, apex = body.faces[np.any(masks[body.faces, joint - 1] > 0, axis=1)], body.joints[joint]
        rest = volume(body.vertices - apex, faces)
        for angle in (90, 120):
            change = volume(body.posed(rotations(left, angle)) - apex, faces) / rest - 1.0
            limit = _SHOULDER_LIMIT if name == "shoulder" else 5.0
            yield Figure(f"volume of the skin that the {name} moves, at {angle}°", 100 * change, "%", -limit, limit)


def _twist_figures(body: BakedBody) -> Iterator[Figure]:
    wrist = body.joints[JOINT["left_wrist"], 0]
    tapes = [place_tape(body.vertices, body.faces, (1, 0, 0), (wrist + d, 0, 0)) for d in np.linspace(-0.10, 0.03, 14)]
    twist = rotations({"left_wrist": (90, 0, 0)})
    for correctives, label, limit in ((True, "", 0.85), (False, " without correctives", -np.inf)):
        posed = body.posed(twist, correctives=correctives)
        ratio = min(_section_area(t.points(posed)) / _section_area(t.points(body.vertices)) for t in tapes)
        yield Figure(f"thinnest forearm section at 90° twist{label}, share of rest area", ratio, "", limit)


def _section_area(points: Array) -> float:
    y, z = points[:, 1], points[:, 2]
    return 0.5 * abs(float(y @ np.roll(z, -1) - z @ np.roll(y, -1)))


def _corrective_figures(body: BakedBody) -> Iterator[Figure]:
    local = sample_poses(60, seed=99)
    wanted = rest_differences(body.vertices, body.weights, body.joints, local).astype(np.float64)
    given = np.tensordot(pose_features(local), body.posedirs, axes=(1, 2))
    left = float(np.sum((wanted - given) ** 2) / np.sum(wanted**2))
    yield Figure("held-out share of (dual quaternion - linear) that the correctives give", 1 - left, "", 0.7)
    away = joint_masks(body.weights).max(axis=1) == 0
    largest = float(np.abs(body.posedirs[away]).max(initial=0.0))
    yield Figure("largest corrective where no joint acts", largest, "m", 0, 0)


def _regressor_figures(body: BakedBody, path: Path) -> Iterator[Figure]:
    with np.load(path, allow_pickle=False) as data:
        joints, directions = data["J"].astype(np.float64), data["J_shapedirs"].astype(np.float64)
    betas = np.random.default_rng(0).normal(size=(1000, directions.shape[2]))
    by_skin = np.tensordot(body.regressor, body.shapedirs, axes=1) - directions
    gap = (body.joints - joints)[None] + np.einsum("jak,nk->nja", by_skin, betas)
    largest = 1e3 * float(np.linalg.norm(gap, axis=2).max())
    yield Figure("J_regressor against the joints, 1,000 random shapes, largest", largest, "mm", 0, 2)


def _rebuild_figures(path: Path) -> Iterator[Figure]:
    start = time.perf_counter()
    rebuilt = build_body().arrays
    yield Figure("build time", time.perf_counter() - start, "s")
    with np.load(path, allow_pickle=False) as data:
        different = [key for key in rebuilt if not np.array_equal(rebuilt[key], data[key])]
    yield Figure("arrays that differ after a rebuild", len(different), "", 0, 0)


def main() -> None:
    """Print a table of all measured values. Exit with 1 if a value is outside its range."""
    rebuild = flag("rebuild", "Also rebuild the body, time it and compare bit by bit")
    arguments = parse_script(__doc__, option("path", "body", "BODY.npz", "Body file", BODY_FILE), rebuild)
    found = list(figures(read_baked(arguments.body), arguments.body))
    if arguments.rebuild:
        found += _rebuild_figures(arguments.body)
    lines = ["| figure | measured | must be | reached |", "|---|---|---|---|", *(f.row() for f in found)]
    sys.stdout.write("\n".join(lines) + "\n")
    sys.exit(0 if all(f.good for f in found) else 1)


if __name__ == "__main__":
    main()
