"""A shot filmed in colour: every camera and frame rendered, bent by its lens, exposed, with the sensor's noise."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.capture_file import CaptureFile, read_capture
from .._exchange.errors import FileDamaged
from .._exchange.motion_file import read_motion
from ..body.body_choice import body_path_of
from ..body.body_file import read_body
from ..render.picture import write_png
from ..render.still import render_still, write_targa
from ..scene.cameras import create_camera, look_through
from .dressed_person import DressedPerson
from .engines import set_engine, show_paint
from .lens_picture import LensPicture, lens_picture
from .marker_balls import MarkerBalls
from .paint import person_colours
from .room import build_room, light_room
from .scene_file import read_scene

DONE = "rgb.json"
"""Of a shot's folder: its colour pictures are whole."""
FOLDER, _UNFINISHED = "rgb", ".unfinished-rgb"
_BLUR_STEPS = 4
_BANDS = 8
"""Bands of rows that a rolling shutter is made of."""


@dataclass(frozen=True)
class ColourShot:
    """What is rendered."""

    folder: Path
    capture: CaptureFile
    person: DressedPerson
    markers: MarkerBalls | None
    lenses: tuple[LensPicture, ...]
    cameras: tuple[bpy.types.Object, ...]
    settings: dict[str, Any]
    seed: int


def film_in_colour(
    folder: Path, told: Callable[[int], None] = lambda frame: None, balls: tuple[np.ndarray, np.ndarray] | None = None
) -> int:
    """Render a shot's colour pictures, whole or not at all, and return how many; those that are there stay.

    The open file is forgotten.

    Args:
        folder: the shot's.
        told: is told each frame that is done.
        balls: (F, N, 3) metres and (N, 3) linear colours of balls that are shown instead of person and markers.

    Raises:
        RenderFailed: Blender cannot render here.
        MocapError: a file of the shot is missing or damaged.
    """
    if (folder / DONE).is_file():
        return 0
    record = _record(folder)
    scene = _empty_scene()
    shot = _set_up(folder, record, scene, balls)
    unfinished = folder / _UNFINISHED
    shutil.rmtree(unfinished, ignore_errors=True)
    frames, count = record["frames"], 0
    with tempfile.TemporaryDirectory(prefix="studio_") as name:
        for frame in range(frames):
            if balls is not None and shot.markers is not None:
                shot.markers.place(balls[0][frame])
            for view, camera in enumerate(shot.capture.cameras):
                target = unfinished / camera.name
                target.mkdir(parents=True, exist_ok=True)
                write_png(target / f"{frame:06d}.png", _picture(scene, shot, view, frame, Path(name)), level=1)
                count += 1
            told(frame + 1)
    shutil.rmtree(folder / FOLDER, ignore_errors=True)
    unfinished.rename(folder / FOLDER)
    (folder / DONE).write_text(json.dumps({"pictures": count, "blender": bpy.app.version_string}), encoding="utf-8")
    return count


def _record(folder: Path) -> dict[str, Any]:
    path = folder / "shot.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileDamaged(f"The shot cannot be read: {error}.", where=str(path)) from error


def _empty_scene() -> bpy.types.Scene:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


def _set_up(
    folder: Path, record: dict[str, Any], scene: bpy.types.Scene, balls: tuple[np.ndarray, np.ndarray] | None
) -> ColourShot:
    capture, motion = read_capture(folder / "clean.npz"), read_motion(folder / "motion.npz")
    own = folder / "body.npz"
    body = read_body(own if own.is_file() else body_path_of(motion.provenance))
    dressed = read_scene(folder / "scene.npz")
    rng = np.random.default_rng(int(record["rgb_seed"]))
    # Who somebody is does not depend on where they stand: their colours have a seed of their own.
    person = DressedPerson(body, motion, dressed, person_colours(dressed, rng), scene.collection)
    settings = dict(record["rgb"])
    if balls is None:
        build_room(dressed, scene.collection, rng)
        count = 0 if capture.markers is None else capture.markers.shape[1]
        markers = MarkerBalls(count, scene.collection) if count else None
    else:
        bpy.data.objects.remove(person.object)
        markers = MarkerBalls(balls[0].shape[1], scene.collection, 0.015, balls[1])
    light_room(dressed, scene, scene.collection, rng)
    for thing in scene.collection.objects:
        if thing.type == "MESH":
            show_paint(thing.data)
    settings["exposure"] = float(settings["exposure"]) + float(rng.uniform(-0.25, 0.25))
    write_targa(scene)
    set_engine(scene, settings["engine"], int(settings["samples"]))
    scene.view_settings.exposure = settings["exposure"]
    if settings["engine"] == "workbench":
        scene.display.light_direction = tuple(float(v) for v in _sun(rng))
    lenses = tuple(lens_picture(camera) for camera in capture.cameras)
    cameras = tuple(create_camera(lens.pinhole, scene.collection) for lens in lenses)
    shown = person if balls is None else _Nobody()
    return ColourShot(folder, capture, shown, markers, lenses, cameras, settings, int(record["rgb_seed"]))  # type: ignore[arg-type]


class _Nobody:
    """Stands where a person would, and does nothing."""

    def pose(self, frame: float) -> None:
        """Do nothing."""


def _sun(rng: np.random.Generator) -> np.ndarray:
    """Return where Workbench's sun stands, from above; its second axis is the world's third."""
    direction = np.array([rng.uniform(-0.5, 0.5), 1.0, rng.uniform(-0.5, 0.5)])
    return direction / np.linalg.norm(direction)


def _picture(scene: bpy.types.Scene, shot: ColourShot, view: int, frame: int, folder: Path) -> np.ndarray:
    """Return the (h, w, 3) uint8 picture of a camera."""
    look_through(scene, shot.cameras[view])
    if shot.settings["engine"] == "cycles":
        scene.cycles.seed = frame
    open_share = float(shot.settings["blur"])
    rolling = float(shot.settings["rolling_s"]) * shot.capture.fps
    times = frame + open_share * ((np.arange(_BLUR_STEPS) + 0.5) / _BLUR_STEPS - 0.5) if open_share else [frame]
    total = np.zeros(1)
    for time in times:
        total = total + _at_time(scene, shot, view, float(time), rolling, folder)
    picture = shot.lenses[view](np.round(total / len(times)).astype(np.uint8))
    return _with_noise(picture, float(shot.settings["noise"]), np.random.default_rng([shot.seed, view, frame]))


def _at_time(
    scene: bpy.types.Scene, shot: ColourShot, view: int, time: float, rolling: float, folder: Path
) -> np.ndarray:
    """Return the pinhole's picture at a time, (h, w, 3) floats; a rolling shutter reads row after row."""
    if not rolling:
        _place(shot, time)
        return render_still(scene, 1, folder)[..., :3].astype(np.float64)
    rows = []
    height = shot.lenses[view].pinhole.image_size[1]
    edges = np.linspace(0, height, _BANDS + 1).round().astype(int)
    for top, bottom in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        _place(shot, time + rolling * ((top + bottom) / 2 / height - 0.5))
        rows.append(render_still(scene, 1, folder)[top:bottom, :, :3])
    return np.concatenate(rows).astype(np.float64)


def _place(shot: ColourShot, time: float) -> None:
    last = max(shot.capture.num_frames - 1, 0)
    at = float(np.clip(time, 0, last))
    shot.person.pose(at)
    if shot.markers is not None and shot.capture.markers is not None and not isinstance(shot.person, _Nobody):
        first = min(int(at), max(last - 1, 0))
        share = at - first
        markers = shot.capture.markers
        shot.markers.place((1 - share) * markers[first] + share * markers[min(first + 1, last)])


def _with_noise(picture: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    if not sigma:
        return np.ascontiguousarray(picture)
    noisy = picture + (255 * sigma) * rng.standard_normal(picture.shape, np.float32)
    return np.clip(noisy + 0.5, 0, 255).astype(np.uint8)
