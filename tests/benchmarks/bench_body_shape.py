"""Compare the shown body with the solver's body in 300 random poses: volume, surface, and self-intersections.

Every joint rotates at random over its range (``sample_poses``, seed 60, which the fit does not use). "before" is the
body file, which solves use. "after" is the body that Blender shows. Intersecting faces are counted if both belong to
one bone or to neighbouring bones, so that a hand in the belly does not count. "moved" is the distance between the two
skins.
"""

from __future__ import annotations

import numpy as np

from assets_procedural.quality.contact_sheet import rotations
from assets_procedural.skeleton.correctives import sample_poses
from assets_procedural.skeleton.skinning import vertex_areas, volume
from tests.benchmarks.metric import Metric
from tests.support.shown_body import NAMED, bodies, figures

POSES, SEED = 300, 60


def run() -> list[Metric]:
    """Measure both bodies."""
    poses, found = sample_poses(POSES, SEED), []
    before, after = bodies().values()
    moved = np.array([np.linalg.norm(after.posed(pose) - before.posed(pose), axis=1) for pose in poses[::10]])
    found.append(Metric("moved_mean_mm", 1e3 * float(moved.mean()), "mm", abs_tol=0.1))
    found.append(Metric("moved_99th_mm", 1e3 * float(np.quantile(moved, 0.99)), "mm", abs_tol=0.5))
    for name, body in bodies().items():
        rest = np.array([volume(body.vertices, body.faces), vertex_areas(body.vertices, body.faces).sum()])
        rows = np.array([figures(body, pose) for pose in poses])
        change = 100.0 * (rows[:, :2] / rest - 1.0)
        found += [
            Metric(f"{name}_volume_pct", float(np.abs(change[:, 0]).mean()), "%", abs_tol=0.1),
            Metric(f"{name}_surface_pct", float(np.abs(change[:, 1]).mean()), "%", abs_tol=0.1),
            Metric(f"{name}_crossing_faces", float(rows[:, 2].mean()), "faces/pose", rel_tol=0.05, abs_tol=2.0),
        ]
        for pose, turns in NAMED.items():
            posed = figures(body, rotations(turns))
            key = f"{name}_{pose.replace(' ', '_')}"
            found.append(Metric(f"{key}_volume_pct", float(100.0 * abs(posed[0] / rest[0] - 1.0)), "%", abs_tol=0.1))
            found.append(Metric(f"{key}_faces", posed[2], "faces", rel_tol=0.05, abs_tol=4.0))
    return found
