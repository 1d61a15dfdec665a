"""Figures from the real application: ``python -m tests.gui --script measure.py``.

What a solve by the button adds to the solver's own time on the same job, and how fast the shipped body (7,000 vertices,
pose correctives and bone colours on) plays on the screen. A screen without a graphics card is drawn by the processor,
also while nothing moves: what an idle Blender and an empty scene cost there is noted, too.
"""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import bpy

from tests.gui.scene import empty, extension

_SECONDS = 8.0


def steps(user: Any) -> Any:
    """Make the demo, solve it by the button and alone, play it."""
    empty()
    yield from user.open_tab("MoCap")
    yield from user.press("mocap.demo_capture(kind='CAMERAS')")
    yield from user.until(lambda: bpy.context.scene.mocap.capture.file, "the demo capture is there", 300)
    x, y = yield from user.find("mocap.solve()")
    processor = time.process_time()
    yield from user.until(lambda start=time.monotonic(): time.monotonic() > start + _SECONDS, "idle for a while")
    user.note(f"idle, Blender uses {(time.process_time() - processor) / _SECONDS:.0%} of a processor")
    start, processor = time.monotonic(), time.process_time()
    yield from user.click(x, y)
    yield from user.until(lambda: bpy.context.scene.mocap.review.armature, "the capture is solved", 900)
    by_button, processor = time.monotonic() - start, time.process_time() - processor
    alone = _solved_alone(Path(bpy.context.scene.mocap.review.take["job_file"]))
    user.note(f"solve by the button {by_button:.2f} s, alone {alone:.2f} s, added {by_button - alone:.2f} s")
    share = f"{processor:.2f} s of processor time ({processor / by_button:.0%})"
    user.note(f"meanwhile Blender itself used {share}, drawing included")

    scene, review = bpy.context.scene, bpy.context.scene.mocap.review
    user.look_at(review.armature.pose.bones["pelvis"].head, 4.0)
    skin = next(child for child in review.armature.children if child.type == "MESH")
    user.note(f"the body has {len(skin.data.vertices)} vertices; the scene asks for {scene.render.fps} fps")
    yield from _played(user, "correctives on")
    correctives = skin.modifiers["Pose Correctives"]
    correctives.show_viewport = False
    yield from _played(user, "correctives off")
    correctives.show_viewport = True
    yield from user.press("mocap.show_confidence()")
    yield from _played(user, "correctives and bone colours on")
    yield from user.shot("playing")
    for obj in scene.objects:
        obj.hide_viewport = True
    yield from _played(user, "nothing to be seen: what the screen alone costs")


def _solved_alone(job_file: Path) -> float:
    """Return the wall seconds of the same job without Blender."""
    environment = extension("backend_environment")
    job = json.loads(job_file.read_text("utf-8"))
    out = job_file.parent / "alone.npz"
    job |= {"out": str(out), "report": str(out.with_suffix(".html"))}
    path = out.with_suffix(".json")
    path.write_text(json.dumps(job), "utf-8")
    command = [*environment.backend_command(), "solve", "--job", str(path), "--json"]
    start = time.monotonic()
    subprocess.run(command, env=environment.environment_for_child(), check=True, capture_output=True)
    return time.monotonic() - start


def _played(user: Any, what: str) -> Any:
    """Play for a while and note how many frames a second were drawn, and what each cost."""
    shown: list[int] = []

    def count(scene: bpy.types.Scene, *_: object) -> None:
        shown.append(scene.frame_current)

    scene = bpy.context.scene
    scene.sync_mode = "NONE"
    scene.frame_set(scene.frame_start)
    with user.override:
        bpy.ops.screen.animation_play()
    yield 1.0
    bpy.app.handlers.frame_change_post.append(count)
    start, processor = time.monotonic(), time.process_time()
    yield _SECONDS
    wall, processor = time.monotonic() - start, time.process_time() - processor
    bpy.app.handlers.frame_change_post.remove(count)
    with user.override:
        bpy.ops.screen.animation_cancel(restore_frame=False)
    each_ms = 1000 * processor / max(len(shown), 1)
    user.note(f"played with {what}: {len(shown) / wall:.1f} fps, {each_ms:.0f} ms of processor time a frame")
    yield 0.5
