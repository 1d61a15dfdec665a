"""Write the files of a shot: images (``kind/camera/000000.png``), annotations, trials and scenes."""

from __future__ import annotations

import json
import struct
import zlib
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType

import numpy as np

from solver_backend.body.body import Body
from solver_backend.camera_calibration.formats import pose2sim_toml
from solver_backend.exchange.body_layout import FAMILY
from solver_backend.exchange.npz import write_npz
from solver_backend.io.png import png_bytes
from solver_backend.synthesis.studio.costume import LABELS
from solver_backend.synthesis.studio.stage import Stage
from solver_backend.synthesis.studio.truth import OUTSIDE, VISIBLE, Truth
from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D

_MAGIC, _VERSION = 20000630, 2
_FLOAT, _ZIP = 2, 3
_LINES = 16  # Number of lines per ZIP-compressed block in OpenEXR.


def exr_bytes(channels: Mapping[str, np.ndarray]) -> bytes:
    """Encode (h, w) float32 channels, such as 'Z' or 'R', 'G', 'B', as an OpenEXR image."""
    names = sorted(channels)
    planes = np.stack([np.asarray(channels[name], "<f4") for name in names], axis=1)
    height, _, width = planes.shape
    header = _header(names, width, height)
    chunks = []
    for top in range(0, height, _LINES):
        raw = planes[top : top + _LINES].tobytes()
        packed = zlib.compress(_predicted(raw), level=1)
        data = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", top, len(data)) + data)
    first = len(header) + 8 * len(chunks)
    starts = first + np.cumsum([0, *map(len, chunks[:-1])])
    return b"".join([header, starts.astype("<u8").tobytes(), *chunks])


def _header(names: list[str], width: int, height: int) -> bytes:
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", _FLOAT, 0, 1, 1) for name in names) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    one, header = struct.pack("<f", 1.0), struct.pack("<ii", _MAGIC, _VERSION)
    values = [("channels", "chlist", listed), ("compression", "compression", bytes([_ZIP]))]
    values += [("dataWindow", "box2i", window), ("displayWindow", "box2i", window), ("lineOrder", "lineOrder", b"\0")]
    values += [("pixelAspectRatio", "float", one), ("screenWindowCenter", "v2f", bytes(8))]
    for name, kind, value in [*values, ("screenWindowWidth", "float", one)]:
        header += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    return header + b"\0"


def _predicted(raw: bytes) -> bytes:
    """Prepare bytes for compression: even positions, then odd positions, each minus the previous byte."""
    data = np.frombuffer(raw, np.uint8)
    parted = np.concatenate([data[0::2], data[1::2]]).astype(np.int16)
    parted[1:] = parted[1:] - parted[:-1] + 128
    return parted.astype(np.uint8).tobytes()


EXR = "exr"  # Kind of floating-point images, which store the normal as R, G, B and the depth as Z.
_NOISY = ("infrared", "depth")
_WAITING = 16  # Maximum number of images waiting to be written.


class PictureWriter:
    """Writes images in a thread while other images are rendered. The number of waiting images is limited."""

    def __init__(self, folder: Path, cameras: tuple[str, ...]) -> None:
        self._folder, self._cameras = folder, cameras
        self._pool = ThreadPoolExecutor(1)
        self._waiting: deque[Future[None]] = deque()

    def __enter__(self) -> PictureWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            while self._waiting and error is None:
                self._waiting.popleft().result()
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def __call__(self, kind: str, view: int, frame: int, picture: np.ndarray) -> None:
        """Queue an image for writing. Raise the error of an earlier image that could not be written."""
        folder = self._folder / kind / self._cameras[view]
        if frame == 0:
            folder.mkdir(parents=True, exist_ok=True)
        suffix = "exr" if kind == EXR else "png"
        self._waiting.append(self._pool.submit(_write, folder / f"{frame:06d}.{suffix}", picture, kind in _NOISY))
        while len(self._waiting) > _WAITING:
            self._waiting.popleft().result()


def _write(path: Path, picture: np.ndarray, noisy: bool) -> None:
    exr = path.suffix == ".exr"
    channels = {name: picture[..., i] for i, name in enumerate("RGBZ")} if exr else {}
    path.write_bytes(exr_bytes(channels) if exr else png_bytes(picture, noisy=noisy))


_BONES = "16-14 14-12 17-15 15-13 12-13 6-12 7-13 6-7 6-8 7-9 8-10 9-11 2-3 1-2 1-3 2-4 3-5 4-6 5-7"
_SKELETON = [[int(point) for point in bone.split("-")] for bone in _BONES.split()]


def coco_text(cameras: Cameras, truth: Truth, pictures: str, shot: str) -> str:
    """Return the COCO annotations of a shot as JSON. ``pictures`` is the folder of the images."""
    chosen = JointSet.COCO_17
    xy, visibility = truth.xy[chosen], truth.visibility[chosen]
    state = np.where(visibility == VISIBLE, 2, np.where(visibility == OUTSIDE, 0, 1))
    images, annotations = [], []
    for view, name in enumerate(cameras.names):
        width, height = cameras.image_size[view].tolist()
        for frame in range(xy.shape[1]):
            number, file = view * xy.shape[1] + frame, f"{pictures}/{name}/{frame:06d}.png"
            images.append({"id": number, "file_name": file, "width": width, "height": height})
            box = truth.boxes[view, frame]
            if not np.isfinite(box).all():
                continue
            known = state[view, frame] > 0
            rows = np.where(known[:, None], np.round(xy[view, frame], 2), 0.0)
            flat = np.concatenate([rows, state[view, frame][:, None]], axis=1).ravel().tolist()
            size = np.round([box[0], box[1], box[2] - box[0], box[3] - box[1]], 2)
            person = {"id": number, "image_id": number, "category_id": 1, "iscrowd": 0, "bbox": size.tolist()}
            person |= {"area": round(float(size[2] * size[3]), 1), "num_keypoints": int(known.sum())}
            person |= {"keypoints": [int(v) if i % 3 == 2 else v for i, v in enumerate(flat)]}
            annotations.append(person | {"truncation": round(1.0 - float(truth.inside[view, frame]), 4)})
    category = {"id": 1, "name": "person", "supercategory": "person"}
    category |= {"keypoints": list(chosen.keypoints), "skeleton": _SKELETON}
    info = {"description": shot, "note": "pixel (0, 0) is the centre of the top-left pixel"}
    return json.dumps({"info": info, "images": images, "annotations": annotations, "categories": [category]})


_MODELS = {JointSet.COCO_WHOLEBODY_133: "COCO_133", JointSet.MEDIAPIPE_33: "BLAZEPOSE"}  # Others have the same name.
_TRIANGULATION = """
[triangulation]
reproj_error_threshold_triangulation = 15
likelihood_threshold_triangulation = 0.3
min_cameras_for_triangulation = 2
undistort_points = true
interp_if_gap_smaller_than = 20
interpolation = 'linear'
remove_incomplete_frames = false
sections_to_keep = 'all'
min_chunk_size = 10
fill_large_gaps_with = 'last_value'
show_interp_indices = true
make_c3d = false
"""
"""Settings that Pose2Sim's triangulation requires, with Pose2Sim's default values."""
_WRITTEN = {JointSet.COCO_WHOLEBODY_133: 133}  # Number of keypoints in a file if it exceeds the joint set's.


def write_trial(folder: Path, capture: Capture) -> Path:
    """Write the keypoints of a multi-view capture as a new Pose2Sim trial."""
    cameras, keypoints = capture.require_multiview()
    (folder / "calibration").mkdir(parents=True)
    (folder / "calibration" / "Calib.toml").write_text(pose2sim_toml(cameras, 0.0), encoding="utf-8", newline="\n")
    for view, name in enumerate(cameras.names):
        target = folder / "pose" / f"{name}_json"
        target.mkdir(parents=True)
        for frame in range(keypoints.num_frames):
            path = target / f"{name}_{frame:012d}_keypoints.json"
            path.write_text(frame_text(keypoints, view, frame), encoding="utf-8", newline="\n")
    model = _MODELS.get(keypoints.joint_set, keypoints.joint_set.value)
    config = (
        f"[project]\nmulti_person = false\nframe_rate = {keypoints.fps:g}\nframe_range = []\n\n"
        f"[pose]\npose_model = '{model}'\n{_TRIANGULATION}"
    )
    (folder / "Config.toml").write_text(config, encoding="utf-8", newline="\n")
    return folder


def frame_text(keypoints: Keypoints2D, view: int, frame: int) -> str:
    """Return one frame of keypoints in OpenPose's JSON format. Missing keypoints are 0 0 0."""
    xy, confidence = keypoints.xy[view, frame], keypoints.confidence[view, frame]
    count = _WRITTEN.get(keypoints.joint_set, len(xy))
    rows = np.zeros((count, 3))
    rows[: len(xy), :2], rows[: len(xy), 2] = np.nan_to_num(xy), confidence
    flat = [round(float(v), 3) for v in rows.ravel()]
    people = [{"person_id": [-1], "pose_keypoints_2d": flat}] if (confidence > 0).any() else []
    return json.dumps({"version": 1.3, "people": people})


FORMAT, VERSION = "manifold_mocap_studio_scene", 1


def write_scene(path: Path, stage: Stage) -> Path:
    """Write the static parts of a shot's scene, without motion and cameras."""
    costume, room = stage.costume, stage.room
    arrays = {"format": np.array(FORMAT), "version": np.array(VERSION), "base": costume.base.astype(np.int32)}
    arrays |= {"offset_m": costume.offset_m.astype(np.float32), "faces": costume.faces.astype(np.int32)}
    arrays |= {"label": costume.label, "labels": np.array(LABELS), "outfit": np.array(stage.outfit)}
    arrays |= {"rest": stage.person.body.v_template[costume.base].astype(np.float32)}
    arrays |= {"room": np.stack([room.low, room.high]), "walls": np.array(room.walls), "furniture": room.furniture}
    return write_npz(path, arrays)


def write_body(path: Path, body: Body) -> Path:
    """Write a body file for ``load_body``, including the names of joints outside the SMPL family."""
    layout = body.layout
    known = FAMILY.get(layout.num_joints)
    own = known is None or known.joints != layout.joints
    joints = {"joint_names": np.array(layout.joints), "joint_groups": np.array(layout.groups)} if own else {}
    real = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights")
    arrays = joints | {key: getattr(body, key).astype(np.float32) for key in real} | {"f": body.faces.astype(np.int32)}
    arrays |= {"kintree_table": np.stack([layout.parents, np.arange(layout.num_joints)]), "body_id": np.array(body.id)}
    return write_npz(path, arrays)
