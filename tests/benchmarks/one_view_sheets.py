"""Render five motions solved from one camera: ``python -m tests.benchmarks.one_view_sheets --out FOLDER``.

The motions are a walk towards the camera, a rotation, a squat, sitting down and standing up, and rising from the floor.
Each is seen by a simulated detector and solved from the first camera. The picture shows it from the camera (above) and
from its right side (below, with the camera on the left). The truth is grey, the solve orange, the floor a line. Titles
have the mean distance of 12 limb joints, after the best similarity and relative to the hips.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from assets_procedural.quality.contact_sheet import RasterView, render, tile, write_png
from research.simulation.benchmark import BenchmarkSettings, benchmark_capture
from solver_backend.body.body import load_body
from solver_backend.body.mesh import pose_mesh
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import Take
from solver_backend.types import Capture
from tests.benchmarks.comparison.validation_takes import read_take
from tests.support.limb_errors import limb_errors
from tests.support.recordings import recordings_folder

MOMENTS = 6
VIEW = RasterView(height_m=2.2, size=(150, 200), centre=(0.0, 0.9, 0.0))
TRUE, SOLVED, FLOOR = (0.62, 0.64, 0.68), (0.86, 0.55, 0.28), (90, 90, 100)


@dataclass(frozen=True)
class Scene:
    """A frame range of a recorded take, and its heading as seen by the camera."""

    name: str
    file: str
    """File under ``motion_cmu``."""
    start: int
    frames: int
    """Number of frames at 30 per second."""
    towards_camera: bool = False
    """Rotate the take so that the path from the first to the last position leads to the camera."""


SCENES = (
    Scene("walk", "mb2/08_01", 10, 75, towards_camera=True),
    Scene("turn", "asfamc/16_19", 0, 90),
    Scene("squat", "mb2/13_29", 1900, 100),
    Scene("sit", "daz_more/13_01", 60, 210),
    Scene("lying", "jump/139_17", 0, 120),
)
"""The priors and the lifter were not trained on subjects 08 and 13. They were trained on 16 and 139."""


def filmed(scene: Scene) -> Capture:
    """Return the scene seen by one camera."""
    whole = read_take(recordings_folder() / "motion_cmu" / f"{scene.file}.npz", None, scene.start)
    step = max(1, round(whole.fps / 30.0))
    take = replace(
        whole, rotations=whole.rotations[::step][: scene.frames], root=whole.root[::step][: scene.frames],
        fps=whole.fps / step,
    )  # fmt: skip
    capture = benchmark_capture(take, BenchmarkSettings(num_views=3))
    if scene.towards_camera:
        assert capture.cameras is not None
        way, to = _flat(capture.truth["joints"][[0, -1], 0]), capture.cameras.centres[0]
        wanted = to[:2] - capture.truth["joints"][:, 0, :2].mean(axis=0)
        turn = np.arctan2(wanted[1], wanted[0]) - np.arctan2(way[1], way[0])
        capture = benchmark_capture(_turned(take, float(turn)), BenchmarkSettings(num_views=3))
    return capture.views([0])


def sheet(capture: Capture) -> tuple[np.ndarray, tuple[float, float]]:
    """Return the picture of a solved scene, and its errors in mm."""
    body, motion, truth = load_body(), solve(capture).motion, capture.truth
    cameras, _ = capture.require_views()
    frames = np.linspace(2, motion.num_frames - 3, MOMENTS).round().astype(int)
    local = exp_so3(truth["body_pose"].reshape(len(truth["transl"]), -1, 3))[:, :21]
    true = pose_mesh(
        body, truth["betas"], exp_so3(truth["global_orient"])[frames], local[frames], truth["transl"][frames]
    )
    own = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3))[:, :21]
    solved = pose_mesh(body, motion.betas, exp_so3(motion.global_orient)[frames], own[frames], motion.transl[frames])
    forward = np.array([*cameras.R[0, 2, :2], 0.0]) / np.linalg.norm(cameras.R[0, 2, :2])
    right, up = np.cross(forward, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
    rows = []
    for axes in (np.stack([right, up, -forward]), np.stack([forward, up, right])):
        for vertices, joints, tint in ((true, truth["joints"], TRUE), (solved, motion.joints, SOLVED)):
            middle = joints[frames, 0] * [1.0, 1.0, 0.0]
            rows += [
                _drawn((at - place) @ axes.T, body.faces, tint) for at, place in zip(vertices, middle, strict=True)
            ]
    return tile(rows, MOMENTS), limb_errors(motion.joints, truth["joints"])


def _drawn(vertices: np.ndarray, faces: np.ndarray, tint: tuple[float, float, float]) -> np.ndarray:
    picture = render(np.asarray(vertices), np.asarray(faces), np.tile(tint, (len(faces), 1)), VIEW, oversample=1)
    row = round(VIEW.size[1] * (0.5 + VIEW.centre[1] / VIEW.height_m))
    picture[row] = FLOOR
    return picture


def _flat(ends: np.ndarray) -> np.ndarray:
    return ends[1, :2] - ends[0, :2]


def _turned(take: Take, angle: float) -> Take:
    """Return a take rotated about its vertical axis (Y)."""
    turn = exp_so3(np.array([0.0, angle, 0.0]))
    rotations = take.rotations.copy()
    rotations[:, 0] = turn @ rotations[:, 0]
    return replace(take, rotations=rotations, root=take.root @ turn.T)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a picture per scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--only", nargs="*", default=[scene.name for scene in SCENES], metavar="NAME")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    for scene in SCENES:
        if scene.name in options.only:
            picture, (pa, hip) = sheet(filmed(scene))
            write_png(options.out / f"{scene.name}.png", picture)
            sys.stdout.write(
                f"{scene.name}: {scene.file}, {pa:.0f} mm after the best similarity, {hip:.0f} about the hips\n"
            )


if __name__ == "__main__":
    main()
