"""Map the frames of takes to scene frames, and set the scene's frame rate."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np


@dataclass(frozen=True)
class TakeTiming:
    """Conversion from a take's frames to scene frames."""

    start: float  # Scene frame of the take's first frame.
    scene_fps: float  # Frame rate of the scene, in frames per second.

    def scene_frames(self, count: int, fps: float) -> np.ndarray:
        """Return the scene frames (count,) of a take at ``fps``: ``start + i scene_fps / fps``."""
        step = self.scene_fps / fps
        # A take that has the scene's own rate falls exactly on whole frames.
        return self.start + np.arange(count) * (1.0 if abs(step - 1) < 1e-6 else step)

    def last_frame(self, count: int, fps: float) -> int:
        """Return the scene frame of the last of ``count`` take frames, rounded up."""
        return int(np.ceil(self.scene_frames(count, fps)[-1] - 1e-3))


def set_up_time(scene: bpy.types.Scene, frames: int, fps: float, start: int, scene_fps: float | None) -> TakeTiming:
    """Return a recording's timing in a scene. With ``scene_fps``, also set the scene's frame rate and range."""
    if scene_fps is None:
        return TakeTiming(start, scene_frame_rate(scene))
    set_scene_frame_rate(scene, scene_fps)
    timing = TakeTiming(start, scene_fps)
    scene.frame_start, scene.frame_end = start, timing.last_frame(frames, fps)
    return timing


def show_frame(scene: bpy.types.Scene, frame: int | None = None) -> None:
    """Go to a whole frame, or evaluate the current frame again if ``frame`` is None."""
    if frame is None:
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    else:
        scene.frame_set(frame)


def go_to_frame(scene: bpy.types.Scene, frame: float) -> None:
    """Go to a scene frame, which may be fractional."""
    whole = int(np.floor(frame))
    scene.frame_set(whole, subframe=float(frame - whole))


def scene_frame_rate(scene: bpy.types.Scene) -> float:
    """Return the scene's frame rate in frames per second."""
    return scene.render.fps / scene.render.fps_base


def set_scene_frame_rate(scene: bpy.types.Scene, fps: float) -> None:
    """Set the scene's frame rate, which may be fractional. 59.94 becomes 60 / 1.001."""
    whole = max(1, round(fps))
    scene.render.fps = whole
    scene.render.fps_base = whole / fps
