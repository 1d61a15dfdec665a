"""Render shots and data sets in colour, and simulate lens distortion, exposure and noise."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile, CaptureFile, read_capture
from .._exchange.errors import FileDamaged, FileMissing
from .._exchange.json_file import read_json_file
from .._exchange.lens import DEFAULT_MODEL, is_pinhole, normalised, pixels, undistort
from .._exchange.motion_file import read_motion
from .._exchange.outputs import publish, temporary_folder, unfinished_names, write_text
from .._exchange.progress import Progress
from .._exchange.verb_results import ShotRecord, is_shot_record
from ..body.body_file import body_path_of, read_body
from ..errors import RenderFailed
from ..render.picture import Resampling, write_png
from ..render.stage import encode_video, light_studio, render_still, write_targa
from ..scene.cameras import create_camera, look_through
from .dressed_person import COLOURS, DressedPerson, MarkerBalls, person_colours
from .room import LIGHTS, Light, build_room, light_room
from .scene_file import SceneFile, read_scene

_WIDEST = 1.6  # Largest size of the pinhole picture, relative to the size of the camera's picture.
_OUTSIDE = (0, 0, 0)


@dataclass(frozen=True)
class LensPicture:
    """A pinhole camera that Blender can render, and the mapping from its pixels to the real camera's pixels."""

    pinhole: CameraFile
    resampling: Resampling | None  # None if both pictures have the same pixels.

    def __call__(self, rendered: np.ndarray) -> np.ndarray:
        """Convert the pinhole picture to the camera's picture (h, w, 3)."""
        return rendered if self.resampling is None else self.resampling(np.ascontiguousarray(rendered))


def lens_picture(camera: CameraFile) -> LensPicture:
    """Return the pinhole camera and the pixel mapping for a camera."""
    straight = replace(camera, distortion=np.zeros(8), distortion_model=DEFAULT_MODEL, footage=None)
    if is_pinhole(camera.distortion, camera.distortion_model):
        return LensPicture(straight, None)
    width, height = camera.image_size
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    flat = undistort(normalised(np.stack([u, v], -1), camera.K), camera.distortion, camera.distortion_model)
    seen = pixels(flat, camera.K)
    low = np.floor(np.nanmin(seen.reshape(-1, 2), axis=0)) - 1
    high = np.ceil(np.nanmax(seen.reshape(-1, 2), axis=0)) + 1
    spare = (_WIDEST - 1) / 2 * np.array([width, height])
    low, high = np.maximum(low, -spare.round()), np.minimum(high, np.array([width, height]) + spare.round())
    K = camera.K.copy()
    K[:2, 2] -= low
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    positions = np.nan_to_num(seen - low, nan=-1e6)
    return LensPicture(replace(straight, K=K, image_size=size), Resampling(positions, size, _OUTSIDE))


_EEVEE = ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE")
_IDS = {"workbench": ("BLENDER_WORKBENCH",), "cycles": ("CYCLES",), "eevee": _EEVEE}


def engine_id(name: str) -> str:
    """Return Blender's identifier of a render engine. Raise ``RenderFailed`` if this Blender does not have it."""
    scene = bpy.data.scenes.new("engines")
    try:
        found = next((candidate for candidate in _IDS[name] if _takes(scene, candidate)), None)
        usable = [other for other, ids in _IDS.items() if any(_takes(scene, candidate) for candidate in ids)]
    finally:
        bpy.data.scenes.remove(scene)
    if found is None:
        hint = f"It has {', '.join(usable)}."
        raise RenderFailed(f"This version of Blender has no engine '{name}'.", where=bpy.app.version_string, hint=hint)
    return found


def set_engine(scene: bpy.types.Scene, name: str, samples: int) -> None:
    """Set a scene's render engine. Raise ``RenderFailed`` if this Blender does not have it."""
    scene.render.engine = engine_id(name)
    if name == "workbench":
        shading = light_studio(scene, "VERTEX")
        shading.show_shadows = True
        shading.show_specular_highlight = False
    elif name == "cycles":
        cycles = scene.cycles
        cycles.samples, cycles.use_adaptive_sampling = samples, False
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 2, 1
        cycles.transmission_bounces = cycles.volume_bounces = cycles.transparent_max_bounces = 0
        cycles.use_denoising = True
        cycles.seed = 0
        scene.render.use_persistent_data = True
    else:
        scene.eevee.taa_render_samples = samples


def enlargement(name: str) -> int:
    """Return how many times larger a render engine renders its pictures before they are averaged."""
    return 2 if name == "workbench" else 1


def show_paint(mesh: bpy.types.Mesh) -> None:
    """Make Workbench show the colours of a mesh's triangle corners."""
    mesh.color_attributes.active_color = mesh.color_attributes[COLOURS]
    mesh.color_attributes.render_color_index = mesh.color_attributes.find(COLOURS)


def _takes(scene: bpy.types.Scene, engine: str) -> bool:
    """Return whether Blender has a render engine. It is tested by setting it, because there is no list of engines."""
    try:
        scene.render.engine = engine
    except TypeError:
        return False
    return True


DONE = "rgb.json"  # File that marks a shot whose colour pictures are complete.
FOLDER = "rgb"
_BLUR_STEPS = 4
_BANDS = 8
"""Number of image bands that approximate a rolling shutter."""


Place = Callable[[float], None]  # Function that poses the scene at a time, which is given in frames.
StandIn = Callable[[bpy.types.Collection], Place]  # Function that builds another object to film.


@dataclass(frozen=True)
class ColourShot:
    """Cameras, lenses, light and settings for rendering a shot in colour."""

    capture: CaptureFile
    place: Place
    lenses: tuple[LensPicture, ...]
    cameras: tuple[bpy.types.Object, ...]
    settings: dict[str, Any]
    light: Light
    seed: int


def film_in_colour(
    folder: Path, progress: Callable[[int], None] = lambda frame: None, stand_in: StandIn | None = None
) -> int:
    """Render all colour pictures of a shot, and return their number. A failure leaves no pictures."""
    if (folder / DONE).is_file() and (folder / FOLDER).is_dir():
        return 0
    record = _record(folder)
    scene = _empty_scene()
    shot = _set_up(folder, record, scene, stand_in)
    frames, count = record["frames"], 0
    with temporary_folder() as working, unfinished_names(folder) as beginning:
        unfinished = folder / f"{beginning}{FOLDER}"
        for frame in range(frames):
            for view, camera in enumerate(shot.capture.cameras):
                target = unfinished / camera.name
                target.mkdir(parents=True, exist_ok=True)
                write_png(target / f"{frame:06d}.png", _picture(scene, shot, view, frame, working), level=1)
                count += 1
            progress(frame + 1)
        publish(unfinished, folder / FOLDER, DONE)
    about = json.dumps({"pictures": count, "blender": bpy.app.version_string})
    write_text(folder / DONE, about, overwrite=True)
    return count


def _record(folder: Path) -> ShotRecord:
    path = folder / "shot.json"
    record = read_json_file(path)
    if not is_shot_record(record) or not isinstance(record.get("rgb"), dict) or record.get("light") not in LIGHTS:
        raise FileDamaged("The shot's record has no colour settings.", where=str(path), hint="Run the studio again.")
    return record


def _empty_scene() -> bpy.types.Scene:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


def _set_up(folder: Path, record: ShotRecord, scene: bpy.types.Scene, stand_in: StandIn | None) -> ColourShot:
    capture, dressed = read_capture(folder / "clean.npz"), read_scene(folder / "scene.npz")
    rng = np.random.default_rng(int(record["rgb_seed"]))
    settings = dict(record["rgb"])
    if stand_in is None:
        place = _cast(folder, capture, dressed, scene.collection, rng)
        build_room(dressed, scene.collection, rng)
    else:
        place = stand_in(scene.collection)
    light_room(dressed, scene, scene.collection, rng)
    for thing in scene.collection.objects:
        if thing.type == "MESH":
            show_paint(thing.data)
    write_targa(scene)
    set_engine(scene, settings["engine"], int(settings["samples"]))
    scene.view_settings.exposure = float(settings["exposure"]) + float(rng.uniform(-0.25, 0.25))
    light = LIGHTS[record["light"]]
    light.set_up(scene)
    if settings["engine"] == "workbench":
        scene.display.light_direction = tuple(_sun(rng).tolist())
    lenses = tuple(lens_picture(camera) for camera in capture.cameras)
    cameras = tuple(create_camera(lens.pinhole, scene.collection) for lens in lenses)
    return ColourShot(capture, place, lenses, cameras, settings, light, int(record["rgb_seed"]))


def _cast(
    folder: Path, capture: CaptureFile, dressed: SceneFile, collection: bpy.types.Collection, rng: np.random.Generator
) -> Place:
    motion, own = read_motion(folder / "motion.npz"), folder / "body.npz"
    body = read_body(own if own.is_file() else body_path_of(motion.provenance), motion.body_layout)
    person = DressedPerson(body, motion, dressed, person_colours(dressed, rng), collection)
    markers = capture.markers
    balls = MarkerBalls(markers.shape[1], collection) if markers is not None and markers.shape[1] else None

    def place(time: float) -> None:
        at = float(np.clip(time, 0, motion.num_frames - 1))
        person.pose(at)
        if balls is not None and markers is not None:
            first = int(at)
            after = min(first + 1, len(markers) - 1)
            balls.place((1 - at + first) * markers[first] + (at - first) * markers[after])

    return place


def _sun(rng: np.random.Generator) -> np.ndarray:
    direction = np.array([rng.uniform(-0.5, 0.5), 1.0, rng.uniform(-0.5, 0.5)])
    return direction / np.linalg.norm(direction)


def _picture(scene: bpy.types.Scene, shot: ColourShot, view: int, frame: int, folder: Path) -> np.ndarray:
    look_through(scene, shot.cameras[view], scale=enlargement(shot.settings["engine"]))
    if shot.settings["engine"] == "cycles":
        scene.cycles.seed = frame
    open_share = float(shot.settings["blur"])
    rolling = float(shot.settings["rolling_s"]) * shot.capture.fps
    times = frame + open_share * ((np.arange(_BLUR_STEPS) + 0.5) / _BLUR_STEPS - 0.5) if open_share else [frame]
    total = np.zeros(1)
    for time in times:
        total = total + _at_time(scene, shot, view, float(time), rolling, folder)
    picture = shot.lenses[view](np.round(shot.light.tinted(total / len(times))).astype(np.uint8))
    sigma = shot.light.gain * float(shot.settings["noise"])
    return _with_noise(picture, sigma, np.random.default_rng([shot.seed, view, frame]))


def _at_time(
    scene: bpy.types.Scene, shot: ColourShot, view: int, time: float, rolling: float, folder: Path
) -> np.ndarray:
    """Return the pinhole picture (h, w, 3) as float at a time in frames. A rolling shutter is rendered in bands."""
    if not rolling:
        shot.place(time)
        return _averaged(render_still(scene, 1, folder), shot.settings["engine"])
    rows = []
    height = shot.lenses[view].pinhole.image_size[1]
    edges = np.linspace(0, height, _BANDS + 1).round().astype(int)
    for top, bottom in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        shot.place(time + rolling * ((top + bottom) / 2 / height - 0.5))
        rows.append(_averaged(render_still(scene, 1, folder), shot.settings["engine"])[top:bottom])
    return np.concatenate(rows)


def _averaged(rendered: np.ndarray, engine: str) -> np.ndarray:
    by = enlargement(engine)
    parts = [rendered[i::by, j::by, :3].astype(np.float32) for i in range(by) for j in range(by)]
    return np.sum(parts, axis=0) / len(parts)


def _with_noise(picture: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    if not sigma:
        return np.ascontiguousarray(picture)
    noisy = picture + (255 * sigma) * rng.standard_normal(picture.shape, np.float32)
    return np.clip(noisy + 0.5, 0, 255).astype(np.uint8)


SHOTS, VIDEOS = "shots", "videos"


def film_data_set_in_colour(out: Path, shots: list[str], frames: int, progress: Progress) -> int:
    """Render the missing colour pictures of every shot, and return how many were added."""
    made, each = 0, max(1, frames // max(len(shots), 1))
    for number, name in enumerate(shots):
        folder = out / SHOTS / name
        if not (folder / "shot.json").is_file():
            raise FileMissing("The shot is missing.", where=str(folder), hint="Run the studio again.")
        start = number * each
        made += film_in_colour(folder, lambda n, start=start: progress("colour", start + n, frames))
        progress("colour", (number + 1) * each, frames)
    return made


def write_videos(out: Path, shots: list[str], progress: Progress) -> None:
    """Write each missing ``videos/<camera>.mp4`` of every shot, scaled to an even width and height."""
    for done, name in enumerate(shots, start=1):
        folder = out / SHOTS / name
        record = read_json_file(folder / "shot.json")
        (folder / VIDEOS).mkdir(exist_ok=True)
        for camera, (width, height) in zip(record["cameras"], record["size"], strict=True):
            path = folder / VIDEOS / f"{camera}.mp4"
            if path.is_file():
                continue
            pictures = sorted((folder / FOLDER / camera).glob("*.png"))
            with unfinished_names(folder / VIDEOS) as name:
                unfinished = path.with_name(f"{name}{path.name}")
                encode_video(pictures, (width // 2 * 2, height // 2 * 2), float(record["fps"]), unfinished)
                unfinished.replace(path)
        progress("videos", done, len(shots))
