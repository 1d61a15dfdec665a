"""Files of networks' results, written from one motion as each program's public code lays them out."""

from __future__ import annotations

import json
import pickle
import zlib
from collections import defaultdict
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.geometry.rotations import log_so3

Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class FilmedMotion:
    """A motion before a camera, in the camera's axes and in a world with Z up."""

    body: Body
    root: np.ndarray  # (F, 3, 3) in the world.
    local: np.ndarray  # (F, 21, 3, 3)
    transl: np.ndarray  # (F, 3)
    R: np.ndarray  # (3, 3) from the world to the camera.
    t: np.ndarray  # (3,)
    fingers: np.ndarray | None = None  # (F, 30, 3) rotation vectors, SMPL-X's order.

    @property
    def vectors(self) -> np.ndarray:
        """(F, 21, 3) rotation vectors of the body's joints."""
        return np.asarray(log_so3(self.local)).astype(np.float32)

    def roots(self, R: np.ndarray) -> np.ndarray:
        """Return the (F, 3) rotation vectors of the pelvis in other axes."""
        return np.asarray(log_so3(R @ self.root)).astype(np.float32)

    def places(self, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return SMPL's translation in other axes: the pelvis' place without its place at rest."""
        pelvis = np.asarray(self.body.rest_joints(np.zeros(10)))[0]
        return ((self.transl + pelvis) @ R.T + t - pelvis).astype(np.float32)

    def points(self, joint_set: JointSet) -> np.ndarray:
        """Return the (F, K, 3) keypoints in the camera's axes about the pelvis."""
        landmarks = keypoint_landmarks(self.body, joint_set)
        posed = pose_landmarks(self.body, landmarks, np.zeros(10), self.root, self.local, 0.0 * self.transl).points
        return (np.asarray(posed) - np.asarray(self.body.rest_joints(np.zeros(10)))[0]) @ self.R.T


def write_network_file(program: str, motion: FilmedMotion, folder: Path) -> Path:
    """Write a result as the program does, and return its path."""
    return _WRITERS[program](motion, folder)


def _smpl(motion: FilmedMotion, R: np.ndarray, t: np.ndarray) -> dict[str, Any]:
    """Return SMPL's parameters of 24 joints as one array and a place."""
    count = len(motion.root)
    hands = np.zeros((count, 6), np.float32)
    pose = np.concatenate([motion.roots(R), motion.vectors.reshape(count, -1), hands], axis=1)
    return {"pose": pose, "trans": motion.places(R, t)}


def _gvhmr(motion: FilmedMotion, folder: Path) -> Path:
    import torch

    def group(R: np.ndarray, t: np.ndarray) -> dict[str, Any]:
        count = len(motion.root)
        values = {"body_pose": motion.vectors.reshape(count, -1), "global_orient": motion.roots(R)}
        values |= {"betas": np.zeros((count, 10), np.float32), "transl": motion.places(R, t)}
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}

    path, eye = folder / "hmr4d_results.pt", torch.eye(3)[None].repeat(len(motion.root), 1, 1)
    content = {"smpl_params_global": group(Z_UP_TO_Y_UP, np.zeros(3)), "smpl_params_incam": group(motion.R, motion.t)}
    torch.save({**content, "K_fullimg": eye, "net_outputs": {"model_output": {"pred_x": eye}}}, path)
    return path


def _gem(motion: FilmedMotion, folder: Path) -> Path:
    import torch

    from solver_backend.io.motions.network_results import _SOMA_FINGERS, _SOMA_OF

    count = len(motion.root)
    pose = np.zeros((count, 77, 3), np.float32)
    pose[:, list(_SOMA_OF[1:])] = motion.vectors
    if motion.fingers is not None:
        pose[:, [joints[-1] for joints in _SOMA_FINGERS]] = motion.fingers

    def group(R: np.ndarray, t: np.ndarray) -> dict[str, Any]:
        values = {"global_orient": motion.roots(R), "body_pose": pose[:, 1:].reshape(count, -1)}
        values |= {"identity_coeffs": np.zeros((count, 45), np.float32), "transl": motion.places(R, t)}
        return {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}

    path = folder / "hpe_results.pt"
    content = {"body_params_global": group(Z_UP_TO_Y_UP, np.zeros(3)), "body_params_incam": group(motion.R, motion.t)}
    torch.save(content, path)
    return path


def _wham(motion: FilmedMotion, folder: Path) -> Path:
    world = _smpl(motion, Z_UP_TO_Y_UP, np.zeros(3))
    people: Any = defaultdict(dict)
    people[1] = {
        **_smpl(motion, motion.R, motion.t),
        "pose_world": world["pose"],
        "trans_world": world["trans"],
        "betas": np.zeros((len(motion.root), 10), np.float32),
        "verts": np.zeros((len(motion.root), 8, 3), np.float32),
        "frame_ids": np.arange(len(motion.root)),
    }
    return _joblib(people, folder / "wham_output.pkl")


def _open_cap(motion: FilmedMotion, folder: Path) -> Path:
    world = _smpl(motion, Z_UP_TO_Y_UP, np.zeros(3))
    person = {
        "pose_world": world["pose"],
        "pose": world["pose"],
        "trans_world": world["trans"],
        "trans": world["trans"],
        "betas": np.zeros((len(motion.root), 10)),
        "frame_ids": np.arange(len(motion.root)),
        "n_frames": len(motion.root),
        "trial_name": "walk",
        "cam_R": (motion.R @ Z_UP_TO_Y_UP.T).astype(np.float32),
        "cam_T": motion.t.astype(np.float32),
    }
    return _joblib({"0": person}, folder / "walk_optimized.pkl")


def _tram(motion: FilmedMotion, folder: Path) -> Path:
    import torch

    count = len(motion.root)
    turns = np.tile(np.eye(3, dtype=np.float32), (count, 24, 1, 1))
    turns[:, 0], turns[:, 1:22] = motion.R @ motion.root, motion.local
    values = {"pred_rotmat": turns, "pred_shape": np.zeros((count, 10), np.float32)}
    values |= {"pred_trans": motion.places(motion.R, motion.t)[:, None], "frame": np.arange(count)}
    path = folder / "hps_track_0.npy"
    content: Any = {name: torch.from_numpy(np.ascontiguousarray(value)) for name, value in values.items()}
    np.save(path, content, allow_pickle=True)
    return path


def _prompt(motion: FilmedMotion, folder: Path) -> Path:
    count = len(motion.root)

    def smplx(R: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        fingers = np.zeros((count, 90)) if motion.fingers is None else motion.fingers.reshape(count, 90)
        parts = [motion.roots(R), motion.vectors.reshape(count, -1), np.zeros((count, 9)), fingers]
        pose = np.concatenate(parts, axis=1).astype(np.float32)
        return {"pose": pose, "shape": np.zeros((count, 10), np.float32), "trans": motion.places(R, t)}

    world, camera = smplx(Z_UP_TO_Y_UP, np.zeros(3)), smplx(motion.R, motion.t)
    person = {"frames": np.arange(count), "track_id": 1, "smplx_cam": camera, "smplx_world": world}
    return _joblib({"camera": {}, "people": {1: person}, "has_slam": True}, folder / "results.pkl")


def _phalp(motion: FilmedMotion, folder: Path) -> Path:
    frames = {}
    for f in range(len(motion.root)):
        turns = np.tile(np.eye(3, dtype=np.float32), (24, 1, 1))
        turns[0], turns[1:22] = motion.R @ motion.root[f], motion.local[f]
        smpl = {"global_orient": turns[:1], "body_pose": turns[1:], "betas": np.zeros(10, np.float32)}
        place = motion.places(motion.R, motion.t)[f]
        frames[f"img/{f:06d}.jpg"] = {"time": f, "tid": [1], "smpl": [smpl], "camera": [place], "bbox": [np.zeros(4)]}
    return _joblib(frames, folder / "demo_video.pkl", compress=True)


def _sam(motion: FilmedMotion, folder: Path) -> Path:
    path = folder / "sam3d.npz"
    np.savez(path, pred_keypoints_3d=_mhr(motion), mhr_model_params=np.zeros((len(motion.root), 204)))
    return path


def _instant(motion: FilmedMotion, folder: Path) -> Path:
    path = folder / "instanthmr.npz"
    np.savez(path, joints_3d=_mhr(motion), frame_idx=np.arange(len(motion.root)))
    return path


def _mhr(motion: FilmedMotion) -> np.ndarray:
    """Return the 70 points. Those without a name are the wrists', as if the fists were closed."""
    from solver_backend.io.motions.network_results import _MHR

    body = motion.points(JointSet.COCO_WHOLEBODY_133)
    names = JointSet.COCO_WHOLEBODY_133.keypoints
    neck = body[:, [names.index(f"{side}_shoulder") for side in ("left", "right")]].mean(axis=1)
    columns = [names.index(name) if name in names else 0 for name in _MHR]
    points = body[:, columns]
    points[:, [k for k, name in enumerate(_MHR) if not name]] = np.nan
    points[:, -1] = neck
    return points.astype(np.float32)


def _media_pipe(motion: FilmedMotion, folder: Path) -> Path:
    frames = [
        {"pose_world_landmarks": [[dict(zip("xyz", map(float, point), strict=True)) for point in points]]}
        for points in motion.points(JointSet.MEDIAPIPE_33)
    ]
    path = folder / "landmarks.json"
    path.write_text(json.dumps(frames))
    return path


def _rtmw(motion: FilmedMotion, folder: Path) -> Path:
    points = motion.points(JointSet.COCO_WHOLEBODY_133)
    whole = np.concatenate([points, np.repeat(points[:, :1], 133 - points.shape[1], axis=1)], axis=1)
    world = -whole[..., [0, 2, 1]]
    world[..., 2] -= world[..., 2].min(axis=1, keepdims=True)
    info = [{"frame_id": f, "instances": [{"keypoints": frame.tolist()}]} for f, frame in enumerate(world)]
    path = folder / "results_walk.json"
    path.write_text(json.dumps({"meta_info": {}, "instance_info": info}))
    return path


def _motion_bert(motion: FilmedMotion, folder: Path) -> Path:
    points = 0.4 * motion.points(JointSet.H36M_17)
    np.save(folder / "X3D.npy", points.astype(np.float32))
    return folder / "X3D.npy"


class _Wrapper:
    """Stands for joblib's description of an array, under its name."""

    def __init__(self, array: np.ndarray) -> None:
        self.__dict__ |= {"subclass": np.ndarray, "shape": array.shape, "order": "C", "dtype": array.dtype}
        self.__dict__ |= {"allow_mmap": True, "numpy_array_alignment_bytes": 16}


class _Pickler(pickle._Pickler):  # type: ignore[name-defined]
    """Writes arrays behind their description, aligned to 16 bytes, as joblib 1.4 does."""

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if type(obj) is not np.ndarray:
            super().save(obj, save_persistent_id)
            return
        wrapper = _Wrapper(obj)
        self.write(pickle.GLOBAL + b"joblib.numpy_pickle\nNumpyArrayWrapper\n" + pickle.EMPTY_TUPLE + pickle.NEWOBJ)
        super().save({name: value for name, value in wrapper.__dict__.items() if name != "subclass"})
        self.write(pickle.BUILD)
        self.framer.commit_frame(force=True)
        padding = 16 - (self._file.tell() + 1) % 16
        self._file.write(bytes([padding]) + b"\xff" * padding + np.ascontiguousarray(obj).tobytes())

    @property
    def _file(self) -> Any:
        return self.file


def _joblib(content: Any, path: Path, compress: bool = False) -> Path:
    stream = BytesIO()
    pickler = _Pickler(stream, protocol=4)
    pickler.file = stream
    pickler.dump(content)
    path.write_bytes(zlib.compress(stream.getvalue(), 3) if compress else stream.getvalue())
    return path


_WRITERS = {
    "GVHMR": _gvhmr,
    "GEM-X": _gem,
    "WHAM": _wham,
    "OpenCap Monocular": _open_cap,
    "TRAM": _tram,
    "PromptHMR": _prompt,
    "4D-Humans": _phalp,
    "SAM 3D Body": _sam,
    "InstantHMR": _instant,
    "MediaPipe": _media_pipe,
    "RTMW3D": _rtmw,
    "MotionBERT": _motion_bert,
}
PROGRAMS = tuple(_WRITERS)
ROTATIONS = ("GVHMR", "GEM-X", "WHAM", "OpenCap Monocular", "TRAM", "PromptHMR", "4D-Humans")
