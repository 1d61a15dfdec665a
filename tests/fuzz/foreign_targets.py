"""Readers of other programs' files that only some users have, and files between two processes of ours."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from blender_addon.retarget.actor_file import ReadActor, read_actor_file, write_actor
from blender_addon.retarget.motion.figures import Actor, Hand, Trunk
from blender_addon.retarget.recognition import frame_rate, humanoid, read_header, write_skinned
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.skeleton_file import SkeletonFile, read_skeleton, write_skeleton
from solver_backend.io.calibration.read import calibrations_in
from solver_backend.io.camera_paths import read_camera_path
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.footage import recorded_focal_mm
from solver_backend.io.markers.c3d import read_segments
from solver_backend.io.markers.read import read_markers
from solver_backend.io.motions.gloves import read_gloves
from solver_backend.live.recordings import PosesRecording
from solver_backend.types import JointSet
from solver_backend.videos.detect.child.pose_workers.described_pose import DEFAULTS, read_description
from solver_backend.videos.detect.child.pose_workers.serve import Refused
from solver_backend.videos.detect.detector import chosen_detector
from tests.fuzz.target import Target, file
from tests.support import program_calibrations
from tests.support.drawn_gloves import drawn_gloves, manus_csv, rokoko_csv
from tests.support.mat_bytes import mat_of_qtm
from tests.support.segment_bytes import file_of

_RANDOM = np.random.default_rng(8)
_GLTF = {
    "accessors": [{"count": 11, "min": [0.0], "max": [0.5]}], "nodes": [{"name": "Hips"}],
    "animations": [{"samplers": [{"input": 0}]}],
    "extensions": {"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 0}}}},
                   "VRM": {"humanoid": {"humanBones": [{"bone": "hips", "node": 0}]}}},
}  # fmt: skip


def _actor(folder: Path) -> None:
    turns = np.tile(np.eye(3), (3, 24, 1, 1))
    hand = Hand(("left_index_1",), np.ones((1, 3)), np.tile(np.eye(3), (1, 3, 1, 1)), np.ones((1, 3)))
    trunk = Trunk(np.arange(2.0), turns[:, :2].swapaxes(0, 1))
    actor = Actor(
        "a", np.ones((24, 3)), turns, np.ones((3, 24, 3)), 30.0, None, trunk, (hand,), {"trunk": np.ones((2, 3))}
    )
    write_actor(folder / "a.npz", ReadActor(actor, ("note",)))


def _skeleton(folder: Path) -> None:
    rest, turns = np.zeros((2, 3)), np.tile(np.eye(3), (3, 2, 1, 1))
    held = SkeletonFile("a", ("hips", "knee"), (-1, 0), rest, np.zeros((3, 2, 3)), turns, 30.0, {"pelvis": "hips"})
    write_skeleton(folder / "a.npz", held)


def _gltf(folder: Path) -> object:
    path = next(folder.iterdir())
    header = read_header(path)
    if path.suffix == ".glb":  # as a VRM animation
        write_skinned(path, folder / "made.glb").unlink()
    return frame_rate(header), humanoid(header)


def _glb(folder: Path) -> None:
    text = json.dumps(_GLTF).encode()
    (folder / "a.glb").write_bytes(struct.pack("<4sIIII", b"glTF", 2, 20 + len(text), len(text), 0x4E4F534A) + text)


def _poses(folder: Path) -> None:
    recording = PosesRecording()
    rows = [recording.encode(k / 30, _RANDOM.normal(size=(24, 3)), np.zeros(3)) for k in range(4)]
    (folder / "a.npz.recording").write_bytes(recording.head() + b"".join(rows))


def _finished(folder: Path) -> object:
    content = next(folder.iterdir()).read_bytes()
    (folder / "copy.recording").write_bytes(content)
    try:
        return PosesRecording().finish(folder / "copy.recording", folder / "made.npz")
    finally:
        for name in ("copy.recording", "made.npz"):
            (folder / name).unlink(missing_ok=True)


def _points(folder: Path) -> None:
    np.save(folder / "a.npy", _RANDOM.normal(size=(4, 33, 3)) + [0, 0, 1.0])


def _named_points(folder: Path) -> None:
    np.save(folder / "a.npy", _RANDOM.normal(size=(4, 12, 3)))
    (folder / "a.txt").write_text("\n".join(f"point{k}" for k in range(12)))


def _lines_of_people(folder: Path) -> None:
    """Write a text per frame, with a line per person: class, box, and 17 keypoints."""
    for camera in ("cam01", "cam02"):
        (folder / camera / "labels").mkdir(parents=True)
        for frame in range(3):
            numbers = [0, *_RANDOM.uniform(0.1, 0.9, 4 + 51)]
            (folder / camera / "labels" / f"{camera}_{frame + 1}.txt").write_text(
                " ".join(f"{n:g}" for n in numbers) + "\n"
            )


def _one_camera(folder: Path) -> None:
    """Write OpenPose's documents of one camera side by side."""
    for frame in range(3):
        people = [{"pose_keypoints_2d": _RANDOM.uniform(1, 400, 51).tolist()}]
        (folder / f"walk_{frame:06d}.json").write_text(json.dumps({"version": 1.3, "people": people}))


def _deeplabcut(folder: Path) -> None:
    head = [["scorer", *["net"] * 51], ["bodyparts", *(n for n in JointSet.COCO_17.keypoints for _ in range(3))],
            ["coords", *["x", "y", "likelihood"] * 17]]  # fmt: skip
    rows = [[str(frame), *(f"{n:g}" for n in _RANDOM.uniform(0, 1, 51))] for frame in range(3)]
    (folder / "cam01DLC_resnet50.csv").write_text("\n".join(map(",".join, head + rows)))


def _people(folder: Path) -> object:
    sources = camera_sources(folder)
    return read_detections(sources, joint_set=JointSet.COCO_17) if sources else None


def _results(form: str) -> bytes:
    """Return AlphaPose's default, ``open`` or ``cmu`` results of one camera."""
    flat = [_RANDOM.uniform(1, 400, 51).tolist() for _ in range(3)]
    if form == "list":
        return json.dumps([{"image_id": f"{f}.jpg", "keypoints": k} for f, k in enumerate(flat)]).encode()
    key, points = ("people", "pose_keypoints_2d") if form == "open" else ("bodies", "joints")
    return json.dumps({f"{f}.jpg": {key: [{points: k}]} for f, k in enumerate(flat)}).encode()


def _gloves(folder: Path) -> None:
    rokoko_csv(folder / "a.csv", drawn_gloves())


_CAMERA_KINDS = {
    ".pickle": "pickle",
    ".json": "json",
    ".yaml": "text",
    ".yml": "text",
    ".xml": "text",
    ".xcp": "text",
    ".txt": "table",
}


_MATRIX = [[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 1.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
_TURNED = {"translation": [0.1, 0.2, 1.5], "rotation": [0.0, 0.0, 0.0, 1.0]}
_PATHS = (
    file("path.txt", "".join(f"{1.7e9 + n / 30:.6f} 0.1 0.2 {n / 30:.4f} 0 0 0 1\n" for n in range(6))),
    file(
        "images.txt",
        "# list\n" + "".join(f"{n} 1 0 0 0 0.1 0.2 {n / 9:.3f} 1 a_{n:04}.jpg\n1 2 -1\n" for n in range(6)),
    ),
    file("path.json", json.dumps([{"timestamp": n / 30, "transform": np.ravel(_MATRIX).tolist()} for n in range(6)])),
    file("path.json", json.dumps({"frames": [{"frame": n, "transform_matrix": _MATRIX} for n in range(6)]})),
    file("path.json", json.dumps({"frames": [{"frame": n, **_TURNED} for n in range(6)]})),
)
"""Paths of a carried camera as programs write them."""


def _described(folder: Path, **more: object) -> None:
    (folder / "own.onnx").write_bytes(b"")
    values = {"model": "own.onnx", "joint_set": "COCO_17", "size": [192, 256], "decoding": "simcc"}
    (folder / "own.json").write_text(json.dumps(values | more))


def _described_in_full(folder: Path) -> None:
    _described(folder, **DEFAULTS)


def _description(folder: Path) -> object:
    """Read a detector's description as the program does, and then as the detector's process does."""
    choice = chosen_detector(str(folder / "own.json"))
    try:
        return read_description(choice.options["description"])
    except Refused as error:
        raise MocapError(str(error)) from error


TARGETS: tuple[Target, ...] = (
    Target("markers, QTM's MATLAB", (file("a.mat", mat_of_qtm()), file("a.mat", mat_of_qtm(packed=True))),
           lambda f: read_markers(f / "a.mat"), {".mat": "binary"}),
    Target("markers, array", (_points, _named_points),
           lambda f: read_markers(f / "a.npy", fps=30.0, unit="m"), {".npy": "binary"}),
    Target("detections, lines", (_lines_of_people,), _people, {".txt": "table"}),
    Target("detections, one camera", (_one_camera,), _people, {".json": "json"}),
    Target("detections, DeepLabCut", (_deeplabcut,), _people, {".csv": "table"}),
    Target("markers, segments of C3D", (file("a.c3d", file_of(np.ones((3, 4, 3)), np.ones((3, 4), bool))),),
           lambda f: read_segments(f / "a.c3d"), {".c3d": "binary"}),
    Target("gloves", (_gloves, lambda f: manus_csv(f / "left.csv", drawn_gloves(), 0)),
           lambda f: read_gloves(next(f.iterdir()), "left"), {".csv": "table"}),
    Target("skeleton of a clip", (_skeleton,), lambda f: read_skeleton(f / "a.npz"), {".npz": "npz"}),
    Target("actor of a clip", (_actor,), lambda f: read_actor_file(f / "a.npz"), {".npz": "npz"}),
    Target("header of glTF", (_glb, file("a.gltf", json.dumps(_GLTF))), _gltf, {".glb": "binary", ".gltf": "json"}),
    Target("live poses, unfinished", (_poses,), _finished, {".recording": "binary"}),
    Target("calibration of other programs",
           (*program_calibrations.WRITERS, *program_calibrations.PAIRS), calibrations_in, _CAMERA_KINDS),
    Target("results of AlphaPose", tuple(file("cam01.json", _results(form)) for form in ("list", "open", "cmu")),
           _people, {".json": "json"}),
    Target("detections, HDF5", (), _people, {".slp": "binary", ".h5": "binary"},
           (file("a.slp", b"\x89HDF\r\n\x1a\n" + bytes(90)), file("aDLC_resnet.h5", b"\x89HDF\r\n\x1a\n" + bytes(90)))),
    Target("path of a carried camera", (), lambda f: read_camera_path(next(f.iterdir()), 6, 30.0),
           {".txt": "table", ".json": "json"}, _PATHS),
    Target("description of a detector", (_described, _described_in_full), _description, {".json": "json"}),
    Target("focal length of a picture", (file("a.jpg", b"\xff\xd8\xff\xe1" + bytes(30)),),
           lambda f: recorded_focal_mm(f / "a.jpg"), {".jpg": "binary"}),
)  # fmt: skip
