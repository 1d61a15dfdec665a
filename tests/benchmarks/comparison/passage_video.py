"""Render the comparison video: truth and solved motions side by side, with the true joints as dots on each.

``python -m tests.benchmarks.comparison.passage_video FOLDER OUT.mp4`` renders the motion files ``0_LABEL.npz,
1_LABEL.npz, ...`` of a folder (``write_passage``), with the truth first, and a contact sheet ``OUT.png`` of some
frames.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.benchmarks.comparison.passage import Passage

ROOT = Path(__file__).resolve().parents[3]
PANE = (360, 480)
STRIDE = 2
"""Every second frame, which gives 30 frames per second for a take at 60."""
SHEET_FRAMES = 5
TRUE_JOINT = (0.25, 0.95, 0.65)


def write_passage(passage: Passage, folder: Path) -> None:
    """Write the motions of a passage for the renderer, which is another process."""
    from solver_backend.io.native.motion_file import write_motion

    errors = passage.errors_mm()
    for number, (label, motion) in enumerate(passage.motions.items()):
        words = label if number == 0 else f"{label}  {errors[label]:.0f} mm"
        write_motion(folder / f"{number}_{words}.npz", motion, overwrite=True)


def render_apart(passage: Passage, out: Path) -> None:
    """Render in a separate process, because Blender keeps data that it opened once."""
    with tempfile.TemporaryDirectory(prefix="passage_") as name:
        write_passage(passage, Path(name))
        command = [sys.executable, "-m", "tests.benchmarks.comparison.passage_video", name, str(out)]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def render(folder: Path, out: Path) -> None:
    """Render the motions of a folder side by side."""
    from blender_addon.render.picture import write_png
    from blender_addon.render.stage import encode_video
    from blender_addon.scene.session import fresh_scene

    paths = sorted(folder.glob("*.npz"))
    truth, view = _true_view(paths[0])
    panes = [_pane(path, truth, view, folder) for path in paths]
    rows = [np.concatenate(frame, axis=1) for frame in zip(*panes, strict=True)]
    fresh_scene()
    pictures = []
    for number, row in enumerate(rows):
        pictures.append(folder / f"frame_{number:05d}.png")
        write_png(pictures[-1], row, level=1)
    out.parent.mkdir(parents=True, exist_ok=True)
    encode_video(pictures, (PANE[0] * len(paths), PANE[1]), 60.0 / STRIDE, out)
    chosen = np.linspace(0, len(rows) - 1, SHEET_FRAMES).round().astype(int)
    write_png(out.with_suffix(".png"), np.concatenate([rows[i] for i in chosen]))


def _true_view(path: Path):
    """Return the true joints and a view that includes the whole passage."""
    from blender_addon._exchange.motion_file import read_motion
    from blender_addon._exchange.so3 import matrix_from_rotvec
    from blender_addon.body.body_file import default_body_path, pose_joints, read_body
    from blender_addon.render.view import View, three_quarter_view

    motion, body = read_motion(path), read_body(default_body_path())
    joints = pose_joints(body.rest_joints(motion.betas), motion.rotvec, motion.transl)[1]
    forward = matrix_from_rotvec(motion.rotvec[0, 0])[:, 2]
    heading = float(np.arctan2(forward[1], forward[0]))
    return joints, View(three_quarter_view(joints.reshape(-1, 3), heading, PANE), PANE)


def _pane(path: Path, truth: np.ndarray, view, folder: Path) -> list[np.ndarray]:
    """Return the pictures of one motion, in a fresh Blender file."""
    from blender_addon._exchange.motion_file import read_motion
    from blender_addon.body.body_file import default_body_path, read_body
    from blender_addon.render.contact_sheet import open_lettering
    from blender_addon.render.picture import blend, draw_dots, gradient, layer_from_render, soften_edges
    from blender_addon.render.stage import RenderQuality, open_stage
    from blender_addon.render.subject import RenderedTake
    from blender_addon.scene.bake import bake_take
    from blender_addon.scene.session import fresh_scene

    motion, body = read_motion(path), read_body(default_body_path())
    take = bake_take(fresh_scene(), motion, body, None)
    subject, dots = RenderedTake(take, motion, body), view.project(truth)[0]
    pictures = []
    with (
        open_lettering(folder, 18) as letters,
        open_stage("pane", (take.body, *subject.floor), view, RenderQuality(), folder) as stage,
    ):
        for frame in range(0, motion.num_frames, STRIDE):
            picture = gradient(*PANE)
            blend(picture, soften_edges(layer_from_render(stage.render(float(subject.times[frame])), 2)), 0, 0)
            draw_dots(picture, dots[frame], 2.5, TRUE_JOINT)
            letters.write(picture, path.stem.partition("_")[2], 8, 8)
            pictures.append(picture)
    return pictures


if __name__ == "__main__":
    render(Path(sys.argv[1]), Path(sys.argv[2]))
