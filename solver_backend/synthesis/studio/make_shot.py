"""Render a shot and write it with its ground truth, completely or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.marker_formats import MARKER_FORMATS
from solver_backend.exchange.npz import write_npz
from solver_backend.exchange.outputs import publish, unfinished_names
from solver_backend.exchange.verb_results import ShotRecord, is_shot_record
from solver_backend.fitters.hands.solve_hands import with_finger_turns
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.files import read_json
from solver_backend.io.markers.read import write_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.studio.person_hands import hidden_of, with_found_hands, with_true_hands
from solver_backend.synthesis.studio.perturb import clean_capture, perturbed_capture
from solver_backend.synthesis.studio.sensor_pictures import (
    Backdrop,
    InfraredModel,
    TimeOfFlightModel,
    backdrop,
    infrared,
    look,
    measure_depth,
    poses_of,
    sphere_light,
    views_of,
)
from solver_backend.synthesis.studio.spec import Spec
from solver_backend.synthesis.studio.stage import Shot, Stage, require_sight, set_up
from solver_backend.synthesis.studio.truth import VISIBLE, Truth, find_truth, marker_sight, true_motion
from solver_backend.synthesis.studio.write_pictures import (
    EXR,
    PictureWriter,
    coco_text,
    write_body,
    write_scene,
    write_trial,
)
from solver_backend.types import Capture, Motion

Keep = Callable[[str, int, int, np.ndarray], None]  # Receives kind, view, frame and image.
_CHUNK = 16  # Number of frames with their surfaces in memory at a time.


def film(spec: Spec, stage: Stage, keep: Keep, on_frame: Callable[[int], None] = lambda frame: None) -> np.ndarray:
    """Render the images of a shot. Return the (C, F, M) float32 visible fractions of the markers.

    Args:
        keep: receives every image: 'infrared' and 'depth' (h, w) uint16, 'masks' (h, w) uint8, 'normals' (h, w, 3)
            uint8 in the camera's frame, 'exr' (h, w, 4) float32 with the normal and the exact depth in metres.
        on_frame: called after each frame.
    """
    kinds = [kind for kind in spec.film if kind != "rgb"] + ([EXR] if EXR in spec.write else [])
    cameras = stage.cameras
    markers = np.zeros((len(cameras), stage.num_frames, stage.markers.shape[1]), np.float32)
    coloured = "rgb" in spec.film and bool(stage.labels)
    if not kinds and not coloured:
        return marker_sight(stage)
    behind = [backdrop(stage, view) for view in range(len(cameras))]
    for start in range(0, stage.num_frames, _CHUNK):
        frames = np.arange(start, min(start + _CHUNK, stage.num_frames))
        surfaces = stage.surface(frames)
        for frame, surface in zip(frames.tolist(), surfaces, strict=True):
            for view in range(len(cameras)):
                markers[view, frame] = _shoot(spec, stage, behind[view], kinds, view, frame, surface, keep)
            on_frame(frame + 1)
    return markers


def _shoot(
    spec: Spec, stage: Stage, behind: Backdrop, kinds: list[str], view: int, frame: int, surface: np.ndarray, keep: Keep
) -> np.ndarray:
    seen = look(stage, view, behind, surface, frame, normals="normals" in kinds or EXR in kinds)
    rng = stage.shot.rng(spec, f"pixels {view} {frame}")
    model = InfraredModel()
    if "infrared" in kinds or "depth" in kinds:
        light = sphere_light(seen.spheres, (len(seen.depth), seen.depth.shape[1]), model)
        if "infrared" in kinds:
            keep("infrared", view, frame, infrared(seen, light, model, rng))
        if "depth" in kinds:
            sensor = TimeOfFlightModel(range_m=stage.shot.array.range_m)
            keep("depth", view, frame, measure_depth(seen, light, sensor, rng))
    if "masks" in kinds:
        keep("masks", view, frame, seen.label)
    if seen.normal is not None:
        turned = seen.normal @ stage.cameras.R[view].T.astype(np.float32)
        if "normals" in kinds:
            keep("normals", view, frame, np.round(turned * 127.5 + 127.5).astype(np.uint8))
        if EXR in kinds:
            keep(EXR, view, frame, np.concatenate([turned, seen.depth[..., None]], axis=-1, dtype=np.float32))
    return seen.spheres.seen.astype(np.float32)


DONE = "shot.json"  # File that marks the folder of a finished shot.


def make_shot(spec: Spec, shot: Shot, shots: Path, on_frame: Callable[[int], None] = lambda frame: None) -> ShotRecord:
    """Make a shot and return its record. An existing shot is not made again.

    Several processes may make the same shot at once. The first one to finish publishes its folder. ``on_frame`` is
    called after each rendered frame.

    Raises:
        NobodySeen, CameraInsideBody: the shot cannot be rendered.
        MocapError: its motion cannot be read, or the folder cannot be written.
    """
    folder = shots / shot.name
    if (folder / DONE).is_file():
        return read_shot(folder)
    stage = set_up(spec, shot)
    require_sight(stage)
    shots.mkdir(parents=True, exist_ok=True)
    with unfinished_names(shots) as name:
        unfinished = shots / f"{name}{shot.name}"
        unfinished.mkdir()
        record = _write_shot(spec, stage, unfinished, on_frame)
        (unfinished / DONE).write_text(json.dumps(record, indent=1, sort_keys=True), encoding="utf-8", newline="\n")
        publish(unfinished, folder, f"{folder.name}/{DONE}")
    return record


def read_shot(folder: Path) -> ShotRecord:
    """Read the record of a finished shot. Raise ``FileMissing`` or ``FileDamaged``."""
    record = read_json(folder / DONE)
    if not is_shot_record(record):
        message, hint = "The shot's record is not an object.", "Remove the shot's folder."
        raise FileDamaged(message, where=str(folder / DONE), hint=hint)
    return record


def _write_shot(spec: Spec, stage: Stage, folder: Path, on_frame: Callable[[int], None]) -> ShotRecord:
    truth = find_truth(stage, spec.fps)
    with PictureWriter(folder, stage.cameras.names) as keep:
        marker_seen = film(spec, stage, keep, on_frame)
    motion = true_motion(stage.person, stage.joints, truth.contacts, spec.fps)
    clean = clean_capture(spec, stage, truth, motion)
    if stage.labels:
        clean.truth["marker_seen"] = marker_seen
    perturbed = perturbed_capture(spec, stage, truth, clean)
    if stage.hands is not None:
        hidden = hidden_of(stage.person, stage.cameras, stage.hands)
        clean, perturbed = (with_true_hands(c, stage.cameras, stage.hands, hidden) for c in (clean, perturbed))
        if spec.perturb.of_views:
            rng = stage.shot.rng(spec, "found hands")
            perturbed = with_found_hands(perturbed, stage.cameras, stage.hands, hidden, spec.fps, rng)
        motion = with_finger_turns(motion, stage.person.body, log_so3(stage.hands.rotations()))
    write_capture(folder / "clean.npz", clean)
    write_capture(folder / "perturbed.npz", perturbed)
    write_motion(folder / "motion.npz", motion)
    write_npz(folder / "truth.npz", truth.arrays() | {"marker_seen": marker_seen})
    if "rgb" in spec.film:
        write_scene(folder / "scene.npz", stage)
    if stage.person.body.id != load_body().id:
        write_body(folder / "body.npz", stage.person.body)
    _write_formats(spec, stage, folder, truth, (clean, perturbed))
    return _record(spec, stage, truth, motion)


def _write_formats(spec: Spec, stage: Stage, folder: Path, truth: Truth, captures: tuple[Capture, Capture]) -> None:
    pictures = "rgb" if "rgb" in spec.film else next(iter(spec.film), "rgb")
    for capture, ending in zip(captures, ("", "_perturbed"), strict=True):
        if ending and not (spec.perturb.of_views or spec.perturb.of_markers):
            continue
        if "pose2sim" in spec.write:
            write_trial(folder / f"pose2sim{ending}", capture)
        if capture.markers is not None:
            for kind in MARKER_FORMATS.keys() & set(spec.write):
                write_markers(folder / f"markers{ending}.{kind}", capture.markers)
    if "coco" in spec.write:
        text = coco_text(stage.cameras, truth, pictures, stage.shot.name)
        (folder / "coco.json").write_text(text, encoding="utf-8", newline="\n")


def _record(spec: Spec, stage: Stage, truth: Truth, motion: Motion) -> ShotRecord:
    visible = truth.visibility[spec.joint_set] == VISIBLE
    return {
        "name": stage.shot.name, "frames": stage.num_frames, "fps": spec.fps, "seed": spec.seed,
        "motion": stage.shot.motion.name, "motion_file": getattr(stage.shot.motion.path, "name", ""),
        "person": stage.shot.person, "betas": [round(float(b), 6) for b in motion.betas], "body": motion.body,
        "camera_array": stage.shot.array.name, "cameras": list(stage.cameras.names),
        "size": stage.cameras.image_size.tolist(), "look": stage.shot.look.name, "clothes": stage.outfit[0],
        "hair": stage.outfit[1], "light": stage.light, "markers": len(stage.labels), "film": list(spec.film),
        "visible": round(float(visible.mean()), 4), "inside": round(float(truth.inside.mean()), 4),
        "views": views_of(stage), "poses": poses_of(stage.joints), "rgb": asdict(spec.rgb),
        "rgb_seed": int(stage.shot.rng(spec, "rgb").integers(2**31)),
    }  # fmt: skip
